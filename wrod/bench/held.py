"""The nearest curve to a pattern that can lie at rest: what friction leaves of any deployment.

A rod that lies on a table bears along itself a force F that friction f changes, F' = -f, and a
moment that F turns, M' = -t x F; nothing but |f| <= mu w bounds what it may lie in. Of all such
curves, free at their beginning and held by the grip at the pattern's end, that with the least mean
(smoothed) distance from the points of the metric is found by sequential quadratic programming
(SciPy's SLSQP, Kraft 1988).
"""

import numpy as np
from scipy.optimize import minimize

from wrod.deployment.result import METRIC_POINTS, interpolation, metric_points
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.rods.model import Rod

# Edges a length L_gb; and by the definition of that, bending stiffness over w L_gb^3.
_EDGES, _STIFFNESS = 4, 2.0
# Distances are smoothed below this [L_gb]; what they change by at last; and after how many steps
# what is known of second derivatives is forgotten, as often at most.
_NEAR, _DONE, _STEPS, _TIMES = 1e-3, 1e-6, 300, 10
# Of the friction that a curve asks for, that which the next one may; by how much it may miss it.
_FALLS, _MISSES = 0.7, 1e-5

Statics = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


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
        RodError: no such curve was found.
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
    bound = np.inf
    while bound > friction:
        bound = max(friction, _FALLS * problem.asked(values))
        for _ in range(_TIMES):
            found = minimize(
                problem.distance, values, jac=True, method="SLSQP",
                constraints={"type": "ineq", "fun": problem.room, "jac": problem.room_slope,
                             "args": (bound,)},
                options={"ftol": _DONE, "maxiter": _STEPS},
            )  # fmt: skip
            values = found.x
            if found.success:
                break
        if not found.success or problem.asked(values) > (1.0 + _MISSES) * bound:
            raise RodError(
                f"no curve near {pattern.source} that friction {friction:g} holds was found; "
                "give more friction"
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
        self._at = np.zeros(0)
        self._statics: Statics = (self._at,) * 4

    def statics(self, values: np.ndarray) -> Statics:
        """Places (n + 1, 2), friction (n, 2) that the nodes but the last ask for, and the tangents
        (n, 2) and forces (n, 2) of edges."""
        if np.array_equal(values, self._at):  # which distance, room and its slope ask for in turn
            return self._statics
        n, angle = self.count, values[: self.count]
        tangent = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        curvature = np.zeros(n + 1)
        curvature[1:n], curvature[n] = (angle[1:] - angle[:-1]) / self.edge, values[-1]
        shear = -_STIFFNESS / self.edge * (curvature[1:] - curvature[:-1])
        force = values[n : 2 * n, None] * tangent + shear[:, None] * _left(tangent)
        place = np.zeros((n + 1, 2))
        np.cumsum(self.edge * tangent, axis=0, out=place[1:])
        place += values[2 * n : -1]
        friction = -force
        friction[1:] += force[:-1]
        friction /= self.lengths[:, None]
        self._at, self._statics = values.copy(), (place, friction, tangent, force)
        return self._statics

    def asked(self, values: np.ndarray) -> float:
        """The least coefficient of friction that holds all of the rod."""
        return float(np.linalg.norm(self.statics(values)[1], axis=1).max())

    def distance(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean distance from the points of the metric, and its derivatives."""
        place, _, tangent, _ = self.statics(values)
        off = self.weights @ place - self.target
        far = np.sqrt((off**2).sum(axis=1) + _NEAR**2)
        pull = self.weights.T @ (off / (METRIC_POINTS * far[:, None]))  # on each node
        # An edge that turns moves all nodes after it.
        after = pull.sum(axis=0) - np.cumsum(pull, axis=0)[:-1]
        turn = self.edge * (_left(tangent) * after).sum(axis=1)
        return float(far.mean()), np.r_[turn, np.zeros(self.count), pull.sum(axis=0), 0.0]

    def room(self, values: np.ndarray, bound: float) -> np.ndarray:
        """(n,) what is left of friction's bound, of its square and in parts of that."""
        return 1.0 - (self.statics(values)[1] ** 2).sum(axis=1) / bound**2

    def room_slope(self, values: np.ndarray, bound: float) -> np.ndarray:
        """(n, 2 n + 3) derivatives of `room`."""
        n, i = self.count, np.arange(self.count)
        _, friction, tangent, force = self.statics(values)
        bends = np.zeros((n + 1, len(values)))
        bends[i[1:], i[1:]], bends[i[1:], i[:-1]] = 1.0 / self.edge, -1.0 / self.edge
        bends[n, -1] = 1.0
        shears = -_STIFFNESS * np.diff(bends, axis=0) / self.edge
        forces = _left(tangent)[:, :, None] * shears[:, None]
        forces[i, :, i] += _left(force)
        forces[i, :, n + i] += tangent
        rates = -np.diff(forces, axis=0, prepend=0.0) / self.lengths[:, None, None]
        return -2.0 / bound**2 * np.einsum("nd,ndv->nv", friction, rates)


def _left(vectors: np.ndarray) -> np.ndarray:
    """(n, 2) turned to the left by a right angle."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])
