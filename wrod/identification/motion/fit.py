"""Fits of models of motion: Levenberg-Marquardt with exact derivatives through the steps."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from wrod.errors import RodError
from wrod.identification.effect import Model
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.inverse import rates_about
from wrod.identification.motion.remembered import KnownSteps
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.solver import MotionRun, Runs
from wrod.identification.motion.tension import base_setup
from wrod.identification.motion.windows import Lacking, Windows, windows_of
from wrod.machine import usable_cores

# Errors of a motion grow far beyond the markers' noise, so large ones count linearly.
_ROBUST = 10e-3
_DAMPING, _HARDER, _TRIALS = 1e-3, 5.0, 7
_CONVERGED = 2e-3
# A parameter as large as its prior's scale costs this share of the misfit that a fit starts from.
_PRIOR = 2e-3
# Slices of windows are run side by side, one a core at most. They are set up one after the other,
# each of which takes as long as so many time steps of a node; with tangents both take longer.
_SLICE = 5600
# Stretches for each parameter that tell the errors of estimates.
_STRETCHES = 3
# Predictions from shaken grips that tell their scatter.
_SHAKES = 6
# Time steps a frame at most, where longer ones do not converge.
_FINEST = 4


@dataclass(frozen=True)
class Linearised:
    """A model's robust misfit to some windows around a parameter vector.

    Attributes:
        cost: mean over coordinates of the robust misfit, the prior included [m].
        hessian, gradient: (P, P), (P,) of the cost, Gauss-Newton.
        error: mean |difference| over coordinates and all markers [m].
        failed: windows whose steps did not converge.
        scatter: (P, P) sum over stretches of the outer products of their shares of the gradient:
            over whole recordings or, where these are few, over so long pieces of them that there
            are three for each parameter.
    """

    cost: float
    hessian: np.ndarray
    gradient: np.ndarray
    error: float
    failed: int
    scatter: np.ndarray

    def part(self, index: np.ndarray) -> Linearised:
        """The same for some of the parameters, the others held."""
        block = np.ix_(index, index)
        return replace(
            self,
            hessian=self.hessian[block],
            gradient=self.gradient[index],
            scatter=self.scatter[block],
        )

    @property
    def covariance(self) -> np.ndarray:
        """(P, P) of the estimates, from the scatter between stretches: errors within one hang
        together, and the model is never exactly the rod's. Fewer stretches than parameters would
        leave combinations of these without any error."""
        inverse = np.linalg.inv(self.hessian)
        return inverse @ self.scatter @ inverse


class MotionLaboratory:
    """Recordings of one rod, and the motions that models predict for them.

    Args:
        measurements: what was recorded.
        subdivisions: edges between neighbouring free markers.
        substeps: time steps a frame.
        device: Warp device.
        remembered: where problems and errors are kept, and looked for first.
    """

    def __init__(
        self,
        measurements: MotionMeasurements,
        *,
        subdivisions: int = 2,
        substeps: int = 1,
        device: str = "cpu",
        remembered: KnownSteps | None = None,
    ):
        self.measurements, self.subdivisions = measurements, subdivisions
        self.remembered = remembered
        self.base = base_setup(measurements, subdivisions)
        self.substeps, self.device = substeps, device
        self.misfit: float | None = None
        self._runs = Runs()

    def windows(self, recordings, starts=(0,), frames=None) -> Windows:
        return windows_of(self.measurements, recordings, starts, frames)

    def run(self, windows: Windows, setup: MotionSetup, rates: Sequence[MotionSetup] = ()):
        """`MotionRun` over slices of the windows, side by side; what its `finish` returns.

        Windows whose steps do not converge are run again with shorter ones.
        """
        x, rate, failed = self._run(windows, setup, rates)
        if failed.any() and self.substeps < _FINEST:
            worst = np.flatnonzero(failed)
            part = windows.part(worst)
            again = self.finer().run(part, setup, rates)
            x[worst], failed[worst] = again[0], again[2]
            if rates:
                rate[worst] = again[1]
        return x, rate, failed

    def _run(self, windows: Windows, setup: MotionSetup, rates: Sequence[MotionSetup]):
        count, rods = 1, len(windows.recording)
        if self.device == "cpu":
            # n slices of the work w, each set up in s, take n s + w / n: least at n^2 = w / s.
            work = rods * (windows.held.shape[1] - 1) * self.substeps * len(setup.node_length)
            count = max(1, min(usable_cores(), rods, round(np.sqrt(work / _SLICE))))
        runs = []
        for index in np.array_split(np.arange(rods), count):
            own = windows.part(index), self.measurements.rate, setup, rates
            runs.append(self._runs.begun(*own, substeps=self.substeps, device=self.device))
        with ThreadPoolExecutor(count) as pool:
            x, rate, failed = zip(*pool.map(MotionRun.finish, runs), strict=True)
        self._runs.keep(runs)
        return np.concatenate(x), np.concatenate(rate) if rates else None, np.concatenate(failed)

    def predict(self, windows: Windows, model: Model, values: np.ndarray) -> np.ndarray:
        """(W, F, M, 3) markers [m]."""
        return self.run(windows, model.setup(self.base, values))[0]

    def error(self, windows: Windows, predicted: np.ndarray) -> float:
        """Mean |difference| over coordinates and all markers from the third frame on [m]."""
        return float(windows.errors(predicted)[:, 2:][windows.seen[:, 2:]].mean())

    def finer(self) -> MotionLaboratory:
        """The same with half the time step."""
        other = copy.copy(self)
        other.substeps = 2 * self.substeps
        vars(other).pop("_halved", None)
        return other

    @cached_property
    def _halved(self) -> MotionLaboratory:
        """The same with half the edges and half the time step."""
        return MotionLaboratory(
            self.measurements, subdivisions=2 * self.subdivisions, substeps=2 * self.substeps,
            device=self.device,
        )  # fmt: skip

    def resolved(
        self, windows: Windows, model: Model, values: np.ndarray
    ) -> tuple[Windows, np.ndarray, np.ndarray]:
        """Windows with what mesh and time step lack in this prediction, (W, F, M, 3) the latter
        without it [m], and (W,) failures.

        Both errors are of second order, so halving shows three quarters of them. Nothing is added
        where the halved steps do not converge. Held while a model is fitted, what is lacking makes
        the fit that of the fine mesh (defect correction), so no parameter makes up for edges.
        """
        predicted, _, failed = self.run(windows, model.setup(self.base, values))
        other = self._halved
        finer, _, lost = other.run(windows, model.setup(other.base, values))
        lacking = 4.0 / 3.0 * (finer - predicted)
        lacking[failed | lost] = 0.0
        return replace(windows, lacking=Lacking(lambda: lacking)), predicted, failed

    def judged(self, windows: Windows, model: Model, values: np.ndarray) -> tuple[Windows, float]:
        """`resolved` windows, and the error of what is predicted for them, with what lacks [m]."""
        resolved = cache(lambda: self.resolved(windows, model, values))

        def work(*_) -> dict:
            own, predicted, _ = resolved()
            return {"error": self.error(own, predicted), "digest": own.lacking.digest}

        found = self._recalled("judged", work, windows, model, values)
        lacking = Lacking(lambda: resolved()[0].lacking.array, found["digest"])
        return replace(windows, lacking=lacking), found["error"]

    def score(self, windows: Windows, model: Model, values: np.ndarray) -> float:
        """Error of what is predicted for windows, with what these lack [m]."""

        def work(*asked) -> dict:
            return {"error": self.error(windows, self.predict(*asked))}

        return self._recalled("score", work, windows, model, values)["error"]

    def floor(self, windows: Windows, model: Model, values: np.ndarray) -> float:
        """Error that may be left of a prediction although the model is right [m]: noise of the
        markers that are compared, and what the noise of grips, first frames and lengths makes of
        it: as much again shows it, of few recordings more than once, with twice the standard error
        of as many recordings as are compared.

        Args:
            windows: from the start of recordings to their end; of them nothing lacks.
        """
        return self._recalled("floor", self._floor, windows, model, values)["floor"]

    def _floor(self, windows: Windows, model: Model, values: np.ndarray) -> dict:
        m, noise = self.measurements, np.random.default_rng(0)
        predicted = self.predict(windows, model, values)
        still = replace(windows, markers=predicted)
        count, each = len(predicted), []
        while len(each) < max(_SHAKES, count):
            noisy = noise.normal(m.positions, m.noise)
            again = windows_of(replace(m, positions=noisy), windows.recording.tolist())
            again = replace(again, markers=windows.markers)
            shaken, _, failed = self.run(again, model.setup(self.base, values))
            shaken[failed] = predicted[failed]
            each += [self.error(still.part(np.array([k])), shaken[[k]]) for k in range(count)]
        shaken_by = np.mean(each) + 2.0 * np.std(each) / np.sqrt(count)
        return {"floor": float(np.hypot(m.noise_floor, shaken_by))}

    def linearise(self, windows: Windows, model: Model, values: np.ndarray) -> Linearised:
        """The misfit and its derivatives."""
        return Linearised(**self._recalled("linearised", self._linearised, windows, model, values))

    def cost(self, windows: Windows, model: Model, values: np.ndarray) -> float:
        """The misfit alone."""
        return self._recalled("cost", self._cost, windows, model, values)["cost"]

    def _recalled(self, what: str, work, windows: Windows, model: Model, values: np.ndarray):
        """What `work` finds, or has found before this identification was stopped, by name."""
        if self.remembered is None:
            return work(windows, model, values)
        key = [what, self.substeps, self.subdivisions, self.misfit]
        key += [model.names, np.asarray(values).tolist(), windows.markers.shape]
        key += [windows.recording.tolist(), windows.start.tolist()]
        key += [windows.lacking.digest]
        found = self.remembered.recall(
            key, lambda: {**work(windows, model, values), "misfit": self.misfit}
        )
        self.misfit = found.pop("misfit")
        return found

    def _linearised(self, windows: Windows, model: Model, values: np.ndarray) -> dict:
        setup = model.setup(self.base, values)
        x, rate, failed = self.run(windows, setup, rates_about(self.base, model, values))
        seen, difference, root, cost, prior = self._misfit(windows, model, values, x)
        count = difference.size
        frames, recordings = seen.shape[1], len(np.unique(windows.recording))
        pieces = min(max(-(-_STRETCHES * len(values) // recordings), 1), frames)
        piece = windows.recording[:, None] * pieces + np.arange(frames) * pieces // frames
        owners, owner = np.unique(piece[seen], return_inverse=True)
        hessian = np.zeros((len(values), len(values)))
        shares = np.zeros((len(owners), len(values)))
        last = 0
        # Window by window, which stay in a processor's memory. Held markers have no derivatives.
        for one, lost, there in zip(rate, failed, seen, strict=True):
            first, last = last, last + np.count_nonzero(there)
            if lost:  # where a run ended early its derivatives mean nothing
                continue
            part = root[first:last, 2:-2]
            j = np.moveaxis(one[there, 2:-2], 2, -1) / np.sqrt(part)[..., None]
            pull = difference[first:last, 2:-2] / np.sqrt(part)
            flat = j.reshape(-1, len(values))
            hessian += flat.T @ flat
            frame = j.reshape(last - first, -1, len(values))
            pulls = pull.reshape(last - first, 1, -1) @ frame
            np.add.at(shares, owner[first:last], pulls[:, 0])
        hessian *= 3.0 / (count * _ROBUST)
        shares *= 3.0 / (count * _ROBUST)
        gradient = shares.sum(axis=0)
        shares = shares - shares.mean(axis=0)
        return {
            "cost": cost,
            "hessian": hessian + np.diag(prior),
            "gradient": gradient + prior * values,
            "error": float(np.abs(difference).mean()),
            "failed": int(failed.sum()),
            "scatter": shares.T @ shares * len(shares) / max(len(shares) - 1, 1),
        }

    def _cost(self, windows: Windows, model: Model, values: np.ndarray) -> dict:
        x, _, _ = self.run(windows, model.setup(self.base, values))
        return {"cost": self._misfit(windows, model, values, x)[3]}

    def _misfit(self, windows, model, values, x):
        """Frames that count, their differences, robust weights, cost and the prior's curvature."""
        seen = windows.seen.copy()
        seen[:, :2] = False
        difference = (x + windows.lacking.array - windows.markers)[seen]
        square = np.sum(difference**2, axis=-1, keepdims=True)
        root = np.sqrt(1.0 + square / _ROBUST**2)
        scale = np.array([p.scale for p in model.parameters])
        cost = _ROBUST * np.sum(root - 1.0) * 3 / max(difference.size, 1)
        if self.misfit is None:
            self.misfit = cost
        prior = _PRIOR * self.misfit / scale**2
        cost += 0.5 * np.sum(prior * values**2)
        return seen, difference, root, float(cost), prior

    def fit(
        self,
        windows: Windows,
        model: Model,
        values: np.ndarray,
        *,
        iterations: int = 12,
        converged: float = _CONVERGED,
        linearised: bool = True,
    ) -> tuple[np.ndarray, Linearised]:
        """Levenberg-Marquardt from `values`, until a step takes less than a share `converged` of
        the misfit.

        Args:
            linearised: whether the problem is wanted where the last of the iterations leads, too.
        """
        values, damping = np.asarray(values, dtype=float), _DAMPING
        self.misfit = None
        now = self.linearise(windows, model, values)
        for k in range(iterations):
            last = not linearised and k == iterations - 1
            trial, then, damping = self._step(windows, model, values, now, damping, last=last)
            if trial is None:
                break
            before, values, now = now.cost, trial, then
            if before - now.cost < converged * before:
                break
        return values, now

    def refine(
        self, windows: Windows, model: Model, values: np.ndarray, steps: int, settled: float = 0.0
    ) -> np.ndarray:
        """Values of a `fit` in a few steps, without the linearisation that would follow the last;
        until one takes less than a share `settled` of the misfit."""
        return self.fit(
            windows, model, values, iterations=steps, converged=settled, linearised=False
        )[0]

    def step(
        self, windows: Windows, model: Model, values: np.ndarray, now: Linearised
    ) -> np.ndarray:
        """One step of Levenberg-Marquardt; `values` where none lowers the misfit."""
        trial, _, _ = self._step(windows, model, values, now, _DAMPING, last=True)
        return values if trial is None else trial

    def _step(self, windows, model, values, now, damping, last=False):
        """Parameters, the problem there and the next damping of a step that lowers the cost; None
        without one. After the last step nobody asks for more of the problem than its cost.

        Most first trials do: they are linearised at once, which is one run in place of two."""
        lower, upper = (np.array([getattr(p, b) for p in model.parameters]) for b in
                        ("lower", "upper"))  # fmt: skip
        # A parameter at its bound stays there while the cost falls beyond it.
        inside = ~(
            ((values <= lower) & (now.gradient > 0)) | ((values >= upper) & (now.gradient < 0))
        )
        for k in range(_TRIALS):
            trial, at_once = np.clip(values + _newton(now, damping, inside), lower, upper), k == 0
            try:
                if at_once and not last:
                    then = self.linearise(windows, model, trial)
                else:
                    then = replace(now, cost=self.cost(windows, model, trial))
            except RodError:  # no rod can be so
                then = replace(now, cost=np.inf)
            if then.cost < now.cost:
                step = trial - values
                promised = -(now.gradient @ step + 0.5 * step @ now.hessian @ step)
                if now.cost - then.cost > 0.5 * promised:
                    damping = max(damping / _HARDER, 1e-6)
                if not (at_once or last):
                    then = self.linearise(windows, model, trial)
                return trial, then, damping
            damping *= _HARDER
        return None, now, damping


def _newton(at: Linearised, damping: float, inside: np.ndarray) -> np.ndarray:
    """(P,) damped Gauss-Newton step of the parameters that are not held at a bound."""
    step = np.zeros(len(inside))
    h = at.hessian[np.ix_(inside, inside)]
    step[inside] = -np.linalg.solve(h + damping * np.diag(np.diag(h)), at.gradient[inside])
    return step
