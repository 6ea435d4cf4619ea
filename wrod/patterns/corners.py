"""Corners among the points of a pattern: smooth runs between them, joined by tight turns."""

import itertools

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline
from scipy.spatial import cKDTree

from wrod.patterns.curve import smoothstep
from wrod.patterns.smoothing import fit_heading

CORNER = np.radians(40.0)  # a larger turn at one point is a corner, unless all points turn so
SHARP = np.radians(50.0)  # and one still larger always is: no sampled curve turns so at each point
_FEW = 8  # fewer points say nothing about how much the others turn
_TURN = 0.002  # [m] over which a corner turns, at most; a rod's own bend is larger
_SHARE = 0.2  # of the shorter neighbour
_STEP = 0.001  # [m] between samples of a run
_PER_TURN = 24  # samples within a corner's turn


def turns(points: np.ndarray) -> np.ndarray:
    """(n - 2,) angle by which a polyline (n, 2) turns at each inner point [rad]."""
    steps = np.diff(points, axis=0)
    cross = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    return np.arctan2(cross, np.sum(steps[:-1] * steps[1:], axis=1))


def find_corners(points: np.ndarray) -> np.ndarray:
    """Indices of the points (n, 2) at which the pattern has a corner."""
    angle = np.abs(turns(points))
    usual = 8.0 * 1.4826 * np.median(angle) if len(points) >= _FEW else 0.0
    return np.flatnonzero(angle > np.clip(usual, CORNER, SHARP)) + 1


def heading_with_corners(
    points: np.ndarray, corners: np.ndarray, smoothing: float | None
) -> tuple[PPoly, np.ndarray, float]:
    """Heading over arc length of smooth runs between corners; see `fit_heading`.

    A run of two points is straight. Every corner turns within 2 mm, or a fifth of its shorter
    neighbour.
    """
    ends = [0, *corners, len(points) - 1]
    runs = []
    for first, last in itertools.pairwise(ends):
        piece = points[first : last + 1]
        if len(piece) == 2:
            step = piece[1] - piece[0]
            runs.append((float(np.hypot(*step)), None, float(np.arctan2(step[1], step[0])), 0.0))
        else:
            heading, _, noise = fit_heading(piece, smoothing)
            runs.append((float(heading.x[-1]), heading, 0.0, noise))
    starts = np.concatenate([[0.0], np.cumsum([run[0] for run in runs])])
    places: list[np.ndarray] = []
    values: list[np.ndarray] = []
    for number, (length, heading, angle, _) in enumerate(runs):
        before = 0.0 if number == 0 else _width(runs[number - 1][0], length) / 2
        after = 0.0 if number == len(runs) - 1 else _width(length, runs[number + 1][0]) / 2
        local = np.linspace(before, length - after, max(8, int(length / _STEP)))
        here = np.full(len(local), angle) if heading is None else heading(local)
        if values:
            here = here + 2 * np.pi * np.round((values[-1][-1] - here[0]) / (2 * np.pi))
            share = np.linspace(0.0, 1.0, _PER_TURN + 2)[1:-1]
            low, high = places[-1][-1], starts[number] + before
            places.append(low + share * (high - low))
            values.append(values[-1][-1] + smoothstep(share) * (here[0] - values[-1][-1]))
        places.append(starts[number] + local)
        values.append(here)
    spline = make_interp_spline(np.concatenate(places), np.concatenate(values), 3)
    noise = max(run[3] for run in runs)
    return PPoly.from_spline(spline), points[0].copy(), noise


def _width(first: float, second: float) -> float:
    return min(_TURN, _SHARE * min(first, second))


def distance_from_lines(points: np.ndarray, curve: np.ndarray) -> tuple[float, int]:
    """How far a curve (m, 2) leaves the polyline through points (n, 2), and where in `curve`."""
    start, axis = points[:-1], np.diff(points, axis=0)
    square = np.maximum((axis**2).sum(1), 1e-300)

    def away(part, lines):
        offset, along = part[:, None] - start[lines], axis[lines]
        share = np.clip((offset * along).sum(-1) / square[lines], 0.0, 1.0)
        return np.linalg.norm(offset - share[..., None] * along, axis=-1).min(1)

    # None is farther than from the two lines at the nearest point: those that are far from these
    # are compared with all lines, of which there may be thousands.
    nearest = cKDTree(points).query(curve)[1][:, None] + [-1, 0]
    most = away(curve, nearest.clip(0, len(start) - 1))
    order = np.argsort(-most, kind="stable")
    worst, place = 0.0, 0
    for low in range(0, len(curve), 64):
        part = order[low : low + 64]
        if most[part[0]] <= worst:
            break
        far = away(curve[part], np.arange(len(start))[None])
        if far.max() > worst:
            worst, place = float(far.max()), int(part[far.argmax()])
    return worst, place
