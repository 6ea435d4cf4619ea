"""Centreline of the whole rod at every node of a trajectory: laid part and suspended part."""

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.patterns.curve import arc_length
from wrod.planning.shapes import with_shapes
from wrod.planning.trajectory import Trajectory

POINTS = 201  # of the centreline; 4 mm apart on the rods of Table 2


def whole_rod(trajectory: Trajectory, pattern=None, points: int = POINTS) -> np.ndarray:
    """Points of the rod at each node, at the same places of the material throughout.

    The laid part follows the contact points; the suspended part is the trajectory's `shape`.
    Without one (a controller computes none), the rod solver is asked for the same grasps; theirs
    is the shape where the grips agree. A grip that is as far from the contact as the rod is long
    (the intuitive one) leaves the rod nothing but the straight line. Where neither holds, the
    shape is not known: the curve stops at the contact.

    Args:
        trajectory: grip poses, with `shape` (T, nodes, 3) where the planner computed it [m].
        pattern: `Pattern` of the trajectory, whose curvature is better than that of its nodes.
        points: of the centreline.

    Returns:
        (T, points, 3) [m], from the free end to the grip.
    """
    laid = np.asarray(trajectory.arc_length) - trajectory.arc_length[0]
    table = CubicSpline(laid, trajectory.contact)
    shape = trajectory.shape
    if shape is None:
        shape = _straight(trajectory, laid)
    if shape is None:
        shape = with_shapes(trajectory, pattern if hasattr(pattern, "sample") else None).shape
    rods = np.empty((len(laid), points, 3))
    if shape is None:
        for k, end in enumerate(laid):
            rods[k] = table(np.linspace(0.0, end, points))
        return rods
    hanging = arc_length(shape)
    total = float(np.median(laid + hanging[:, -1]))
    material = np.linspace(0.0, total, points)
    for k, end in enumerate(laid):
        below = material <= end
        rods[k, below] = table(material[below])
        share = (material[~below] - end) / (total - end)
        rods[k, ~below] = CubicSpline(hanging[k], shape[k])(share * hanging[k, -1])
    return rods


def _straight(trajectory: Trajectory, laid: np.ndarray) -> np.ndarray | None:
    """Straight suspended parts (T, 2, 3) where the rod is taut within 1 %, else None."""
    rod = trajectory.metadata.get("rod")
    if not isinstance(rod, dict) or "length" not in rod:
        return None
    distance = np.linalg.norm(trajectory.position - trajectory.contact, axis=1)
    if np.abs(distance - (rod["length"] - laid)).max() > 0.01 * rod["length"]:
        return None
    return np.stack([trajectory.contact, trajectory.position], axis=1)
