"""The trials of one set of measurements, and what models predict for their sensors."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.branches import from_measured, to_measured
from wrod.identification.clamped.clock import Clock
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.layout import COMPLEX_STEP
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.clamped.noise import NoiseModel, outliers_of, whiteners
from wrod.identification.clamped.sensing import Prediction
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.effect import Effect, Model
from wrod.rods.state import node_positions

_SMALLEST_STEP = 1.0 / 64
# Of the free length, RMS over the markers; 90 edges move rods by less than a tenth of it.
_LARGEST_CORRECTION = 0.005
# States that are kept, of 0.2 MB for 24 trials.
_REMEMBERED = 200


class Laboratory:
    """The trials of one set of measurements, and the rods that models predict for them.

    Args:
        measurements: what was measured.
        edge_count: edges between the clamps. Predictions are extrapolated to the continuum with a
            mesh of half as many.
        device: Warp device.

    A search sets its `clock`, without an end by default.
    """

    def __init__(
        self, measurements: ClampedMeasurements, *, edge_count: int = 90, device: str = "cpu"
    ):
        self.measurements, self.clock = measurements, Clock()
        # Each with its model, so that no other takes its place in memory.
        self._known: dict[tuple, tuple[Model, tuple[np.ndarray, ...]]] = {}
        self._own = threading.local()
        self.edge_count, self.device = edge_count, device
        self.trials = np.arange(measurements.trial_count)
        self.base = ClampedSetup.base(measurements, self.trials, edge_count)
        solver = self._at_base(self.base)
        self.base_state, self.branches = solver.saved(), solver.branches
        self.target, self.deviation = self._observations()
        self.mesh_correction = np.zeros_like(self.target)
        self.read = np.isfinite(self.target)
        markers = np.isfinite(measurements.centerline).all(axis=2)
        self.read[:, : 3 * markers.shape[1]] = np.repeat(markers, 3, axis=1)
        self.missing = int((~markers).sum())
        self.target = np.nan_to_num(self.target)
        self.set_noise(NoiseModel())
        self.refine(Model(), np.zeros(0))
        self.outliers = self._set_aside()

    def _at_base(self, base: ClampedSetup) -> ClampedSolver:
        """Rods of the base model on their own mesh, on the equilibria that were measured."""
        solver = ClampedSolver([base], device=self.device, shape=base.measured)
        to_measured(solver, [base], base.measured, self.measurements.noise_floor, clearly=True)
        return solver

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

    def _set_aside(self) -> np.ndarray:
        """(T, M) markers that stand apart from their neighbours; they are read no more."""
        m = self.measurements
        found = outliers_of(m.centerline - self.predict(Model(), np.zeros(0)), m.noise)
        if found.any():
            self.read[:, : found.size // len(found) * 3] &= ~np.repeat(found, 3, axis=1)
            self.set_noise(self.noise)
        return found

    def set_noise(self, noise: NoiseModel, scatter_rates: np.ndarray | None = None) -> None:
        """Weigh readings as this noise asks; see `whiteners` for (T, R, 15) `scatter_rates`."""
        self.noise, self.scatter_rates = noise, scatter_rates
        self.whitener, self.effective = whiteners(
            noise, self.measurements.arc_length, self.read, scatter_rates
        )
        self.whitener /= self.deviation[:, None, :]

    def whiten(self, values: np.ndarray, trials: np.ndarray) -> np.ndarray:
        """Differences of readings (t, R, ...) as independent numbers of variance 1."""
        whitener = self.whitener[trials]
        return (whitener @ values.reshape(*values.shape[:2], -1)).reshape(values.shape)

    def misfit(self, model: Model, values: np.ndarray, trials: np.ndarray) -> np.ndarray:
        """(t,) chi squared of every trial."""
        left = self.target[trials] - self.observe(model, values, trials=trials)
        return (self.whiten(left, trials) ** 2).sum(axis=1)

    def rms(self, predicted: np.ndarray, trials: np.ndarray) -> float:
        """RMS over the markers read in trials of the distance to (T, M, 3) predictions [m]."""
        square = ((predicted - self._markers(self.target)) ** 2).sum(axis=-1)[trials]
        return float(np.sqrt(square[self._markers(self.read)[trials, :, 0]].mean()))

    def refine(self, model: Model, values: np.ndarray) -> None:
        """Set the mesh correction to that of a model: a third of what halving the mesh changes.

        A trial whose rod reaches another equilibrium on the coarser mesh keeps none.
        """
        fine = self.observe(model, values, corrected=False)
        half = ClampedSetup.base(self.measurements, self.trials, self.edge_count // 2)
        solver = self._at_base(half)
        setup = self._lead(solver, half, model, values)
        coarse = self.observed(model, values, setup, solver.predict([setup]), 0).real
        correction = (fine - coarse) / 3.0
        move = np.sqrt((self._markers(correction) ** 2).sum(axis=2).mean(axis=1))
        same = move < _LARGEST_CORRECTION * self.measurements.material.length
        self.mesh_correction = correction * same[:, None]

    def adopt(self, other: Laboratory) -> None:
        """Take the mesh of another laboratory of the same measurements."""
        self.__dict__.update(other.__dict__)

    def base_positions(self) -> np.ndarray:
        """(T, n + 1, 3) nodes of the base model's rods between the clamps [m]."""
        return node_positions(self.base_state[0])[:, 1:-1]

    def solver_at(
        self, model: Model, values: np.ndarray, trials: np.ndarray | None = None
    ) -> tuple[ClampedSolver, ClampedSetup]:
        """Trials (default: all) at equilibrium with a model; the solver is this thread's, until it
        asks for the same trials again.

        Raises:
            DataError: a trial has none.
        """
        trials = self.trials if trials is None else trials
        base = ClampedSetup.base(self.measurements, trials, self.edge_count)
        key = _key(model, values, trials)
        state = tuple(a[trials] for a in self.base_state)
        solvers: dict[bytes, ClampedSolver] = vars(self._own).setdefault("of_trials", {})
        solver = solvers.get(trials.tobytes())
        if solver is None or solver.edge_count != self.edge_count:
            solver = ClampedSolver([base], device=self.device, start=state)
            solvers[trials.tobytes()] = solver
        if key in self._known:
            solver.begin([base], self._known[key][1])
            setup = model.setup(base, values)
            if solver.solve([setup], walk=False).all():
                return solver, setup
        solver.begin([base], state)
        setup = self._lead(solver, base, model, values)
        self.remember(model, values, trials, solver.saved())
        return solver, setup

    def remember(self, model: Model, values: np.ndarray, trials: np.ndarray, state: tuple) -> None:
        """Keep a state in which trials are at equilibrium with a model: leading rods there again
        takes most of the time of asking what a fit leaves."""
        self._known[_key(model, values, trials)] = model, state
        while len(self._known) > _REMEMBERED:
            self._known.pop(next(iter(self._known)))

    def settle(self, model: Model, values: np.ndarray, trials: np.ndarray) -> bool:
        """Put trials on the equilibria of a model that are nearest to what was measured, if others
        are nearer than where they are; whether any was put.

        Raises:
            DataError: a trial has no equilibrium with these values.
        """
        solver, setup = self.solver_at(model, values, trials)
        measured = self._as_measured(solver, model, values, setup)
        put = to_measured(solver, [setup], measured, every=True)
        if put:
            self.remember(model, values, trials, solver.saved())
        return put

    def _lead(
        self, solver: ClampedSolver, base: ClampedSetup, model: Model, values
    ) -> ClampedSetup:
        """Lead the rods from the base model to another, in steps that keep them on their branch.

        Where no short way leads there, as past a fold, they come from their measured shapes, if
        that leaves no doubt of the branch (`from_measured`).
        """
        first = solver.saved()
        # Shorter steps are cheaper than the patience of walks, which may still get past a fold.
        for walk in (False, True):
            setup, done, step = base, 0.0, 0.5
            while done < 1.0 and len(values):
                self.clock.check()
                before = solver.saved()
                setup = model.setup(base, model.grown(values, min(done + step, 1.0)))
                if solver.solve([setup], walk=walk).all():
                    done, step = done + step, 2.0 * step
                elif step > _SMALLEST_STEP:
                    solver.restore(before)
                    step *= 0.5
                else:
                    break
            else:
                if len(values):
                    measured = self._as_measured(solver, model, values, setup)
                    to_measured(solver, [setup], measured, self.measurements.noise_floor)
                return setup
            solver.restore(first)
            if not walk:
                setup = model.setup(base, values)
                if from_measured(solver, [setup], base.measured)[1].all():
                    return setup
                solver.restore(first)
        raise DataError(
            f"{self.measurements.name}: no equilibrium with {', '.join(model.names)} at the values "
            "asked for"
        )

    def _as_measured(
        self, solver: ClampedSolver, model: Model, values, setup: ClampedSetup
    ) -> np.ndarray:
        """(t, n + 1, 3) where the nodes are by the markers, if cameras see them as the model says:
        where one is off every rod is as far from what was reported, and none the farther for
        standing elsewhere."""
        if not _measuring(model):
            return setup.measured
        prediction, own = solver.predict([setup]), setup.trials
        seen = self._markers(self.observed(model, values, setup, prediction, 0).real)
        centerline = self.measurements.centerline.copy()
        centerline[own] -= seen - prediction.position[0].real
        corrected = replace(self.measurements, centerline=centerline)
        return corrected.node_positions(solver.edge_count)[own]

    def observe(
        self,
        model: Model,
        values: np.ndarray,
        *,
        trials: np.ndarray | None = None,
        corrected: bool = True,
    ) -> np.ndarray:
        """(t, R) what the sensors would read in `trials`, by default all.

        Raises:
            DataError: a trial has no equilibrium with these values.
        """
        trials = self.trials if trials is None else trials
        solver, setup = self.solver_at(model, values, trials)
        seen = self.observed(model, values, setup, solver.predict([setup]), 0).real
        return seen + self.mesh_correction[trials] if corrected else seen

    def predict(self, model: Model, values: np.ndarray) -> np.ndarray:
        """(T, M, 3) marker positions as the cameras would report them [m]."""
        return self._markers(self.observe(model, values))

    def _markers(self, readings: np.ndarray) -> np.ndarray:
        shape = self.measurements.centerline.shape[1:]
        return readings[:, : shape[0] * shape[1]].reshape(-1, *shape)

    def scores(self, models: Sequence[Model], values: Sequence[np.ndarray]) -> list[float | None]:
        """RMS marker distance on the test trials of many models [m], in one batch.

        None where a trial has no equilibrium with the values.
        """
        m, trials = self.measurements, self.measurements.test
        base = ClampedSetup.base(m, trials, self.edge_count)
        state = tuple(a[trials] for a in self.base_state)
        solver = ClampedSolver([base] * len(models), device=self.device, start=state)
        reached = np.ones(len(models), dtype=bool)
        for share in (0.5, 1.0):
            setups = [m.setup(base, m.grown(v, share)) for m, v in zip(models, values, strict=True)]
            reached &= solver.solve(setups).all(axis=1)
        prediction = solver.predict(setups)
        scores: list[float | None] = []
        for c, (model, own) in enumerate(zip(models, values, strict=True)):
            try:
                if reached[c]:
                    seen = self.observed(model, own, setups[c], prediction, c).real
                    seen = seen + self.mesh_correction[trials]
                else:
                    seen = self.observe(model, own, trials=trials)
            except DataError:
                scores.append(None)
                continue
            square = ((self._markers(seen) - self._markers(self.target)[trials]) ** 2).sum(axis=-1)
            read = self._markers(self.read)[trials, :, 0]
            scores.append(float(np.sqrt(square[read].mean())))
        return scores

    def jacobian(self, model: Model, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(T, R) readings of all trials and their (T, R, P) derivatives, exact."""
        solver, setup = self.solver_at(model, values)
        seen = self.observed(model, values, setup, solver.predict([setup]), 0).real
        rates = self.rates(solver, [model], [values], self.base)
        return seen + self.mesh_correction, rates[0]

    def observed(
        self, model: Model, values, setup: ClampedSetup, prediction: Prediction, candidate: int
    ) -> np.ndarray:
        """(t, R) readings of one candidate, complex if the prediction is."""
        position = prediction.position[candidate]
        if _measuring(model):
            position = model.measure(position, prediction.frames[candidate](), values, setup)
        readings = [position.reshape(len(position), -1)]
        if self.measurements.grip_force is not None:
            readings += [prediction.force[candidate], prediction.torque[candidate]]
        return np.concatenate(readings, axis=1)

    def rates(self, solver, models, values, base, first: int = 0) -> list[np.ndarray]:
        """(t, R, P) derivatives of every candidate's readings, by parameters from `first` on."""
        count = max(len(v) for v in values)
        steps = []
        for j in range(first, count):
            moved = [v.astype(complex) for v in values]
            for v in moved:
                if j < len(v):
                    v[j] += 1j * COMPLEX_STEP
            setups = [m.setup(base, v) for m, v in zip(models, moved, strict=True)]
            steps.append((moved, setups))
        predictions = solver.predict_rates(
            [setups for _, setups in steps],
            [[j < len(v) for v in values] for j in range(first, count)],
        )
        return [
            np.stack(
                [
                    np.imag(self.observed(model, moved[c], setups[c], prediction, c)) / COMPLEX_STEP
                    for (moved, setups), prediction in list(zip(steps, predictions, strict=True))[
                        : len(values[c]) - first
                    ]
                ],
                axis=2,
            )
            for c, model in enumerate(models)
        ]


def _measuring(model: Model) -> bool:
    return any(type(e).measure is not Effect.measure for e in model.effects)


def _key(model: Model, values: np.ndarray, trials: np.ndarray) -> tuple:
    """What names a state: effects of no size leave it as it is."""
    parts = [(id(e), v) for e, v in zip(model.effects, model.split(values), strict=True)]
    return (*((e, v.tobytes()) for e, v in parts if v.any()), trials.tobytes())
