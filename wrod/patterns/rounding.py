"""Corners rounded to what a rod can lie in: the nearest curve whose curvature stays in bounds."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, PPoly
from scipy.linalg import cholesky, solve_triangular
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import lsq_linear
from scipy.sparse.linalg import spsolve

from wrod.errors import PatternError
from wrod.patterns.fillets import bends, fillets
from wrod.patterns.pattern import Pattern

_KNOTS_PER_BEND = 4.0  # knots of the curvature per radius of the tightest bend
_MOST_KNOTS = 400
_ITERATIONS = 40
# A step that saves less than this part of the cost is the last, or one that saves nothing though it
# is damped so much.
_SAVED, _DAMPED = 1e-3, 1e3
_STAGE = 1.2  # by which the bound comes down at a time
# Weights of the curvature's changes against distances, tried in this order: even bends are easier
# to lay and to follow, and cost a few millimetres.
_SMOOTH = (0.1, 0.03, 0.01)
_ALONG = 0.15  # weight of distances along the curve: it may slide on itself
_SAID = 1e-4  # [m] smaller departures are not reported


@dataclass(frozen=True)
class Rounding:
    """How a curve with bounded curvature departs from the one that was asked for.

    Attributes:
        largest: greatest distance between the two [m].
        places: (arc length of the first curve, distance there) of every corner [m].
        sharpest: curvature of the first curve, largest amount [1/m].
        bound: what the second keeps [1/m].
    """

    largest: float
    places: tuple[tuple[float, float], ...]
    sharpest: float
    bound: float

    def __str__(self) -> str:
        where = ", ".join(f"{1e3 * far:.1f} mm at s = {s:.3f} m" for s, far in self.places)
        return (
            f"bends of up to {self.sharpest:.0f} 1/m are rounded to {self.bound:.0f} 1/m "
            f"(radius {1e3 / self.bound:.0f} mm), which departs by {where}"
        )


def round_corners(
    pattern: Pattern, bound: float, tolerance: float = 0.01
) -> tuple[Pattern, Rounding | None]:
    """The pattern with its curvature bounded, as near to the first as it gets.

    Args:
        pattern: without a remainder.
        bound: largest amount of curvature [1/m].
        tolerance: largest distance that is accepted between the two curves [m].

    Returns:
        The pattern as it was and None, where it keeps the bound; else the rounded one, and where
        and how far it departs.

    Raises:
        PatternError: it would depart by more than the tolerance; says where and by how much.
    """
    count = int(np.clip(pattern.length * max(8.0 * bound, 2000.0), 800, 8000))
    s = np.linspace(0.0, pattern.length, count)
    position, tangent, curvature = pattern.sample(s)
    sharpest = float(np.abs(curvature).max())
    if sharpest <= bound * (1.0 + 1e-6):
        return pattern, None
    flat, angles = position[:, :2], np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    first, best = fillets(s, flat, angles, curvature, bound), None
    for smooth in _SMOOTH:
        spline, start, angle = _nearest(s, flat, angles, first, bound, smooth)
        heading = PPoly.from_spline(spline.antiderivative())
        heading.c[-1] += angle - float(heading(0.0))
        other = pattern.redrawn(heading, origin=start)
        found = _compare(s, flat, other, sharpest, bound)
        if best is None or found.largest < best[1].largest:
            best = other, found
        if found.largest <= tolerance:
            break
    rounded, rounding = best
    if rounding.largest > tolerance:
        worst, far = max(rounding.places, key=lambda place: place[1])
        # Beyond a quarter of a leg between bends the drawing would be lost.
        legs = np.diff([0.0, *(s[[a, b]].mean() for a, b in bends(curvature, bound)), s[-1]])
        lost = far > 0.25 * np.median(legs)
        more = "" if lost else f"--tolerance {np.ceil(1e4 * far) / 1e4 + 0.0001:.4f}, "
        raise PatternError(
            f"{pattern.source}: bends by {sharpest:.0f} 1/m, and this rod lies in no more than "
            f"{bound:.0f} 1/m (radius {1e3 / bound:.0f} mm); rounded, it would depart by "
            f"{1e3 * far:.1f} mm at s = {worst:.3f} m, more than the tolerance of "
            f"{1e3 * tolerance:g} mm; give {more}a larger drawing or a softer rod"
        )
    return rounded, rounding


def _nearest(s, points, heading, first, bound, smoothness):
    """Cubic spline of curvature over [0, length], first point and heading of the nearest curve.

    The descent starts from the curve `first`: see `fillets`.
    """
    length = first[-1, 0]
    knots = int(np.clip(_KNOTS_PER_BEND * bound * length, 24, _MOST_KNOTS))
    inner = np.linspace(0.0, 1.0, knots)
    full = np.concatenate([np.zeros(3), inner, np.ones(3)])
    size = len(full) - 4
    u = np.linspace(0.0, 1.0, 4 * knots)
    design = BSpline.design_matrix(u, full, 3).toarray()
    second = np.diff(np.eye(size), n=2, axis=0)
    coefficients = _resolved(first, np.linspace(0.0, length, len(s)), length / knots, full)
    # The bound comes down in steps, so that the curve stays near.
    limits = [bound]
    while limits[0] < np.abs(coefficients).max():
        limits.insert(0, limits[0] * _STAGE)
    start, angle = points[0].copy(), float(heading[0])
    tangents = np.column_stack([np.cos(heading), np.sin(heading)])
    ds = u[1] - u[0]
    turned_by = np.vstack([np.zeros(size), np.cumsum(_middle(design), axis=0) * ds])
    index = np.round(np.interp(u * length, first[:, 0], first[:, 2]) / s[1]).astype(int)
    limit, least, damping, best = limits.pop(0), np.inf, 0.0, None
    for iteration in range(_ITERATIONS):
        turned = np.concatenate([[0.0], np.cumsum(_middle(design @ coefficients)) * ds * length])
        theta = angle + turned
        ahead = np.column_stack([np.cos(theta), np.sin(theta)])
        place = start + np.vstack([[0, 0], np.cumsum(_middle(ahead), axis=0) * ds * length])
        if iteration:
            index = _partners(place, points, index)
        # Derivatives of place by coefficients, heading, length and start.
        side = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        by_angle = np.vstack([[0, 0], np.cumsum(_middle(side), axis=0) * ds * length])
        turn_by = length * turned_by
        jacobian = np.empty((len(u), 2, size + 4))
        for axis in range(2):
            rows = _middle(side[:, axis, None] * turn_by) * ds * length
            jacobian[:, axis, :size] = np.vstack([np.zeros(size), np.cumsum(rows, axis=0)])
            jacobian[:, axis, size] = by_angle[:, axis]
            jacobian[:, axis, size + 1] = (place - start)[:, axis] / length
            jacobian[:, axis, size + 2 :] = np.eye(2)[axis]
        off = points[index] - place
        along = tangents[index]
        normal = np.column_stack([-along[:, 1], along[:, 0]])
        across, weight = np.ones(len(u)), np.full(len(u), _ALONG)
        across[[0, -1]] = weight[[0, -1]] = 30.0  # the ends stay
        parts, wanted = [], []
        for direction, factor in ((normal, across), (along, weight)):
            parts.append(factor[:, None] * np.einsum("na,nak->nk", direction, jacobian))
            wanted.append(factor * np.einsum("na,na->n", direction, off))
        # A start of even curvature: a lead-in meets its derivatives.
        parts.append(np.hstack([np.diff(np.eye(size), axis=0)[:3] / bound, np.zeros((3, 4))]))
        wanted.append(-np.diff(coefficients)[:3] / bound)
        smooth = smoothness / bound * np.sqrt(len(u) / size) * length
        parts.append(np.hstack([smooth * second, np.zeros((len(second), 4))]))
        wanted.append(-smooth * (second @ coefficients))
        cost = sum(float(part @ part) for part in wanted)
        # Far from the solution a step can lead away from it: it is taken back and damped.
        if cost < least:
            done = cost > (1.0 - _SAVED) * least
            best, least, damping = (coefficients, angle, length, start, index), cost, 0.2 * damping
            rows = np.concatenate(parts)
            equations = rows.T @ rows, rows.T @ np.concatenate(wanted)
        else:
            done = damping > _DAMPED
            coefficients, angle, length, start, index = best
            damping = max(10.0 * damping, 1e-3)
        if limits:
            limit, least, damping = limits.pop(0), np.inf, 0.0
        elif done:
            break
        low = np.concatenate([-limit - coefficients, [-0.3, -0.1 * length, -0.1, -0.1]])
        high = np.concatenate([limit - coefficients, [0.3, 0.1 * length, 0.1, 0.1]])
        step = _step(*equations, damping, low - 1e-12, high + 1e-12)
        coefficients = (coefficients + step[:size]).clip(-limit, limit)
        angle, length = angle + step[size], length + step[size + 1]
        start = start + step[size + 2 :]
    coefficients, angle, length, start, _ = best
    return BSpline(full * length, coefficients.clip(-bound, bound), 3), start, angle


def _step(matrix, right, damping, low, high):
    """The step within bounds that solves normal equations best, damped by so much of each
    unknown's own share in them."""
    triangle = cholesky(matrix + np.diag(damping * np.diag(matrix)))
    wanted = solve_triangular(triangle, right, trans="T")
    free = solve_triangular(triangle, wanted)
    if ((low <= free) & (free <= high)).all():
        return free
    return lsq_linear(triangle, wanted, (low, high), max_iter=60).x


def _resolved(first, even, width, full):
    """Coefficients of the curvature as knots a `width` apart resolve it, every turn kept."""
    turned = np.interp(even, first[:, 0], first[:, 1])
    spread = np.gradient(gaussian_filter1d(turned, width / even[1], mode="nearest"), even)
    sample = BSpline.design_matrix(even / even[-1], full, 3)
    return spsolve((sample.T @ sample).tocsc(), sample.T @ spread)


def _middle(values: np.ndarray) -> np.ndarray:
    return (values[1:] + values[:-1]) / 2


def _partners(place, points, before) -> np.ndarray:
    """The nearest point of the first curve near the last partner of each, in order."""
    window = max(3, len(points) // 40)
    offsets = np.arange(-window, window + 1)
    near = np.clip(before[:, None] + offsets, 0, len(points) - 1)
    found = near[
        np.arange(len(place)), np.linalg.norm(points[near] - place[:, None], axis=2).argmin(axis=1)
    ]
    found = np.maximum.accumulate(found)
    found[0], found[-1] = 0, len(points) - 1
    return found


def _compare(s, points, rounded: Pattern, sharpest: float, bound: float) -> Rounding:
    """Distance of the first curve's points from the second, corner by corner."""
    t = np.linspace(0.0, rounded.length, len(s))
    other = rounded.sample(t)[0][:, :2]
    far = np.linalg.norm(points - other[_partners(points, other, np.arange(len(s)))], axis=1)
    high = far > max(_SAID, 0.3 * far.max())
    places = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], high.astype(int), [0]])))
    gap = 0.5 / bound
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        k = first + int(far[first:last].argmax())
        if places and s[k] - places[-1][0] < gap:
            if far[k] > places[-1][1]:
                places[-1] = (float(s[k]), float(far[k]))
            continue
        places.append((float(s[k]), float(far[k])))
    return Rounding(float(far.max()), tuple(places), sharpest, bound)
