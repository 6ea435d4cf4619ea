"""Warp device code: one physics term a file. No allocation, no launch, no policy.

Nothing of it is differentiated by Warp, which compiles half as much then.
"""

import os
import pkgutil
import sys

import warp as wp

wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)


def _start_quietly() -> None:
    """Start Warp without its note that there is no CUDA driver: it goes to the process's standard
    error past every setting, and a user of wrod on a CPU did not ask."""
    sys.stderr.flush()
    kept = os.dup(2)
    if not os.environ.get("WARP_CACHE_PATH", "none"):
        del os.environ["WARP_CACHE_PATH"]  # Warp would take an empty one for the working folder
    if not os.path.isabs(os.environ.get("XDG_CACHE_HOME", "/")):
        del os.environ["XDG_CACHE_HOME"]  # as its specification asks of one that is relative
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)


# Options of all modules: a CPU multiplies and adds at once, as a GPU does, also across Warp's
# functions, which Warp alone asks no CPU to do. LLVM's own options are those of the process, whose
# threads compile side by side: the same for all.
_FLAGS = "-march=native" if wp.config.cpu_compiler_flags is None else wp.config.cpu_compiler_flags
FUSED = {"cpu_compiler_flags": f"{_FLAGS} -ffp-contract=fast"}


def _set_options() -> None:
    """Of every module here, before any is imported."""
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        wp.set_module_options({"enable_backward": False, **FUSED}, module.name)


_start_quietly()
_set_options()
