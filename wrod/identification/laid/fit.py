"""What the shapes of laid rods say of rod and table: natural curvature, L_gb, friction, by
simulation.

The deployment is simulated as it was planned, with the believed rod and with each parameter a
little off; the residual is explained by these prints, the weighted least squares of one Gauss-
Newton step, as often as asked. Friction keeps what it is given unless it is asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from wrod import arguments
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.simulate import Trial, simulate_deployments
from wrod.errors import DataError, GraspError, within_precision
from wrod.identification.effect import Estimate
from wrod.identification.laid.measurements import LaidMeasurements
from wrod.identification.report import Finding
from wrod.identification.verdict import CORRELATED, LAID, LAID_ONCE
from wrod.planning.tail import tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod, RodModel
from wrod.solvers.friction import Friction

PARAMETERS = ("natural_curvature", "log_L_gb", "log_friction")
# Of the rod, among which as few are taken as explain it.
_OF_ROD = PARAMETERS[:2]
_UNITS = {"natural_curvature": "1/m", "log_L_gb": "", "log_friction": ""}
# Differences are taken over these: large against the simulation's rounding, small in effect.
_STEPS = {"natural_curvature": 1.0, "log_L_gb": 0.03, "log_friction": 0.15}
# Standard deviations of Gaussian priors around the believed rod.
_PRIORS = {"natural_curvature": 20.0, "log_L_gb": 0.5, "log_friction": 0.7}
# Of a step that leaves more than there was this share is tried; one that is over so many of the
# noise's standard errors has not settled.
_LESS, _SETTLED = 0.3, 3.0
# One parameter is enough where it leaves no more than this, over what both leave.
_ENOUGH = 1.3


@dataclass(frozen=True, kw_only=True)
class LaidFit(Finding):
    """What a set of laid rods says; errors are RMS distances of the rods from the simulation.

    Attributes:
        estimates: by parameter that is needed: how much more than believed the rod is curved at
            rest to the left of the pattern [1/m], the logarithm of the true over the believed L_gb
            and, if asked for, that of the true over the believed friction. Their standard errors
            are those of the noise; what the simulation itself misses is not in them.
        rod: the believed rod with them.
        alone: RMS distance [m] that each parameter alone would leave, to first order.
        correlation: of the two estimates that are told apart worst, 0 for one.
        friction: the table's coefficient, fitted or as given.
    """

    estimates: dict[str, Estimate]
    rod: Rod
    alone: dict[str, float]
    correlation: float
    friction: float


@dataclass
class _Laying:
    """Simulated deployments of rods with other parameters; arguments of `fit_laid`, and how many
    there will be."""

    measurements: LaidMeasurements
    rod: Rod
    trajectory: Trajectory
    friction: Friction
    released: bool
    runs: int
    progress: Callable[[float], object] | None
    options: dict

    def predict(self, many: list[np.ndarray]) -> np.ndarray:
        """(k, 50, 2) where rods with these parameters come to lie."""
        seen, rod, trajectory = self.measurements, self.rod, self.trajectory
        after_plan = tail(seen.pattern, rod, trajectory)
        trials = [
            Trial(seen.pattern, with_parameters(rod, v, trajectory.roll), trajectory,
                  scaled(self.friction, v[2]), tail=after_plan)
            for v in many
        ]  # fmt: skip

        def watch(share: float) -> None:
            if self.progress is not None:
                self.progress(share * len(many) / self.runs)

        try:
            laid = simulate_deployments(trials, progress=watch, **self.options)
        except GraspError:
            ratio = max(np.exp(v[1]) for v in many)
            raise DataError(
                "no rod like the believed one comes to lie there (the fit tries one whose L_gb is "
                f"{ratio:.3g} times as large); check pattern, trajectory, friction and noise"
            ) from None
        if any(d.diverged for d in laid):
            raise DataError("a simulated deployment diverged; take a smaller step or other rods")
        lines = [d.released_centerline if self.released else d.centerline for d in laid]
        # As a camera sees them: by the length that lies there, not by the length at rest.
        return np.stack([seen.at_points(line[:, :2]) for line in lines])

    def linearised(self, values: np.ndarray, active: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(50, 2) where the rod comes to lie, and (active, 100) derivatives by its parameters."""
        steps = np.array([_STEPS[name] for name in PARAMETERS])
        here, *there = self.predict([values, *(values + np.diag(steps)[active])])
        rates = [(t - here).ravel() / h for t, h in zip(there, steps[active], strict=True)]
        return here, np.stack(rates)


def _step(measurements: LaidMeasurements, values, active, rates, off):
    """The values after a Gauss-Newton step, which is at most as long as what is believed before;
    and its matrix."""
    priors = np.array([_PRIORS[name] for name in PARAMETERS])[active]
    weight = len(measurements.curves) / measurements.noise**2
    matrix = weight * rates @ rates.T + np.diag(priors**-2)
    step = np.linalg.solve(matrix, weight * rates @ off - values[active] / priors**2)
    there = values.copy()
    there[active] += step / max(1.0, np.abs(step / priors).max())
    return there, matrix


def _estimates(values, active, covariance) -> tuple[dict[str, Estimate], float]:
    """Estimates by name, and the largest correlation of two."""
    errors = np.sqrt(np.diag(covariance))
    estimates = {
        PARAMETERS[k]: Estimate(float(values[k]), float(e), _UNITS[PARAMETERS[k]])
        for k, e in zip(active, errors, strict=True)
    }
    apart = np.tril(covariance / np.outer(errors, errors), -1)
    return estimates, float(apart.flat[np.abs(apart).argmax()])


@within_precision()
@arguments.checked(
    DataError,
    measurements=arguments.like("what wrod.load_laid returns", "pattern", "curves"),
    friction=arguments.either(
        arguments.like("a wrod.Friction", "static", "kinetic"), arguments.number(0.0, 1e3)
    ),
    iterations=arguments.whole(1, 1000),
)
def fit_laid(
    measurements: LaidMeasurements,
    rod: Rod,
    trajectory: Trajectory,
    friction: Friction | float = 0.6,
    *,
    fit_friction: bool = False,
    released: bool = True,
    iterations: int = 2,
    progress: Callable[[float], object] | None = None,
    **options,
) -> LaidFit:
    """Explain where rods lie by their natural curvature and their L_gb.

    Args:
        measurements: the laid rods.
        rod: the believed rod.
        trajectory: that laid them.
        friction: of the table, or a first guess of it.
        fit_friction: find it as well, together with natural curvature and L_gb. Its derivative is
            that of rods that slide: where none does, the error stays that of the prior, 0.7.
        released: whether they were measured after the grip let go, or with it still holding.
        iterations: Gauss-Newton steps, each a batch of three or four simulated deployments; one
            that leaves more than there was is taken back, and a shorter one tried.
        progress: called with the share of all simulations done since the last call.
        options: those of `wrod.simulate_deployments`.

    Raises:
        DataError: no iteration is asked for, the simulation of the believed rod diverged, or a
            friction is to be found that begins at 0.
    """
    law = friction if isinstance(friction, Friction) else Friction(friction)
    if fit_friction and law.static == 0.0:
        raise DataError(
            "friction is 0, and another is found as so many times the given one; begin with one "
            "that the table may have, such as 0.4"
        )
    roll = trajectory.roll
    active = list(range(len(PARAMETERS) if fit_friction else len(_OF_ROD)))
    runs = (1 + len(active)) * iterations + 1
    laying = _Laying(measurements, rod, trajectory, law, released, runs, progress, options)
    values = kept = np.zeros(len(PARAMETERS))
    before = after = np.inf
    for iteration in range(iterations):
        here, rates = laying.linearised(values, active)
        left = measurements.rms(here)
        if left > after:  # the step went too far for its derivatives
            values = kept + _LESS * (values - kept)
            continue
        kept, after = values, left
        off = (measurements.positions.mean(axis=0) - here).ravel()
        if iteration == 0:
            before, alone = left, _alone(measurements, here, rates, off)
        if not fit_friction and active == [0, 1]:
            # Again after a step with both: one may stand for what the other's derivative omits.
            active = _chosen(measurements, here, rates, off, kept)
            if kept.any() and len(active) == 1:
                (off, kept), after = _without(active[0], kept, rates, off), np.inf
            rates, laying.runs = rates[active], (1 + len(active)) * iterations + 1
        values, matrix = _step(measurements, kept, active, rates, off)
    left, step = measurements.rms(laying.predict([values])[0]), np.abs(values - kept)[active]
    if left < after:
        kept, after = values, left
    values, count, floor = kept.copy(), len(measurements.curves), measurements.noise_floor
    # Of what the model leaves wrong the parameters bear their part (Birge's ratio).
    covariance = np.linalg.inv(matrix) * max(1.0, after / floor) ** 2
    estimates, correlation = _estimates(values, active, covariance)
    verdict, reason = _verdict(before, after, floor, count, estimates, correlation)
    if verdict != "adequate" and (step > _SETTLED * np.sqrt(np.diag(np.linalg.inv(matrix)))).any():
        reason += "; the last step was larger than the noise's error: give more iterations"
    if verdict == "adequate":
        # The friction is asked for, whether or not the believed one would do.
        table = estimates.get("log_friction")
        estimates, after = {} if table is None else {"log_friction": table}, before
        values[: len(_OF_ROD)] = 0.0
    return LaidFit(
        verdict=verdict, reason=reason, before=before, after=after, noise_floor=floor,
        estimates=estimates, rod=with_parameters(rod, values, roll), alone=alone,
        correlation=correlation, friction=scaled(law, values[2]).static,
    )  # fmt: skip


def scaled(law: Friction, log_ratio: float) -> Friction:
    """The law with both coefficients exp(log_ratio) times as large."""
    ratio = float(np.exp(log_ratio))
    kinetic = None if law.kinetic is None else law.kinetic * ratio
    return replace(law, static=law.static * ratio, kinetic=kinetic)


def with_parameters(rod: Rod, values: np.ndarray, roll: float = 0.0) -> Rod:
    """`rod` with more natural curvature to the left as held at `roll`, and another L_gb."""
    more = float(values[0])
    if isinstance(rod, RodModel):
        return rod.bent(more, roll=roll).stiffened(float(np.exp(3.0 * values[1])))
    first, second = rod.natural_curvature
    return replace(
        rod,
        natural_curvature=(first + more * np.cos(roll), second - more * np.sin(roll)),
        gravito_bending_length=rod.gravito_bending_length * float(np.exp(values[1])),
    )


def _chosen(measurements, here, rates, off, values) -> list[int]:
    """The better parameter, or both where it leaves clearly more than both together do."""
    together = np.linalg.lstsq(rates.T, off, rcond=None)[0] @ rates
    left = measurements.rms(here + together.reshape(METRIC_POINTS, 2))
    alone = []
    for name, rate, value in zip(_OF_ROD, rates[::-1], values[1::-1], strict=True):
        other = rate * value
        there = here - other.reshape(METRIC_POINTS, 2)
        alone.append(_alone(measurements, there, rates, off + other)[name])
    best = int(np.argmin(alone))
    return [best] if alone[best] <= _ENOUGH * left else [0, 1]


def _without(kept: int, values: np.ndarray, rates: np.ndarray, off: np.ndarray):
    """What is off [m], (100,), and the values, where of the rod's parameters one alone is kept."""
    other = 1 - kept
    alone = values.copy()
    alone[other] = 0.0
    return off + rates[other] * values[other], alone


def _alone(measurements, here, rates, off) -> dict[str, float]:
    left = {}
    for name, rate in zip(PARAMETERS, rates, strict=False):
        moved = here + (rate * (rate @ off) / max(rate @ rate, 1e-300)).reshape(METRIC_POINTS, 2)
        left[name] = measurements.rms(moved)
    return left


def _verdict(before, after, floor, count, estimates, correlation) -> tuple[str, str]:
    """Neighbouring points of a laid rod err together, so a margin stands for their number."""
    shares = f"{1e3 * before:.2f} mm before, {1e3 * after:.2f} mm after, noise {1e3 * floor:.2f} mm"
    rule = LAID if count > 1 else LAID_ONCE
    if rule.is_noise(before, floor):
        return "adequate", f"the believed rod is within the noise ({shares})"
    clear = [name for name, e in estimates.items() if abs(e.value) > 3.0 * e.stderr]
    if not clear or after > (1.0 - rule.takes) * before:
        return "unexplained", f"neither natural curvature nor L_gb explains the residual ({shares})"
    word = "explained" if rule.is_noise(after, floor) else "partly-explained"
    said = " and ".join(name.removeprefix("log_") for name in clear)
    if abs(correlation) > CORRELATED:
        said += ", which these rods hardly tell apart"
    return word, f"{said} ({shares})"
