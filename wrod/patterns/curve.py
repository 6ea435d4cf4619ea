"""Planar curves given by the heading of their tangent along their arc length."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import BPoly, BSpline, PPoly, make_interp_spline
from scipy.spatial import cKDTree

from wrod.errors import PatternError

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
# Of a curve that is compared with itself.
_MOST_POINTS = 10_000


def integrate_heading(heading: PPoly, origin: np.ndarray) -> BSpline:
    """Position (s -> (n, 2)) of the curve of that heading, with `origin` (2,) at s = 0.

    Gauss-Legendre quadrature of (cos, sin) in cells short against the curve's features, then a
    quintic through the cells' ends, so that the tangent is a unit vector to rounding.
    """
    start, stop = heading.x[0], heading.x[-1]
    cells = int(np.clip(4 * len(heading.x), 800, 10_000))
    ends = np.linspace(start, stop, cells + 1)
    half = (ends[1] - ends[0]) / 2.0
    angle = heading(ends[:-1, None] + half * (1.0 + _NODES))
    steps = half * np.stack([np.cos(angle) @ _WEIGHTS, np.sin(angle) @ _WEIGHTS], axis=1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    position = make_interp_spline(ends, points, 5)
    return BSpline(position.t, position.c + (origin - position(0.0)), 5)


def lead_in(heading: PPoly, length: float) -> PPoly:
    """The same curve, begun `length` earlier at zero curvature.

    The added curvature is the quintic that starts with zero value, slope and second derivative
    and meets those of the curve at its start: curvature and its two derivatives are continuous.
    """
    start = heading.x[0]
    joint = [float(heading(start, nu=order)) for order in (1, 2, 3)]
    curvature = PPoly.from_bernstein_basis(
        BPoly.from_derivatives([start - length, start], [[0.0, 0.0, 0.0], joint])
    )
    turned = curvature.antiderivative()
    rows = max(len(turned.c), len(heading.c))
    before = np.zeros((rows, turned.c.shape[1]))
    before[rows - len(turned.c) :] = turned.c
    before[-1] += float(heading(start)) - float(turned(start))
    after = np.zeros((rows, heading.c.shape[1]))
    after[rows - len(heading.c) :] = heading.c
    return PPoly(np.concatenate([before, after], axis=1), np.append(turned.x[:-1], heading.x))


def heading_of_curve(
    curve: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], stop: float
) -> tuple[PPoly, np.ndarray]:
    """Heading along the arc length of an exact curve t -> (x, y) from t = 0, and its first point.

    The curve is interpolated at 4001 values of t, to about 1e-9 of its length if its features
    are longer than a hundredth of it.
    """
    t = np.linspace(0.0, stop, 4001)
    x, y = curve(t)
    position = make_interp_spline(t, np.stack([x, y], axis=1), 7)
    velocity = position.derivative()
    half = (t[1] - t[0]) / 2.0
    other = t[:-1] + 0.764 * half  # no simple fraction, which ripples might repeat at
    between = position(other) - np.stack(curve(other), axis=1)
    step = np.hypot(np.diff(x), np.diff(y))[:, None]
    if not (np.abs(between) <= 0.05 * step).all():  # it turns by half a radian there
        raise PatternError(
            "the curve has features finer than a 4000th of its range; give a shorter range "
            "without kinks, jumps and ripples, or the points of a drawing"
        )
    speed = np.linalg.norm(velocity(t[:-1, None] + half * (1.0 + _NODES)), axis=-1)
    arc = np.concatenate([[0.0], np.cumsum(half * speed @ _WEIGHTS)])
    tangent = velocity(t)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return PPoly.from_spline(make_interp_spline(arc, heading, 5)), position(0.0)


def heading_of_curvature(curvature: PPoly, angle: float) -> PPoly:
    """Heading of a curve of given curvature [1/m] over arc length, starting at `angle` [rad]."""
    heading = curvature.antiderivative()
    heading.c[-1] += angle - float(heading(curvature.x[0]))
    return heading


def smoothstep(x):
    """The quintic smoothstep from 0 to 1 at x, clipped there: two derivatives are continuous."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def arc_length(points: np.ndarray) -> np.ndarray:
    """(..., n) lengths of polylines (..., n, 2 or 3) up to each of their points."""
    lengths = np.zeros(points.shape[:-1])
    steps = points[..., 1:, :] - points[..., :-1, :]
    np.cumsum(np.sqrt((steps * steps).sum(-1)), axis=-1, out=lengths[..., 1:])
    return lengths


def runs_along_itself(
    sample: Callable[[np.ndarray], np.ndarray], length: float, width: float
) -> list[tuple[float, float]]:
    """Arc lengths (from, to) [m] between which a curve is nearer than `width` to a part of it that
    came before, for longer than where it crosses that under more than 20 degrees.

    Args:
        sample: (n,) arc lengths to (n, 2) points [m].
        length: of the curve [m].
        width: of what lies along it [m].
    """
    s = np.linspace(0.0, length, int(np.clip(2.0 * length / width, 2, _MOST_POINTS)))
    first, second = cKDTree(sample(s)).query_pairs(width, output_type="ndarray").T
    # A bend as tight as a rod can take has turned round by then.
    near = np.zeros(len(s) + 2, bool)
    near[1 + np.maximum(first, second)[np.abs(s[first] - s[second]) > 5.0 * width]] = True
    turns = np.flatnonzero(np.diff(near)).reshape(-1, 2)
    runs = [(float(s[a]), float(s[b - 1])) for a, b in turns]
    return [(a, b) for a, b in runs if b - a > 2.0 * width / np.sin(np.radians(20.0))]
