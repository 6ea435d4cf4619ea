"""What time steps launch on a GPU, compiled side by side before the first of them.

Modules that are not listed are compiled when they are launched first, one after the other.
"""

from functools import cache
from importlib import import_module
from types import ModuleType

import warp as wp

from wrod.kernels.compiling import compile_together
from wrod.kernels.lanes import TEAM, WARP
from wrod.kernels.linear.two_warps import ENDS

_WIDE = 256  # Warp's own
# Modules of `wrod.kernels`, by the size of the blocks in which they are launched; a kernel after a
# colon has a module of its own.
_STEPS = {
    WARP: ("stepping.pace", "stepping.newton_iteration", "elastic.bending:elasticity"),
    ENDS: ("linear.banded_ends",),
    _WIDE: (
        "elastic.frames",
        "elastic.loads",
        "stepping.continuation",
        "contact.planes",
        "stepping.dynamics",
        "stepping.viscosity",
    ),
}
_LAYING = {_WIDE: ("stepping.grip",)}
_COUPLED = {
    WARP: ("contact.touching", "linear.banded_lanes"),
    TEAM: (
        "linear.skyline_order",
        "linear.skyline_ends",
        "linear.skyline_lanes",
        "linear.coupling",
    ),
    _WIDE: ("contact.rods", "contact.pairs", "stepping.hands"),
}


@cache
def compile_steps(device: str, *, coupled: bool = False) -> None:
    """Compile, on a GPU, what simulated deployments launch; of rods that touch rods with `coupled`
    instead of those that a grip lays."""
    if wp.get_device(device).is_cpu:
        return
    tables = (_STEPS, _COUPLED if coupled else _LAYING)
    names = [(name, block) for table in tables for block, row in table.items() for name in row]
    compile_together(device, [(_found(name), block) for name, block in names])


def _found(name: str) -> wp.Kernel | ModuleType:
    place, _, kernel = name.partition(":")
    module = import_module(f"wrod.kernels.{place}")
    return getattr(module, kernel) if kernel else module
