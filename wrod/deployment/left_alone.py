"""Rods on a table that nothing holds: put down without motion, or let go as they hang."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.rods.batch import RodBatch
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.solvers.contact import Contact, Friction
from wrod.solvers.dynamics import Dynamics

# The table gives way by this part of the radius under the rod's weight, as in a deployment.
_SINKING = 1.0 / 600.0
_EDGES = 4.0  # of a rod that falls, per L_gb
_STEP = 5e-3  # [s]


def left_alone(
    rods,
    arc_length: np.ndarray,
    position: np.ndarray,
    director: np.ndarray,
    friction: list[Friction],
    device: str = "cpu",
) -> tuple[RodBatch, Dynamics]:
    """Rods at rest on a table at z = 0 or above it, with what steps them.

    Args:
        rods: a `RodMaterial` or `RodModel` for each row.
        arc_length: (rod, node) [m].
        position: (rod, node, 3) of centrelines [m]; a rod lies at z = its radius.
        director: (rod, 3) across the first edges.
        friction: of each rod's table.
    """
    weight = np.array([rod.weight for rod in rods])
    radius = np.array([rod.radius for rod in rods])
    batch = RodBatch.of(rods, arc_length, position, director=director, device=device)
    contact = Contact(batch, radius, weight / (_SINKING * radius), friction)
    dynamics = Dynamics(
        batch,
        scheme="euler",
        radius=radius,
        air_damping=1.0,
        contact=contact,
        force_scale=weight * np.array([rod.gravito_bending_length for rod in rods]),
        tolerance=1e-5,
    )
    return batch, dynamics


def fall(
    rod: RodModel | RodMaterial, shape: np.ndarray, time: np.ndarray, friction: float
) -> np.ndarray | None:
    """How a rod comes to lie that is let go at rest.

    Args:
        rod: what it is.
        shape: (M, 3) centreline as it was held, its lowest points on the table [m]; evenly spaced
            along the rod. It is taken for free of twist and stretch.
        time: (K,) since it was let go, growing [s].
        friction: of the table [-].

    Returns:
        (K, M, 3) [m] at the same points, as far apart as they were, where a coarse mesh is longer
        or shorter by a part in ten thousand. None where the simulation does not converge.
    """
    steps = np.linalg.norm(np.diff(shape, axis=0), axis=1)
    points = np.concatenate([[0.0], np.cumsum(steps)])
    lowest = float(shape[:, 2].min())
    count = max(int(np.ceil(_EDGES * points[-1] / rod.gravito_bending_length)), 20) + 1
    nodes = np.linspace(0.0, points[-1], count)
    place = CubicSpline(points, shape)(nodes)
    place[:, 2] += rod.radius - lowest
    place[:, 2] = np.maximum(place[:, 2], rod.radius)
    across = np.cross([0.0, 0.0, 1.0], place[1] - place[0])
    batch, dynamics = left_alone(
        [rod], nodes[None], place[None], across[None], [Friction(friction)]
    )
    shapes, now = [], 0.0
    for at in time:
        if at > now and dynamics.advance(at, _STEP).diverged.any():
            return None
        now = at
        lies = CubicSpline(nodes, batch.positions()[0])(points)
        lies[:, 2] += lowest - rod.radius
        pieces = np.diff(lies, axis=0)
        pieces *= (steps / np.linalg.norm(pieces, axis=1))[:, None]
        lies[1:] = lies[0] + np.cumsum(pieces, axis=0)
        shapes.append(lies)
    return np.array(shapes)
