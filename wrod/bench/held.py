"""The nearest curve to a pattern that can lie at rest: what friction leaves of any deployment.

A rod that lies on a table bears along itself a force F that friction f changes, F' = -f, and a
moment that F turns, M' = -t x F; nothing but |f| <= mu w bounds what it may lie in. Of all such
curves, free at their beginning and held by the grip at the pattern's end, that with the least mean
distance from the points of the metric is found by an interior-point method: friction is kept
within its bound by a logarithmic barrier (Nocedal and Wright, Numerical Optimization, ch. 19).
"""

import numpy as np

from wrod.deployment.result import METRIC_POINTS, interpolation, metric_points
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.rods.model import Rod

# Edges a length L_gb.
_EDGES = 4
# Weight of the barrier at first and at last, by what it falls, and how often the last is repeated,
# by when each point counts by the inverse of its distance, but for distances below this [L_gb]:
# squares become distances.
_FIRST, _LAST, _FALLS, _AGAIN, _NEAR = 1e-2, 1e-9, 10.0**-0.5, 3, 1e-3
# Newton steps for each weight at most, and the decrease that ends them, over the weight.
_STEPS, _DONE, _DAMPING = 30, 1e-3, 1e-9
# Beyond the friction that a curve asks for, that which it is given next, unless it has hardly more.
_WITHIN = 1.02
# Minima on the way at most.
_MOST = 300


def held(pattern: Pattern, rod: Rod, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the nearest curve to a pattern at which friction can hold a rod, without stretch.

    The problem is not convex: it is followed from the friction that holds the pattern itself down
    to the given one.

    Args:
        pattern: with its remainder.
        rod: of which L_gb counts.
        friction: the coefficient [-].

    Returns:
        Arc length (node,) and place (node, 3) [m], as `wrod.bench.put_down.put_down`.

    Raises:
        RodError: the way down to this friction does not end.
    """
    lgb = rod.gravito_bending_length
    length = pattern.length + pattern.remainder_length
    count = int(np.ceil(_EDGES * length / lgb))
    s = np.linspace(0.0, length, count + 1)
    problem = _Problem(pattern, s, lgb)
    tangent = pattern.sample(0.5 * (s[1:] + s[:-1]) - pattern.remainder_length)[1]
    angle = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    begin = pattern.sample(-pattern.remainder_length)[0][0, :2] / lgb
    values = np.r_[angle, np.zeros(count), begin, np.diff(angle[-2:]) / problem.edge]
    bound, weight, left = max(friction, _WITHIN * problem.asked(values)), _FIRST, _AGAIN
    for _ in range(_MOST):
        values = problem.minimum(values, bound, weight)
        if bound > friction:
            asked = problem.asked(values)
            bound = max(friction, min(_WITHIN * asked, 0.5 * (asked + bound)), 0.5 * bound)
        elif weight > _LAST:
            weight = max(_LAST, _FALLS * weight)
        else:
            problem.weigh(values)
            left -= 1
            if left == 0:
                break
    else:
        raise RodError(
            f"no curve near {pattern.source} that friction {friction:g} holds was found; give more"
        )
    place = np.zeros((count + 1, 3))
    place[:, :2] = lgb * problem.statics(values)[0]
    return s, place


class _Problem:
    """Lengths in L_gb, forces in weights of that. Values (2 n + 3,) are the angles and the tensions
    of n edges, the place of the first node, and the curvature at the last one."""

    def __init__(self, pattern: Pattern, s: np.ndarray, lgb: float):
        at, target = metric_points(pattern)
        self.count, self.edge = len(s) - 1, float(s[1] / lgb)
        self.weights = interpolation(at + pattern.remainder_length, s)
        self.target = target[:, :2] / lgb
        self.lengths = np.full(self.count, self.edge)  # of rod that each node but the last bears
        self.lengths[0] *= 0.5
        self.share = np.full(METRIC_POINTS, 1.0 / METRIC_POINTS)

    def statics(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Places (n + 1, 2), friction (n, 2) that the nodes but the last ask for, and the tangents
        (n, 2) and forces (n, 2) of edges."""
        n, angle = self.count, values[: self.count]
        tangent = np.column_stack([np.cos(angle), np.sin(angle)])
        curvature = np.r_[0.0, np.diff(angle) / self.edge, values[-1]]
        shear = -np.diff(curvature) / self.edge
        force = values[n : 2 * n, None] * tangent + shear[:, None] * _left(tangent)
        place = values[2 * n : -1] + self.edge * np.cumsum(np.vstack([[0, 0], tangent]), axis=0)
        friction = -np.diff(force, axis=0, prepend=0.0) / self.lengths[:, None]
        return place, friction, tangent, force

    def asked(self, values: np.ndarray) -> float:
        """The least coefficient of friction that holds all of the rod."""
        return float(np.linalg.norm(self.statics(values)[1], axis=1).max())

    def weigh(self, values: np.ndarray) -> None:
        """Let each point count by the inverse of its distance."""
        off = np.linalg.norm(self.weights @ self.statics(values)[0] - self.target, axis=1)
        self.share = 1.0 / np.maximum(off, _NEAR)
        self.share /= self.share.sum()

    def value(self, values: np.ndarray, bound: float, weight: float) -> float:
        place, friction = self.statics(values)[:2]
        room = 1.0 - (friction**2).sum(axis=1) / bound**2
        if not room.min() > 0.0:
            return np.inf
        off = ((self.weights @ place - self.target) ** 2).sum(axis=1)
        return float(0.5 * self.share @ off - weight * np.log(room).mean())

    def minimum(self, values: np.ndarray, bound: float, weight: float) -> np.ndarray:
        """Values at which friction is within its bound, from some at which it is."""
        for _ in range(_STEPS):
            matrix, slope = self._model(values, bound, weight)
            step, now = -np.linalg.solve(matrix, slope), self.value(values, bound, weight)
            falls, length = float(-slope @ step), 1.0
            while not self.value(values + length * step, bound, weight) < (
                now - 1e-4 * length * falls
            ):
                length *= 0.5
                if length < 1e-8:
                    return values
            values = values + length * step
            if falls < _DONE * weight:
                break
        return values

    def _model(self, values: np.ndarray, bound: float, weight: float):
        """Matrix and slope of a quadratic model, without what second derivatives of places and
        friction add to it."""
        n, size = self.count, len(values)
        place, friction, tangent, force = self.statics(values)
        root, i = np.sqrt(self.share), np.arange(n)
        places = np.zeros((METRIC_POINTS, 2, size))
        below = self.edge * np.tri(n + 1, n, -1)
        places[:, :, :n] = (self.weights @ below)[:, None] * _left(tangent).T
        places[:, 0, 2 * n] = places[:, 1, 2 * n + 1] = self.weights.sum(axis=1)
        places = (root[:, None, None] * places).reshape(-1, size)
        off = (root[:, None] * (self.weights @ place - self.target)).ravel()
        bends = np.zeros((n + 1, size))
        bends[i[1:], i[1:]], bends[i[1:], i[:-1]] = 1.0 / self.edge, -1.0 / self.edge
        bends[n, -1] = 1.0
        forces = -_left(tangent)[:, :, None] * np.diff(bends, axis=0)[:, None] / self.edge
        forces[i, :, i] += _left(force)
        forces[i, :, n + i] += tangent
        rates = -np.diff(forces, axis=0, prepend=0.0) / self.lengths[:, None, None]
        room = 1.0 - (friction**2).sum(axis=1) / bound**2
        used = 2.0 / bound**2 * np.einsum("nd,ndv->nv", friction, rates) / room[:, None]
        rates = (np.sqrt(2.0 / room)[:, None, None] / bound * rates).reshape(-1, size)
        matrix = places.T @ places + weight / n * (used.T @ used + rates.T @ rates)
        slope = places.T @ off + weight / n * used.sum(axis=0)
        return matrix + _DAMPING * np.eye(size), slope


def _left(vectors: np.ndarray) -> np.ndarray:
    """(n, 2) turned to the left by a right angle."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])
