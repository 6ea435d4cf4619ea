"""wrod plans and proves how a robot lays a rod along a pattern.

Public names are imported when first used, so that `import wrod` stays light; they are listed, with
their modules, in `__init__.pyi`, which editors and type checkers read.
"""

from importlib import import_module as _import_module

import lazy_loader

# The only place of it: the package, datasets and benchmarks read it here.
__version__ = "0.1.0"

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
# Rooms that are reached through the package, as in `wrod.identification.load_motion`.
_ROOMS = (
    "deployment", "errors", "grasps", "identification", "knots", "newton_solver", "patterns",
    "perception", "planning", "robot", "rods", "scene", "solvers", "training",
)  # fmt: skip


def __getattr__(name):
    return _import_module(f"wrod.{name}") if name in _ROOMS else _public(name)
