"""What an effect is, and how a list of effects becomes a model."""

from __future__ import annotations

import copy
import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np

from wrod import arguments
from wrod.errors import DataError, within_precision
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.clamped.setup import ClampedSetup

Asks = TypeVar("Asks", bound=Callable[..., Any])
AnySetup = TypeVar("AnySetup")  # ClampedSetup or MotionSetup


@dataclass(frozen=True)
class Parameter:
    """One unknown of an effect.

    Attributes:
        key: its name in reports.
        unit: its unit ("" for a ratio).
        scale: standard deviation of its prior, a Gaussian around zero: how large it may well be.
        lower, upper: bounds.
        anywhere: zero means nothing special (a place, a direction): the Gaussian stands around the
            value that a fit starts from.
    """

    key: str
    unit: str
    scale: float
    lower: float = -np.inf
    upper: float = np.inf
    anywhere: bool = False


def unknowns(unit: str, scale: float, *keys: str, **how: Any) -> tuple[Parameter, ...]:
    """Parameters that differ by their keys alone."""
    return tuple(Parameter(key, unit, scale, **how) for key in keys)


@dataclass(frozen=True)
class Estimate:
    """A reported quantity with its standard error."""

    value: float
    stderr: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.4g} ± {self.stderr:.2g} {self.unit}".rstrip()


class Effect:
    """Something that the base model lacks. Subclass it in a file of `wrod.identification.effects`.

    All parameters at zero is the base model. `apply` and `measure` may be handed complex numbers,
    whose imaginary part carries a derivative: use analytic functions only (no abs, norm, max).

    Attributes:
        name: snake_case, as reports and `candidates` have it.
        title: a phrase for people.
        reference: where the model comes from.
        parameters: the unknowns.
        adds: field of the set-up that they are added to; scales: fields that grow by the
            exponential of the only one.
        polar: what the size and the angle of the first two are called, and the unit of the former.
        alike: what else is the same to such data, a phrase; empty where nothing is.
        stage: effects are applied in this order; those that change the free length come first.
        follows_shape: whether its load depends on the rod's shape (`ClampedSetup.wind`).
        kinds: the measurements that it is tried on: "clamped" (`ClampedSetup`), "motion"
            (`MotionSetup`).
    """

    name: str
    title: str
    reference: str
    parameters: tuple[Parameter, ...]
    adds: str = ""
    scales: tuple[str, ...] = ()
    polar: tuple[str, str, str] | None = None
    alike: str = ""
    stage: int = 1
    follows_shape: bool = False
    kinds: tuple[str, ...] = ("clamped",)

    def starts(self, measurements: ClampedMeasurements | None) -> list[np.ndarray]:
        """Values to start fits from; more than one where the fit has several optima. Of motion,
        where `measurements` is None, the first is taken."""
        return [np.zeros(len(self.parameters))]

    def apply(self, setup: Any, values: np.ndarray) -> None:
        """Change the model in place, a `ClampedSetup` or, of kind "motion", a `MotionSetup`."""
        if self.adds:
            field, added = getattr(setup, self.adds), np.asarray(values)
            if len(values) == 1:
                added = values[0]
            elif np.size(field) == len(values):
                added = added.reshape(np.shape(field))
            setattr(setup, self.adds, field + added)
        for name in self.scales:
            setattr(setup, name, getattr(setup, name) * np.exp(values[0]))

    def measure(
        self, position: np.ndarray, frame: np.ndarray, values: np.ndarray, setup: ClampedSetup
    ) -> np.ndarray:
        """What the cameras report of (T, M, 3) markers, whose material frames are `frame`."""
        return position

    def doubt(
        self, values: np.ndarray, covariance: np.ndarray, measurements: ClampedMeasurements
    ) -> str:
        """What else the effect may stand for at these values, a phrase; empty where nothing."""
        return ""

    def special_cases(
        self, values: np.ndarray, measurements: ClampedMeasurements
    ) -> dict[str, np.ndarray]:
        """Effects of fewer parameters that it comes near to at these values, by name, and theirs;
        those whose parameters are among its own need not be said."""
        return {}

    def describe(
        self, values: np.ndarray, covariance: np.ndarray, measurements: ClampedMeasurements
    ) -> dict[str, Estimate]:
        """The quantities to report, by default the parameters themselves, after what is `polar` of
        them; of what `scales`, the factor."""
        told: dict[str, Estimate] = {}
        if self.polar:
            size, angle = magnitude_and_angle(values[0], values[1], covariance[:2, :2])
            name, direction, unit = self.polar
            if unit == "deg":
                size = float(np.degrees(size[0])), float(np.degrees(size[1]))
            told = {name: Estimate(*size, unit), direction: Estimate(*angle, "deg")}
        errors = np.sqrt(np.diag(covariance))
        if self.scales:
            factor = float(np.exp(values[0]))
            key = self.parameters[0].key.removeprefix("log_")
            return {key: Estimate(factor, factor * float(errors[0]), "")}
        return told | {
            p.key: Estimate(float(v), float(e), p.unit)
            for p, v, e in zip(self.parameters, values, errors, strict=True)
        }


def magnitude_and_angle(
    x: float, y: float, covariance: np.ndarray
) -> tuple[tuple[float, float], tuple[float, float]]:
    """((size, stderr), (angle [deg], stderr)) of a vector in a plane."""
    size = float(np.hypot(x, y))
    along = np.array([x, y]) / max(size, 1e-300)
    across = np.array([-along[1], along[0]])
    radial = np.sqrt(along @ covariance @ along)
    turning = np.sqrt(across @ covariance @ across) / max(size, 1e-300)
    return (size, float(radial)), (float(np.degrees(np.arctan2(y, x))), float(np.degrees(turning)))


def checked_as_identification(data: Callable, **more: Callable) -> Callable[[Asks], Asks]:
    """Decorator that checks what an identification is asked; `data` checks measurements, `more`
    what only one kind is asked. Matrices of it that are singular are a `DataError`."""
    given = arguments.either(arguments.path, data)
    an_effect = arguments.either(arguments.text, arguments.like("an Effect", "name"))
    checked = arguments.checked(
        DataError,
        measurements=given,
        test=arguments.optional(given),
        candidates=arguments.optional(arguments.several(an_effect)),
        device=arguments.optional(arguments.text),
        progress=arguments.optional(arguments.callback),
        **more,
    )
    return lambda asks: within_precision()(checked(asks))


@cache
def effects(kind: str = "clamped") -> dict[str, Effect]:
    """Every effect in `wrod.identification.effects` for a kind of measurements, by name."""
    package = importlib.import_module("wrod.identification.effects")
    found = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(package.__path__)):
        content = vars(importlib.import_module(f"{package.__name__}.{module}"))
        for value in content.values():
            is_effect = isinstance(value, type) and issubclass(value, Effect)
            if is_effect and value is not Effect and kind in value.kinds:
                found[value.name] = value()
    return dict(sorted(found.items()))


def as_asked(kind: str, of: type, load: Callable, measurements, test, candidates):
    """The measurements that an identification is asked about, scored on those of `test`, and its
    candidates (default: all of the kind).

    Args:
        kind: of the measurements, for `effects`; of: their class; load: reads a file of them.

    Raises:
        DataError: a file cannot be right, or there is no effect of that name.
    """

    def read(source):
        return source if isinstance(source, of) else load(source)

    m = read(measurements)
    if test is not None:
        m = m.scored_on(read(test))
    _refuse_seen(m)
    return m, effects_asked(kind, candidates)


def _refuse_seen(m) -> None:
    """Raise where what is scored is among what is fitted: such a score proves nothing."""
    data, scored = m.positions if hasattr(m, "positions") else m.centerline, set(m.test.tolist())
    seen = {data[k].tobytes() for k in range(len(data)) if k not in scored}
    for k in sorted(scored):
        if data[k].tobytes() in seen:
            raise DataError(
                f"{m.name}: number {k} of its data is to score on, and the same stands among those "
                "that are fitted; leave one out"
            )


def effects_asked(kind: str, candidates) -> list[Effect]:
    """The candidates, which are effects or names of them; all of the kind where they are None.

    Raises:
        DataError: there is no effect of that name, or one has nothing to fit.
    """
    known = effects(kind)
    chosen = list(known.values() if candidates is None else candidates)
    unknown = [c for c in chosen if not isinstance(c, Effect) and c not in known]
    if unknown:
        names = ", ".join(known)
        raise DataError(f"unknown effect {unknown[0]!r} for {kind} data; known effects: {names}")
    asked = [c if isinstance(c, Effect) else known[c] for c in chosen]
    for effect in asked:
        if not effect.parameters:
            raise DataError(
                f"effect {effect.name!r} has no parameters to fit; give it one or leave it out"
            )
    return asked


def refuse_undefined(
    chosen: list[Effect], base: Any, measurements: ClampedMeasurements | None = None
) -> None:
    """Raise where fits start, or a little off there, if an effect or its rates are no numbers, or
    the imaginary parts that it is handed come back as no rates.

    Args:
        base: set-up of the base model.
        measurements: as of `Effect.starts`.
    """
    for effect in chosen:
        low, high, scale = np.array([(p.lower, p.upper, p.scale) for p in effect.parameters]).T

        def told(values: np.ndarray, effect: Effect = effect) -> dict[str, Any]:
            return _changed(effect, base, values, measurements)

        for start in effect.starts(measurements):
            off = np.where(start + 1e-3 * scale <= high, start + 1e-3 * scale, start - 1e-3 * scale)
            for values in (start, np.clip(off, low, high)):
                # A rate that is infinite grows as the step shrinks.
                found, wider = told(values + 1e-30j * scale), told(values + 1e-20j * scale)
                for k, v in found.items():
                    rate = np.imag(v) / 1e-30
                    most = 2.0 * np.abs(np.imag(wider[k])).max(initial=0.0) / 1e-20
                    if np.isfinite(v).all() and np.abs(rate).max(initial=0.0) <= most:
                        continue
                    raise DataError(
                        f"effect {effect.name!r} makes {k} no number, or its rate, at "
                        f"{_shown(values)}, where fits start; use analytic functions that are "
                        "finite there"
                    )
            ahead, behind = told(values + 1e-4 * scale), told(values - 1e-4 * scale)
            for k, v in found.items():
                rate, slope = np.imag(v) / 1e-30, (ahead[k] - behind[k]) / 2e-4
                rounding = 1e-9 * np.abs(v).max(initial=0.0)
                if np.any(np.abs(rate - slope) > 0.1 * np.abs(slope).max(initial=0.0) + rounding):
                    raise DataError(
                        f"effect {effect.name!r} changes {k} at {_shown(values)} otherwise than "
                        "the imaginary parts of what it returns say; use analytic functions (no "
                        "abs, norm or max)"
                    )


def _shown(values: np.ndarray) -> str:
    return np.array2string(values, formatter={"float_kind": "{:.3g}".format})


def _changed(
    effect: Effect, base: Any, values: np.ndarray, measurements: ClampedMeasurements | None
) -> dict[str, Any]:
    """Fields of the set-up that an effect changes, and, of what it changes of them, the "measure"
    of markers."""
    setup = Model((effect,)).setup(base, values)
    found = {k: vars(setup)[k] for k, v in vars(base).items() if vars(setup)[k] is not v}
    if measurements is not None and type(effect).measure is not Effect.measure:
        at = np.nan_to_num(measurements.centerline[setup.trials])
        frame = np.zeros((*at.shape, 3)) + np.eye(3)
        found["measure"] = effect.measure(at, frame, values, setup)
    return found


@dataclass(frozen=True)
class Model:
    """The base model with effects on top."""

    effects: tuple[Effect, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(e.name for e in self.effects)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(p for e in self.effects for p in e.parameters)

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """The part of a parameter vector that belongs to each effect."""
        ends = np.cumsum([len(e.parameters) for e in self.effects])
        return np.split(values, ends[:-1]) if len(ends) else []

    def setup(self, base: AnySetup, values: np.ndarray) -> AnySetup:
        """The base model changed by every effect."""
        setup = copy.copy(base)
        order = sorted(zip(self.effects, self.split(values), strict=True), key=lambda e: e[0].stage)
        for effect, part in order:
            effect.apply(setup, part)
        return setup

    def measure(self, position, frame, values: np.ndarray, setup: ClampedSetup) -> np.ndarray:
        """What the cameras report, every effect's part included."""
        for effect, part in zip(self.effects, self.split(values), strict=True):
            position = effect.measure(position, frame, part, setup)
        return position

    def at_bound(self, values: np.ndarray) -> tuple[str, ...]:
        """Keys of parameters that ended at a bound: the data ask for what they cannot be."""
        return tuple(
            p.key
            for p, v in zip(self.parameters, values, strict=True)
            if v <= p.lower or v >= p.upper
        )

    def grown(self, values: np.ndarray, share: float) -> np.ndarray:
        """The same effects at a share of their size; places and directions stay."""
        return np.where([p.anywhere for p in self.parameters], values, share * values)

    def prior_mean(self, start: np.ndarray) -> np.ndarray:
        """(P,) middle of the prior of a fit that starts from `start`."""
        return np.where([p.anywhere for p in self.parameters], start, 0.0)

    def extended(self, effect: Effect) -> Model:
        return Model((*self.effects, effect))

    def without(self, place: int, values: np.ndarray) -> tuple[Model, np.ndarray]:
        """The model without the effect at a place, and its values."""
        parts = self.split(values)
        rest = Model((*self.effects[:place], *self.effects[place + 1 :]))
        return rest, np.concatenate([*parts[:place], *parts[place + 1 :]])
