"""Properties along a rod: constant, or linear between knots; and numbers of it, checked."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from wrod import arguments
from wrod.errors import RodError

# What a file, or a caller, may ask for; a cable has features every few millimetres at most.
_MOST_KNOTS = 20_000
# Knots of what is not linear between its own: products, and functions that are sampled.
_SAMPLES = 257
# What stands in for a profile of what is one number for the whole rod.
_INSTEAD = {
    "radius": "the largest one, which touches",
    "principal_angle": "that at the beginning, and how it turns from there as natural_twist",
}


@dataclass(frozen=True)
class Profile:
    """A property over arc length: constant, or linear between knots and constant beyond them.

    Args:
        values: the values at the knots; one for a constant.
        knots: arc lengths [m], ascending; not needed for a constant.

    Raises:
        RodError: the numbers are not finite, not as many as each other, or not ascending.
    """

    values: tuple[float, ...]
    knots: tuple[float, ...] = (0.0,)

    if TYPE_CHECKING:  # what it takes, which becomes tuples

        def __init__(self, values: ArrayLike, knots: ArrayLike = (0.0,)) -> None: ...

    def __post_init__(self) -> None:
        values, knots = (
            np.atleast_1d(arguments.floats(part, f"a profile's {name}", RodError))
            for name, part in (("values", self.values), ("knots", self.knots))
        )
        if values.ndim != 1 or values.shape != knots.shape or not 1 <= len(values) <= _MOST_KNOTS:
            raise RodError(
                f"a profile has {values.size} values at {knots.size} knots; give one value per "
                f"knot, at most {_MOST_KNOTS}"
            )
        if not (np.isfinite(values).all() and np.isfinite(knots).all()):
            raise RodError("a profile holds a number that is not finite")
        if not (np.diff(knots) > 0.0).all():
            raise RodError("a profile's knots do not ascend; sort them and drop repeated ones")
        object.__setattr__(self, "values", tuple(values.tolist()))
        object.__setattr__(self, "knots", tuple(knots.tolist()))

    @classmethod
    @arguments.checked(RodError)
    def of(cls, value) -> Profile:
        """A profile as it is, a number, or {"knots": [...], "values": [...]}.

        Raises:
            RodError: it is none of these.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, Real) and not isinstance(value, bool):
            return cls(np.array([value]))
        if isinstance(value, dict) and set(value) == {"knots", "values"}:
            return cls(value["values"], value["knots"])
        raise RodError(
            f"{arguments.shown(value)} is no profile; give a number, a wrod.Profile, or knots and "
            "values"
        )

    @classmethod
    @arguments.checked(
        RodError, start=arguments.number(-1e9, 1e9), stop=arguments.number(-1e9, 1e9)
    )
    def sampled(cls, function: Callable, start: float, stop: float) -> Profile:
        """A smooth vectorised function of arc length [m] between two places, at 257 knots."""
        knots = np.linspace(start, stop, _SAMPLES)
        try:
            values = np.broadcast_to(np.asarray(function(knots), dtype=float), knots.shape)
        except (TypeError, ValueError) as reason:
            raise RodError(f"Profile.sampled: function is of no use ({reason})") from None
        return cls(values, knots)

    def __repr__(self) -> str:
        if self.is_constant:
            return f"Profile({self.values[0]:g})"
        return (
            f"Profile({len(self.values)} values from {self.smallest:g} to {max(self.values):g} "
            f"over {self.knots[0]:g} to {self.knots[-1]:g} m)"
        )

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Knots, values, and the integral from the first knot to each."""
        knots, values = np.array(self.knots), np.array(self.values)
        parts = 0.5 * (values[1:] + values[:-1]) * np.diff(knots)
        return knots, values, np.concatenate([[0.0], np.cumsum(parts)])

    @property
    def is_constant(self) -> bool:
        """Whether it is the same everywhere."""
        return min(self.values) == max(self.values)

    @property
    def smallest(self) -> float:
        return min(self.values)

    def __call__(self, s) -> np.ndarray:
        """Values at arc lengths `s` [m], of their shape."""
        s = arguments.floats(s, "Profile: s", RodError)
        if self.is_constant:
            return np.full(s.shape, self.values[0])
        return np.interp(s, *self._arrays[:2])

    def integral(self, start, stop) -> np.ndarray:
        """Exact integral from `start` to `stop` [m], broadcast."""
        start, stop = _places(start, stop, "Profile.integral")
        if self.is_constant:
            return self.values[0] * (stop - start)
        return self._from_first(stop) - self._from_first(start)

    def mean(self, start, stop) -> np.ndarray:
        """Exact mean from `start` to `stop` [m], broadcast; where they coincide, the value."""
        start, stop = _places(start, stop, "Profile.mean")
        if self.is_constant:
            return np.full(start.shape, self.values[0])
        length = stop - start
        some = length != 0.0
        mean = self.integral(start, stop) / np.where(some, length, 1.0)
        return np.where(some, mean, self(start))

    def _from_first(self, s: np.ndarray) -> np.ndarray:
        knots, values, sums = self._arrays
        i = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
        inside = np.clip(s, knots[0], knots[-1])
        at = np.interp(inside, knots, values)
        within = sums[i] + 0.5 * (values[i] + at) * (inside - knots[i])
        return within + at * (s - inside)

    # ---- new profiles from old ----------------------------------------------------------------

    @arguments.checked(
        RodError, factor=arguments.number(), length_factor=arguments.number(above=0.0)
    )
    def scaled(self, factor: float, length_factor: float = 1.0) -> Profile:
        """Values times a factor, arc lengths times another, which must be positive."""
        return Profile(factor * np.array(self.values), length_factor * np.array(self.knots))

    @arguments.checked(
        RodError, start=arguments.number(-1e9, 1e9), stop=arguments.number(-1e9, 1e9)
    )
    def piece(self, start: float, stop: float) -> Profile:
        """What lies between two places, arc length counted from the first."""
        if self.is_constant:
            return self
        knots = self._arrays[0]
        inner = knots[(knots > start) & (knots < stop)]
        knots = np.concatenate([[start], inner, [stop]])
        return Profile(self(knots), knots - start)

    @arguments.checked(RodError, length=arguments.number())
    def reversed(self, length: float) -> Profile:
        """The same over arc length counted backwards from `length` [m]."""
        if self.is_constant:
            return self
        return Profile(self.values[::-1], length - self._arrays[0][::-1])

    def __add__(self, other: Profile | float) -> Profile:
        other = Profile.of(other)
        if self.is_constant and other.is_constant:
            return Profile((self.values[0] + other.values[0],))
        knots = self._knots_with(other)
        return Profile(self(knots) + other(knots), knots)

    def __mul__(self, other: Profile | float) -> Profile:
        """The product; of two that both vary it is quadratic, and is sampled finely."""
        other = Profile.of(other)
        if other.is_constant:
            return self.scaled(other.values[0])
        if self.is_constant:
            return other.scaled(self.values[0])
        knots = self._knots_with(other)
        finer = np.linspace(knots[0], knots[-1], _SAMPLES)
        knots = np.unique(np.concatenate([knots, finer]))
        # Knots that differ by rounding are one.
        knots = knots[np.diff(knots, prepend=-np.inf) > 1e-12 * (knots[-1] - knots[0])]
        return Profile(self(knots) * other(knots), knots)

    def _knots_with(self, other: Profile) -> np.ndarray:
        varying = [p.knots for p in (self, other) if not p.is_constant]
        return np.unique(np.concatenate(varying))

    def as_json(self):
        """A number, or {"knots", "values"}."""
        if self.is_constant:
            return self.values[0]
        return {"knots": list(self.knots), "values": list(self.values)}


def _places(start, stop, where: str) -> list[np.ndarray]:
    """Arc lengths that broadcast to each other."""
    both = [
        arguments.floats(value, f"{where}: {name}", RodError)
        for name, value in (("start", start), ("stop", stop))
    ]
    try:
        return list(np.broadcast_arrays(*both))
    except ValueError:
        raise RodError(
            f"{where}: start has shape {both[0].shape} and stop {both[1].shape}; give one shape"
        ) from None


def as_number(name: str, value, *, positive: bool = False, least: float = -math.inf) -> float:
    if issubclass(type(value), (Profile, dict)):
        raise RodError(
            f"rod {name} is a profile and can only be one number for the whole rod; give "
            f"{_INSTEAD.get(name, 'its mean')}"
        )
    if arguments.wrong(arguments.number(least, above=0.0 if positive else None), value) is not None:
        wanted = (
            "a positive" if positive else "a" if least == -math.inf else f"at least {least:g}, a"
        )
        said = arguments.shown(value)
        raise RodError(f"rod {name} is {said}; give {wanted} finite number in SI units")
    return float(value)


def as_profile(name: str, value) -> Profile:
    try:
        return Profile.of(value)
    except RodError as error:
        raise RodError(f"rod {name}: {error}") from None


def as_pair(name: str, value, *, same: bool = False) -> tuple[Profile, Profile]:
    if same and not issubclass(type(value), (tuple, list)):
        value = (value, value)
    if not issubclass(type(value), (tuple, list)) or len(value) != 2:
        said = arguments.shown(value)
        raise RodError(f"rod {name} is {said}; give two profiles, one per direction")
    return as_profile(name, value[0]), as_profile(name, value[1])
