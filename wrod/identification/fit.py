"""Fits of many models at once: Levenberg-Marquardt with exact derivatives through the solver."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped import ClampedSolver
from wrod.identification.effect import Model
from wrod.identification.layout import COMPLEX_STEP
from wrod.identification.measurements import ClampedMeasurements
from wrod.identification.sensing import Prediction
from wrod.identification.setup import Setup

_MAX_ITERATIONS = 30
_CONVERGED = 0.02
# A candidate that gains less than this share of its distance to the best one has lost.
_HOPELESS = 0.01
_DAMPING = (1e-2, 1e6)
_SMALLEST_STEP = 1.0 / 64
# Candidates in one batch: more share launches, but their Hessians leave the cache.
_BATCH = 48


@dataclass
class Fit:
    """One model at its best parameters.

    Attributes:
        model: the effects.
        values: (P,) parameters; covariance: (P, P), of the Gaussian posterior.
        chi_squared: weighted squares of the residuals over the trials fitted, without the prior.
        residual_count: how many residuals those were.
        converged: whether the iteration ended by its own criterion.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    chi_squared: float
    residual_count: int
    converged: bool

    @property
    def bic(self) -> float:
        """Bayesian information criterion, up to a constant of the data."""
        return self.chi_squared + len(self.values) * np.log(self.residual_count)

    def correlation(self) -> np.ndarray:
        """(P, P) correlations of the parameters."""
        error = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(error, error)


class Laboratory:
    """The trials of one set of measurements, and the rods that models predict for them.

    Args:
        measurements: what was measured.
        edge_count: edges between the clamps. Predictions are extrapolated to the continuum with a
            mesh of half as many.
        device: Warp device.
    """

    def __init__(
        self, measurements: ClampedMeasurements, *, edge_count: int = 60, device: str = "cpu"
    ):
        self.measurements = measurements
        self.edge_count, self.device = edge_count, device
        self.trials = np.arange(measurements.trial_count)
        self.base = Setup.base(measurements, self.trials, edge_count)
        solver = ClampedSolver([self.base], device=device)
        self.base_state = solver.saved()
        self.target, self.deviation = self._observations()
        self.mesh_correction = np.zeros_like(self.target)
        self.refine(Model(), np.zeros(0))

    def _observations(self) -> tuple[np.ndarray, np.ndarray]:
        """(T, R) measured values and their standard deviations: markers, force, torque."""
        m = self.measurements
        target = [m.centerline.reshape(m.trial_count, -1)]
        deviation = [np.full(target[0].shape, m.noise)]
        for value, (relative, absolute) in (
            (m.grip_force, m.force_noise),
            (m.grip_torque, m.torque_noise),
        ):
            if value is not None:
                target.append(value)
                deviation.append(np.hypot(relative * value, absolute))
        return np.concatenate(target, axis=1), np.concatenate(deviation, axis=1)

    def refine(self, model: Model, values: np.ndarray) -> None:
        """Set the mesh correction to that of a model: a third of what halving the mesh changes."""
        fine = self.observe(model, values, corrected=False)
        half = Setup.base(self.measurements, self.trials, self.edge_count // 2)
        solver = ClampedSolver([half], device=self.device)
        setup = self._lead(solver, half, model, values)
        coarse = self._observed(model, values, setup, solver.predict([setup]), 0).real
        self.mesh_correction = (fine - coarse) / 3.0

    def adopt(self, other: Laboratory) -> None:
        """Take the mesh of another laboratory of the same measurements."""
        self.__dict__.update(other.__dict__)

    def solver_at(self, model: Model, values: np.ndarray) -> tuple[ClampedSolver, Setup]:
        """All trials at equilibrium with a model."""
        solver = ClampedSolver([self.base], device=self.device, start=self.base_state)
        return solver, self._lead(solver, self.base, model, values)

    def _lead(self, solver: ClampedSolver, base: Setup, model: Model, values) -> Setup:
        """Lead the rods from the base model to another, in steps that keep them on their branch."""
        setup, done, step = base, 0.0, 0.5
        while done < 1.0 and len(values):
            before = solver.saved()
            setup = model.setup(base, min(done + step, 1.0) * values)
            if solver.solve([setup]).all():
                done, step = done + step, 2.0 * step
            elif step > _SMALLEST_STEP:
                solver.restore(before)
                step *= 0.5
            else:
                raise DataError(
                    f"{self.measurements.name}: no equilibrium with {', '.join(model.names)} at "
                    "the values asked for"
                )
        return setup

    def observe(self, model: Model, values: np.ndarray, *, corrected: bool = True) -> np.ndarray:
        """(T, R) what the sensors would read, all trials."""
        solver, setup = self.solver_at(model, values)
        seen = self._observed(model, values, setup, solver.predict([setup]), 0).real
        return seen + self.mesh_correction if corrected else seen

    def predict(self, model: Model, values: np.ndarray) -> np.ndarray:
        """(T, M, 3) marker positions as the cameras would report them [m]."""
        markers = self.measurements.centerline[0].size
        return self.observe(model, values)[:, :markers].reshape(self.measurements.centerline.shape)

    def jacobian(self, model: Model, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(T, R) readings of all trials and their (T, R, P) derivatives, exact."""
        solver, setup = self.solver_at(model, values)
        seen = self._observed(model, values, setup, solver.predict([setup]), 0).real
        rates = self._rates(solver, [model], [values], self.base)
        return seen + self.mesh_correction, rates[0]

    def _observed(
        self, model: Model, values, setup: Setup, prediction: Prediction, candidate: int
    ) -> np.ndarray:
        """(t, R) readings of one candidate, complex if the prediction is."""
        position = model.measure(
            prediction.position[candidate], prediction.frame[candidate], values, setup
        )
        readings = [position.reshape(len(position), -1)]
        if self.measurements.grip_force is not None:
            readings += [prediction.force[candidate], prediction.torque[candidate]]
        return np.concatenate(readings, axis=1)

    def _rates(self, solver, models, values, base) -> list[np.ndarray]:
        """(t, R, P) derivatives of every candidate's readings."""
        count = max(len(v) for v in values)
        steps = []
        for j in range(count):
            moved = [v.astype(complex) for v in values]
            for v in moved:
                if j < len(v):
                    v[j] += 1j * COMPLEX_STEP
            setups = [m.setup(base, v) for m, v in zip(models, moved, strict=True)]
            steps.append((moved, setups))
        predictions = solver.predict_rates(
            [setups for _, setups in steps], [[j < len(v) for v in values] for j in range(count)]
        )
        return [
            np.stack(
                [
                    np.imag(self._observed(model, moved[c], setups[c], prediction, c))
                    / COMPLEX_STEP
                    for (moved, setups), prediction in list(zip(steps, predictions, strict=True))[
                        : len(values[c])
                    ]
                ],
                axis=2,
            )
            for c, model in enumerate(models)
        ]

    def fit(
        self,
        models: Sequence[Model],
        starts: Sequence[np.ndarray],
        *,
        trials: np.ndarray | None = None,
        weights: np.ndarray | None = None,
        origin: Fit | None = None,
        least_gain: float = 0.0,
        race: bool = True,
        progress=None,
    ) -> list[Fit]:
        """Fit every model from its start, all in one batch.

        Args:
            models, starts: candidates and their first parameter vectors.
            trials: trial indices to fit on; default: the measurements' train trials.
            weights: (candidate, trial) of 0 and 1: which of `trials` a candidate may see.
                origin: a fit whose shapes to start from; by default those of the base model.
            least_gain: a candidate stops at once where the linearised problem promises less.
            race: let a candidate stop early that is far behind the best one of its batch.
        progress: called with 1 whenever a candidate is finished.
        """
        trials = self.measurements.train if trials is None else trials
        if weights is None:
            weights = np.ones((len(models), len(trials)))
        # Launches release the interpreter, so slices of the candidates run side by side. A wind is
        # iterated over the whole batch: its candidates stay among themselves.
        windy = [c for c, m in enumerate(models) if any(e.follows_shape for e in m.effects)]
        still = [c for c in range(len(models)) if c not in windy]
        slices = max(os.cpu_count() or 1, -(-len(still) // _BATCH))
        groups = [g for g in (*(still[k::slices] for k in range(slices)), windy) if g]
        best = _Best(race)
        state = self.base_state
        if origin is not None:
            state = self.solver_at(origin.model, origin.values)[0].saved()
        state = tuple(a[trials] for a in state)

        def run(group):
            own = ([models[c] for c in group], [starts[c] for c in group])
            iteration = _Iteration(self, *own, trials, weights[group], best, state, least_gain)
            return iteration.run(progress)

        fits: list[Fit | None] = [None] * len(models)
        with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
            for group, results in zip(groups, pool.map(run, groups), strict=True):
                for c, fit in zip(group, results, strict=True):
                    fits[c] = fit
        return fits


class _Best:
    """The lowest cost of all candidates so far, for the race."""

    def __init__(self, race: bool):
        self.race, self.cost = race, np.inf

    def behind(self, cost: float) -> float:
        self.cost = min(self.cost, cost)
        return cost - self.cost if self.race else 0.0


class _Iteration:
    """Levenberg-Marquardt of one batch of candidates; each has its own damping."""

    def __init__(self, laboratory: Laboratory, models, starts, trials, weights, best, state, least):
        self.laboratory, self.models, self.trials = laboratory, list(models), trials
        self.weights, self.best = weights, best
        self.base = Setup.base(laboratory.measurements, trials, laboratory.edge_count)
        self.values = [np.array(v, dtype=float) for v in starts]
        self.scales = [np.array([p.scale for p in m.parameters]) for m in models]
        self.target = laboratory.target[trials]
        self.deviation = laboratory.deviation[trials]
        self.correction = laboratory.mesh_correction[trials]
        self.start, self.least_gain = state, least

    def run(self, progress) -> list[Fit]:
        count = len(self.models)
        damping = np.full(count, _DAMPING[0])
        costs = np.full(count, np.inf)
        converged = np.zeros(count, dtype=bool)
        active = list(range(count))
        results: list[Fit | None] = [None] * count
        trial_values = [v.copy() for v in self.values]
        normal: list[tuple[np.ndarray, np.ndarray] | None] = [None] * count
        predicted = np.full(count, np.inf)
        states = [self.start] * count
        solver = None
        for _ in range(_MAX_ITERATIONS):
            if not active:
                break
            if solver is None or solver.candidate_count != len(active):
                solver = self._solver(active, states)
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
                    converged[c] = gain < enough and predicted[c] < enough
                else:
                    damping[c] *= 20.0
                    converged[c] = predicted[c] < _CONVERGED
            if accepted:
                rates = self.laboratory._rates(
                    solver,
                    [self.models[c] for c in active],
                    [trial_values[c] for c in active],
                    self.base,
                )
                for k in accepted:
                    c = active[k]
                    first = normal[c] is None
                    normal[c] = self._normal(c, k, setups[k], readings, rates[k])
                    matrix, rhs = normal[c]
                    if first and rhs @ np.linalg.solve(matrix, rhs) < self.least_gain:
                        converged[c] = True
            self._put_back(solver, active, states)
            done = []
            for c in active:
                if normal[c] is None or converged[c] or damping[c] > _DAMPING[1]:
                    done.append(c)
                    continue
                trial_values[c], predicted[c] = self._step(c, normal[c], damping[c])
            for c in done:
                active.remove(c)
                results[c] = self._result(c, normal[c], costs[c], bool(converged[c]))
                if progress:
                    progress(1)
        for c in active:
            results[c] = self._result(c, normal[c], costs[c], False)
            if progress:
                progress(1)
        return results

    def _solver(self, active, states) -> ClampedSolver:
        stacked = tuple(
            np.concatenate([states[c][i] for c in active]) for i in range(len(self.start))
        )
        return ClampedSolver(
            [self.base] * len(active), device=self.laboratory.device, start=stacked
        )

    def _put_back(self, solver, active, states) -> None:
        solver.restore(
            tuple(np.concatenate([states[c][i] for c in active]) for i in range(len(self.start)))
        )

    def _residual(self, c, k, values, setup, readings) -> np.ndarray:
        seen = self.laboratory._observed(self.models[c], values, setup, readings, k).real
        return (self.target - seen - self.correction) / self.deviation * self.weights[c][:, None]

    def _cost(self, c, k, values, setup, readings) -> float:
        residual = self._residual(c, k, values, setup, readings)
        cost = float((residual**2).sum() + ((values / self.scales[c]) ** 2).sum())
        return cost if np.isfinite(cost) else np.inf

    def _normal(self, c, k, setup, readings, rates) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, prior included, in units of the priors."""
        residual = self._residual(c, k, self.values[c], setup, readings)
        scale = self.scales[c]
        jacobian = rates / self.deviation[..., None] * self.weights[c][:, None, None] * scale
        matrix = np.einsum("trp,trq->pq", jacobian, jacobian) + np.eye(len(scale))
        return matrix, np.einsum("trp,tr->p", jacobian, residual) - self.values[c] / scale

    def _step(self, c, normal, damping) -> tuple[np.ndarray, float]:
        matrix, rhs = normal
        damped = matrix + damping * np.diag(np.diag(matrix))
        step = np.linalg.solve(damped, rhs)
        parameters = self.models[c].parameters
        lower = np.array([p.lower for p in parameters])
        upper = np.array([p.upper for p in parameters])
        values = np.clip(self.values[c] + step * self.scales[c], lower, upper)
        taken = (values - self.values[c]) / self.scales[c]
        return values, float(abs(2 * taken @ rhs - taken @ matrix @ taken))

    def _result(self, c, normal, cost, converged) -> Fit:
        scale = self.scales[c]
        values = self.values[c]
        covariance = np.diag(scale**2)
        if normal is not None:
            covariance = np.linalg.inv(normal[0]) * np.outer(scale, scale)
        return Fit(
            self.models[c],
            values,
            covariance,
            float(cost - ((values / scale) ** 2).sum()),
            int(self.target.shape[1] * self.weights[c].sum()),
            converged,
        )
