"""Centreline of the whole rod at every node of a trajectory: laid part and suspended part."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.errors import GraspError
from wrod.trajectory import Trajectory

_AGREE = 0.06  # [L_gb] distance of two grips that are the same grasp, curvature off by its noise
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
        shape = _solved(trajectory, laid, table, pattern)
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


def _solved(
    trajectory: Trajectory, laid: np.ndarray, table: CubicSpline, pattern
) -> np.ndarray | None:
    """Suspended parts (T, nodes, 3) of the rod solver's grasps, ended at the trajectory's grips.

    None where the solver knows no such grasps, or has its grips elsewhere.
    """
    from wrod.grasps import CLOSURES, solve_grasps
    from wrod.material import RodMaterial

    figures = trajectory.metadata
    if not isinstance(figures.get("rod"), dict) or figures.get("closure") not in CLOSURES:
        return None
    rod = RodMaterial(**figures["rod"])
    unit = rod.gravito_bending_length
    forward, bend = table(laid, 1), table(laid, 2)
    curvature = forward[:, 0] * bend[:, 1] - forward[:, 1] * bend[:, 0]
    curvature /= np.linalg.norm(forward[:, :2], axis=1) ** 3
    if hasattr(pattern, "sample"):
        curvature = _own_curvature(pattern, trajectory, curvature)
    try:
        grasps = solve_grasps(
            (rod.length - laid) / unit,
            curvature * unit,
            rod.stretch_ratio,
            closure=figures["closure"],
        )
    except GraspError:
        return None
    tangent = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    up = np.broadcast_to([0.0, 0.0, 1.0], tangent.shape)
    frame = np.stack([tangent, np.cross(up, tangent), up], axis=-1)
    shape = trajectory.contact[:, None] + unit * np.einsum("tij,tnj->tni", frame, grasps.shape)
    miss = trajectory.position - shape[:, -1]
    if not grasps.converged.all() or np.linalg.norm(miss, axis=1).max() > _AGREE * unit:
        return None
    # What is left (3e-4 L_gb with the pattern's own curvature) fades out towards the contact.
    share = np.linspace(0.0, 1.0, shape.shape[1]) ** 2
    return shape + share[None, :, None] * miss[:, None]


def _own_curvature(pattern, trajectory: Trajectory, curvature: np.ndarray) -> np.ndarray:
    """Curvature (T,) of the pattern where it is the one that was laid, else as given [1/m]."""
    lead = float(trajectory.metadata.get("remainder_length", 0.0))
    if lead > 0.0 and pattern.remainder_length == 0.0:
        pattern = pattern.with_remainder(lead)  # as `plan` does
    places = trajectory.pattern_arc_length
    within = np.clip(places, -pattern.remainder_length, pattern.length)
    contact, _, known = pattern.sample(within)
    same = (
        np.abs(within - places).max() < 1e-9 and np.abs(contact - trajectory.contact).max() < 1e-6
    )
    return known if same else curvature
