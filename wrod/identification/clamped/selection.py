"""Which effects the data ask for: forward selection, pairs, exchange, cross-validation.

Stopping rule: `acceptance`. No model has more than `MOST_EFFECTS`, and where two effects leave more
than half of the excess a third is not tried: what so many small effects mend is not theirs.

Where no known effect reaches the noise, effects are built from profiles along the rod (`profiles`):
a few numbers at one place that reach it by themselves are chosen among themselves, else all are
searched together. The noise is taken as declared, then estimated from what the chosen model leaves;
where it is another one, everything is weighed with it: chosen anew where the model leaves no more
than noise, else freed of effects that are not needed then.
"""

from dataclasses import dataclass

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.acceptance import judged, kept, too_little
from wrod.identification.clamped.clock import Clock, OutOfTime
from wrod.identification.clamped.described import Described
from wrod.identification.clamped.drift import with_drift
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.held_out import held_out_error
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.moment_law import MomentLaw, moment_law_of
from wrod.identification.clamped.noise import NoiseModel, estimate
from wrod.identification.clamped.profiles import ProfileEffect, built_effects
from wrod.identification.clamped.refinement import EVIDENCE, profile_of, refined, with_profile
from wrod.identification.clamped.scatter import what_is_left
from wrod.identification.clamped.steps import (
    base_fit,
    best_of_each,
    evident,
    exchanged,
    extensions,
    has_profile,
    instead_of_scatter,
    leaner,
    on_finer_mesh,
    pairs_beside,
    pruned,
    reordered,
)
from wrod.identification.clamped.verdict import (
    BIC_MARGIN,
    LEFT_OVER,
    Round,
    Selection,
    at_noise_of,
    judge,
    only_so_far,
)
from wrod.identification.effect import Effect
from wrod.identification.effects.law import LAWS

MOST_EFFECTS = 3
# Effects that a law of unknown form may be taken for.
_LIKE_A_LAW = (*LAWS, "stiffness", "anisotropic_bending")
# How often to choose at most, each time with the noise that the last choice has left.
_NOISE_PASSES = 3


def select(laboratory: Laboratory, candidates: list[Effect], *, build: bool = False) -> Selection:
    """Find the effects that explain the laboratory's train trials.

    When its clock runs out, the best that was fitted until then is judged, and said to be so.

    Args:
        build: whether to build effects where the candidates do not reach the noise.
    """
    try:
        current, rounds, held_out = _chosen(laboratory, candidates, build)
        final = kept(laboratory, on_finer_mesh(laboratory, current), rounds)
        final, held_out, doubts = refined(laboratory, final, rounds, held_out, build)
        laboratory.clock.extend()
        found = judge(laboratory, final, base_fit(laboratory), rounds, held_out, doubts)
        return _or_another(laboratory, candidates, final, found) if build else found
    except OutOfTime:
        return _so_far(laboratory)
    finally:
        laboratory.clock = Clock()


def _so_far(laboratory: Laboratory) -> Selection:
    """The verdict on the best fitted in time; where that takes too long, on the base model."""
    clock, laboratory.clock = laboratory.clock, Clock()
    empty = base_fit(laboratory)
    before = held_out_error(laboratory, empty).rms
    fits, best = best_of_each(clock.fits), empty
    for count in range(1, MOST_EFFECTS + 1):
        own = [f for f in fits if len(f.model.effects) == count]
        if own and not too_little(laboratory, empty, best, own[0]):
            best = own[0]
    alone = [f for f in fits if len(f.model.effects) == 1]
    gains = [empty.bic - f.bic for f in alone]
    said = f"the time of {clock.seconds:g} s was over"
    rounds = [Round((), best, alone, gains, best.model.names or None, said)] if alone else []
    try:
        laboratory.clock = clock
        clock.extend()
        found = judge(laboratory, best, empty, rounds, (before, None))
    except (DataError, OutOfTime):  # nor may shapes be led to it in time
        laboratory.clock = Clock()
        found = judge(laboratory, empty, empty, rounds, (before, None))
    return only_so_far(found, clock.seconds)


def _chosen(laboratory: Laboratory, candidates: list[Effect], build: bool):
    """(model, rounds, held out) of the whole search."""
    pool, tried_to_build, before = list(candidates), not build, []
    for _ in range(_NOISE_PASSES):
        opening = _opening(laboratory, pool, before, build)
        if tried_to_build or opening.reaches_noise:
            current, rounds, held_out = _search(laboratory, pool, opening)
            if build:
                current, held_out = _or_built(laboratory, opening, current, rounds, held_out)
            if not tried_to_build and not _reaches_noise(laboratory, current):
                found = current, rounds, held_out
                current, rounds, held_out = _with_built(laboratory, pool, opening, found)
                tried_to_build = True
        else:
            current, rounds, held_out = _with_built(laboratory, pool, opening, None)
            tried_to_build = True
        if not current.model.effects and laboratory.noise.white:
            own = current, opening.singles, rounds, held_out
            current, held_out = instead_of_scatter(laboratory, *own)
        before = [*opening.singles, *opening.pairs, *(f for r in rounds for f in r.fits)]
        if not _noise_changed(laboratory, current):
            break
        if not _at_noise(laboratory, current):
            # No other weights would leave a smaller error, but the noise may ask for fewer effects.
            current = _weighed_anew(laboratory, current)
            break
    return current, rounds, held_out


@dataclass(frozen=True)
class _Opening:
    """Every candidate alone and the likely pairs, best first; whether one of them, or the base
    model, is as near to the train trials as noise lets it."""

    singles: list[Fit]
    pairs: list[Fit]
    reaches_noise: bool


def _opening(
    laboratory: Laboratory, pool: list[Effect], before: list[Fit], build: bool
) -> _Opening:
    """The first fits, and in the `pool` a law of unknown form where a known one comes nearest, or
    what comes or goes while it is measured where that reaches the noise.

    Args:
        before: what was fitted with other noise, to start from.
    """
    empty = base_fit(laboratory)
    singles = extensions(laboratory, empty, pool, before=before)
    if not singles or _reaches_noise(laboratory, empty):
        return _Opening(singles, [], True)
    near, best = _reaches_noise(laboratory, singles[0]), singles[0].model.names[0]
    # Its form may be another one even where the nearest known law leaves no more than noise: what
    # mends a law's form passes for a second effect.
    if best in (LAWS if near else _LIKE_A_LAW) and all(e.name != MomentLaw.name for e in pool):
        pool.append(moment_law_of(laboratory))
        singles = best_of_each([*singles, *extensions(laboratory, empty, pool[-1:])])
        near = _reaches_noise(laboratory, singles[0])
    if near:
        return _Opening(singles, [], True)
    drifting = with_drift(laboratory, pool, empty, to_noise=True) if build else []
    if drifting and _reaches_noise(laboratory, drifting[0]):
        pool += drifting[0].model.effects
        return _Opening(best_of_each([*singles, *drifting]), [], True)
    pairs = best_of_each(pairs_beside(laboratory, singles[0], pool, joined=True, before=before))
    return _Opening(singles, pairs, bool(pairs) and _reaches_noise(laboratory, pairs[0]))


def _with_built(laboratory: Laboratory, pool: list[Effect], opening: _Opening, known):
    """(model, rounds, held out) with effects that are built from profiles, which join `pool`.

    A few numbers at one place that reach the noise by themselves end the search where no known
    effect and no likely pair does; else the built ones are searched with the known.

    Args:
        known: what a search among the known effects has found; None: it has not been made.
    """
    alone, empty = opening.singles, base_fit(laboratory)
    if not known:
        also = with_drift(laboratory, pool, alone[0], to_noise=True)
        if also and _reaches_noise(laboratory, also[0]):
            pool += [e for e in also[0].model.effects if e not in pool]
            return _search(laboratory, pool, _Opening(alone, [*opening.pairs, also[0]], True))
    built = _built(laboratory, alone)
    if all(e.name != MomentLaw.name for e in pool):
        built.append(moment_law_of(laboratory))
    pool += built
    mark = min(f.chi_squared for f in [*alone, *opening.pairs])
    singles = extensions(laboratory, empty, built, rival=mark)
    few = [f for f in singles if isinstance(f.model.effects[0], (Described, MomentLaw))]
    if known is None and few and _reaches_noise(laboratory, few[0]):
        found = _search(laboratory, built, _Opening(singles, [], True))
        if found[0].model.effects and _reaches_noise(laboratory, found[0]):
            reason = "leaves more than noise, and so does every likely pair"
            first = Round((), alone[0], alone, [empty.bic - f.bic for f in alone], None, reason)
            return found[0], [first, *found[1]], found[2]
    together = _Opening(best_of_each([*alone, *singles]), opening.pairs, False)
    found = _search(laboratory, pool, together)
    if known and known[0].bic <= found[0].bic + BIC_MARGIN:
        return known
    return found


def _or_another(laboratory: Laboratory, candidates, final: Fit, found: Selection) -> Selection:
    """The verdict on what was found, or on another model that explains all: of built effects, where
    something is seen beside those that were found; else of what comes or goes, where something is
    found to change, or trials that come later are missed by more than those that were fitted."""
    if found.verdict in ("explained", "adequate"):
        return found
    noise, correction = (laboratory.noise, laboratory.scatter_rates), laboratory.mesh_correction
    try:
        if another := _another(laboratory, candidates, final, found):
            return another
    except OutOfTime:
        found = only_so_far(found, laboratory.clock.seconds)
    laboratory.mesh_correction = correction
    laboratory.set_noise(*noise)
    return found


def _another(laboratory: Laboratory, candidates, final: Fit, found: Selection) -> Selection | None:
    """The verdict on another model, if that explains all."""
    fits: list[Fit] = []
    if found.left_over and found.left_over.evidence > LEFT_OVER and not found.changing:
        empty = base_fit(laboratory)
        fits = extensions(laboratory, empty, _built(laboratory, found.ranking))
    elif found.changing or _at_noise(laboratory, final):
        laboratory.set_noise(NoiseModel())
        empty = base_fit(laboratory)
        few = 0 < len(final.model.effects) < MOST_EFFECTS and not has_profile(final.model)
        fits = with_drift(laboratory, candidates, empty)
        fits = best_of_each([*fits, *(with_drift(laboratory, candidates, final) if few else [])])
    if fits:
        base = held_out_error(laboratory, empty)
        step, ahead = judged(laboratory, empty, empty, fits[0], fits, base)
        if step.accepted:
            laboratory.refine(fits[0].model, fits[0].values)
            laboratory.set_noise(*estimate(laboratory, fits[0].model, fits[0].values))
            steps = [*found.rounds, step]
            best = leaner(laboratory, _weighed_anew(laboratory, fits[0]), candidates, steps)
            best, held_out, doubts = refined(laboratory, best, steps, (base.rms, ahead.rms))
            again = judge(laboratory, best, base_fit(laboratory), steps, held_out, doubts)
            if again.verdict == "explained" and again.fit.model.effects:
                return again
    return None


def _built(laboratory: Laboratory, singles: list[Fit], above: float = -np.inf) -> list[Effect]:
    """Effects that are built from profiles of the residual, the likeliest two of which are among
    them; none where no profile's log evidence is above that.

    Args:
        singles: effects alone, best first.
    """
    built, found = built_effects(laboratory, above)
    seen = [f for f in found[:2] if f.evidence > BIC_MARGIN and f.basis.size]
    return [*built, *(profile_of(laboratory, singles, f) for f in seen)]


def _or_built(laboratory: Laboratory, opening: _Opening, current: Fit, rounds, held_out):
    """(model, held out): an effect that is built in the place of what was found, where the residual
    is likelier as a profile: what reaches the noise need not be of the right quantity."""
    empty = base_fit(laboratory)
    if not current.model.effects or has_profile(current.model):
        return current, held_out
    built = _built(laboratory, opening.singles, 0.5 * (empty.bic - current.bic + BIC_MARGIN))
    fits = extensions(laboratory, empty, built, rival=current.chi_squared)
    if not fits or fits[0].bic > current.bic - BIC_MARGIN:
        return current, held_out
    before = held_out_error(laboratory, empty)
    step, ahead = judged(laboratory, empty, empty, fits[0], fits, before)
    mine = held_out_error(laboratory, current).squares.sum()
    if step.accepted is None or ahead.squares.sum() >= mine:
        return current, held_out
    rounds.append(step)
    return leaner(laboratory, fits[0], built, rounds), (held_out[0], ahead.rms)


def _reaches_noise(laboratory: Laboratory, fit: Fit) -> bool:
    """Whether a model is as near to the train trials as noise lets it, with plausible numbers."""
    return not fit.model.at_bound(fit.values) and _at_noise(laboratory, fit)


def _at_noise(laboratory: Laboratory, fit: Fit) -> bool:
    m, found = laboratory.measurements, (fit.model, fit.values)
    try:
        rms = laboratory.rms(laboratory.predict(*found), m.train)
        if rms <= at_noise_of(laboratory) * m.noise_floor:
            return True
        # Of the many numbers of a profile some would be a print's. What seems to change from trial
        # to trial may be an effect that is not tried yet: a pull is another force in each.
        return not has_profile(fit.model) and bool(what_is_left(laboratory, *found, m.train)[0])
    except DataError:  # a trial that is not fitted has no equilibrium with it
        return False


def _noise_changed(laboratory: Laboratory, current: Fit) -> bool:
    """Estimate the noise beside a model; whether to choose anew with it.

    Poses that scatter hide from equal weights what such weights would show: a twist, say.
    """
    noise, rates = estimate(laboratory, current.model, current.values)
    if noise.near(laboratory.noise):
        return False
    laboratory.set_noise(noise, rates)
    laboratory.clock.fits.clear()
    return bool(current.model.effects) or any(noise.scatter)


def _weighed_anew(laboratory: Laboratory, fit: Fit) -> Fit:
    """The effects of a model that are needed with the present noise."""
    if not fit.model.effects:
        return base_fit(laboratory)
    again = fit_models(laboratory, [fit.model], [fit.values], origin=fit, race=False)[0]
    return pruned(laboratory, again)


def _search(laboratory: Laboratory, candidates, opening: _Opening | None = None):
    """(model, rounds, (before, after) RMS of markers held out) with the present noise.

    A profile stands by itself or joins what is there: nothing joins it.

    Args:
        opening: of the same candidates, if it is there already.
    """
    empty = base_fit(laboratory)
    current, rounds = empty, []
    excess = max(empty.chi_squared - empty.residual_count, 0.0)
    held_out = held_out_error(laboratory, empty)
    base_held_out = held_out
    while len(current.model.effects) < MOST_EFFECTS and not has_profile(current.model):
        ready = opening.pairs if opening and len(current.model.effects) == 1 else []
        if opening and not current.model.effects:
            fits = opening.singles
        else:
            mark = min((f.chi_squared for f in ready), default=np.inf)
            fits = extensions(laboratory, current, candidates, rival=mark)
        if len(current.model.effects) == 1:
            fits += ready or pairs_beside(laboratory, current, candidates)
        if not fits:
            break
        # What begins with a profile would end there.
        few = [f for f in fits if current.model.effects or not has_profile(f.model)]
        best = min(few or fits, key=lambda f: f.bic)
        if len(best.model.effects) > 1 and current.bic - best.bic >= BIC_MARGIN:
            best, others = exchanged(laboratory, best, candidates)
            fits += others
        step, ahead = judged(laboratory, empty, current, best, best_of_each(fits), held_out)
        rounds.append(step)
        if step.accepted is None:
            break
        current, held_out = best, ahead
        left = current.chi_squared - current.residual_count
        if len(current.model.effects) > 1 and left > 0.5 * excess:
            break
    before = base_held_out, held_out
    current, held_out = _or_profile(laboratory, empty, current, rounds, before)
    current = pruned(laboratory, current)
    current = leaner(laboratory, current, candidates, rounds)
    if len(current.model.effects) > 1:
        # The one that does most by itself comes first.
        alone = [f.model.names[0] for f in rounds[0].fits]
        order = [alone.index(name) if name in alone else len(alone) for name in current.model.names]
        current = reordered(current, sorted(range(len(order)), key=order.__getitem__))
    return current, rounds, (base_held_out.rms, held_out.rms)


def _or_profile(laboratory: Laboratory, empty: Fit, current: Fit, rounds: list[Round], before):
    """(model, held-out error): the best profile alone, where it does better than what was found.

    Args:
        before: held-out errors of the base model and of what was found.
    """
    base, held_out = before
    alone = [f for f in rounds[0].fits if has_profile(f.model)] if rounds else []
    built = any(isinstance(e, Described) for e in current.model.effects)
    if not alone:
        return current, held_out
    best, less, gain, least = alone[0], current, current.bic - alone[0].bic, BIC_MARGIN
    if built:
        # From the same residual: it has no better claim than its evidence, of what the data leave
        # possible with the present noise. One that was found with another, and smoother, has less.
        own = best.model.effects[0]
        assert isinstance(own, ProfileEffect)
        best = with_profile(laboratory, best, 0, own.kind)[0] or best
        less, gain, least = empty, evident(current) - evident(best), 2.0 * EVIDENCE
    if gain < least:
        return current, held_out
    step, ahead = judged(laboratory, empty, less, best, alone, base)
    rounds.append(step)
    better = step.accepted and ahead.squares.sum() < held_out.squares.sum()
    return (best, ahead) if better else (current, held_out)
