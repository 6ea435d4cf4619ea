"""`identify`: from measurements to a verdict, a better model and a report."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import DataError
from wrod.identification.clamped.branches import FoundBranch
from wrod.identification.clamped.clock import Clock
from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.loading import load_measurements
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.clamped.noise import NoiseModel
from wrod.identification.clamped.refinement import in_doubt
from wrod.identification.clamped.selection import select
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.clamped.trace import Print, trace
from wrod.identification.clamped.verdict import Selection
from wrod.identification.effect import (
    Effect,
    Estimate,
    Model,
    as_asked,
    checked_as_identification,
    refuse_undefined,
)
from wrod.identification.found_rod import FoundRod, found_rod, rod_of
from wrod.identification.report import FoundEffect, Report, millimetres
from wrod.rods.device import resolve_device
from wrod.rods.model import RodModel
from wrod.rods.model_file import save_rod

METRIC = "RMS over test trials and markers of the 3-D distance [mm]"
_FORMAT = "wrod-identification-1"
# Of the noise: what is no size.
_NOTHING = 1e-3


@dataclass(frozen=True, kw_only=True)
class IdentificationReport(Report):
    """What the measurements say: errors on test trials, the effect first that does most by itself,
    and as candidates every effect tried alone, with BIC gain and test error.

    Attributes:
        selection, prints: the whole evidence.
        predicted_before, predicted_after: (T, M, 3) marker positions [m].
        found: the rod with all that was found of it, and what belongs to the set-up instead.
        noise: as the selection found it; missing: markers without a position; outliers: (T, M)
            markers that were set aside; branches: (T,) equilibrium of the base model in each trial.
    """

    measurements: ClampedMeasurements
    selection: Selection
    prints: tuple[Print, ...]
    predicted_before: np.ndarray
    predicted_after: np.ndarray
    found: FoundRod
    noise: NoiseModel
    missing: int
    outliers: np.ndarray
    branches: tuple[FoundBranch, ...]

    @property
    def out_of_time(self) -> bool:
        """Whether the time was over before all was tried."""
        return self.selection.out_of_time

    @property
    def scatter(self) -> dict[str, Estimate]:
        """By name, what is off anew in each trial, where that is all that is left."""
        found = self.selection.scatter
        return found.sizes if found else {}

    def to_dict(self) -> dict:
        """The content of `report.json`; lengths of errors in mm, everything else SI."""
        s = self.selection
        return self.head(_FORMAT, self.measurements.name, METRIC) | {
            "confounded": s.confounded,
            "selection": [
                {"model": list(r.current), "accepted": r.accepted, "reason": r.reason}
                for r in s.rounds
            ],
            "out_of_time": self.out_of_time,
            "cross_validation_mm": [millimetres(v) for v in s.cross_validation],
            "chi_squared": {
                "base": s.base_chi_squared,
                "final": s.fit.chi_squared,
                "residuals": s.fit.residual_count,
            },
            "noise": self.noise.to_dict() | {"said": self.noise.described()},
            "readings_set_aside": {
                "missing_markers": self.missing,
                "outliers": [
                    {"trial": int(t), "marker": int(k)} for t, k in np.argwhere(self.outliers)
                ],
            },
            "equilibria": [
                {
                    "trial": t,
                    "negative_eigenvalues": b.negative,
                    "stable_found": b.found,
                    "reached_from": b.start,
                }
                for t, b in enumerate(self.branches)
                if b.negative or b.found > 1 or b.start == "saddle"
            ],
            "trials_apart": [{"trial": t, "rms_mm": millimetres(o)} for t, o in s.apart.items()],
            "scatter": s.scatter.to_dict() if s.scatter else [],
            "changing": s.changing,
            "left_over": s.left_over.to_dict() if s.left_over else None,
            "unseen_trials": {"chi_squared_taken": s.unseen[0], "stderr": s.unseen[1]},
            "parameters_at_a_bound": list(s.at_bound),
            "prints": [p.to_dict() for p in self.prints],
        }

    def save(self, out: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, report.html, model.json and rod.json into a folder."""
        from wrod.identification.clamped.page import write_page

        return [*self.written(out, write_page), save_rod(self.material, Path(out) / "rod.json")]


@checked_as_identification(
    arguments.like("measurements", "clamp_position"),
    seconds=arguments.optional(arguments.number(0.0)),
)
def identify_clamped(
    measurements: ClampedMeasurements | str | os.PathLike[str],
    *,
    test: ClampedMeasurements | str | os.PathLike[str] | None = None,
    candidates: Sequence[Effect | str] | None = None,
    device: arguments.DeviceLike = "cpu",
    seconds: float | None = None,
    progress=None,
) -> IdentificationReport:
    """Find what the base model lacks, and prove it on trials that were not fitted.

    Args:
        measurements: a rod between two clamps, or its file; fitted on its train trials.
        test: measurements of the same rod to score on; default: the test trials of `measurements`.
        candidates: effects, or names of effects; default: every known one.
        device: "cpu", "cuda:0", "auto".
        seconds: after which the search for effects ends with the best verdict until then, which
            says so (`out_of_time`); default: when all is tried.
        progress: called with (text,) as the work goes on.

    Raises:
        DataError: the data cannot be right, an effect is unknown, or one of those given is not the
            base model where its parameters are zero, or no number where fits start.
    """
    say = progress or (lambda text: None)
    clock, asked = Clock(seconds), (measurements, test, candidates)
    m, chosen = as_asked("clamped", ClampedMeasurements, load_measurements, *asked)
    say("base model")
    laboratory = Laboratory(m, device=resolve_device(device))
    _refuse_sized_at_zero(laboratory, chosen)
    refuse_undefined(chosen, laboratory.base, m)
    say("force print")
    prints = trace(laboratory)
    say("effects")
    laboratory.clock = clock
    selection = select(laboratory, chosen, build=candidates is None)
    if selection.verdict == "adequate" and not laboratory.noise.white:
        # What looked like a print by the noise that was declared is none by the noise there is.
        prints = trace(laboratory)
    say("scores")
    fit = selection.fit
    before = laboratory.predict(Model(), np.zeros(0))
    after = laboratory.predict(fit.model, fit.values)
    return IdentificationReport(
        measurements=m,
        verdict=selection.verdict,
        reason=_reason(selection, prints),
        before=laboratory.rms(before, m.test),
        after=laboratory.rms(after, m.test),
        noise_floor=m.noise_floor,
        effects=_found(laboratory, fit, selection),
        candidates=tuple(_scores(laboratory, selection)),
        selection=selection,
        prints=tuple(prints),
        predicted_before=before,
        predicted_after=after,
        found=_found_rod(m, laboratory, fit),
        noise=selection.scatter.noise if selection.scatter else laboratory.noise,
        missing=laboratory.missing,
        outliers=laboratory.outliers,
        branches=tuple(laboratory.branches),
    )


def _refuse_sized_at_zero(laboratory: Laboratory, chosen: Sequence[Effect]) -> None:
    """Raise where an effect is not the base model in the first trial with all its parameters at
    zero, as fits, priors and known equilibria take it to be."""
    first = laboratory.trials[:1]
    base = ClampedSetup.base(laboratory.measurements, first, laboratory.edge_count)
    state, read = tuple(a[first] for a in laboratory.base_state), laboratory.read[first]
    models, nothing = [Model(), *(Model((e,)) for e in chosen)], np.zeros(0)
    values = [np.zeros(len(m.parameters)) for m in models]
    setups = [m.setup(base, v) for m, v in zip(models, values, strict=True)]
    solver = ClampedSolver([base] * len(models), device=laboratory.device, start=state)
    reached, prediction = solver.solve(setups, walk=False)[:, 0], solver.predict(setups)
    plain = laboratory.observed(Model(), nothing, setups[0], prediction, 0).real
    for c in range(1, len(models)):
        seen = laboratory.observed(models[c], values[c], setups[c], prediction, c).real
        away = np.abs(seen - plain)[read] / laboratory.deviation[first][read]
        if not reached[c]:
            raise DataError(
                f"effect {models[c].names[0]!r} leaves the rod no equilibrium where all its "
                "parameters are zero; let zero be the base model"
            )
        off = away.max(initial=0.0)
        if not off < _NOTHING:
            raise DataError(
                f"effect {models[c].names[0]!r} still changes what is measured, by {off:.2g} of "
                "the noise, where all its parameters are zero; let zero be the base model"
            )


def _reason(selection: Selection, prints: Sequence[Print]) -> str:
    """The evidence, and where something is left, whether it came or went meanwhile."""
    changes = prints[0].changes
    said = selection.changing or selection.verdict in ("explained", "adequate")
    return selection.reason if said or not changes else f"{selection.reason}; {changes}"


def _found_rod(m: ClampedMeasurements, laboratory: Laboratory, fit: Fit) -> FoundRod:
    """The free part of the rod between the clamps, arc length from clamp A, as it was at last."""
    base = ClampedSetup.base(m, laboratory.trials[-1:], laboratory.edge_count)
    like = RodModel.of(m.material)

    def read(setup: ClampedSetup) -> RodModel:
        # What slipped into or out of a clamp is still the same rod.
        return rod_of(setup.rods()[0], setup.arc_length, like=like)

    return found_rod(base, fit.model, fit.values, read)


def _found(laboratory: Laboratory, fit: Fit, selection: Selection) -> tuple[FoundEffect, ...]:
    m = laboratory.measurements
    alone = {f.model.names[0]: f for f in selection.ranking}
    effects, parts = fit.model.effects, fit.model.split(fit.values)
    if not effects:
        return ()
    ends = np.cumsum([len(p) for p in parts])
    after: list[float | None] = [None] * (2 * len(effects))
    if not selection.out_of_time:
        steps = [
            fit_models(
                laboratory,
                [Model(effects[:k])],
                [fit.values[: ends[k - 1]]],
                origin=fit,
                race=False,
            )[0]
            for k in range(1, len(effects))
        ]
        scored = [*steps, fit, *(alone.get(e.name, fit) for e in effects)]
        after = laboratory.scores([f.model for f in scored], [f.values for f in scored])
    return tuple(
        FoundEffect(
            effect.name,
            effect.title,
            effect.reference,
            in_doubt(fit, k, selection.doubts, m),
            after[k],
            {"after_mm_with_this_effect_alone": after[len(effects) + k]},
        )
        for k, effect in enumerate(effects)
    )


def _scores(laboratory: Laboratory, selection: Selection) -> list[dict]:
    """Every effect alone on the base model."""
    fits = selection.ranking
    if not fits:
        return []
    errors: list[float | None] = [None] * len(fits)
    if not selection.out_of_time:
        errors = laboratory.scores([f.model for f in fits], [f.values for f in fits])
    return [
        {
            "name": fit.model.names[0],
            "bic_gain": gain,
            "chi_squared": fit.chi_squared,
            "parameter_count": len(fit.values),
            "test_mm": millimetres(error),
        }
        for fit, gain, error in zip(fits, selection.rounds[0].gains, errors, strict=True)
    ]
