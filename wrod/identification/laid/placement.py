"""Where a predicted rod is in a photograph: seen from the camera, after at most one rigid motion.

What hangs from the grip is nearer to the camera than the table, and a camera shows it farther from
the point that it looks down on: by H / (H - z), H the camera's and z the rod's height.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares, minimize
from scipy.spatial import cKDTree

from wrod.identification.laid.photographs import LaidPhotograph

# A predicted curve is compared at points this far apart [m].
_SPACING = 5e-4
# What is above the table by more than this hangs [m].
_LYING = 4e-3
# Points nearer to the camera than this share of its height are not shown.
_NEAREST = 0.7
# Rounds of nearest points found anew, and the last descent's smoothing over the uncertainty.
_ROUNDS, _SHARP = 4, 0.1
# What turns [rad] and shifts [m] are counted in.
_UNIT = np.array([0.3, 0.05, 0.05])
# Standard deviations of the turn [rad] and the shifts [m] that are looked for, over ten.
_REACH = np.array([0.03, 0.005, 0.005])


@dataclass(frozen=True)
class Alignment:
    """A predicted curve beside a photograph.

    Attributes:
        curve: (n, 2) the curve moved [m].
        turn: angle [rad] about the middle of the points seen, and shift (2,) [m] of that middle.
        distance: (m,) of every point seen from the curve [m].
    """

    curve: np.ndarray
    turn: float
    shift: np.ndarray
    distance: np.ndarray

    @property
    def mean(self) -> float:
        """Mean distance [m], which photographs are judged by."""
        return float(self.distance.mean())


@dataclass(frozen=True)
class MissesByPart:
    """Where a prediction misses: mean distance [m] of the points seen of a rod's first stretch on
    the table, of the rest that lies there and of what hangs (nan where nothing is seen), and each
    part's share of all squares."""

    mean: tuple[float, ...]
    share: tuple[float, ...]


def parts_of(
    photograph: LaidPhotograph,
    placed: Alignment,
    arc_length: np.ndarray,
    nodes: np.ndarray,
    first: float,
) -> MissesByPart:
    """The parts of a rod (node,), (node, 3) that was seen and placed, `first` long the first."""
    s = foot(photograph, placed, arc_length)
    hangs = np.interp(s, arc_length, nodes[:, 2]) > _LYING
    begins = (s - arc_length[0] < first) & ~hangs
    masks = begins, ~begins & ~hangs, hangs
    square = placed.distance**2
    return MissesByPart(
        tuple(float(placed.distance[k].mean()) if k.any() else float("nan") for k in masks),
        tuple(float(square[k].sum() / square.sum()) for k in masks),
    )


def foot(photograph: LaidPhotograph, placed: Alignment, arc_length: np.ndarray) -> np.ndarray:
    """(m,) arc length [m] of the place of a rod (node,) that is nearest to every point seen."""
    return _fine(arc_length)[cKDTree(placed.curve).query(photograph.points)[1]]


def shown_at(curve: np.ndarray, arc_length: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(m, 2) of a curve that `seen_from` shows of a rod (node,), at arc lengths (m,) [m]; where it
    shows no more, the curve's last place."""
    s = _fine(arc_length)[: len(curve)]
    return np.column_stack([np.interp(at, s, c) for c in curve.T])


def _fine(arc_length: np.ndarray) -> np.ndarray:
    """Arc lengths at which a predicted curve is shown [m]."""
    return np.linspace(arc_length[0], arc_length[-1], int(np.ptp(arc_length) / _SPACING) + 2)


def seen_from(
    arc_length: np.ndarray, nodes: np.ndarray, middle: np.ndarray, height: float = np.inf
) -> np.ndarray:
    """(n, 2) what a camera that looks straight down shows of a rod, on the table's plane [m].

    Args:
        arc_length: (node,) [m].
        nodes: (node, 3) the rod, the table at z = 0 [m].
        middle: (2,) below the camera [m].
        height: of the camera [m]; infinite: no perspective.
    """
    place = CubicSpline(arc_length, nodes)(_fine(arc_length))
    if not np.isfinite(height):
        return place[:, :2]
    above = np.maximum(place[:, 2], 0.0)
    # The first place beyond the limit ends the curve: the gripper is there.
    last = int(np.argmax(above > _NEAREST * height)) or len(above)
    scale = height / (height - above[:last, None])
    return middle + (place[:last, :2] - middle) * scale


def raw(photograph: LaidPhotograph, curve: np.ndarray) -> Alignment:
    """The curve where it was predicted."""
    return Alignment(curve, 0.0, np.zeros(2), _off(photograph.points, curve))


def _off(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """(m,) distances from a curve [m]: up to half a step along it from its nearest point."""
    if len(curve) < 2:  # a rod that leaves the picture at once
        return np.linalg.norm(points - curve[0], axis=1)
    near = cKDTree(curve).query(points)[1]
    gap, step = points - curve[near], np.gradient(curve, axis=0)[near]
    along = (gap * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-24)
    along = np.clip(along, -0.5 * (near > 0), 0.5 * (near < len(curve) - 1))
    return np.linalg.norm(gap - along[:, None] * step, axis=1)


def rigid(photograph: LaidPhotograph, curve: np.ndarray) -> Alignment:
    """The curve after the one rigid motion in the plane that brings it nearest to what is seen.

    Least mean distance, which photographs are judged by, found by descent from two places: one by
    a descent that smooths distances below the picture's uncertainty, one where nearest points that
    are fitted and found anew lead to. Motions of over 0.6 rad or 10 cm are not taken: a straight
    rod would match from either end.
    """
    points = photograph.points
    centre, tree = points.mean(axis=0), cKDTree(curve)
    scale = float(np.median(photograph.uncertainty))
    found = [raw(photograph, curve)]
    for start in (_descended(points, tree, centre, np.zeros(3), scale),
                  _alternated(points, curve, centre, scale)):  # fmt: skip
        motion = _descended(points, tree, centre, start, _SHARP * scale)
        if (np.abs(motion) > 2.0 * _UNIT).any():
            continue
        line = moved(motion, curve, centre)
        found.append(Alignment(line, motion[0], motion[1:], _off(points, line)))
    return min(found, key=lambda placement: placement.mean)


def moved(motion: np.ndarray, what: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(n, 2) points turned about a centre and shifted [m]; motion: (3,) turn [rad] and shift."""
    c, s = np.cos(motion[0]), np.sin(motion[0])
    return (what - centre) @ np.array([[c, s], [-s, c]]) + centre + motion[1:]


def _descended(points, tree, centre, start, smooth) -> np.ndarray:
    """(3,) turn and shift of a least mean of sqrt(distance^2 + smooth^2), by BFGS: the points are
    moved back instead of the curve."""
    arms = points - centre
    turned = np.array([[0.0, -1.0], [1.0, 0.0]])

    def cost(x):
        turn, shift = x[0] * _UNIT[0], x[1:] * _UNIT[1:]
        rotation = np.cos(turn) * np.eye(2) + np.sin(turn) * turned
        back = (arms - shift) @ rotation
        distance, near = tree.query(back + centre)
        soft = np.hypot(distance, smooth)
        pull = (back + centre - tree.data[near]) / soft[:, None]
        slope = np.append(
            (pull * (back @ turned)).sum(axis=1).mean(), -rotation @ pull.mean(axis=0)
        )
        return soft.mean(), slope * _UNIT

    return minimize(cost, start / _UNIT, jac=True, method="BFGS", options={"gtol": 1e-5}).x * _UNIT


def _alternated(points, curve, centre, scale) -> np.ndarray:
    """(3,) turn and shift by nearest points that are brought to the curve, across it."""
    normal, motion = normals(curve), np.zeros(3)
    near = cKDTree(curve).query(points)[1]
    for _ in range(_ROUNDS):
        motion = _fitted(points, curve[near], normal[near], centre, motion, scale)
        near = cKDTree(moved(motion, curve, centre)).query(points)[1]
    return motion


def _fitted(points, foot, normal, centre, motion, scale):
    """(3,) turn and shift that bring the feet to the points, across the curve."""

    def off(p):
        c, s = np.cos(p[0]), np.sin(p[0])
        across = normal @ np.array([[c, s], [-s, c]])
        gap = points - moved(p, foot, centre)
        return np.concatenate([(gap * across).sum(axis=1) / scale, p / _REACH])

    return least_squares(off, motion, loss="soft_l1", max_nfev=20).x


def normals(curve: np.ndarray) -> np.ndarray:
    """(n, 2) unit vectors to the left of a curve (n, 2)."""
    tangent = np.gradient(curve, axis=0)
    length = np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)
    return np.column_stack([-tangent[:, 1], tangent[:, 0]]) / length[:, None]
