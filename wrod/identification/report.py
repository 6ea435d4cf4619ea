"""What the reports of all identifications share."""

import os
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrod.errors import WrodWarning
from wrod.files import write_json
from wrod.identification.effect import Estimate
from wrod.identification.found_rod import FoundRod
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel


@dataclass(frozen=True)
class FoundEffect:
    """An effect of the chosen model.

    Attributes:
        name, title, reference: of the effect.
        parameters: what was found, with standard errors.
        after: test error with the effects up to this one [m].
        others: further errors, by what `to_dict` calls them [m].
        An error is None where something has no equilibrium with what was fitted, or the time was
        over.
    """

    name: str
    title: str
    reference: str
    parameters: dict[str, Estimate]
    after: float | None
    others: dict[str, float | None]

    def to_dict(self) -> dict:
        """Plain figures; errors in mm, everything else SI."""
        return {
            "name": self.name,
            "title": self.title,
            "reference": self.reference,
            "parameters": {key: asdict(value) for key, value in self.parameters.items()},
            "after_mm_with_this_effect": millimetres(self.after),
            **{key: millimetres(error) for key, error in self.others.items()},
        }


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What every identification ends with.

    Attributes:
        verdict: "adequate", "explained", "partly-explained" or "unexplained".
        reason: the evidence in a sentence.
        before, after: error of the base model, or the believed one, and of the better one [m].
        noise_floor: error of a perfect model [m].
    """

    verdict: str
    reason: str
    before: float
    after: float
    noise_floor: float

    def errors(self) -> dict[str, float]:
        """By what `report.json` calls them."""
        return {
            "noise_floor_mm": 1e3 * self.noise_floor,
            "before_mm": 1e3 * self.before,
            "after_mm": 1e3 * self.after,
        }


@dataclass(frozen=True, kw_only=True)
class Report(Finding):
    """A finding with its evidence, and the rod that was found.

    Attributes:
        measurements: what was explained.
        effects: what was added to the model.
        candidates: every effect that was tried, as plain figures.
    """

    measurements: Any
    effects: tuple[FoundEffect, ...]
    candidates: tuple[dict, ...]

    @property
    def out_of_time(self) -> bool:
        """Whether the time was over before all was tried."""
        return False

    @property
    def scatter(self) -> dict[str, Estimate]:
        """By name, what is off anew in each trial, where that is all that is left."""
        return {}

    @property
    def cautions(self) -> tuple[str, ...]:
        """What data of this kind cannot tell, a sentence each."""
        return ()

    if TYPE_CHECKING:

        @property
        def found(self) -> FoundRod: ...

    @property
    def model(self) -> RodModel:
        """The rod with every effect that belongs to it; see `found`."""
        return self.found.rod

    @property
    def material(self) -> RodMaterial:
        """The rod with what a `RodMaterial` can carry of it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", WrodWarning)
            return self.model.material()

    def head(self, form: str, data: str, metric: str) -> dict[str, Any]:
        """The part of `to_dict` that says what was found."""
        return {
            "format": form,
            "data": data,
            "verdict": self.verdict,
            "reason": self.reason,
            "metric": metric,
            **self.errors(),
            "effects": [e.to_dict() for e in self.effects],
            "candidates": list(self.candidates),
            "set_aside": list(self.found.set_aside),
            "no_model": self.found.refused or None,
        }

    def to_dict(self) -> dict:
        """The content of `report.json`; errors in mm, everything else SI."""
        raise NotImplementedError

    def written(self, out: str | os.PathLike[str], page: Callable[[Path, Any], Path]) -> list[Path]:
        """Write report.json, report.html by `page`, and, of what can be a rod, model.json into a
        folder."""
        out = Path(out)
        return [
            write_json(out / "report.json", self.to_dict(), allow_nan=False),
            page(out / "report.html", self),
            *self.found.save(out / "model.json"),
        ]


def millimetres(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
