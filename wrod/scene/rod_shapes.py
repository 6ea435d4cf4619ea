"""Centreline of the whole rod at every node of a trajectory: laid part and suspended part."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.trajectory import Trajectory

POINTS = 201  # of the centreline; 4 mm apart on the rods of Table 2


def whole_rod(trajectory: Trajectory, points: int = POINTS) -> np.ndarray:
    """Points of the rod at each node, at the same places of the material throughout.

    The laid part follows the contact points; the suspended part is the trajectory's `shape`.
    Where the trajectory has none, the last point follows the laid end only and the curve stops at
    the contact.

    Args:
        trajectory: grip poses, with `shape` (T, nodes, 3) where the planner computed it [m].
        points: of the centreline.

    Returns:
        (T, points, 3) [m], from the free end to the grip.
    """
    laid = np.asarray(trajectory.arc_length) - trajectory.arc_length[0]
    table = CubicSpline(laid, trajectory.contact) if len(laid) > 1 else None
    shape = getattr(trajectory, "shape", None)
    rods = np.empty((len(laid), points, 3))
    if shape is None:
        for k, end in enumerate(laid):
            rods[k] = table(np.linspace(0.0, end, points))
        return rods
    steps = np.linalg.norm(np.diff(shape, axis=1), axis=2)
    hanging = np.concatenate([np.zeros((len(laid), 1)), np.cumsum(steps, axis=1)], axis=1)
    total = float(np.median(laid + hanging[:, -1]))
    material = np.linspace(0.0, total, points)
    for k, end in enumerate(laid):
        below = material <= end
        rods[k, below] = table(material[below])
        # Chords of a bent rod are a little short of its length; the ends are kept exact.
        share = (material[~below] - end) / (total - end)
        rods[k, ~below] = CubicSpline(hanging[k], shape[k])(share * hanging[k, -1])
    return rods
