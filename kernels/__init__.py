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


def _leave_adjoints_out() -> None:
    """Say so of every module here, before any is imported."""
    for module in pkgutil.walk_packages(__path__, f"{__name__}."):
        wp.set_module_options({"enable_backward": False}, module.name)


_start_quietly()
_leave_adjoints_out()
