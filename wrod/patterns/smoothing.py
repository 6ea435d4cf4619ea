"""Smooth planar curves through noisy points, with the noise estimated from the points themselves.

A penalised regression spline per coordinate, parametrised by arc length, whose smoothing parameter
minimises the generalised cross-validation score of both coordinates together. The penalty is on
the fourth derivative, of splines of degree seven: the cubic smoothing splines of libraries penalise
the second, whose natural end condition forces the curvature to zero at both ends of the pattern,
and the friction bound needs the fourth derivative of position itself to be smooth.
"""

import numpy as np
from scipy import linalg
from scipy.interpolate import BSpline, PPoly, make_interp_spline
from scipy.optimize import brentq, minimize_scalar

from wrod.patterns.curve import arc_length

_MAX_SITES = 400  # columns of the regression; a rod pattern of 0.8 m then has a knot every 2 mm
_MIN_SMOOTHED = 8  # fewer points say nothing about their noise and are interpolated
_GAMMA = 1.4  # weight of a degree of freedom in GCV against undersmoothing (Kim and Gu 2004)
_SETTLED = 0.3  # of the noise, by which a point may yet move along the curve
_NOISE_FLOOR = 1e-9  # of the pattern's length: smaller residuals are rounding, not information


class _PenalisedSpline:
    """Demmler-Reinsch form of min |y - f(t)|^2 + lam * int |f^(m)|^2 for every lam at once."""

    def __init__(self, t: np.ndarray, points: np.ndarray):
        n = len(t)
        degree = 7 if n >= 8 else 5 if n >= 6 else 3 if n >= 4 else 2
        order = (degree + 1) // 2
        sites = t if n <= _MAX_SITES else np.quantile(t, np.linspace(0.0, 1.0, _MAX_SITES))
        self.knots = make_interp_spline(sites, sites, degree).t
        self.degree = degree
        design = BSpline.design_matrix(t, self.knots, degree)
        self.factor = linalg.cholesky((design.T @ design).toarray())
        # Its triangle has the same singular values and right vectors, and a quarter of its rows.
        root = linalg.qr(self._penalty_root(order), mode="r")[0][: len(self.factor)]
        _, self.singular, vectors = linalg.svd(
            linalg.solve_triangular(self.factor, root.T, trans="T").T
        )
        self.singular = np.pad(self.singular, (0, len(self.factor) - len(self.singular)))
        # The polynomials below the penalty's order are free of penalty by definition; their
        # computed singular values are rounding errors.
        self.singular[len(self.factor) - order :] = 0.0
        projected = linalg.solve_triangular(self.factor, design.T @ points, trans="T")
        self.rotated = vectors @ projected
        self.vectors = vectors
        unpenalised = design @ linalg.solve_triangular(self.factor, projected)
        self.lack_of_fit = float(np.sum((points - unpenalised) ** 2))
        self.count = n

    def _penalty_root(self, order: int) -> np.ndarray:
        """Matrix G with |G c|^2 = int |f^(order)|^2, by Gauss-Legendre quadrature on knot spans."""
        breaks = np.unique(self.knots)
        nodes, weights = np.polynomial.legendre.leggauss(self.degree - order + 1)
        half = np.diff(breaks)[:, None] / 2.0
        places = (breaks[:-1, None] + half * (1.0 + nodes)).ravel()
        scale = np.sqrt((half * weights).ravel())
        basis = BSpline(self.knots, np.eye(len(self.knots) - self.degree - 1), self.degree)
        return scale[:, None] * basis.derivative(order)(places)

    def residual(self, lam: float) -> float:
        """Sum of squared residuals over both coordinates."""
        shrink = lam * self.singular**2 / (1.0 + lam * self.singular**2)
        return self.lack_of_fit + float(np.sum((shrink[:, None] * self.rotated) ** 2))

    def freedom(self, lam: float) -> float:
        """Effective degrees of freedom of one coordinate."""
        return float(np.sum(1.0 / (1.0 + lam * self.singular**2)))

    def score(self, lam: float, floor: float) -> float:
        """Generalised cross-validation, Craven and Wahba 1979, with the weight gamma."""
        left = self.count - _GAMMA * self.freedom(lam)
        if left <= 0.0:
            return np.inf
        return (self.residual(lam) + floor) / left**2

    def fit(self, lam: float) -> BSpline:
        shrunk = self.rotated / (1.0 + lam * self.singular[:, None] ** 2)
        coefficients = linalg.solve_triangular(self.factor, self.vectors.T @ shrunk)
        return BSpline(self.knots, coefficients, self.degree)

    def bounds(self) -> tuple[float, float]:
        """Logarithms of the smoothing parameters between interpolation and a polynomial."""
        active = self.singular[self.singular > 0.0]
        return np.log(1e-4 / active.max() ** 2), np.log(1e4 / active.min() ** 2)

    def choose(self, smoothing: float | None) -> float:
        """Smoothing parameter: by cross-validation (None) or for a given noise [length unit]."""
        if smoothing == 0.0 or self.count < _MIN_SMOOTHED or not np.any(self.singular > 0.0):
            return 0.0
        low, high = self.bounds()
        if smoothing is not None:
            target = self.count * smoothing**2

            # Only the noise across the curve leaves a residual (see `fit_heading`).
            def excess(log_lam):
                return self.residual(np.exp(log_lam)) - target

            if excess(low) >= 0.0:
                return np.exp(low)
            if excess(high) <= 0.0:
                return np.exp(high)
            return float(np.exp(brentq(excess, low, high)))
        floor = 2.0 * self.count * _NOISE_FLOOR**2
        grid = np.linspace(low, high, 60)
        scores = [self.score(np.exp(value), floor) for value in grid]
        best = int(np.argmin(scores))
        around = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        found = minimize_scalar(
            lambda value: self.score(np.exp(value), floor), bounds=around, method="bounded"
        )
        return float(np.exp(found.x if found.fun <= scores[best] else grid[best]))


def fit_heading(
    points: np.ndarray, smoothing: float | None = None
) -> tuple[PPoly, np.ndarray, float]:
    """Smooth curve through `points`, as the direction of its tangent along its arc length.

    Args:
        points: (n, 2) distinct points in order, n >= 3 [m].
        smoothing: standard deviation of the points' noise across the curve [m]; None estimates it,
            0 interpolates.

    Returns:
        Heading angle [rad] as a piecewise polynomial of arc length on [0, length], the curve's
        first point (2,) [m], and the standard deviation of the points across the curve [m].
    """
    scale = float(arc_length(points)[-1])
    scaled = points / scale
    level = None if smoothing is None else smoothing / scale
    t = arc_length(scaled)
    # Noise lengthens the chords; refitting over the fitted curve's own arc length removes that.
    # The noise along the curve is taken up by the parameter, so what is left is that across it;
    # steps of the parameter below that bring the curve no nearer to the true one.
    for _ in range(4):
        spline = _PenalisedSpline(t, scaled)
        lam = spline.choose(level)
        curve = spline.fit(lam)
        arc, fine = _arc_length(curve)
        measured = np.interp(t, fine, arc)
        noise = np.sqrt(spline.residual(lam) / max(spline.count - spline.freedom(lam), 1.0))
        step = np.max(np.abs(measured - t))
        if np.any(np.diff(measured) <= 0.0) or step < max(1e-7, _SETTLED * noise):
            break
        t = measured
    velocity = curve.derivative()(fine)
    heading = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    heading = make_interp_spline(arc * scale, heading, 5)
    return PPoly.from_spline(heading), curve(fine[0]) * scale, float(noise * scale)


def _arc_length(curve: BSpline) -> tuple[np.ndarray, np.ndarray]:
    """Arc length at a fine grid of the curve's parameter, by Gauss-Legendre quadrature."""
    start, stop = curve.t[curve.k], curve.t[-curve.k - 1]
    spans = len(np.unique(curve.t)) - 1
    fine = np.linspace(start, stop, int(np.clip(6 * spans, 600, 2400)) + 1)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    half = (fine[1] - fine[0]) / 2.0
    speed = np.linalg.norm(curve.derivative()(fine[:-1, None] + half * (1.0 + nodes)), axis=-1)
    return np.concatenate([[0.0], np.cumsum(half * speed @ weights)]), fine
