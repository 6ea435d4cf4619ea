"""Modules compiled side by side, before the first of their kernels is launched one after the other,
or while something else is done.

A module is compiled for each size of block that its kernels are launched in; a CPU has one.
"""

import os
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from types import ModuleType

import warp as wp

# Names of threads that stay and launch nothing.
COMPILERS = "wrod-compilers"


@cache
def _compilers() -> ThreadPoolExecutor:
    # Each compiles Warp's headers first: more of them than usable cores only take time.
    cores = (
        os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    )
    return ThreadPoolExecutor(len(cores), thread_name_prefix=COMPILERS)


@cache
def _begun(device: str, module: wp.Module, block: int) -> Future:
    return _compilers().submit(wp.force_load, device, [module], block_dim=block)


def _forget() -> None:
    """A process that was forked has none of the threads of the one before: what it waited for would
    never come. Modules that were loaded are."""
    _compilers.cache_clear()
    _begun.cache_clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def compile_ahead(
    device: str, launches: Iterable[tuple[wp.Kernel | ModuleType, int]]
) -> list[Future]:
    """Begin to compile the modules of kernels, or Python modules with all their kernels, for their
    block sizes, as far as that was not begun before; in that order."""
    on_cpu = wp.get_device(device).is_cpu
    wanted = dict.fromkeys((_module(what), 1 if on_cpu else block) for what, block in launches)
    return [_begun(device, module, block) for module, block in wanted]


def compile_together(device: str, launches: Iterable[tuple[wp.Kernel | ModuleType, int]]) -> None:
    """Compile them, and wait until they are."""
    wait(compile_ahead(device, launches))


def wait(begun: Iterable[Future]) -> None:
    """Wait until they are compiled; where that is interrupted no more of them are begun, for which
    the end of the process would wait."""
    try:
        for one in begun:
            one.result()
    except KeyboardInterrupt:
        _compilers().shutdown(wait=False, cancel_futures=True)
        _forget()
        raise


def _module(what: wp.Kernel | ModuleType) -> wp.Module:
    return wp.get_module(what.__name__) if isinstance(what, ModuleType) else what.module
