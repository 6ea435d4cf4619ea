"""Which effects a rod's motion asks for: selection on recordings that were not fitted.

Its rounds are told in docs/identification-motion.md ("Choice"). Beside the `KEPT_ON` candidates
with the least error the most promising one is fitted, and the most promising law of bending: laws
come to what they promise in many steps only. Others have to gain against the present model that was
fitted on, too. When the rounds end, effects are tried without that the linearised problem hardly
needs.
"""

from dataclasses import dataclass, replace

import numpy as np

from wrod.identification.effect import Effect, Model, effects
from wrod.identification.effects.law import LAWS, Yielding
from wrod.identification.motion.fit import Linearised, MotionLaboratory
from wrod.identification.motion.linearised import (
    confounded_pairs,
    correlations_of,
    losses_of,
    promises_of,
)
from wrod.identification.motion.windows import Windows
from wrod.identification.verdict import MOTION

# What cannot be known beforehand, with the value that fits start from: a rod without damping would
# ring on, and one damped by air alone is a local optimum that fits do not leave.
_BASE = {"stiffness": 0.0, "air_damping": 0.5, "internal_damping": 0.05}
BASE = tuple(_BASE)
TRIED, KEPT_ON = 6, 2
LEAST_GAIN = 0.01
MOST_EFFECTS = 6
# (frames, recordings) of the windows: to begin with, of the selection and of the last fit.
_SHORT, _MEDIUM, _WHOLE = (60, 10), (150, 10), (None, 32)
# Validation recordings that are predicted from shaken grips.
_SHAKEN = 8
# Steps of a candidate's fit, at most; it ends where one takes less than this share of the misfit.
_LONGEST, _SETTLED = 10, 2e-2
# Effects without which the linearised misfit rises by more than this share are not idle.
_BUSY = 0.02


@dataclass(frozen=True)
class Candidate:
    """An effect in one round.

    Attributes:
        promise: share of the misfit that it would take away if the motion were linear in it.
        validation: error on the validation recordings with it [m]; nan if it was not fitted.
    """

    name: str
    promise: float
    validation: float


@dataclass(frozen=True)
class MotionRound:
    """One step of the selection, its candidates the most promising first.

    Attributes:
        current: the model that it starts from; accepted, removed: the effect that it changes.
        validation, test: errors of the model that it leads to [m].
    """

    current: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    accepted: str | None
    reason: str
    validation: float
    test: float
    removed: str | None = None


@dataclass(frozen=True)
class MotionSelection:
    """What was chosen and why.

    Attributes:
        laboratory: on the mesh and with the time step of what follows.
        base_values: (3,) of the base model, fitted as the last model is.
        model, values: the chosen model, `BASE` first.
        covariance: (P, P) of the values.
        rounds: the steps that led there; the first is internal damping, as part of the base model.
        undamped: test error of the base model without internal damping, as the rounds fit it [m].
        before, after: test errors [m]; validation_before, validation_after, of the models before
            they were fitted to the validation recordings too.
        confounded: pairs of effects whose estimates hang together, with their correlation.
        correlation: (E, E) largest correlations between combinations of two effects' parameters,
            for `correlated`, the chosen effects and then those that were left out.
    """

    laboratory: MotionLaboratory
    base_values: np.ndarray
    model: Model
    values: np.ndarray
    covariance: np.ndarray
    rounds: tuple[MotionRound, ...]
    undamped: float
    before: float
    after: float
    validation_before: float
    validation_after: float
    confounded: tuple[dict, ...]
    correlated: tuple[str, ...]
    correlation: np.ndarray

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Parameters of the effects beyond the base model that ended at a bound."""
        added = Model(self.model.effects[len(BASE) :])
        return added.at_bound(self.values[len(self.values) - len(added.parameters) :])


def select_motion(
    laboratory: MotionLaboratory, candidates: list[Effect], *, progress=None
) -> MotionSelection:
    """Find the effects that explain the laboratory's recordings; `progress` is called with text."""
    return _Selection(laboratory, candidates, progress or (lambda text: None)).run()


@dataclass(frozen=True)
class _Fitted:
    """A model fitted to the medium windows, these and the validation recordings with what meshes
    lack, and its error on the latter [m]."""

    model: Model
    values: np.ndarray
    medium: Windows
    checked: Windows
    validation: float


class _Selection:
    def __init__(self, laboratory: MotionLaboratory, candidates: list[Effect], say):
        m = laboratory.measurements
        self.rod, self.say, self.rounds = laboratory, say, []
        self.left = [c for c in candidates if c.name not in BASE]
        self.short, self.medium = (self._windows(m.fit, *size) for size in (_SHORT, _MEDIUM))
        self.validation, self.test = laboratory.windows(m.validation), laboratory.windows(m.test)
        # Where nothing is kept for a test the validation recordings are one, and stay unfitted.
        apart = len(np.intersect1d(m.test, m.validation)) == 0
        every = np.union1d(m.fit, m.validation) if apart else m.fit
        self.whole = self._windows(every, *_WHOLE)

    def _windows(self, recordings, frames: int | None, count: int):
        """Windows of evenly chosen recordings, from their start, their end and between."""
        every = self.rod.measurements.frame_count
        length = min(frames or every, every)
        starts = np.linspace(0, every - length, min(3, -(-every // length))).round().astype(int)
        return self.rod.windows(_some(recordings, count), sorted(set(starts.tolist())), length)

    def _error(self, windows, model, values) -> float:
        return self.rod.judged(windows, model, values)[1]

    def _validated(self, model: Model, values: np.ndarray, beside: _Fitted) -> _Fitted:
        """A model whose predictions lack what those of another one do."""
        error = self.rod.score(beside.checked, model, values)
        return replace(beside, model=model, values=values, validation=error)

    def _fit(self, model, values, steps: int, settled: float, beside: _Fitted) -> _Fitted:
        values = self.rod.refine(beside.medium, model, values, steps, settled)
        return self._validated(model, values, beside)

    def _resolved(self, model: Model, values: np.ndarray, steps: int = 3) -> _Fitted:
        """Fitted on with what mesh and time step lack in its own predictions."""
        medium, _ = self.rod.judged(self.medium, model, values)
        values = self.rod.refine(medium, model, values, steps)
        checked, error = self.rod.judged(self.validation, model, values)
        return _Fitted(model, values, medium, checked, error)

    def run(self) -> MotionSelection:
        known = effects("motion")
        self.say("base model")
        base = self._base(BASE, known)
        undamped = self._base(BASE[:2], known)
        gain = 1.0 - base.validation / undamped.validation
        damped = gain >= LEAST_GAIN and base.values[2] > 0.0
        self._note(
            undamped.model, base, (), f"part of the base model; {_lowers(gain)}",
            accepted=BASE[2] if damped else None,
        )  # fmt: skip
        now = base
        while self.left and len(now.model.effects) < len(BASE) + MOST_EFFECTS:
            self.say(" + ".join(now.model.names[len(BASE) :]) or "effects")
            now, better = self._round(now)
            if not better:
                break
        now = self._without_idle(now)
        self._damped_after_all(now)
        self.say("whole recordings")
        base_values, _ = self._on_the_whole(base, 4)
        values, fit = self._on_the_whole(now, 8)
        self.say("confounding")
        rod = self.rod
        names, correlation = correlations_of(rod, now.medium, now.model, values, self.left)
        return MotionSelection(
            laboratory=rod,
            base_values=base_values,
            model=now.model,
            values=values,
            covariance=fit.covariance,
            rounds=tuple(self.rounds),
            undamped=self._error(self.test, undamped.model, undamped.values),
            before=self._error(self.test, base.model, base_values),
            after=self._error(self.test, now.model, values),
            validation_before=base.validation,
            validation_after=now.validation,
            confounded=confounded_pairs(names, correlation, len(now.model.effects)),
            correlated=names,
            correlation=correlation,
        )

    def _base(self, names: tuple[str, ...], known: dict[str, Effect]) -> _Fitted:
        model = Model(tuple(known[name] for name in names))
        start = np.array([_BASE[name] for name in names])
        values, _ = self.rod.fit(self.short, model, start)
        return self._resolved(model, self.rod.refine(self.medium, model, values, steps=3))

    def _on_the_whole(self, now: _Fitted, iterations: int) -> tuple[np.ndarray, Linearised]:
        """Fitted to whole recordings."""
        windows, _ = self.rod.judged(self.whole, now.model, now.values)
        return self.rod.fit(windows, now.model, now.values, iterations=iterations, converged=0.005)

    def _note(self, model, after: _Fitted, rows, reason, *, accepted=None, removed=None) -> None:
        test = self._error(self.test, after.model, after.values)
        self.rounds.append(
            MotionRound(model.names, tuple(rows), accepted, reason, after.validation, test, removed)
        )

    def _round(self, now: _Fitted) -> tuple[_Fitted, bool]:
        """The model with one effect more, if one is worth it, and whether one was."""
        ranked = promises_of(self.rod, now.medium, now.model, now.values, self.left)
        tried, stepped = {}, {}
        for _, effect, start, at in ranked[:TRIED]:
            model = now.model.extended(effect)
            values = self.rod.step(now.medium, model, np.r_[now.values, start], at)
            stepped[effect.name] = self._validated(model, values, now)
        kept = sorted(stepped, key=lambda n: stepped[n].validation)[:KEPT_ON]
        laws = [name for name in stepped if name in LAWS]
        for name in dict.fromkeys([*kept, *list(stepped)[:1], *laws[:1]]):
            one = stepped[name]
            fitted = self._fit(one.model, one.values, _LONGEST, _SETTLED, now)
            tried[name] = min(one, fitted, key=lambda t: t.validation)
        found = stepped | tried
        rows = [
            Candidate(e.name, p, found[e.name].validation if e.name in found else float("nan"))
            for p, e, *_ in ranked
        ]
        now, best, reason = self._best(now, _in_order(list(found.values())))
        if best is None:
            self._note(now.model, now, rows, reason)
            return now, False
        name = best.model.names[-1]
        self._note(now.model, best, rows, reason, accepted=name)
        # Beside a law that yields no other one counts.
        gone = LAWS if name == Yielding.name else (name,)
        self.left = [c for c in self.left if c.name not in gone]
        return best, True

    def _best(self, now: _Fitted, found: list[_Fitted]) -> tuple[_Fitted, _Fitted | None, str]:
        """The present model, fitted on, the first of the others that is worth its effect, and why.

        Args:
            found: with one effect more each, as `_in_order` has them.
        """

        def short() -> str:
            gain = 1.0 - min(t.validation for t in found) / now.validation
            less = f"the best {_lowers(gain)}, less than {100 * LEAST_GAIN:g} %"
            return "" if gain >= LEAST_GAIN else less

        if short():
            return now, None, short()
        # Others were fitted on from the present model: what further steps bring is not theirs.
        now = min(now, self._resolved(now.model, now.values), key=lambda t: t.validation)
        few = _some(np.arange(len(self.validation.recording)), _SHAKEN)
        floor = self.rod.floor(self.validation.part(few), now.model, now.values)
        if MOTION.is_noise(now.validation, floor):
            left = f"{1e3 * now.validation:.3f} mm are left, no more than noise leaves"
            return now, None, f"{left}, {1e3 * floor:.3f} mm"
        refused = ""
        for one in found:
            gain = 1.0 - one.validation / now.validation
            if not gain >= LEAST_GAIN:
                continue
            one = self._resolved(one.model, one.values)
            own = 1.0 - one.validation / now.validation
            if own >= LEAST_GAIN:
                return now, one, _lowers(own)
            refused = refused or (
                f"{one.model.names[-1]} {_lowers(gain)}, but by {100 * own:.1f} % with what mesh "
                "and time step lack in its own predictions: it makes up for them"
            )
        return now, None, refused or short()

    def _damped_after_all(self, now: _Fitted) -> None:
        """Internal damping may count only beside effects that were found later."""
        first = self.rounds[0]
        place = now.model.names.index(BASE[2])
        damping = now.model.split(now.values)[place][0]
        if first.accepted or len(now.model.effects) == len(BASE) or not damping > 0.0:
            return
        less = self._resolved(*now.model.without(place, now.values))
        gain = 1.0 - now.validation / less.validation
        if gain >= LEAST_GAIN:
            reason = f"{first.reason}, with the later effects by {100 * gain:.1f} %"
            self.rounds[0] = replace(first, accepted=BASE[2], reason=reason)

    def _without_idle(self, now: _Fitted) -> _Fitted:
        """The model without effects that later ones have made idle, the oldest looked at first."""
        loss = losses_of(self.rod, now.medium, now.model, now.values)
        for effect in now.model.effects[len(BASE) : -1]:
            if loss[effect.name] > _BUSY:
                continue
            self.say(f"without {effect.name}")
            place = now.model.names.index(effect.name)
            less = self._resolved(*now.model.without(place, now.values))
            gain = 1.0 - now.validation / less.validation
            if gain < LEAST_GAIN:
                reason = f"with the later effects it {_lowers(gain)}"
                self._note(now.model, less, (), reason, removed=effect.name)
                self.left.append(effect)
                now = less
        return now


def _lowers(gain: float) -> str:
    return f"lowers the validation error by {100 * gain:.1f} %"


def verdict_of(selection: MotionSelection, floor: float) -> tuple[str, str]:
    """(verdict, reason): what the errors on recordings not fitted say."""
    before, after = selection.before, selection.after
    numbers = f"test error {1e3 * before:.2f} mm before, {1e3 * after:.2f} mm after"
    noise = f"{numbers}: noise alone leaves a right model {1e3 * floor:.2f} mm"
    if MOTION.is_noise(before, floor):
        return "adequate", f"{noise}, and the base model no more"
    if len(selection.model.effects) == len(BASE):
        return "unexplained", f"{numbers}: no effect lowers the error of recordings not fitted"
    if MOTION.is_noise(after, floor):
        if not selection.at_bound:
            return "explained", noise
        stuck = ", ".join(selection.at_bound)
        return "partly-explained", f"{noise}, but {stuck} ended at a bound and stands for more"
    if after <= (1.0 - MOTION.takes) * before:
        return "partly-explained", f"{numbers}: {1e2 * (1 - after / before):.0f} % less"
    return "unexplained", f"{numbers}: no effect takes a fifth of it away"


def _in_order(found: list[_Fitted]) -> list[_Fitted]:
    """The best ahead, and before it what has fewer parameters and is no worse but by less than
    `LEAST_GAIN`, which counts as no gain: a hair's breadth decides what can join later."""
    least = min(t.validation for t in found) * (1.0 + LEAST_GAIN)
    ahead = sorted(found, key=lambda t: t.validation)
    return sorted(ahead, key=lambda t: len(t.values) if t.validation <= least else np.inf)


def _some(recordings: np.ndarray, count: int) -> np.ndarray:
    """At most `count` of the recordings, evenly."""
    index = np.unique(np.linspace(0, len(recordings) - 1, min(count, len(recordings))).round())
    return np.asarray(recordings)[index.astype(int)]
