"""What time steps launch, compiled side by side before the first of them.

Modules that are not listed are compiled when they are launched first, one after the other; of
threads that launch them first at the same time, by each.
"""

from concurrent.futures import Future
from functools import cache
from importlib import import_module
from types import ModuleType

import warp as wp

from wrod.kernels.compiling import compile_ahead, wait
from wrod.kernels.lanes import TEAM, WARP
from wrod.kernels.linear.two_warps import ENDS

_WIDE = 256  # Warp's own
# Modules of `wrod.kernels`, by what launches them and the size of its blocks; a kernel after a
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
_MORE: dict[str, dict[int, tuple[str, ...]]] = {
    "grip": {_WIDE: ("stepping.grip",)},
    "hands": {_WIDE: ("stepping.hands",)},
    "pairs": {
        WARP: ("contact.touching", "linear.banded_lanes"),
        TEAM: (
            "linear.skyline_order",
            "linear.skyline_ends",
            "linear.skyline_lanes",
            "linear.coupling",
        ),
        _WIDE: ("contact.rods", "contact.pairs"),
    },
    "solids": {_WIDE: ("contact.edges", "contact.depths")},
    "simulator": {_WIDE: ("stepping.exchange", "stepping.carrying")},
    "bodies": {
        WARP: ("linear.banded_lanes",),
        _WIDE: (
            "stepping.bodies",
            "stepping.body_contact",
            "stepping.body_exchange",
            "stepping.body_meetings",
            "stepping.body_shapes",
            "stepping.body_system",
        ),
    },
    "gradients of steps": {
        _WIDE: (
            "stepping.adjoint",
            "stepping.exchange_adjoint",
            "stepping.model_adjoint",
            "contact.plane_adjoint",
        ),
    },
    "gradients of pairs": {
        TEAM: ("linear.skyline_lu",),
        _WIDE: ("contact.pair_adjoint", "stepping.adjoint:fill_coupled"),
    },
    "gradients of solids": {_WIDE: ("contact.edge_adjoint", "stepping.carrying_adjoint")},
    "gradients of bodies": {
        _WIDE: (
            "stepping.body_adjoint",
            "stepping.body_exchange_adjoint",
            "stepping.body_shapes_adjoint",
            "stepping.meeting_adjoint",
        ),
    },
}


# What a CPU launches where a GPU shares a rod out to lanes; and for derivatives of deployments.
_ON_CPU = {"linear.banded_ends": "linear.banded"}
_TANGENTS = (
    "stepping.deployment_tangents",
    "stepping.flow_tangents",
    "contact.linearised",
    "linear.banded_lu",
)


@cache
def compile_steps(device: str, *more: str) -> None:
    """Compile what time steps launch.

    Args:
        device: where; on a CPU what lays rods alone, which threads do: for one it is no gain.
        more: and what else does: a "grip" that lays rods or "hands" that tie them, "pairs" of rods
            that touch, "solids", the exchange with a "simulator", and its "bodies"; "gradients of"
            these; on a CPU "tangents" of deployments; default: all but gradients and tangents.
    """
    wait(compile_steps_ahead(device, *more))


def compile_steps_ahead(device: str, *more: str) -> list[Future]:
    """Begin to compile it, while something else is done."""
    more = more or tuple(name for name in _MORE if not name.startswith("gradients"))
    tables = (_STEPS, *(_MORE[name] for name in more if name in _MORE))
    names = {
        (name, block): None for table in tables for block, row in table.items() for name in row
    }
    if wp.get_device(device).is_cpu:
        if "grip" not in more:
            return []
        tangents = _TANGENTS if "tangents" in more else ()
        if tangents:
            from wrod.kernels.stepping import deployment_tangents

            deployment_tangents.vector_of(deployment_tangents.PACK)
        whole = [_ON_CPU.get(name, name) for name, _ in names] + [*tangents]
        names = {(name, 1): None for name in whole}
    return compile_ahead(device, [(_found(name), block) for name, block in names])


def _found(name: str) -> wp.Kernel | ModuleType:
    place, _, kernel = name.partition(":")
    module = import_module(f"wrod.kernels.{place}")
    return getattr(module, kernel) if kernel else module
