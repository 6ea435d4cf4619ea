"""Effects that come or go while a rod is measured, in the order of its trials.

Any effect may do so. A rod that warms loses stiffness, a wet rope weight, one off a spool its bend,
a camera its place. All are built alike, where the data say that something changes: the effect's
numbers go from what they are in the first trial to what they are in the last.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.giving import settled
from wrod.identification.clamped.memory import Memory
from wrod.identification.clamped.steps import best_of_each, extensions
from wrod.identification.clamped.trace import memory_of
from wrod.identification.effect import Effect, Estimate, Model, Parameter, effects

# What may drift, each by an effect of this name.
_MAY = (
    "stiffness", "density", "natural_curvature", "natural_twist", "gravity_tilt", "clamp_offset",
    "clamp_rotation", "grip_offset", "grip_rotation", "camera_offset", "camera_rotation",
)  # fmt: skip
# What takes all that is left takes half of it or more to first order, where rods move far.
_PROMISED = 0.2
# Shares below this are expanded: the quotient of the law has no digits left there.
_STRAIGHT = 1e-3


class Drift(Effect):
    """An effect whose numbers are others in each trial, in their order.

    Args:
        of: the effect.
        by_logarithm: of the time, as what creeps; else what settles.
    """

    # Other effects see the rod before it is another one in each trial.
    stage = 2
    reference = (
        "first + (last - first) (1 - exp(-g u)) / (1 - exp(-g)), u from 0 in the first trial to 1 "
        "in the last: what settles at a rate in proportion to what is left (Newton's law of "
        "cooling); or ln(1 + (exp(g) - 1) u) / g: what goes by the logarithm of time (creep); a "
        "straight line where g = 0"
    )

    def __init__(self, of: Effect, by_logarithm: bool = False):
        self.of, self.name, self.by_logarithm = of, f"drift_of_{of.name}", by_logarithm
        self.title = f"{of.title}, coming or going in the order of the trials"
        self.parameters = (
            *(replace(p, key=f"{p.key}_at_first") for p in of.parameters),
            *(replace(p, key=f"{p.key}_at_last") for p in of.parameters),
            Parameter("settling", "", 2.0, lower=-8.0, upper=20.0, anywhere=True),
        )

    def starts(self, measurements):
        return [np.concatenate([v, v, [1.0]]) for v in self.of.starts(measurements)]

    def each(self, values, when) -> np.ndarray:
        """(T, P) numbers of the effect at (T,) shares of the series."""
        first, last = np.split(np.asarray(values)[:-1], 2)
        gone = _gone(values[-1], np.asarray(when), self.by_logarithm)[:, None]
        if self.of.scales:  # the factor settles, not its logarithm
            return np.log((1.0 - gone) * np.exp(first) + gone * np.exp(last))
        return first + gone * (last - first)

    def apply(self, setup, values):
        rods = setup.rods()
        own = [copy.copy(rods[min(t, len(rods) - 1)]) for t in range(len(setup.trials))]
        for one, mine in zip(own, self.each(values, setup.when), strict=True):
            self.of.apply(one, mine)
        setup.put_together(own)

    def measure(self, position, frame, values, setup):
        if type(self.of).measure is Effect.measure:
            return position
        own = self.each(values, setup.when)
        parts = [
            self.of.measure(position[t : t + 1], frame[t : t + 1], mine, setup)
            for t, mine in enumerate(own)
        ]
        return np.concatenate(parts)

    def special_cases(self, values, measurements):
        """What hardly drifts."""
        return {self.of.name: self.each(values, np.array([0.5]))[0]}

    def describe(self, values, covariance, measurements):
        """What the effect is in the first trial and in the last, and by how much it changes: of a
        factor, as a share of the first."""
        count = len(self.of.parameters)
        ends = [slice(0, count), slice(count, 2 * count)]
        told: dict[str, Estimate] = {}
        for at, k in zip(("first", "last"), ends, strict=True):
            own = self.of.describe(values[k], covariance[k, k], measurements)
            told |= {f"{key}_at_{at}": e for key, e in own.items()}
        change = values[ends[1]] - values[ends[0]]
        across = np.hstack([-np.eye(count), np.eye(count)])
        spread = across @ covariance[: 2 * count, : 2 * count] @ across.T
        if self.of.scales:
            key = self.of.parameters[0].key.removeprefix("log_")
            factor, error = float(np.exp(change[0])), float(np.sqrt(spread[0, 0]))
            return {f"change_of_{key}": Estimate(factor - 1.0, factor * error, "")} | told
        changed = {
            f"change_of_{p.key}": Estimate(float(v), float(e), p.unit)
            for p, v, e in zip(self.of.parameters, change, np.sqrt(np.diag(spread)), strict=True)
        }
        return changed | told


def _gone(settling, when: np.ndarray, by_logarithm: bool) -> np.ndarray:
    """(T,) share of a change that is over at (T,) shares of the series, analytic."""
    if abs(settling) < _STRAIGHT:
        return when * (1.0 + 0.5 * settling * (1.0 - when))
    if by_logarithm:
        return np.log1p(np.expm1(settling) * when) / settling
    return np.expm1(-settling * when) / np.expm1(-settling)


def with_drift(
    laboratory, candidates: Sequence[Effect], beside: Fit, to_noise: bool = False
) -> list[Fit]:
    """Every way in which a candidate may come or go while it is measured, and what a rod remembers,
    added to a fit as far as it may pay for itself; best first.

    Args:
        to_noise: leave out what will hardly take all that is left.
    """
    known, asked = effects(), {e.name for e in candidates}
    if any(isinstance(e, (Drift, Memory)) for e in candidates):
        return []
    ways: list[Effect] = [Drift(known[name]) for name in _MAY if name in asked]
    ways.append(memory_of(laboratory, Model(), np.zeros(0)))
    fits = extensions(laboratory, beside, ways, share=_PROMISED if to_noise else 0.0)
    best = [settled(laboratory, fit) for fit in fits[:1]]
    return best_of_each(
        [*best, *(f for fit in best for f in by_another_law(laboratory, fit)), *fits]
    )


def by_another_law(laboratory, fit: Fit) -> list[Fit]:
    """A model in which what drifts does so by the other law; nothing where nothing does."""
    own = tuple(
        Drift(e.of, not e.by_logarithm) if isinstance(e, Drift) else e for e in fit.model.effects
    )
    if own == fit.model.effects:
        return []
    fits = fit_models(laboratory, [Model(own)], [fit.values], origin=fit, race=False)
    return [f for f in fits if np.isfinite(f.chi_squared)]
