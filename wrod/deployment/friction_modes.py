"""Friction that varies over a table, by a few numbers that looks can tell."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from wrod.patterns.pattern import Pattern
from wrod.solvers.friction import FrictionField

# Over how far friction is much the same [m], its standard deviation where it varies, of its
# logarithm, and the share of its variance under the pattern that the modes have.
_REACH, _DEVIATION, _SHARE = 0.06, 0.5, 0.98
# Points of the pattern; and spacing of the field's grid [m], which goes on beyond the pattern for
# so many reaches.
_POINTS, _GRID, _BEYOND = 200, 0.01, 2.5


class FrictionModes:
    """Modes of the logarithm of friction under a pattern.

    A Gaussian process over the table, of covariance 0.25 exp(-d^2 / 2 l^2), d the distance of two
    places and l 6 cm, is a sum of modes with independent standard normal coefficients
    (Karhunen-Loeve, by Nystroem's method at points of the pattern); those that hardly vary are left
    out.

    Attributes:
        count: of modes.
        reach: l [m].
    """

    def __init__(self, pattern: Pattern):
        self.reach = _REACH
        self._length, self._remainder = pattern.length, pattern.remainder_length
        self._pattern = pattern
        s = np.linspace(-self._remainder, self._length, _POINTS)
        self._points = pattern.sample(s)[0][:, :2]
        variances, vectors = np.linalg.eigh(self._alike(self._points) / _POINTS)
        variances, vectors = variances[::-1], vectors[:, ::-1]
        self.count = 1 + int(np.searchsorted(np.cumsum(variances), _SHARE))
        chosen = slice(0, self.count)
        self._weights = _DEVIATION * vectors[:, chosen] / np.sqrt(_POINTS * variances[chosen])

    def _alike(self, places: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * cdist(places, self._points, "sqeuclidean") / _REACH**2)

    def modes(self, arc_length: np.ndarray) -> np.ndarray:
        """(n, count) where a rod lies on the pattern at arc lengths (n,) from its free end [m]."""
        s = np.clip(arc_length - self._remainder, -self._remainder, self._length)
        return self._alike(self._pattern.sample(s)[0][:, :2]) @ self._weights

    def field(self, coefficients: np.ndarray) -> FrictionField:
        """What coefficients (count,) say of the table."""
        low = self._points.min(axis=0) - _BEYOND * _REACH
        high = self._points.max(axis=0) + _BEYOND * _REACH
        counts = np.ceil((high - low) / _GRID).astype(int) + 1
        x, y = (np.linspace(low[k], high[k], counts[k]) for k in range(2))
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        factor = np.exp(self._alike(grid) @ (self._weights @ coefficients))
        return FrictionField(factor.reshape(len(y), len(x)), (x[0], x[-1]), (y[0], y[-1]))
