"""Which effects a rod's motion asks for: forward selection on recordings that were not fitted.

Stopping rule. In each round the candidates are ranked by the misfit that they promise to take away
in the problem linearised around the present model, all in one run; the `TRIED` most promising are
fitted. The one with the least error on the validation recordings joins if it lowers that error by
`LEAST_GAIN` or more. The selection ends when none does, or after `MOST_EFFECTS`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrod.identification.effect import Effect, Model, effects
from wrod.identification.motion_fit import Linearised, MotionLaboratory

# The base model: straight, uniform, isotropic; only what cannot be known beforehand is fitted.
BASE = ("stiffness", "air_damping")
TRIED = 3
LEAST_GAIN = 0.01
MOST_EFFECTS = 10
PARTLY = 0.8
AT_NOISE = 1.15
CONFOUNDED = 0.9
_SHORT, _LONG = 60, 250
_MOST_FITTED, _MOST_POLISHED = 10, 24


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
class Round:
    """One step of the selection, its candidates the most promising first."""

    current: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    accepted: str | None
    reason: str
    validation: float
    test: float


@dataclass(frozen=True)
class MotionSelection:
    """What was chosen and why.

    Attributes:
        base_values: (2,) stiffness and air damping of the base model.
        model, values: the chosen model, `BASE` first.
        fit: its linearised misfit; covariance: (P, P) of the values.
        rounds: the steps that led there, the base model's errors in the first.
        before, after: test errors [m]; validation_before, validation_after.
        confounded: pairs of effects whose estimates hang together, with their correlation.
        correlation: (E, E) largest correlations between combinations of two effects' parameters,
            for `correlated`, the chosen effects and then those that were left out.
    """

    base_values: np.ndarray
    model: Model
    values: np.ndarray
    fit: Linearised
    covariance: np.ndarray
    rounds: tuple[Round, ...]
    before: float
    after: float
    validation_before: float
    validation_after: float
    confounded: tuple[dict, ...]
    correlated: tuple[str, ...]
    correlation: np.ndarray


def select_motion(
    laboratory: MotionLaboratory, candidates: list[Effect], *, progress=None
) -> MotionSelection:
    """Find the effects that explain the laboratory's recordings; `progress` is called with text."""
    say = progress or (lambda text: None)
    m = laboratory.measurements
    rod = laboratory
    known = effects("motion")
    frames = m.frame_count
    starts = sorted({0, max(0, frames // 3), max(0, 2 * frames // 3)})
    short = rod.windows(_some(m.fit, _MOST_FITTED), starts, min(_SHORT, frames))
    validation, test = rod.windows(m.validation), rod.windows(m.test)

    def scores(model, values):
        return tuple(rod.error(w, rod.predict(w, model, values)) for w in (validation, test))

    say("base model")
    model = Model(tuple(known[name] for name in BASE))
    values, _ = rod.fit(short, model, np.array([0.0, 1.0]))
    validation_error, test_error = scores(model, values)
    # What is compared with is the base model at its best, fitted to long stretches as the last is.
    length = min(_LONG, frames)
    long = rod.windows(_some(m.fit, _MOST_POLISHED), sorted({0, max(0, frames - length)}), length)
    base_values, _ = rod.fit(long, model, values, iterations=8)
    validation_before, before = scores(model, base_values)
    rounds = []
    left = [c for c in candidates if c.name not in BASE]
    while True:
        say(" + ".join(model.names[2:]) or "effects")
        ranked = _promises(rod, short, model, values, left)
        tried = []
        for promise, effect, start in ranked[:TRIED]:
            extended = model.extended(effect)
            fitted, _ = rod.fit(
                short, extended, np.concatenate([values, start]), iterations=5, converged=0.01
            )
            error = rod.error(validation, rod.predict(validation, extended, fitted))
            tried.append((error, effect, extended, fitted, promise))
        rows = [Candidate(e.name, p, err) for err, e, _, _, p in tried]
        rows += [Candidate(e.name, p, float("nan")) for p, e, _ in ranked[TRIED:]]
        best = min(tried, key=lambda t: t[0], default=None)
        gain = 0.0 if best is None else 1.0 - best[0] / validation_error
        if best is None or not gain >= LEAST_GAIN:
            reason = (
                f"the best lowers the validation error by {100 * gain:.1f} %, less than "
                f"{100 * LEAST_GAIN:g} %"
                if best
                else "no effect is left"
            )
            rounds.append(
                Round(model.names, tuple(rows), None, reason, validation_error, test_error)
            )
            break
        reason = f"lowers the validation error by {100 * gain:.1f} %"
        _, effect, model, values, _ = best
        previous = model.names[:-1]
        validation_error, test_error = scores(model, values)
        rounds.append(
            Round(previous, tuple(rows), effect.name, reason, validation_error, test_error)
        )
        left = [c for c in left if c.name != effect.name]
        if len(model.effects) >= MOST_EFFECTS + len(BASE) or not left:
            break

    say("polish")
    polished, fit = rod.fit(long, model, values, iterations=4, converged=0.005)
    polished_errors = scores(model, polished)
    if polished_errors[0] <= validation_error:
        values, (validation_error, test_error) = polished, polished_errors
    else:
        fit = rod.linearise(long, model, values)
    say("confounding")
    names, correlation = _correlations(rod, long, model, values, left)
    return MotionSelection(
        base_values,
        model,
        values,
        fit,
        fit.covariance,
        tuple(rounds),
        before,
        test_error,
        validation_before,
        validation_error,
        _confounded(names, correlation, len(model.effects)),
        names,
        correlation,
    )


def verdict_of(selection: MotionSelection, floor: float) -> tuple[str, str]:
    """(verdict, reason): what the errors on recordings not fitted say."""
    before, after = selection.before, selection.after
    numbers = f"test error {1e3 * before:.2f} mm before, {1e3 * after:.2f} mm after"
    if before <= AT_NOISE * floor:
        return "adequate", f"{numbers}: the base model reaches the floor of {1e3 * floor:.2f} mm"
    if len(selection.model.effects) == len(BASE):
        return "unexplained", f"{numbers}: no effect lowers the error of recordings not fitted"
    if after <= AT_NOISE * floor:
        return "explained", f"{numbers}: the floor is {1e3 * floor:.2f} mm"
    if after <= PARTLY * before:
        return "partly-explained", f"{numbers}: {1e2 * (1 - after / before):.0f} % less"
    return "unexplained", f"{numbers}: no effect takes a fifth of it away"


def _some(recordings: np.ndarray, count: int) -> np.ndarray:
    """At most `count` of the recordings, evenly."""
    index = np.unique(np.linspace(0, len(recordings) - 1, min(count, len(recordings))).round())
    return np.asarray(recordings)[index.astype(int)]


def _starts(effect: Effect) -> np.ndarray:
    """Where the linearisation is done: at zero, or where the effect's own start says."""
    return (
        effect.starts(None)[0]
        if effect.name == "anisotropic_bending"
        else np.zeros(len(effect.parameters))
    )


def _promises(rod, windows, model, values, left):
    """[(promise, effect, start values)] of every candidate, best first, from one run."""
    if not left:
        return []
    start = [_starts(e) for e in left]
    everything = Model((*model.effects, *left))
    at = rod.linearise(windows, everything, np.concatenate([values, *start]))

    def gain(index):
        h = at.hessian[np.ix_(index, index)] * (1.0 + 1e-6 * np.eye(len(index)))
        return 0.5 * at.gradient[index] @ np.linalg.solve(h, at.gradient[index])

    own = np.arange(len(values))
    known, first, out = gain(own), len(values), []
    for effect, zero in zip(left, start, strict=True):
        index = np.arange(first, first + len(zero))
        first += len(zero)
        promise = (gain(np.concatenate([own, index])) - known) / at.cost
        out.append((float(promise), effect, zero))
    return sorted(out, key=lambda o: -o[0])


def _correlations(rod, windows, model, values, left) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and (E, E) largest canonical correlations between effects' parameters."""
    everything = Model((*model.effects, *left))
    at = rod.linearise(windows, everything, np.concatenate([values, *(_starts(e) for e in left)]))
    names = everything.names
    parts = np.split(
        np.arange(len(at.gradient)), np.cumsum([len(e.parameters) for e in everything.effects])
    )[:-1]
    chosen = len(model.effects)
    own = np.concatenate(parts[:chosen])
    out = np.eye(len(names))

    def between(covariance, a, b):
        whiten_a, whiten_b = (
            np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(i, i)])) for i in (a, b)
        )
        return np.linalg.norm(whiten_a @ covariance[np.ix_(a, b)] @ whiten_b.T, 2)

    for j in range(len(names)):
        # An effect that was left out joins the chosen ones alone.
        index = own if j < chosen else np.concatenate([own, parts[j]])
        place = {int(p): k for k, p in enumerate(index)}
        covariance = np.linalg.inv(at.hessian[np.ix_(index, index)])
        for i in range(min(j, chosen)):
            a, b = ([place[int(p)] for p in parts[k]] for k in (i, j))
            out[i, j] = out[j, i] = between(covariance, a, b)
    return names, out


def _confounded(names, correlation, chosen) -> tuple[dict, ...]:
    pairs = []
    for i in range(chosen):
        for j in range(i + 1, len(names)):
            if correlation[i, j] >= CONFOUNDED:
                what = "" if j < chosen else f"; {names[j]} was left out"
                pairs.append(
                    {
                        "effects": [names[i], names[j]],
                        "correlation": float(correlation[i, j]),
                        "evidence": f"correlation of the estimates {correlation[i, j]:.2f}{what}",
                    }
                )
    return tuple(sorted(pairs, key=lambda p: -p["correlation"]))
