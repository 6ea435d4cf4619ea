"""wrod plans and proves how a robot lays a rod along a pattern.

Public names are imported when first used, so that `import wrod` stays light; they are listed, with
their modules, in `__init__.pyi`, which editors and type checkers read.
"""

from functools import cache as _cache
from importlib import import_module as _import_module

# The only place of it: the package, datasets and benchmarks read it here.
__version__ = "0.1.0"

# Rooms that are reached through the package, as in `wrod.identification.load_motion`.
_ROOMS = (
    "deployment", "errors", "grasps", "identification", "knots", "newton_solver", "patterns",
    "perception", "planning", "robot", "rods", "scene", "solvers", "training",
)  # fmt: skip


@_cache
def _public():
    """What gives public names, and lists them. `python -m wrod` loads this package before its own
    first line, which says what is missing: of lazy_loader, too."""
    import lazy_loader

    return lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name):
    if name in _ROOMS:
        return _import_module(f"wrod.{name}")
    public, _, names = _public()
    return names if name == "__all__" else public(name)


def __dir__():
    return _public()[1]()
