"""Modules compiled side by side, before the first of their kernels is launched one after the other.

A module is compiled for each size of block that its kernels are launched in; a CPU has one.
"""

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType

import warp as wp


def compile_together(device: str, launches: Iterable[tuple[wp.Kernel | ModuleType, int]]) -> None:
    """Compile, as far as that was not done before, the modules of kernels, or Python modules with
    all their kernels, for their block sizes."""
    on_cpu = wp.get_device(device).is_cpu
    wanted = {(_module(what), 1 if on_cpu else block) for what, block in launches}

    def load(one: tuple) -> None:
        wp.force_load(device, [one[0]], block_dim=one[1])

    with ThreadPoolExecutor(min(len(wanted), os.cpu_count() or 1)) as pool:
        list(pool.map(load, wanted))


def _module(what: wp.Kernel | ModuleType) -> wp.Module:
    return wp.get_module(what.__name__) if isinstance(what, ModuleType) else what.module
