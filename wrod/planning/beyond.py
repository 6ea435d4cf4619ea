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
        edges = int(np.clip(np.ceil(_EDGES * beyond / rod.gravito_bending_length), _FEWEST, _MOST))
        s = beyond / edges * np.arange(-1, edges + 1)
        pose = trajectory.position[nodes], trajectory.rotation[nodes]
        shape = hanging(rod, s, *pose, trajectory.roll)
        if shape is None:
            return None
        laid = trajectory.arc_length[nodes]
        return cls(nodes, laid, shape[:, 1:], trajectory.contact, rod.radius)

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
        return np.stack([off_the_table(shape) for shape in self.shape])


def hanging(
    rod, s: np.ndarray, position: np.ndarray, rotation: np.ndarray, roll: float
) -> np.ndarray | None:
    """What hangs beyond grips, at rest and free.

    Args:
        rod: as long as to the grip [m].
        s: (M,) how far from the grip nodes are [m]; the grip holds the edge between the first two.
        position, rotation: (K, 3), (K, 3, 3) of the grips [m]; roll: of the rod in them [rad].

    Returns:
        (K, M, 3) nodes [m]; None where no equilibrium was found.
    """
    batch = RodBatch.of(
        replace(rod, length=rod.length + s[-1]),
        np.tile(rod.length + s, (len(position), 1)),
        _turning_down(position, rotation[:, :, 0], s, rod.gravito_bending_length),
        clamped=(True, False),
        director=rotation @ [0.0, np.cos(roll), np.sin(roll)],
    )
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    found = EquilibriumSolver(batch).solve(ramp_loads=True)
    return batch.positions() if found.converged.all() else None


def off_the_table(shape: np.ndarray) -> np.ndarray:
    """A shape (M, 3) that hangs from its first point, of which nothing is below the table [m]: from
    there it lies on it, straight on."""
    shape, low = shape.copy(), shape[:, 2] < 0.0
    if low.any():
        steps = np.linalg.norm(np.diff(shape, axis=0), axis=1)
        k = max(int(np.argmax(low)), 1)
        ahead = shape[k, :2] - shape[0, :2]
        apart = float(np.linalg.norm(ahead))
        ahead = ahead / apart if apart > 1e-9 else np.array([1.0, 0.0])
        shape[k:, :2] = shape[k - 1, :2] + np.cumsum(steps[k - 1 :])[:, None] * ahead
        shape[k:, 2] = 0.0
    return shape


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
    middle = np.maximum(0.5 * (s[1:] + s[:-1]) - s[1], 0.0)
    left = angle[:, None] * np.exp(-middle / (_TURNS * lgb))
    way = np.cos(left)[..., None] * down + np.sin(left)[..., None] * aside[:, None]
    steps = np.concatenate([np.zeros((len(way), 1, 3)), np.diff(s)[:, None] * way], axis=1)
    path = np.cumsum(steps, axis=1)
    held = int(np.argmax(s >= 0.0))
    return position[:, None] + path - path[:, held, None]
