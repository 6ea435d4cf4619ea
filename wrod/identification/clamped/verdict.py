"""The verdict on a chosen model of a clamped rod, and what these data cannot tell apart."""

import copy
from dataclasses import dataclass, field, fields, replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.fit import Fit
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.scatter import TrialScatter, said_of, standing_apart, what_is_left
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.clamped.trace import SEEN, Print
from wrod.identification.effect import Effect, Model
from wrod.identification.verdict import CLAMPED, CORRELATED

BIC_MARGIN = 10.0
AT_NOISE = CLAMPED.at_noise
# An effect lowers chi squared of trials that no choice has seen by this, and by so many standard
# errors of that (`error_of_gains`). By simulation (tests/test_proof.py: the best of many effects on
# noise that is wrongly taken for white) 1.5 errors let 1 in 37 false ones pass, 2 at most 1 in 55.
UNSEEN_GAIN, UNSEEN_ERRORS = 4.0, 2.0
# Evidence of a print beside a model from which the model stands for something else [nats].
LEFT_OVER = 2.0 * SEEN


@dataclass
class Round:
    """One step of the selection: every candidate for the next model, best first.

    Attributes:
        stays: what was not accepted and may be all the same, for people.
    """

    current: tuple[str, ...]
    best: Fit
    fits: list[Fit]
    gains: list[float]
    accepted: tuple[str, ...] | None
    reason: str
    stays: str = ""


@dataclass
class Selection:
    """What was chosen and why.

    Attributes:
        verdict: adequate, explained, partly-explained or unexplained.
        fit: the chosen model, polished on a finer mesh.
        rounds: the steps that led there.
        cross_validation: (before, after) RMS of held-out marker errors [m] of the chosen model;
            None if the time was over.
        confounded: pairs of names that these data cannot tell apart, with the evidence.
        ranking: every effect alone on the base model, best first.
        unseen: (chi squared that the model takes from the test trials, its standard error).
        at_bound: parameters of the model that ended at a bound.
        out_of_time: whether not all was tried.
        scatter: what else is off anew in each trial, where that is all that is left.
        changing: what changes while it is measured, a phrase; empty where nothing is seen to.
        left_over: the likeliest print beside the model; None where more than noise is left anyway.
        doubts: by place in the model, one with a profile about the effect there: what else it may
            be; by the place behind the last, one with an effect more that was too small to name.
        apart: as `standing_apart` has it.
    """

    verdict: str
    reason: str
    fit: Fit
    ranking: list[Fit]
    rounds: list[Round]
    base_chi_squared: float
    cross_validation: tuple[float, float | None]
    unseen: tuple[float, float] = (0.0, 0.0)
    at_bound: tuple[str, ...] = ()
    confounded: list[dict] = field(default_factory=list)
    out_of_time: bool = False
    scatter: TrialScatter | None = None
    changing: str = ""
    left_over: Print | None = None
    doubts: dict[int, Fit] = field(default_factory=dict)
    apart: dict[int, float] = field(default_factory=dict)


def judge(
    laboratory: Laboratory,
    fit: Fit,
    empty: Fit,
    rounds: list[Round],
    cross_validation: tuple[float, float | None],
    doubts: dict[int, Fit] | None = None,
) -> Selection:
    """The verdict on a chosen model.

    Args:
        fit: the chosen model; empty: the base model as a fit, both on the laboratory's mesh.
        rounds: the steps that led there.
        cross_validation: (before, after) RMS of held-out marker errors [m].
        doubts: as in `Selection`.
    """
    m = laboratory.measurements
    before = laboratory.rms(laboratory.predict(Model(), np.zeros(0)), m.test) / m.noise_floor
    try:
        after = laboratory.rms(laboratory.predict(fit.model, fit.values), m.test) / m.noise_floor
    except DataError:  # what was fitted is no rod in a trial that it has not seen
        found = judge(laboratory, empty, empty, rounds, cross_validation)
        said = f"an unseen trial has no equilibrium with {' and '.join(fit.model.names)}"
        return replace(found, reason=f"{said}; {found.reason}")
    unseen = unseen_gain(laboratory, fit, empty)
    proven = bool(fit.model.effects) and is_proven(unseen)
    told, left = (fit, after) if proven else (empty, before)
    at_noise = left <= at_noise_of(laboratory) * _expected_of(laboratory, told)
    scatter, changing, left_over = what_is_left(laboratory, told.model, told.values, m.test)
    settled = not changing and (at_noise or bool(scatter))
    if proven:
        verdict, reason = _word_of_effects(
            CLAMPED.share(before, after, 1.0), before, after, settled,
            fit.model.at_bound(fit.values),
        )  # fmt: skip
    elif settled or (changing and not fit.model.effects):
        verdict = "unexplained" if changing else "explained" if scatter else "adequate"
        reason = f"the base model's test error is {before:.2f} times the noise floor"
    elif fit.model.effects:
        verdict = "unexplained"
        reason = (
            f"{' and '.join(fit.model.names)} helps trials that it was fitted to, not unseen ones; "
            f"{before:.2f} times the noise floor stays"
        )
    else:
        verdict, reason = _word_of_effects(0.0, before, before, False, ())
    if scatter:
        reason += f", {scatter.ratio:.2f} times what is to be expected where {scatter}"
    if changing:
        reason += f"; something changes while it is measured: {changing}"
    if verdict == "explained" and told.model.effects and (doubt := _doubt(fit, m)):
        verdict, reason = "partly-explained", f"{reason}, but {doubt}"
    if verdict == "explained" and (said := _looks_like(told, left_over)):
        verdict, reason = "unexplained", f"{said}; {reason}"
    if not scatter and verdict != "explained" and laboratory.noise.described():
        reason += f"; the noise is not what was declared: {laboratory.noise.described()}"
    apart = standing_apart(laboratory, told.model, told.values)
    reason += f"; {said_of(apart)}" if apart else ""
    named = told if verdict in ("explained", "partly-explained") else empty
    selection = Selection(
        verdict,
        reason,
        named.spread(),
        rounds[0].fits if rounds else [],
        rounds,
        empty.chi_squared,
        cross_validation,
        unseen,
        fit.model.at_bound(fit.values),
        scatter=scatter,
        changing=changing,
        left_over=left_over,
        apart=apart,
    )
    if named.model.effects:
        selection.doubts = {place: rich.spread() for place, rich in (doubts or {}).items()}
        selection.confounded = _confounded(laboratory, fit, rounds)
    return selection


def _looks_like(told: Fit, left_over: Print | None) -> str:
    """A phrase about effects beside which something else is seen in every trial; empty where
    nothing is."""
    if not told.model.effects or left_over is None or left_over.evidence <= LEFT_OVER:
        return ""
    return (
        f"it looks like {' and '.join(told.model.names)}, but beside that is seen "
        f"({left_over.evidence:.0f} nats): {left_over.title}"
    )


def _word_of_effects(
    share: float, before: float, after: float, at_noise: bool, at_bound: tuple[str, ...]
) -> tuple[str, str]:
    """(verdict, reason) where effects are proven, or where nothing helps.

    Args:
        share: of the excess that is gone; before, after: test errors over the noise floor.
        at_noise: whether what is left is noise; at_bound: parameters that ended at a bound.
    """
    left = f"what is left on test trials is {after:.2f} times the noise floor"
    if at_noise and not at_bound:
        return "explained", left
    if at_noise:
        return "partly-explained", (
            f"{left}, but {', '.join(at_bound)} ended at a bound: the effect stands for another one"
        )
    if share >= CLAMPED.takes:
        return "partly-explained", (
            f"{100 * share:.0f} % of the excess error is gone, but {after:.2f} times the noise "
            "floor is left: the effects named may stand for one that is not known here"
        )
    return "unexplained", (
        f"no effect, nor any few together, takes {100 * CLAMPED.takes:.0f} % of the excess "
        f"error; {before:.2f} times the noise floor stays"
    )


def only_so_far(selection: Selection, seconds: float) -> Selection:
    """A judgement when the time was over: no more than a part is explained, for what would have
    been tried might do as well, and nothing is adequate."""
    least = {"explained": "partly-explained", "adequate": "unexplained"}
    reason = f"{seconds:g} s were not enough to try everything: {selection.reason}"
    if selection.changing:
        reason += "; what seems to change may be an effect that was not tried"
    verdict = least.get(selection.verdict, selection.verdict)
    return replace(selection, verdict=verdict, reason=reason, out_of_time=True)


def _doubt(fit: Fit, measurements) -> str:
    """What else the effects of a model may stand for."""
    own = fit.model.split(np.arange(len(fit.values)))
    said = [
        effect.doubt(fit.values[k], fit.covariance[np.ix_(k, k)], measurements)
        for effect, k in zip(fit.model.effects, own, strict=True)
    ]
    return "; ".join(text for text in said if text)


def at_noise_of(laboratory: Laboratory) -> float:
    """Times the noise floor that a perfect model's test error may well be.

    Correlated markers are few independent ones, so their RMS varies more.
    """
    m, like = laboratory.measurements, laboratory.noise.markers(laboratory.measurements.arc_length)
    seen = laboratory.read[m.test, : m.centerline[0].size].mean()
    count = 3.0 * len(m.test) * seen * np.trace(like) ** 2 / (like * like).sum()
    return max(AT_NOISE, 1.0 + 2.5 / np.sqrt(2.0 * count))


def _expected_of(laboratory: Laboratory, fit: Fit) -> float:
    """Times the noise that a true model leaves on test trials: its numbers are estimates, and those
    of a profile are many."""
    if not len(fit.values):
        return 1.0
    m, markers = laboratory.measurements, laboratory.measurements.centerline[0].size
    rates = laboratory.jacobian(fit.model, fit.values)[1][m.test, :markers]
    variance = np.einsum("trp,pq,trq->tr", rates, fit.covariance, rates)
    read = laboratory.read[m.test, :markers]
    return float(np.sqrt(1.0 + variance[read].mean() / m.noise**2))


def unseen_gain(laboratory: Laboratory, fit: Fit, less: Fit) -> tuple[float, float]:
    """(chi squared that a model takes from the test trials beyond what another one takes, standard
    error of that sum)."""
    trials = laboratory.measurements.test
    if fit.model.names == less.model.names:
        return 0.0, 0.0
    target = laboratory.target[trials]
    plain, better = (laboratory.observe(f.model, f.values, trials=trials) for f in (less, fit))
    before, after, moved = (
        (laboratory.whiten(v, trials) ** 2).sum(axis=1)
        for v in (target - plain, target - better, better - plain)
    )
    gain = before - after
    return float(gain.sum()), error_of_gains(gain, moved)


def is_proven(unseen: tuple[float, float]) -> bool:
    """Whether what a model takes from trials that no choice has seen proves it."""
    return unseen[0] >= max(UNSEEN_GAIN, UNSEEN_ERRORS * unseen[1])


def error_of_gains(gain: np.ndarray, moved: np.ndarray) -> float:
    """Standard error of the sum of what a model takes from trials.

    A model that is true takes from a trial as many squares as it moves the prediction there, one
    that is not takes none of them: gains are in proportion to that, and only what they scatter
    about the proportion is doubt. This is the ratio estimator of survey sampling (Cochran 1977,
    ch. 6), its error by the jackknife: a trial that outweighs the rest vouches for nothing.

    Args:
        gain: (t,) squares taken from each trial; moved: (t,) squares by which the model moves it.
    """
    count, whole = len(gain), moved.sum()
    if count < 2 or whole <= 0.0:
        return 0.0
    share = moved / whole
    scatter = (gain - gain.sum() * share) / np.maximum(1.0 - share, 1e-3)
    return float(np.sqrt((count - 1) / count * (scatter**2).sum()))


def _confounded(laboratory: Laboratory, fit: Fit, rounds: list[Round]) -> list[dict]:
    """Rivals that the data do not rule out, and parameters that trade against each other."""
    found = [
        {"effects": [e.name, e.alike], "evidence": "they load the rod alike in every trial"}
        for e in fit.model.effects
        if e.alike
    ]
    found += [
        {"effects": [" + ".join(step.current), step.stays], "evidence": step.reason}
        for step in rounds
        if step.stays and set(step.current) == set(fit.model.names)
    ]
    compared = [
        (step.fits, own)
        for step in rounds
        for own in step.fits
        if set(own.model.names) == set(fit.model.names)
    ]
    if compared:
        # The last step that weighed the chosen effects against others.
        rivals, best = compared[-1]
        mine = {e.name: e for e in best.model.effects}
        for rival in rivals:
            theirs = {e.name: e for e in rival.model.effects}
            own, other = sorted(set(mine) - set(theirs)), sorted(set(theirs) - set(mine))
            if not own or not other:
                continue
            gap = _leanest_bic(rival, other) - best.bic
            # A rival that contains the winner and adds nothing is no rival.
            empty = (
                len(rival.values) > len(best.values)
                and rival.chi_squared > best.chi_squared - BIC_MARGIN
                and changed_by(laboratory, [theirs[n] for n in other])
                == changed_by(laboratory, [mine[n] for n in own])
            )
            if gap < BIC_MARGIN and not empty:
                found.append(
                    {
                        "effects": [" + ".join(own), " + ".join(other)],
                        "evidence": f"BIC differs by {gap:.1f} only",
                    }
                )
    if len(fit.model.effects) > 1:
        correlation = fit.correlation()
        owner = [e.name for e in fit.model.effects for _ in e.parameters]
        keys = [p.key for p in fit.model.parameters]
        for i, j in zip(*np.triu_indices(len(keys), 1), strict=True):
            if owner[i] != owner[j] and abs(correlation[i, j]) > CORRELATED:
                found.append(
                    {
                        "effects": [owner[i], owner[j]],
                        "evidence": f"{keys[i]} and {keys[j]} correlate by {correlation[i, j]:.2f}",
                    }
                )
    return found


def _leanest_bic(fit: Fit, names: list[str]) -> float:
    """BIC of a fit without those parameters of the named effects that the data do not ask for.

    An effect may stand for another one with a part of its parameters: a gripper that only rolls is
    no other rod than one with a twist. What leaving parameters out costs is taken from the
    Gaussian posterior.
    """
    parameters = fit.model.parameters
    owner = [e.name for e in fit.model.effects for _ in e.parameters]
    price = np.log(fit.effective_count)
    out: list[int] = []
    best, cost = fit.bic, 0.0
    for _ in parameters:
        left = [
            j
            for j, p in enumerate(parameters)
            if owner[j] in names and not p.anywhere and j not in out
        ]
        if len(left) < 2:
            break
        costs = [_cost_without(fit, [*out, j]) for j in left]
        place = int(np.argmin(costs))
        if costs[place] - cost >= price:
            break
        out.append(left[place])
        cost = costs[place]
        best = fit.bic + cost - price * len(out)
    return best


def _cost_without(fit: Fit, places: list[int]) -> float:
    """Rise of chi squared if these parameters are 0 and all others follow (Wald)."""
    value = fit.values[places]
    return float(value @ np.linalg.solve(fit.covariance[np.ix_(places, places)], value))


def changed_by(laboratory: Laboratory, own: list[Effect]) -> frozenset[str]:
    """What the effects change: fields of the setup, `measure` for what cameras report."""
    m = laboratory.measurements
    base = ClampedSetup.base(m, m.train[:1], 8)
    found = set()
    for effect in own:
        if type(effect).measure is not Effect.measure:
            found.add("measure")
        setup = copy.copy(base)
        start = effect.starts(m)[0]
        effect.apply(setup, start + 1e-3 * np.array([p.scale for p in effect.parameters]))
        found |= {
            f.name
            for f in fields(ClampedSetup)
            if not np.array_equal(getattr(setup, f.name), getattr(base, f.name))
        }
    return frozenset(found)
