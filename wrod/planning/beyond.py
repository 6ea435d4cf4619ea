"""What hangs beyond the grip: the rod's rest, clamped where the grip holds it."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np

from wrod.planning.trajectory import Trajectory
from wrod.rods.batch import RodBatch
from wrod.solvers.statics import EquilibriumSolver, prescribe

# Poses that are looked at, edges of a length of 1 L_gb, at least and at most so many, and parts of
# what is beyond of which the most is found that stays off the table.
_POSES, _EDGES, _FEWEST, _MOST, _SHARES = 48, 12.0, 16, 160, 32
# Length over which a rod turns down from how it is held, to begin with [L_gb].
_TURNS = 1.0


@dataclass(frozen=True)
class Beyond:
    """What hangs beyond the grip at some poses of a trajectory.

    It hangs at rest and free: where it comes below the table it does not say how it lies there.

    Attributes:
        nodes: (K,) of the trajectory.
        laid: (K,) length that is laid there [m].
        shape: (K, M, 3) centrelines from the grip to the rod's other end [m].
        contact: (T, 3) of the trajectory [m].
        radius: of the rod [m].
    """

    nodes: np.ndarray
    laid: np.ndarray
    shape: np.ndarray
    contact: np.ndarray
    radius: float

    @classmethod
    def of(cls, trajectory: Trajectory, share: float = 1.0, poses: int = _POSES) -> Beyond | None:
        """Of as many poses, of a share of what is beyond; None where nothing is, or no equilibrium
        was found."""
        rod, beyond = trajectory.rod, share * trajectory.beyond_grip
        if rod is None or not beyond:
            return None
        nodes = np.unique(np.linspace(0, len(trajectory) - 1, poses).astype(int))
        turns, lgb = trajectory.rotation[nodes], rod.gravito_bending_length
        edges = int(np.clip(np.ceil(_EDGES * beyond / lgb), _FEWEST, _MOST))
        s = beyond / edges * np.arange(-1, edges + 1)
        roll = trajectory.roll
        batch = RodBatch.of(
            replace(rod, length=rod.length + beyond),
            np.tile(rod.length + s, (len(nodes), 1)),
            _turning_down(trajectory.position[nodes], turns[:, :, 0], s, lgb),
            clamped=(True, False),
            director=turns @ [0.0, np.cos(roll), np.sin(roll)],
        )
        prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
        found = EquilibriumSolver(batch).solve(ramp_loads=True)
        if not found.converged.all():
            return None
        shape = batch.positions()[:, 1:]
        laid = trajectory.arc_length[nodes]
        return cls(nodes, laid, shape, trajectory.contact, rod.radius)

    @property
    def touches(self) -> np.ndarray:
        """(K,) whether it comes down to the table, on which centrelines are at z = 0."""
        return self.shape[:, :, 2].min(axis=1) < 0.0

    @property
    def lies_on(self) -> np.ndarray:
        """(K,) whether it comes down where rod lies already, within three radii of it."""
        first = np.argmax(self.shape[:, :, 2] < 0.0, axis=1)
        ends = self.shape[np.arange(len(first)), first, :2]
        apart = [
            np.linalg.norm(self.contact[: node + 1, :2] - end, axis=1).min()
            for node, end in zip(self.nodes, ends, strict=True)
        ]
        return self.touches & (np.array(apart) < 3.0 * self.radius)

    @property
    def drawn(self) -> np.ndarray:
        """(K, M, 3) shapes of which nothing is below the table [m]: it lies on it, straight on."""
        shapes = self.shape.copy()
        lengths = np.linalg.norm(np.diff(shapes, axis=1), axis=2)
        for pose in np.flatnonzero(self.touches):
            shape, steps = shapes[pose], lengths[pose]
            k = max(int(np.argmax(shape[:, 2] < 0.0)), 1)
            ahead = shape[k, :2] - shape[0, :2]
            apart = float(np.linalg.norm(ahead))
            ahead = ahead / apart if apart > 1e-9 else np.array([1.0, 0.0])
            shape[k:, :2] = shape[k - 1, :2] + np.cumsum(steps[k - 1 :])[:, None] * ahead
            shape[k:, 2] = 0.0
        return shapes


def longest_free(trajectory: Trajectory) -> float:
    """Length beyond the grip that comes down to the table at no pose [m], at most what there is."""
    shares = [k / _SHARES for k in range(_SHARES + 1)]

    def comes_down(share: float) -> bool:
        hangs = Beyond.of(trajectory, share)
        return hangs is not None and bool(hangs.touches.any())

    return trajectory.beyond_grip * shares[bisect_left(shares, True, key=comes_down) - 1]


def _turning_down(
    position: np.ndarray, tangent: np.ndarray, s: np.ndarray, lgb: float
) -> np.ndarray:
    """(K, M, 3) curves from poses [m] that turn down from their tangents (K, 3), to begin with."""
    down = np.array([0.0, 0.0, -1.0])
    angle = np.arccos(np.clip(tangent @ down, -1.0, 1.0))
    aside = tangent - (tangent @ down)[:, None] * down
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
    middle = np.maximum(0.5 * (s[1:] + s[:-1]), 0.0)
    left = angle[:, None] * np.exp(-middle / (_TURNS * lgb))
    way = np.cos(left)[..., None] * down + np.sin(left)[..., None] * aside[:, None]
    steps = np.concatenate([np.zeros((len(way), 1, 3)), np.diff(s)[:, None] * way], axis=1)
    path = np.cumsum(steps, axis=1)
    return position[:, None] + path - path[:, 1:2]
