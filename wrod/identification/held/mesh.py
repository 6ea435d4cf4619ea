"""Cables that are held at their ends, as rods on meshes: the ends are the middles of edges."""

from collections.abc import Sequence

import numpy as np

from wrod.rods.batch import RodBatch
from wrod.rods.law import BendingLaw, Linear
from wrod.rods.model import RodModel
from wrod.solvers.statics import prescribe

# A cable hardly stretches: EA over B / L^2.
_STRETCH = 3e4
_LINEAR = Linear()


def cable_model(
    length: float,
    stiffness: float,
    line_mass: float,
    *,
    twist_ratio: float = 1.0,
    stretching: float = 0.0,
    curvature: float = 0.0,
    law: BendingLaw = _LINEAR,
    tip_mass: float = 0.0,
    gravity: float = 9.81,
) -> RodModel:
    """A uniform cable that touches nothing.

    Args:
        length: [m].
        stiffness: bending stiffness B [N m^2]; line_mass: [kg/m].
        twist_ratio: twisting over bending stiffness [-].
        stretching: stretching stiffness [N], where it is more than a usual share of B / L^2.
        curvature: natural one towards m_2 [1/m].
        law: of bending.
        tip_mass: at the end [kg].
        gravity: [m/s^2].
    """
    return RodModel(
        length=length,
        bending_stiffness=stiffness,
        twisting_stiffness=twist_ratio * stiffness,
        stretching_stiffness=max(stretching, _STRETCH * stiffness / length**2),
        line_mass=line_mass,
        radius=1e-3 * length,
        natural_curvature=(0.0, curvature),
        point_masses=((length, tip_mass),) if tip_mass else (),
        law=law,
        gravity=gravity,
    )


def between_ends(length: float, edges: int) -> np.ndarray:
    """(edges + 2,) arc lengths of the nodes of a cable held at both ends [m]: the first and the
    last of them are half an edge beyond it."""
    return length / edges * (np.arange(edges + 2) - 0.5)


def held_batch(
    cables: Sequence[RodModel],
    arc_length: np.ndarray,
    position: np.ndarray,
    *,
    both: bool,
    gravity: np.ndarray | None = None,
    device: str,
) -> RodBatch:
    """Cables on meshes, their first edge held, or the edges at both ends, m_1 along +y there.

    Args:
        cables: one a row; arc_length: (row, node) or (node,) of its nodes [m].
        position: (row, node, 3) [m].
        gravity: (3,) acceleration; default: the cables', along -z.
    """
    batch = RodBatch.of(
        cables, arc_length, position, director=(0.0, 1.0, 0.0), gravity=gravity, device=device
    )
    ends = ((0, 1, -2, -1), (0, -1)) if both else ((0, 1), (0,))
    prescribe(batch, clamped_nodes=ends[0], clamped_angles=ends[1])
    return batch
