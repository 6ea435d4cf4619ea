"""What time steps launch, compiled side by side before the first of them.

Modules that are not listed are compiled when they are launched first, one after the other.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType

import warp as wp

from wrod.kernels.compiling import compile_ahead, compile_together
from wrod.kernels.lanes import TEAM, WARP

_WIDE = 256  # Warp's own
# Modules of `wrod.kernels`, by the size of the blocks in which they are launched.
_STEPS = {
    WARP: ("stepping.dynamics", "stepping.newton_iteration", "linear.banded_lanes"),
    _WIDE: (
        "elastic.bending",
        "elastic.frames",
        "elastic.loads",
        "stepping.continuation",
        "contact.planes",
    ),
}
_LAYING = {_WIDE: ("stepping.grip",)}
# What a CPU has instead.
_ON_CPU = {"linear.banded_lanes": "linear.banded"}
_COUPLED = {
    WARP: ("contact.touching",),
    TEAM: ("linear.skyline_order", "linear.skyline_lanes", "linear.coupling"),
    _WIDE: ("contact.rods", "contact.pairs", "stepping.hands"),
}


@cache
def compile_steps(device: str, *, coupled: bool = False) -> None:
    """Compile what simulated deployments launch; on a GPU, with `coupled`, what rods do that touch
    rods instead of those that a grip lays."""
    compile_together(device, _launched(device, coupled))


@cache
def compile_steps_ahead(device: str) -> None:
    """Begin to compile what simulated deployments launch, while something else is done."""
    compile_ahead(device, _launched(device, False))


def _launched(device: str, coupled: bool) -> list[tuple[ModuleType, int]]:
    on_cpu = wp.get_device(device).is_cpu
    if on_cpu and coupled:
        return []
    names = [
        (_ON_CPU.get(name, name) if on_cpu else name, block)
        for table in (_STEPS, _COUPLED if coupled else _LAYING)
        for block, row in table.items()
        for name in row
    ]
    return [(import_module(f"wrod.kernels.{name}"), block) for name, block in names]
