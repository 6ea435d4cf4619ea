"""Fits of many models at once: Levenberg-Marquardt with exact derivatives through the solver."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.effect import Model
from wrod.machine import usable_cores

_MAX_ITERATIONS = 30
_CONVERGED = 0.02
# A candidate that gains less than this share of its distance to the best one has lost.
_HOPELESS = 0.05
_DAMPING = (1e-2, 1e6)
# A step may move the markers of a trial by this share of the free length (RMS, to first order):
# beyond, rods do not follow and the linearisation says little.
_REACH = 0.04
# Candidates in one batch: more share launches, but the slowest keeps the others waiting.
_BATCH = 20
# A linearisation has as many columns for every rod of a batch as its widest candidate asks for, so
# candidates with more parameters than this have a batch of their own.
WIDE = 12
# How often a start that a rod does not follow to is taken nearer, to which share of what it adds.
_NEARER_STARTS, _NEARER = 2, 0.25
# In a race, a gain below this share of what is left above the noise decides nothing.
_INDIFFERENT = 1e-3


@dataclass
class Fit:
    """One model at its best parameters.

    Attributes:
        model: the effects.
        values: (P,) parameters; covariance: (P, P), of the Gaussian posterior.
        chi_squared: weighted squares of the residuals over the trials fitted, without the prior.
        residual_count: how many residuals those were; effective_count: how many independent
            readings they amount to.
        converged: whether the iteration ended by its own criterion.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    chi_squared: float
    residual_count: int
    effective_count: float
    converged: bool

    @property
    def bic(self) -> float:
        """Bayesian information criterion, up to a constant of the data."""
        return self.chi_squared + len(self.values) * np.log(self.effective_count)

    def spread(self) -> Fit:
        """The fit with its covariance scaled by what is left, where that is more than noise: of
        what the model leaves wrong the parameters bear their part (Birge's ratio)."""
        free = max(self.residual_count - len(self.values), 1)
        return replace(self, covariance=self.covariance * max(1.0, self.chi_squared / free))

    def correlation(self) -> np.ndarray:
        """(P, P) correlations of the parameters."""
        error = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(error, error)


def fit_models(
    laboratory: Laboratory,
    models: Sequence[Model],
    starts: Sequence[np.ndarray],
    *,
    weights: np.ndarray | None = None,
    origin: Fit | Sequence[Fit] | None = None,
    least_gain: float | Sequence[float] = 0.0,
    race: bool = True,
    rival: float = np.inf,
) -> list[Fit]:
    """Fit every model from its start, all in one batch.

    Args:
        models, starts: candidates and their first parameter vectors.
        weights: (candidate, trial) of 0 and 1: which of the train trials a candidate may see.
        origin: a fit whose shapes to start from, or one for each candidate; by default those of
            the base model.
        least_gain: a candidate stops at once where the linearised problem promises less; for all
            or for each.
        race: let a candidate stop early that is far behind the best one of its batch, or whose
            gains are small against what it leaves above the noise.
        rival: chi squared of a model that is already there, for the race.

    Raises:
        OutOfTime: the laboratory's clock has run out; it keeps what was fitted.
    """
    every, trials = weights is None, laboratory.measurements.train
    if weights is None:
        weights = np.ones((len(models), len(trials)))
    # Launches release the interpreter, so slices of the candidates run side by side; their number
    # does not depend on the machine, nor does the race. A wind is iterated over the whole batch:
    # its candidates stay among themselves.
    windy = [c for c, m in enumerate(models) if any(e.follows_shape for e in m.effects)]
    wide = [c for c, v in enumerate(starts) if len(v) > WIDE and c not in windy]
    still = [c for c in range(len(models)) if c not in windy and c not in wide]
    # All rods of a batch get as many derivatives as its widest candidate has.
    still.sort(key=lambda c: len(starts[c]))
    each = -(-len(still) // max(-(-len(still) // _BATCH), 1))
    groups = [still[k : k + each] for k in range(0, len(still), each or 1)] + [windy] * bool(windy)
    least_gains = np.broadcast_to(least_gain, len(models))
    origins = origin if isinstance(origin, Sequence) else [origin] * len(models)
    distinct = {id(one): one for one in origins}
    shapes = {key: _state_of(laboratory, one, trials) for key, one in distinct.items()}
    states = [shapes[id(one)] for one in origins]

    def run(group, rival=rival):
        own = ([models[c] for c in group], [starts[c] for c in group])
        begin, least = [states[c] for c in group], least_gains[group]
        there = [0 if origins[c] is None else len(origins[c].values) for c in group]
        iteration = _Iteration(
            laboratory, *own, trials, weights[group], _Best(race, rival), begin, least, there
        )
        return list(zip(iteration.run(), iteration.states, strict=True))

    fits: dict[int, tuple[Fit, tuple[np.ndarray, ...]]] = {}
    if len(groups) == 1:  # without a second thread equilibria are recorded
        fits |= dict(zip(groups[0], run(groups[0]), strict=True))
    else:
        with ThreadPoolExecutor(max_workers=usable_cores()) as pool:
            for group, results in zip(groups, pool.map(run, groups), strict=True):
                fits |= dict(zip(group, results, strict=True))
    if wide:
        # The narrow ones are done: theirs is the mark to beat.
        mark = min([rival, *(f.chi_squared for f, _ in fits.values())])
        fits |= dict(zip(wide, run(wide, mark), strict=True))
    found = [fits[c][0] for c in range(len(models))]
    for fit, own in fits.values() if every else ():
        if np.isfinite(fit.chi_squared):
            laboratory.remember(fit.model, fit.values, trials, own)
    if every:
        laboratory.clock.fits += [f for f in found if np.isfinite(f.chi_squared)]
    laboratory.clock.check()
    return found


def solved(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solution of normal equations in units of the priors, which are part of them: directions that
    double precision loses, as beside a fold, where one trial outweighs all, are the priors' own.
    NaN where the equations are not finite."""
    if not np.isfinite(matrix).all():
        return np.full_like(rhs, np.nan)
    # One parameter that is known much better than another is no direction that is lost.
    scale = np.sqrt(np.diag(matrix))
    by = scale.reshape(-1, *[1] * (rhs.ndim - 1))
    size, modes = np.linalg.eigh(matrix / np.outer(scale, scale))
    lost = size < len(size) * np.finfo(float).eps
    of_priors = ((modes / scale[:, None]) ** 2).sum(axis=0)
    return (modes / np.where(lost, of_priors, size)) @ (modes.T @ (rhs / by)) / by


def of_trials_with_rates(rates: np.ndarray) -> np.ndarray:
    """Rates (trial, reading, parameter), 0 of a trial without: on a fold a rod has no rate."""
    return np.where(np.isfinite(rates).all(axis=(1, 2), keepdims=True), rates, 0.0)


def _state_of(laboratory: Laboratory, origin: Fit | None, trials) -> tuple[np.ndarray, ...]:
    """Shapes to start from: those of a fit, if there are any, else the base model's."""
    if origin is not None:
        # A fit may have come past a fold that a path from the base model does not get past.
        with suppress(DataError):
            return laboratory.solver_at(origin.model, origin.values, trials)[0].saved()
    return tuple(a[trials] for a in laboratory.base_state)


class _Best:
    """The lowest cost of a batch so far, for the race."""

    def __init__(self, race: bool, rival: float):
        self.race, self.cost = race, rival

    def behind(self, cost: float) -> float:
        self.cost = min(self.cost, cost)
        return cost - self.cost if self.race else 0.0

    def left(self, cost: float, count: float) -> float:
        """How far a cost of `count` readings is beyond what noise may have, in a race."""
        return max(cost - count - 5.0 * np.sqrt(2.0 * count), 0.0) if self.race else 0.0


def _stacked(active, states) -> tuple[np.ndarray, ...]:
    """The state of a batch of the active candidates."""
    return tuple(map(np.concatenate, zip(*(states[c] for c in active), strict=True)))


class _Iteration:
    """Levenberg-Marquardt of one batch of candidates; each has its own damping."""

    def __init__(
        self, laboratory: Laboratory, models, starts, trials, weights, best, states, least, there
    ):
        self.laboratory, self.models, self.trials = laboratory, list(models), trials
        self.weights, self.best = weights, best
        self.base = ClampedSetup.base(laboratory.measurements, trials, laboratory.edge_count)
        self.values = [np.array(v, dtype=float) for v in starts]
        self.means = [m.prior_mean(v) for m, v in zip(self.models, self.values, strict=True)]
        self.scales = [np.array([p.scale for p in m.parameters]) for m in models]
        self.target = laboratory.target[trials]
        self.coordinates = laboratory.measurements.centerline[0].size
        self.correction = laboratory.mesh_correction[trials]
        self.readings = laboratory.effective[trials]
        self.states, self.least_gain, self.there = list(states), least, there

    def run(self) -> list[Fit]:
        count = len(self.models)
        damping = np.full(count, _DAMPING[0])
        costs = np.full(count, np.inf)
        converged = np.zeros(count, dtype=bool)
        active = list(range(count))
        results: list[Fit | None] = [None] * count
        trial_values = [v.copy() for v in self.values]
        normal: list[tuple[np.ndarray, np.ndarray] | None] = [None] * count
        moves: list[np.ndarray | None] = [None] * count
        promised = np.full(count, np.inf)
        nearer = np.zeros(count, dtype=int)
        states, solver = self.states, None
        for _ in range(_MAX_ITERATIONS):
            if not active or self.laboratory.clock.over:
                break
            if solver is None or solver.candidate_count != len(active):
                bases = [self.base] * len(active)
                begin = _stacked(active, states)
                solver = ClampedSolver(bases, device=self.laboratory.device, start=begin)
            setups = [self.models[c].setup(self.base, trial_values[c]) for c in active]
            reached = solver.solve(setups, walk=False)
            readings = solver.predict(setups)
            rods = solver.saved()
            accepted = []
            for k, c in enumerate(active):
                cost = np.inf
                if (reached[k] | (self.weights[c] == 0)).all():
                    cost = self._cost(c, k, trial_values[c], setups[k], readings)
                if cost <= costs[c] and np.isfinite(cost):
                    gain = costs[c] - cost if np.isfinite(costs[c]) else np.inf
                    self.values[c], costs[c] = trial_values[c].copy(), cost
                    damping[c] = max(damping[c] / 10.0, 1e-9)
                    accepted.append(k)
                    mine = slice(k * len(self.trials), (k + 1) * len(self.trials))
                    states[c] = tuple(a[mine] for a in rods)
                    enough = _CONVERGED + _HOPELESS * self.best.behind(cost)
                    enough += _INDIFFERENT * self.best.left(cost, self.weights[c] @ self.readings)
                    converged[c] = gain < enough and promised[c] < enough
                else:
                    damping[c] *= 20.0
                    converged[c] = promised[c] < _CONVERGED
            if accepted:
                rates = self.laboratory.rates(
                    solver,
                    [self.models[c] for c in active],
                    [trial_values[c] for c in active],
                    self.base,
                )
                for k in accepted:
                    c = active[k]
                    first = normal[c] is None
                    normal[c] = self._normal(c, k, setups[k], readings, rates[k])
                    moves[c] = (
                        of_trials_with_rates(rates[k])[:, : self.coordinates] * self.scales[c]
                    )
                    matrix, rhs = normal[c]
                    if first and rhs @ solved(matrix, rhs) < self.least_gain[c]:
                        converged[c] = True
            solver.restore(_stacked(active, states))
            done = []
            for c in active:
                if normal[c] is None and nearer[c] < _NEARER_STARTS:
                    nearer[c] += 1
                    trial_values[c] = self._nearer_start(c, trial_values[c])
                    continue
                if normal[c] is None or converged[c] or damping[c] > _DAMPING[1]:
                    done.append(c)
                    continue
                trial_values[c], promised[c] = self._step(c, normal[c], moves[c], damping[c])
            for c in done:
                active.remove(c)
                results[c] = self._result(c, normal[c], costs[c], bool(converged[c]))
        for c in active:
            results[c] = self._result(c, normal[c], costs[c], False)
        return results

    def _residual(self, c, k, values, setup, readings) -> np.ndarray:
        seen = self.laboratory.observed(self.models[c], values, setup, readings, k).real
        left = self.laboratory.whiten(self.target - seen - self.correction, self.trials)
        return left * self.weights[c][:, None]

    def _cost(self, c, k, values, setup, readings) -> float:
        residual = self._residual(c, k, values, setup, readings)
        cost = float((residual**2).sum() + self._prior(c, values))
        return cost if np.isfinite(cost) else np.inf

    def _prior(self, c, values) -> float:
        return float((((values - self.means[c]) / self.scales[c]) ** 2).sum())

    def _normal(self, c, k, setup, readings, rates) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, prior included, in units of the priors."""
        residual = self._residual(c, k, self.values[c], setup, readings)
        scale = self.scales[c]
        jacobian = self.laboratory.whiten(rates, self.trials)
        jacobian *= self.weights[c][:, None, None] * scale
        matrix = np.einsum("trp,trq->pq", jacobian, jacobian) + np.eye(len(scale))
        away = (self.values[c] - self.means[c]) / scale
        return matrix, np.einsum("trp,tr->p", jacobian, residual) - away

    def _step(self, c, normal, moves, damping) -> tuple[np.ndarray, float]:
        """The values to try next, and what the linearised problem promises without damping."""
        matrix, rhs = normal
        parameters, scale = self.models[c].parameters, self.scales[c]
        lower, upper = np.array([(p.lower, p.upper) for p in parameters]).T
        # A parameter at its bound that wants beyond stays there.
        stuck = (self.values[c] <= lower) & (rhs < 0.0) | (self.values[c] >= upper) & (rhs > 0.0)
        free = np.flatnonzero(~stuck)
        matrix, rhs = matrix[np.ix_(free, free)], rhs[free]
        promise = float(rhs @ solved(matrix, rhs))
        step = np.zeros(len(scale))
        step[free] = solved(matrix + damping * np.diag(np.diag(matrix)), rhs)
        moved = np.sqrt(3.0 * ((moves @ step) ** 2).mean(axis=1).max())
        step *= min(1.0, _REACH * self.base.length / max(moved, 1e-300))
        return np.clip(self.values[c] + step * scale, lower, upper), promise

    def _nearer_start(self, c, start) -> np.ndarray:
        """A start with a smaller share of what it adds to the fit whose shapes it begins with."""
        less, first = self.models[c].grown(start, _NEARER), self.there[c]
        return np.concatenate([start[:first], less[first:]])

    def _result(self, c, normal, cost, converged) -> Fit:
        scale = self.scales[c]
        values = self.values[c]
        covariance = np.diag(scale**2)
        if normal is not None:
            covariance = solved(normal[0], np.eye(len(scale))) * np.outer(scale, scale)
        return Fit(
            self.models[c],
            values,
            covariance,
            float(cost - self._prior(c, values)),
            int(self.weights[c] @ self.laboratory.read[self.trials].sum(axis=1)),
            float(self.weights[c] @ self.laboratory.effective[self.trials]),
            converged,
        )
