"""Modules compiled side by side, before the first of their kernels is launched one after the other.

A module is compiled for each size of block that its kernels are launched in; a CPU has one.
"""

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import warp as wp


def compile_together(device: str, launches: Iterable[tuple[wp.Kernel, int]]) -> None:
    """Compile, as far as that was not done before, the modules of kernels for their block sizes."""
    on_cpu = wp.get_device(device).is_cpu
    wanted = {(kernel.module, 1 if on_cpu else block) for kernel, block in launches}

    def load(one: tuple) -> None:
        wp.force_load(device, [one[0]], block_dim=one[1])

    with ThreadPoolExecutor(min(len(wanted), os.cpu_count() or 1)) as pool:
        list(pool.map(load, wanted))
