"""Laws of bending: the moment that belongs to a curvature. A new one is one class and one line."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from typing import ClassVar, cast

from wrod.errors import RodError

# The numbers that `wrod.kernels.elastic.inelastic` has for laws that remember.
_ELASTIC, _PLASTIC, _STANDARD_LINEAR_SOLID, _DAHL = range(4)


@dataclass(frozen=True)
class _Law:
    """What every law is: linear, but for what it overrides."""

    name: ClassVar[str]
    # Whether the moment depends on how the rod was bent before.
    remembers: ClassVar[bool] = False

    @property
    def at_rest(self) -> BendingLaw | None:
        """The law of a rod that has had its time, or None where that depends on the way there."""
        return cast("BendingLaw", self) if not self.remembers else None

    @property
    def softening(self) -> tuple[float, float]:
        """(c [m^2], r) that `RodBatch` takes."""
        return 0.0, 1.0

    @property
    def inelastic(self) -> tuple[int, float, float, float]:
        """(law, share, scale [1/m], time [s]) that `RodBatch` takes."""
        return _ELASTIC, 0.0, 0.0, 1.0

    def scaled(self, length_unit: float, time_unit: float) -> BendingLaw:
        """The law with lengths [m] and times [s] in other units."""
        return cast("BendingLaw", self)

    def _check(self, wanted: str, good: bool) -> None:
        if not good:
            said = ", ".join(f"{f.name} {getattr(self, f.name)!r:.40}" for f in fields(self))
            raise RodError(f"law {self.name} has {said}; {wanted}")


@dataclass(frozen=True)
class Linear(_Law):
    """M = B e, e the curvature less the natural one."""

    name: ClassVar[str] = "linear"


@dataclass(frozen=True)
class Softening(_Law):
    """M = B e (r + (1 - r) / (1 + (e / k_c)^2)): a cable whose strands begin to slip.

    A smooth form of the stick-slip law of stranded cables (Papailiou 1997).

    Args:
        critical_curvature: k_c at which half of what is lost is lost [1/m].
        kept_stiffness: r, the share of the stiffness that is left far beyond it; at least 0.

    Raises:
        RodError: a number is not finite, or out of its range.
    """

    name: ClassVar[str] = "softening"
    critical_curvature: float
    kept_stiffness: float

    def __post_init__(self) -> None:
        critical, kept = _number(self.critical_curvature), _number(self.kept_stiffness)
        wanted = "the first must be positive [1/m], the second at least 0"
        self._check(wanted, critical > 0.0 and kept >= 0.0)

    @property
    def softening(self) -> tuple[float, float]:
        return self.critical_curvature**-2.0, self.kept_stiffness

    def scaled(self, length_unit: float, time_unit: float) -> Softening:
        return replace(self, critical_curvature=self.critical_curvature * length_unit)


class _Slipping(_Law):
    """A law with a curvature from which on it gives way, and a share of the stiffness that is left,
    which its fields are."""

    remembers: ClassVar[bool] = True
    number: ClassVar[int]

    def __post_init__(self) -> None:
        curvature, kept = map(_number, self._values)
        wanted = "the first must be positive [1/m], the second from 0 to 1"
        self._check(wanted, curvature > 0.0 and 0.0 <= kept <= 1.0)

    @property
    def _values(self) -> tuple[float, float]:
        first, second = (getattr(self, f.name) for f in fields(self))
        return first, second

    @property
    def inelastic(self) -> tuple[int, float, float, float]:
        curvature, kept = self._values
        return self.number, 1.0 - kept, curvature, 1.0

    def scaled(self, length_unit: float, time_unit: float) -> BendingLaw:
        longer = {fields(self)[0].name: self._values[0] * length_unit}
        return cast("BendingLaw", replace(self, **longer))


@dataclass(frozen=True)
class Plastic(_Slipping):
    """A wire that stays bent: linear kinematic hardening beyond a yield curvature.

    Bent from its natural shape, M = B e up to e = k_y and B k_y + r B (e - k_y) from there on;
    unloading and bending back have B again, over 2 k_y. Let go after a curvature e it keeps
    (1 - r) (e - k_y).

    Args:
        yield_curvature: k_y [1/m].
        hardening: r, the share of the stiffness that is left beyond it; from 0 to 1.

    Raises:
        RodError: a number is not finite, or out of its range.
    """

    name: ClassVar[str] = "plastic"
    number: ClassVar[int] = _PLASTIC
    yield_curvature: float
    hardening: float


@dataclass(frozen=True)
class StandardLinearSolid(_Law):
    """A rubber or polymer whose moment relaxes: M = B (e + g z), dz/dt = de/dt - z / T.

    B, the bending stiffness, is that of a rod that has had its time; g B is a second spring in
    series with a dashpot. Bent at once and held, M / (B e) falls from 1 + g to 1 as exp(-t / T).

    Args:
        added_stiffness: g, at least 0.
        relaxation_time: T [s].

    Raises:
        RodError: a number is not finite, or out of its range.
    """

    name: ClassVar[str] = "standard-linear-solid"
    remembers: ClassVar[bool] = True
    added_stiffness: float
    relaxation_time: float

    def __post_init__(self) -> None:
        added, time = _number(self.added_stiffness), _number(self.relaxation_time)
        wanted = "the first must be at least 0, the second positive [s]"
        self._check(wanted, added >= 0.0 and time > 0.0)

    @property
    def at_rest(self) -> Linear:
        return Linear()

    @property
    def inelastic(self) -> tuple[int, float, float, float]:
        return _STANDARD_LINEAR_SOLID, self.added_stiffness, 0.0, self.relaxation_time

    def scaled(self, length_unit: float, time_unit: float) -> StandardLinearSolid:
        return replace(self, relaxation_time=self.relaxation_time / time_unit)


@dataclass(frozen=True)
class Dahl(_Slipping):
    """A cable whose strands rub: M = B (r e + (1 - r) z), dz = de - (z / k_s) |de| (Dahl 1968).

    Its loop in a cycle does not depend on the rate. After a turn it is as stiff as 1 + (1 - r)
    times B at most, and r B once it has slipped.

    Args:
        slip_curvature: k_s, the way over which friction builds up, and its limit over B [1/m].
        kept_stiffness: r, the share of the stiffness without friction; from 0 to 1.

    Raises:
        RodError: a number is not finite, or out of its range.
    """

    name: ClassVar[str] = "dahl"
    number: ClassVar[int] = _DAHL
    slip_curvature: float
    kept_stiffness: float


BendingLaw = Linear | Softening | Plastic | StandardLinearSolid | Dahl
LAWS = {law.name: law for law in (Linear, Softening, Plastic, StandardLinearSolid, Dahl)}


def law_as_json(law: BendingLaw) -> dict:
    """What `law_of` reads."""
    return {"name": law.name, **asdict(law)}


def law_of(content) -> BendingLaw:
    """The law that a file describes.

    Raises:
        RodError: unknown, or not with the numbers that belong to it.
    """
    if not isinstance(content, dict) or not isinstance(content.get("name"), str):
        raise RodError('law must be an object with a "name"')
    name = content["name"]
    if name not in LAWS:
        raise RodError(f"law {name!r:.40} is unknown; known: {', '.join(LAWS)}")
    wanted = {f.name for f in fields(LAWS[name])}
    given = {k: v for k, v in content.items() if k != "name"}
    if set(given) != wanted:
        raise RodError(f"law {name} needs {', '.join(sorted(wanted)) or 'no numbers'}")
    return LAWS[name](**given)


def _number(value) -> float:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else math.nan
