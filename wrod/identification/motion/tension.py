"""The base model of recordings: a rod as long as its markers say, less what its tension adds."""

import numpy as np

from wrod.identification.motion.curves import through_markers
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.smoothing import sampled_frames, smoothing
from wrod.rods.rotation import unit

# Every so many frames are looked at. Forces along a line that sags less than a hundredth of its
# length are not seen.
_SPACING, _SEEN = 10, 1e-2


def base_setup(m: MotionMeasurements, pieces: int) -> MotionSetup:
    """The base model on edges of the mean distance between neighbours of the nodes that cut the
    curves through the markers into `pieces` between neighbouring free ones.

    The edges of a rod that is never straight are chords: taken for arcs they would be compressed,
    by (curvature length)^2 / 24.
    """
    nodes = through_markers(m.positions[m.fit][:, ::_SPACING], pieces)
    length = np.linalg.norm(np.diff(nodes, axis=2), axis=3).mean(axis=(0, 1))
    return MotionSetup.base(length, pieces, m.gravity, mean_tension(m, pieces))


def mean_tension(m: MotionMeasurements, pieces: int) -> np.ndarray:
    """(2, n) mean tension of the edges over the fitted recordings, as far as weight and inertia
    ask for it [m^2/s^2], and each m^4/s^2 of a uniform bending stiffness; none inside the grips.

    In every frame the moments of the curve seen are balanced, by least squares, by a force and a
    moment at the first grip and a twisting moment that is the same along the rod.
    """
    weights = smoothing(m.rate)
    reach = weights.shape[1] // 2
    sampled = sampled_frames(m, m.fit, _SPACING, reach)
    if not len(sampled):  # too short to have accelerations
        weights, reach = np.array([[1.0], [0.0], [0.0]]), 0
        sampled = sampled_frames(m, m.fit, _SPACING, reach)
    recording, frame = sampled.T
    around = frame[:, None] + np.arange(-reach, reach + 1)
    paths = through_markers(m.positions[recording[:, None], around], pieces)
    x, _, acceleration = np.einsum("ak,skmc->asmc", weights, paths)
    edge = np.diff(x, axis=1)
    length = np.linalg.norm(edge, axis=2, keepdims=True)
    t, free = edge / length, edge[:, 1:-1]
    cell = length.copy()
    cell[:, [0, -1]] = 0.0  # what is inside a grip hangs and bends nowhere
    cell = 0.5 * (cell[:, 1:] + cell[:, :-1])
    turn = np.cross(t[:, :-1], t[:, 1:])
    cosine = np.sum(t[:, :-1] * t[:, 1:], axis=2, keepdims=True)
    bent = 2.0 * turn / (1.0 + cosine) / cell
    load = (np.array([0.0, 0.0, -m.gravity]) - acceleration[:, 1:-1]) * cell
    carried = np.cumsum(load[:, :-1], axis=1)
    # Moment at each node: that at the first less edge x force of every edge before.
    across = np.cumsum(np.cross(free[:, :, None], np.eye(3)).swapaxes(2, 3), axis=1)
    across = np.pad(across, ((0, 0), (1, 0), (0, 0), (0, 0)))
    lever = np.pad(np.cumsum(np.cross(free, carried), axis=1), ((0, 0), (1, 0), (0, 0)))
    span = np.linalg.norm(free, axis=2).sum(axis=1).mean()
    axis = unit(t[:, :-1] + t[:, 1:])
    every = np.broadcast_to(np.eye(3), across.shape)
    columns = np.concatenate([across / span, every, axis[..., None]], axis=3)
    columns = columns.reshape(len(x), -1, 7)
    sides = np.stack([lever, -bent], axis=3).reshape(len(x), -1, 2)
    force = (np.linalg.pinv(columns, rcond=_SEEN) @ sides)[:, :3] / span
    by_load = np.einsum("sec,sec->e", force[:, None, :, 0] - carried, t[:, 1:-1])
    by_bending = np.einsum("sc,sec->e", force[:, :, 1], t[:, 1:-1])
    return np.pad(np.stack([by_load, by_bending]) / len(x), ((0, 0), (1, 1)))
