"""Rods on a table that nothing holds: put down without motion, or let go as they hang."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from wrod.deployment.assembly import SINKING, USUAL_DAMPING
from wrod.patterns.curve import arc_length
from wrod.rods.batch import RodBatch
from wrod.rods.discretisation import directors_at_rest
from wrod.rods.model import Rod, RodModel
from wrod.rods.state import node_positions
from wrod.solvers.contact import Contact
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction

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
    director = directors_at_rest(rods, arc_length, position, director)
    batch = RodBatch.of(rods, arc_length, position, director=director, device=device)
    sides = np.array([RodModel.of(rod).has_sides for rod in rods])
    contact = Contact(batch, radius, weight / (SINKING * radius), friction, keeps_roll=sides)
    dynamics = Dynamics.of(
        rods,
        batch,
        **USUAL_DAMPING,
        contact=contact,
        force_scale=weight * np.array([rod.gravito_bending_length for rod in rods]),
        tolerance=1e-5,
        keeps_recording=device == "cpu",  # as in `wrod.deployment.tangents.lay`
    )
    return batch, dynamics


@dataclass(frozen=True)
class Fall:
    """How a rod comes to lie that is let go at rest.

    Attributes:
        nodes: (N,) rest arc length [m].
        places: (K, N, 3) centrelines [m], `_STEP` apart in time from when it was let go.
        rise: [m] by which its points are higher than those of the shape it was let go in.
    """

    nodes: np.ndarray
    places: np.ndarray
    rise: float

    @classmethod
    def of(cls, rod: Rod, shape: np.ndarray, until: float, friction: float) -> Fall | None:
        """Simulate it; None where that does not converge.

        Args:
            rod: what it is.
            shape: (M, 3) centreline as it was held, its lowest points on the table [m]; evenly
                spaced along the rod. It is taken for free of stretch, and of twist but for what is
                there at rest.
            until: when it lies [s since it was let go].
            friction: of the table [-].
        """
        points = arc_length(shape)
        rise = rod.radius - float(shape[:, 2].min())
        count = max(int(np.ceil(_EDGES * points[-1] / rod.gravito_bending_length)), 20) + 1
        nodes = np.linspace(0.0, points[-1], count)
        place = CubicSpline(points, shape)(nodes)
        place[:, 2] = np.maximum(place[:, 2] + rise, rod.radius)
        across = np.cross([0.0, 0.0, 1.0], place[1] - place[0])
        batch, dynamics = left_alone(
            [rod], nodes[None], place[None], across[None], [Friction(friction)]
        )
        frames = np.repeat(batch.state.dof.numpy()[:, None], round(until / _STEP) + 1, axis=1)
        kept = wp.array(frames, dtype=wp.float64, device=batch.device)
        if dynamics.advance(until, _STEP, frames=kept, frame_interval=_STEP).diverged.any():
            return None
        return cls(nodes, node_positions(kept.numpy()[0]), rise)

    def at(self, shape: np.ndarray, time: np.ndarray) -> np.ndarray:
        """(K, M, 3) [m] at times (K,) since it was let go [s], at the points of the shape (M, 3) in
        which it was, as far apart as they were there, where a coarse mesh is longer or shorter by
        a part in ten thousand."""
        points = arc_length(shape)
        lengths = np.diff(points)[None, :, None]
        frame = np.clip(np.asarray(time) / _STEP, 0.0, len(self.places) - 1.0)
        low = np.minimum(frame.astype(int), len(self.places) - 2)
        share = (frame - low)[:, None, None]
        places = (1.0 - share) * self.places[low] + share * self.places[low + 1]
        lies = CubicSpline(self.nodes, places, axis=1)(points)
        lies[..., 2] -= self.rise
        pieces = np.diff(lies, axis=1)
        pieces *= lengths / np.linalg.norm(pieces, axis=2, keepdims=True)
        return np.concatenate([lies[:, :1], lies[:, :1] + np.cumsum(pieces, axis=1)], axis=1)
