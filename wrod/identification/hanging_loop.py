"""A rod's gravito-bending length from a photograph of it hanging as a loop.

The rod hangs in a plane between two hands, clamps or nails, seen from the side. How it is held is
not asked: ends and tangents there are fitted with the stiffness.
"""

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicSpline
from scipy.optimize import OptimizeResult, least_squares

from wrod import arguments
from wrod.errors import DataError
from wrod.grasps.mesh import WEIGHT
from wrod.identification.ruler import MeasuredLength
from wrod.patterns.curve import arc_length
from wrod.rods.batch import RodBatch
from wrod.rods.model import RodModel
from wrod.solvers.statics import EquilibriumSolver, prescribe

_EDGES = 80
_FEWEST, _MOST = 20, 400  # points of the curve that are fitted
_ENOUGH, _EVALUATIONS = 1e-3, 40  # share of the squares that a last step takes
_DEGREE = 9  # of the curve from which equilibria are first sought
# Of the loop's size: first guesses of L_gb.
_GUESSES = (0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7)
_STRETCH_RATIO = 1e4
_UNLIKE = "no hanging rod fits these points; is y up, and is it one rod in a plane?"
_PLANE = np.array([1.0, 1.0j])  # to points as complex numbers
_ASTRAY = np.log(1e3)  # times the size of the loop that no L_gb is
_STEPS = np.array([1e-3, 1e-4, 1e-4, 1e-4, 1e-3, 1e-4, 1e-4, 1e-3])  # of the differences


@arguments.checked(DataError, points=arguments.array())
def measure_hanging_loop(points: np.ndarray) -> MeasuredLength:
    """The gravito-bending length of a rod that hangs as a loop.

    Args:
        points: (n, 2) of its centreline in order, x level and y up [m].

    Returns:
        With the standard error that the scatter of the points about the fitted rod tells.

    Raises:
        DataError: there are too few points, or no hanging rod fits them.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] < 2 or len(points) < _FEWEST:
        raise DataError(
            f"the loop has points of shape {points.shape}; give (n, 2) with {_FEWEST} or more"
        )
    points = points[:, :2]
    arc = arc_length(points)
    if not (np.diff(arc) > 0).all():
        raise DataError("the loop has the same point twice in a row; leave it out")
    if len(points) > _MOST:
        points = CubicSpline(arc, points)(np.linspace(0.0, arc[-1], _MOST))
        arc = np.linspace(0.0, arc[-1], _MOST)
    fit = _Fit(points, arc)
    found = fit.run()
    if found is None:
        raise DataError(_UNLIKE)
    values, residual, jacobian = found.x, found.fun, found.jac
    scatter = float(np.sqrt((residual**2).sum() / max(len(residual) - len(values), 1)))
    if scatter > 0.02 * fit.size:
        raise DataError(
            f"the nearest hanging rod is {1e3 * scatter:.1f} mm off these points; is y up, and is "
            "it one rod in a plane, straight when it lies free?"
        )
    # What the stiffness does that no length, end or tangent does, too, as far as differences tell.
    own, rest = jacobian[:, 0], jacobian[:, 1:]
    own = own - rest @ np.linalg.lstsq(rest, own)[0]
    lgb = float(np.exp(values[0]))
    deviation = scatter * np.sqrt(_correlation(residual))
    error = lgb * float(deviation / max(np.linalg.norm(own), 1e-9 * fit.size))
    warning = None
    if error > 0.1 * lgb:
        warning = (
            "the loop says little of the stiffness; hang the rod narrower, so that its bend is "
            "as tight as its weight allows"
        )
    return MeasuredLength(lgb, error, warning)


def _correlation(residual: np.ndarray) -> float:
    """By how much errors that neighbours share raise the variance of what is fitted."""
    centred = residual - residual.mean()
    power = float((centred**2).sum())
    total = 1.0
    for lag in range(1, len(centred) // 4):
        share = float((centred[lag:] * centred[:-lag]).sum()) / max(power, 1e-300)
        if share <= 0.05:
            break
        total += 2.0 * share
    return total


class _Fit:
    """Least squares of normal distances; values: log L_gb, length over the points', and at each end
    x, y [size] and the tangent's angle [rad]."""

    def __init__(self, points: np.ndarray, arc: np.ndarray):
        self.points, self.arc = points, arc
        self.size = float(np.ptp(points, axis=0).max())
        # Equilibria are sought from a smooth curve, then from the last one found.
        smooth = [Polynomial.fit(arc, column, _DEGREE) for column in points.T]
        even = np.linspace(0.0, arc[-1], _EDGES + 1)
        self.shape = np.column_stack([line(even) for line in smooth])
        count = max(3, len(points) // 15)
        self.first = points[count] - points[0]
        self.last = points[-1] - points[-1 - count]

    def start(self) -> np.ndarray | None:
        """Values of the best of the first guesses, or None where there is none."""
        rows = np.stack([self.guessed(guess) for guess in _GUESSES])
        lines = self.equilibria(rows)
        if lines is None:
            return None
        return rows[int(np.argmin([(self.distance(line) ** 2).sum() for line in lines]))]

    def guessed(self, guess: float) -> np.ndarray:
        ends = [
            np.append(end / self.size, np.arctan2(along[1], along[0]))
            for end, along in ((self.points[0], self.first), (self.points[-1], self.last))
        ]
        return np.concatenate([[np.log(guess * self.size), 1.0], *ends])

    def run(self) -> OptimizeResult | None:
        """The best values with their residual (n,) and jacobian (n, 8) [m], or None where no
        equilibrium is found."""
        values = self.start()
        if values is None or self.equilibria(values[None]) is None:
            return None
        return least_squares(
            self.residual, values, jac=self.rates, x_scale="jac", ftol=_ENOUGH,
            max_nfev=_EVALUATIONS,
        )  # fmt: skip

    def residual(self, values: np.ndarray) -> np.ndarray:
        """(n,) [m]; where there is no equilibrium as if all points were a loop's size off."""
        lines = self.equilibria(values[None])
        return np.full(len(self.points), self.size) if lines is None else self.distance(lines[0])

    def rates(self, values: np.ndarray) -> np.ndarray:
        """(n, 8) of the residual [m], by central differences.

        Raises:
            DataError: a rod beside one that was found has no equilibrium.
        """
        lines = self.equilibria(np.vstack([values + np.diag(_STEPS), values - np.diag(_STEPS)]))
        if lines is None:
            raise DataError(_UNLIKE)
        ahead, behind = np.split(np.stack([self.distance(line) for line in lines]), 2)
        return ((ahead - behind) / (2 * _STEPS[:, None])).T

    def distance(self, line: np.ndarray) -> np.ndarray:
        """(n,) signed distance of the points from a curve (m, 2), positive on its left [m]."""
        fine = CubicSpline(np.linspace(0.0, 1.0, len(line)), line)(np.linspace(0.0, 1.0, 241))
        fine, points = fine @ _PLANE, self.points @ _PLANE
        step = np.diff(fine)
        offset = points[:, None] - fine[:-1]
        share = (offset / step).real
        # The end pieces go on straight: points beyond them count for their distance aside.
        np.maximum(share[:, 1:], 0.0, out=share[:, 1:])
        np.minimum(share[:, :-1], 1.0, out=share[:, :-1])
        away = offset - share * step
        near = (away.real**2 + away.imag**2).argmin(1)
        return (away[np.arange(len(near)), near] * np.abs(step[near]) / step[near]).imag

    def equilibria(self, rows: np.ndarray):
        """(k, nodes, 2) of hanging rods [m], or None where one is not found."""
        share = np.arange(-1, _EDGES + 2) / _EDGES
        off = np.abs(rows[:, 0] - np.log(self.size)).max()
        if rows[:, 1].min() < 0.1 or not off < _ASTRAY:  # no rod between these ends
            return None
        lengths = rows[:, 1] * self.arc[-1]
        edge = lengths / _EDGES
        inner = self.shape[np.clip(np.arange(-1, _EDGES + 2), 0, _EDGES)]
        plane = np.repeat(inner[None], len(rows), axis=0)
        for end, k in ((0, 2), (-1, 5)):
            place = rows[:, k : k + 2] * self.size
            angle = rows[:, k + 2]
            along = edge[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
            inside, ghost = (1, 0) if end == 0 else (-2, -1)
            plane[:, inside] = place
            plane[:, ghost] = place - along if end == 0 else place + along
        position = np.stack([plane[..., 0], np.zeros(plane.shape[:2]), plane[..., 1]], axis=2)
        rods = [
            RodModel(
                length=float(length), bending_stiffness=lgb**3, twisting_stiffness=lgb**3,
                stretching_stiffness=_STRETCH_RATIO * lgb, line_mass=WEIGHT, radius=lgb,
                gravity=1.0,
            )
            for lgb, length in zip(np.exp(rows[:, 0]).tolist(), lengths, strict=True)
        ]  # fmt: skip
        batch = RodBatch.of(
            rods, lengths[:, None] * (share + 1.0 / _EDGES), position, clamped=(True, True),
            director=(0.0, 1.0, 0.0),
        )  # fmt: skip
        prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
        if not EquilibriumSolver(batch).solve(tolerance=1e-8).converged.all():
            return None
        lines = batch.positions()[:, 1:-1, [0, 2]]
        self.shape = lines[0]
        return lines
