"""Laws of bending: the moment that belongs to a curvature. A new one is one class and one line."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import ClassVar

from wrod.errors import RodError


@dataclass(frozen=True)
class Linear:
    """M = B e, e the curvature less the natural one."""

    name: ClassVar[str] = "linear"

    @property
    def softening(self) -> tuple[float, float]:
        """(c [m^2], r) that `RodBatch` takes: none."""
        return 0.0, 1.0

    def scaled(self, length_unit: float) -> Linear:
        """The law with lengths in another unit [m]."""
        return self


@dataclass(frozen=True)
class Softening:
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
        if not (critical > 0.0 and kept >= 0.0):
            raise RodError(
                f"softening has critical_curvature {self.critical_curvature!r} and kept_stiffness "
                f"{self.kept_stiffness!r}; the first must be positive [1/m], the second at least 0"
            )

    @property
    def softening(self) -> tuple[float, float]:
        """(c [m^2], r) that `RodBatch` takes."""
        return self.critical_curvature**-2.0, self.kept_stiffness

    def scaled(self, length_unit: float) -> Softening:
        """The law with lengths in another unit [m]."""
        return Softening(self.critical_curvature * length_unit, self.kept_stiffness)


Law = Linear | Softening
LAWS = {law.name: law for law in (Linear, Softening)}


def law_as_json(law: Law) -> dict:
    """What `law_of` reads."""
    return {"name": law.name, **asdict(law)}


def law_of(content) -> Law:
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
