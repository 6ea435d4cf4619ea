"""`identify_motion`: from recordings of a rod in motion to a verdict, a model and a report."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import DataError
from wrod.identification.effect import (
    Effect,
    Estimate,
    Model,
    as_asked,
    checked_as_identification,
    refuse_undefined,
)
from wrod.identification.found_rod import FoundRod, found_rod, rod_of
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.fit import MotionLaboratory
from wrod.identification.motion.loading import load_motion
from wrod.identification.motion.pace import check_pace
from wrod.identification.motion.remembered import KnownSteps
from wrod.identification.motion.residual import Residual, residual_of
from wrod.identification.motion.selection import BASE, MotionSelection, select_motion, verdict_of
from wrod.identification.motion.setup import SLENDER, START_L_GB, MotionSetup
from wrod.identification.motion.tension import base_setup
from wrod.identification.motion.trace import MotionTrace, trace_motion
from wrod.identification.motion.windows import Windows
from wrod.identification.report import FoundEffect, Report
from wrod.rods.device import resolve_device
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel

METRIC = (
    "mean |difference| over coordinates and all markers, held ones as zero, from frame 2 to the "
    "last of the test recordings [mm]"
)
_FORMAT = "wrod-motion-identification-1"
# Edges between neighbouring free markers of the mesh that the found rod is read off.
_SUBDIVISIONS = 4


@dataclass(frozen=True, kw_only=True)
class MotionReport(Report):
    """What recordings of motion say: errors on test recordings, effects in the order in which they
    were added, and the candidates of the first round.

    Attributes:
        numerical_error: mean |what mesh and time step lack in the prediction|, which is added [m].
        base: what the base model has fitted.
        selection, residual, trace: the whole evidence.
        failed: (before, after) (W,) test recordings whose steps did not converge; they are scored
            with the last shape that did.
        windows: the test recordings; predicted_before, predicted_after: (W, F, M, 3) [m].
    """

    measurements: MotionMeasurements
    numerical_error: float
    base: dict[str, dict[str, Estimate]]
    selection: MotionSelection
    residual: Residual
    trace: MotionTrace | None
    failed: tuple[np.ndarray, np.ndarray]
    windows: Windows
    predicted_before: np.ndarray
    predicted_after: np.ndarray

    def to_dict(self) -> dict:
        """The content of `report.json`; errors in mm, everything else SI."""
        s, m = self.selection, self.measurements
        return self.head(_FORMAT, m.name, METRIC) | {
            "noise_in_time": m.time_noise.to_dict() if m.time_noise else None,
            "numerical_error_mm": 1e3 * self.numerical_error,
            "before_without_internal_damping_mm": 1e3 * s.undamped,
            "validation_before_mm": 1e3 * s.validation_before,
            "validation_after_mm": 1e3 * s.validation_after,
            "base": _plain(self.base),
            "parameters_at_a_bound": list(s.at_bound),
            "confounded": list(s.confounded),
            "cautions": list(self.cautions),
            "correlation": {"effects": list(s.correlated), "largest": s.correlation.tolist()},
            "selection": [
                {
                    "model": list(r.current),
                    "accepted": r.accepted,
                    "removed": r.removed,
                    "reason": r.reason,
                    "candidates": [_candidate(c) for c in r.candidates],
                }
                for r in s.rounds
            ],
            "residual": self.residual.to_dict(),
            "steps_failed": {
                when: [m.names[r] for r in self.windows.recording[failed]]
                for when, failed in (("before", self.failed[0]), ("after", self.failed[1]))
            },
            "trace": None if self.trace is None else self.trace.to_dict(),
            "recordings": {
                "fit": [m.names[r] for r in m.fit],
                "validation": [m.names[r] for r in m.validation],
                "test": [m.names[r] for r in m.test],
                "lost_frames": m.lost_frames,
                "markers_filled": m.filled,
                "gaps": int((m.gap > 1).sum()),
                "frames_with_grip_markers_exchanged": int(m.repaired.sum()),
            },
        }

    @property
    def cautions(self) -> tuple[str, ...]:
        """What motion does not tell of how the rod stretches, where it was not found."""
        if "axial_stiffness" in self.selection.model.names:
            return ()
        return (
            "length and axial stiffness are confounded but for what the tension changes, which "
            "shows nothing here: the mean stretch is in the measured lengths, and the rod is taken "
            "to resist stretching as a common cable does",
        )

    def save(self, out: str | os.PathLike[str]) -> list[Path]:
        """Write report.json, report.html and model.json into a folder."""
        from wrod.identification.motion.page import write_motion_page

        return self.written(out, write_motion_page)

    @cached_property
    def found(self) -> FoundRod:
        """The rod with every effect that belongs to it, arc length from the first marker.

        Its length is that from the first marker to the last. Motion tells ratios to the mass, and
        next to nothing of how the rod stretches: radius, mass per length and stretching stiffness
        are those of a common cable of its stiffness, radius L_gb / 45.
        """
        s = self.selection
        return self._rod(s.model, s.values)

    @property
    def base_rod(self) -> RodModel:
        """The rod of the base model: straight and uniform, as stiff and damped as fits best."""
        s = self.selection
        return self._rod(Model(s.model.effects[: len(BASE)]), s.base_values).rod

    def _rod(self, model: Model, values: np.ndarray) -> FoundRod:
        m = self.measurements
        radius = SLENDER * self.base["stiffness"]["L_gb"].value
        like = RodModel.of(
            RodMaterial(radius, START_L_GB, float(m.marker_arc_length[-1]), gravity=m.gravity)
        )
        line_mass = like.line_mass.values[0]

        def read(setup: MotionSetup) -> RodModel:
            arc_length = np.concatenate([[0.0], np.cumsum(np.real(setup.rest_length))])
            whole = replace(like, length=float(arc_length[-1]))
            return rod_of(setup, arc_length, like=whole, line_mass=line_mass)

        assumed = ("radius", "line_mass")
        if "axial_stiffness" not in model.names:
            assumed += ("stretching_stiffness",)
        base = base_setup(m, _SUBDIVISIONS)
        return found_rod(base, model, values, read, assumed)


@checked_as_identification(arguments.like("recordings", "positions"))
@arguments.checked(
    DataError,
    subdivisions=arguments.whole(1, 64),
    steps=arguments.optional(
        arguments.either(arguments.path, arguments.like("KnownSteps", "recall", "forget"))
    ),
)
def identify_motion(
    measurements: MotionMeasurements | str | os.PathLike[str],
    *,
    test: MotionMeasurements | str | os.PathLike[str] | None = None,
    candidates: Sequence[Effect | str] | None = None,
    subdivisions: int = 2,
    device: arguments.DeviceLike = "cpu",
    steps: str | os.PathLike[str] | KnownSteps | None = None,
    evidence: bool = True,
    progress=None,
) -> MotionReport:
    """Find what a straight, uniform rod lacks to move as recorded, and prove it.

    Args:
        measurements: recordings of a rod that two grips move, or their file. A part of them is
            fitted, a part chooses the effects, and a part is only scored on.
        test: other recordings of the same rod to score on.
        candidates: effects, or names of effects; default: every one that motion may show.
        subdivisions: edges of the rod between neighbouring free markers.
        device: "cpu", "cuda:0", "auto".
        steps: file that remembers what has been computed while the work goes on: where it was
            stopped, it goes on from there. It is removed at the end, but where `KnownSteps` are
            given, which belong to more work than this.
        evidence: also show on which force what the base model lacks acts, for readers; no effect
            is chosen by it.
        progress: called with (text,) as the work goes on.

    Raises:
        DataError: the data cannot be right, an effect is unknown or no number where its fits
            start, or `steps` is of other data.
    """
    asked = measurements, test, candidates
    m, chosen = as_asked("motion", MotionMeasurements, load_motion, *asked)
    device = resolve_device(device)
    check_pace(m, device=device)
    remembered = KnownSteps(Path(steps), m) if isinstance(steps, (str, os.PathLike)) else steps
    laboratory = MotionLaboratory(
        m, subdivisions=subdivisions, device=device, remembered=remembered
    )
    refuse_undefined(chosen, laboratory.base)
    selection = select_motion(laboratory, chosen, progress=progress)
    prints = None
    if evidence:
        if progress:
            progress("force print")
        looked_at = np.union1d(m.fit, m.validation)
        base = Model(selection.model.effects[: len(BASE)])
        prints = trace_motion(
            m, base, selection.base_values, looked_at, int(m.validation[0]), device=device
        )
    report = _report(selection, prints)
    if remembered is not None and remembered is not steps:
        remembered.forget()
    return report


def _report(selection: MotionSelection, evidence: MotionTrace | None) -> MotionReport:
    laboratory = selection.laboratory
    m = laboratory.measurements
    windows = laboratory.windows(m.test)
    base = Model(selection.model.effects[: len(BASE)])
    models = (base, selection.base_values), (selection.model, selection.values)
    found = [laboratory.resolved(windows, *model) for model in models]
    (before, lost_before), (after, lost_after) = (
        (x + w.lacking.array, lost) for w, x, lost in found
    )
    few, last = np.arange(min(2, len(after))), found[1]
    floor = laboratory.floor(windows.part(few), *models[1])
    numerical = laboratory.error(replace(windows, markers=last[1]), after)
    verdict, reason = verdict_of(selection, floor)
    if lost_after.any():
        names = ", ".join(m.names[r] for r in windows.recording[lost_after])
        reason += f"; the steps of {names} fail, which are scored with their last shape"
    described = _described(selection, m)
    first = next((r.candidates for r in selection.rounds if r.candidates), ())
    return MotionReport(
        measurements=m,
        verdict=verdict,
        reason=reason,
        before=selection.before,
        after=selection.after,
        noise_floor=m.noise_floor,
        numerical_error=numerical,
        base={name: described[name] for name in BASE},
        effects=tuple(_found(selection, described)),
        candidates=tuple(_candidate(c) for c in first),
        selection=selection,
        residual=residual_of(laboratory, windows, before, after),
        trace=evidence,
        failed=(lost_before, lost_after),
        windows=windows,
        predicted_before=before,
        predicted_after=after,
    )


def _described(selection: MotionSelection, m) -> dict[str, dict[str, Estimate]]:
    s = selection
    parts = s.model.split(np.arange(len(s.values)))
    return {
        effect.name: effect.describe(s.values[i], s.covariance[np.ix_(i, i)], m)
        for effect, i in zip(s.model.effects, parts, strict=True)
    }


def _found(selection: MotionSelection, described):
    by_name = {e.name: e for e in selection.model.effects}
    for r in (r for r in selection.rounds if r.accepted in by_name):
        effect = by_name[r.accepted]
        yield FoundEffect(
            effect.name, effect.title, effect.reference, described[effect.name],
            r.test, {"validation_mm_with_this_effect": r.validation},
        )  # fmt: skip


def _candidate(candidate) -> dict:
    validation = candidate.validation
    return {
        "name": candidate.name,
        "promised_share": candidate.promise,
        "validation_mm": None if np.isnan(validation) else 1e3 * validation,
    }


def _plain(found: dict[str, dict[str, Estimate]]) -> dict:
    return {name: {k: asdict(v) for k, v in part.items()} for name, part in found.items()}
