"""The moves of a selection: beside a model, in pairs, by exchange, pruned."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.giving import TURNS, giving_for, pulled_at_own, settled, sole_ends
from wrod.identification.clamped.held_out import held_out_error
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.noise import gain_of_scatter
from wrod.identification.clamped.pairs import likely_pairs
from wrod.identification.clamped.profiles import ProfileEffect
from wrod.identification.clamped.scatter import OUTWEIGHS
from wrod.identification.clamped.verdict import BIC_MARGIN, Round
from wrod.identification.effect import Effect, Model

# Edges of the last fit's mesh over those of the search's.
_FINE = 4 / 3
# How often rods are put on nearer equilibria.
_SETTLES = 4
# Pairs to fit, and how many standard deviations of chi squared deserve them.
_PAIRS, FLUCTUATION = 12, 5.0
# Leaner pairs to fit in the place of a chosen one, out of so many by superposition.
_LEANER, _LEANER_FROM = 6, 40
# How many fits are made without trials that hold them back, the best by the squares of so large a
# share of the trials; no more are left out.
_AGAIN, _MOST = 8, 0.75


def base_fit(laboratory: Laboratory) -> Fit:
    trials = laboratory.measurements.train
    return Fit(
        Model(),
        np.zeros(0),
        np.zeros((0, 0)),
        float(laboratory.misfit(Model(), np.zeros(0), trials).sum()),
        int(laboratory.read[trials].sum()),
        float(laboratory.effective[trials].sum()),
        True,
    )


def _starts(laboratory: Laboratory, effect: Effect) -> list[np.ndarray]:
    return effect.starts(laboratory.measurements)


def best_of_each(fits: list[Fit]) -> list[Fit]:
    best: dict[tuple[str, ...], Fit] = {}
    for fit in fits:
        key = tuple(sorted(fit.model.names))
        if key not in best or fit.chi_squared < best[key].chi_squared:
            best[key] = fit
    return sorted(best.values(), key=lambda f: f.bic)


def evident(fit: Fit) -> float:
    """As the criterion of a fit, by its evidence (Laplace): a number costs by how much the data
    narrow its prior. The criterion takes each component of a profile for a free number, and a place
    that the data know to a thousandth of what it might be for one that costs no more."""
    known = [p.anywhere for p in fit.model.parameters]
    scale = np.array([p.scale for p in fit.model.parameters])
    away = np.where(known, 0.0, fit.values / scale)
    narrowed = -np.linalg.slogdet(fit.covariance / np.outer(scale, scale))[1]
    return float(fit.chi_squared + away @ away + narrowed)


def extensions(
    laboratory,
    current: Fit,
    candidates,
    *,
    rival: float = np.inf,
    before: Sequence[Fit] = (),
    share: float = 0.0,
) -> list[Fit]:
    """Every candidate added to the current model that may pay for its parameters, best first.

    Args:
        rival: chi squared of another model that is already there.
        before: fits of such models with other weights, to start from.
        share: of the squares beyond noise's that a candidate has to take to first order.
    """
    models, starts, origins = [], [], []
    known = {f.model.effects: f for f in before}
    # No fit leaves much less than noise does.
    above = current.chi_squared - current.residual_count + 3.0 * np.sqrt(2 * current.residual_count)
    price = np.log(current.effective_count)
    for effect in candidates:
        count = len(effect.parameters)
        if effect.name not in current.model.names and above + count > BIC_MARGIN + price * count:
            own = known.get((*current.model.effects, effect))
            fresh = [np.concatenate([current.values, s]) for s in _starts(laboratory, effect)]
            for start in [own.values] if own else fresh:
                models.append(current.model.extended(effect))
                starts.append(start)
                origins.append(own or current)
    least = share * max(current.chi_squared - current.residual_count, 0.0)
    fits = _fit(laboratory, models, starts, current, rival=rival, origins=origins, promised=least)
    return best_of_each(fits)


def has_profile(model: Model) -> bool:
    return any(isinstance(e, ProfileEffect) for e in model.effects)


def _described(candidates: Sequence[Effect]) -> list[Effect]:
    """All but profiles along the rod, which stand by themselves or join what is there: pairs and
    exchanges with their many numbers would take most of the time, and mean little."""
    return [e for e in candidates if not isinstance(e, ProfileEffect)]


def pairs_beside(
    laboratory, current: Fit, candidates, *, joined=False, before: Sequence[Fit] = ()
) -> list[Fit]:
    """Pairs that are likely by superposition: the best single effect may stand for two others.

    Args:
        joined: also those of which it is one, from where it is fitted: from the base model's shapes
            a rod that moves far may come to another equilibrium; before: as of `extensions`.
    """
    if current.chi_squared - current.residual_count < FLUCTUATION * np.sqrt(
        2.0 * current.residual_count
    ):
        return []
    first, own = current.model.names[0], []
    chosen = likely_pairs(laboratory, _described(candidates), _PAIRS)
    if joined:
        partners = {e.name: e for model, _ in chosen if first in model.names for e in model.effects}
        own = extensions(laboratory, current, list(partners.values()), before=before)
    chosen = [(model, start) for model, start in chosen if first not in model.names]
    models, starts = [model for model, _ in chosen], [start for _, start in chosen]
    rival = min([current.chi_squared, *(f.chi_squared for f in own)])
    return own + _fit(laboratory, models, starts, None, rival=rival)


def exchanged(laboratory, best: Fit, candidates) -> tuple[Fit, list[Fit]]:
    """Try every other effect in the place of each earlier one: the first choice saw the others'
    work as its own. Once one has changed, the others have to prove themselves beside it. Returns
    every fit on the way as well. What a profile has joined stays."""
    if has_profile(best.model):
        return best, []
    # The last one was chosen from all, with the others as they are.
    places = len(best.model.effects) - 1
    tried, seen = 0, []
    while tried < places:
        # The effect in the first place makes room; one that stays moves to the end.
        rest, values = best.model.without(0, best.values)
        models, starts = [], []
        for effect in _described(candidates):
            if effect.name not in best.model.names:
                for start in _starts(laboratory, effect):
                    models.append(rest.extended(effect))
                    starts.append(np.concatenate([values, start]))
        origin = replace(best, model=rest, values=values)
        others = best_of_each(_fit(laboratory, models, starts, origin, rival=best.chi_squared))
        seen += others
        if others and others[0].bic < best.bic - 1e-6:
            best, tried = others[0], 0
        else:
            best, tried = reordered(best, [*range(1, places + 1), 0]), tried + 1
    return best, seen


def reordered(fit: Fit, places: Sequence[int]) -> Fit:
    """The same fit with its effects in another order."""
    own = fit.model.split(np.arange(len(fit.values)))
    order = np.concatenate([own[p] for p in places])
    return replace(
        fit,
        model=Model(tuple(fit.model.effects[p] for p in places)),
        values=fit.values[order],
        covariance=fit.covariance[np.ix_(order, order)],
    )


def without(fit: Fit, kept: Sequence[Effect] = ()) -> tuple[list[Model], list[np.ndarray]]:
    """A model without each of its effects in turn, but for those to be kept, and its values."""
    places = [k for k, one in enumerate(fit.model.effects) if one not in kept]
    found = [fit.model.without(place, fit.values) for place in places]
    return [model for model, _ in found], [start for _, start in found]


def pruned(laboratory, current: Fit, kept: Sequence[Effect] = ()) -> Fit:
    """Drop what a later effect has made superfluous, but for those that are to be kept."""
    while len(current.model.effects) > 1:
        models, starts = without(current, kept)
        fits = fit_models(laboratory, models, starts, origin=current, race=False)
        best = min(fits, key=lambda f: f.bic)
        if best.bic > current.bic + BIC_MARGIN:
            break
        current = best
    return current


def leaner(laboratory, current: Fit, candidates, rounds: list[Round]) -> Fit:
    """A special case in the place of an effect, a pair of fewer parameters in that of a pair, if it
    does as well; what was fitted for that joins the last step, so that the verdict may name it as
    confounded."""
    if not rounds:
        return current
    if len(current.model.effects) == 2:
        tried = {frozenset(f.model.names) for r in rounds for f in r.fits}
        pairs = [
            (model, start)
            for model, start in likely_pairs(laboratory, _described(candidates), _LEANER_FROM)
            if len(start) < len(current.values) and frozenset(model.names) not in tried
        ][:_LEANER]
        models, starts = [model for model, _ in pairs], [start for _, start in pairs]
        fits = best_of_each(_fit(laboratory, models, starts, None, rival=current.chi_squared))
        _join_last(rounds, current, fits)
        current = min([current, *fits], key=lambda f: f.bic)
    while True:
        fits = _special_cases(laboratory, current, candidates)
        _join_last(rounds, current, fits)
        # An end that gives is more than one that is turned: fewer numbers are no reason.
        turned, least = TURNS & set(current.model.names), evident(current) - BIC_MARGIN
        fits = [f for f in fits if not turned - set(f.model.names) or evident(f) < least]
        # Components of a profile are no free numbers.
        best = min([current, *fits], key=evident if has_profile(current.model) else lambda f: f.bic)
        if best is current:
            return pulled_at_own(laboratory, current)
        current = settled(laboratory, best)


def _special_cases(laboratory, current: Fit, candidates) -> list[Fit]:
    """Models in which an effect gives way to one that has some of its parameters and no others, as
    a coil to a curvature, or that it says it comes near to: from the numbers and shapes that were
    found, for by itself it may not have come past a fold."""
    models, starts = [], []
    parts, own = current.model.split(current.values), current.model.effects
    for place, (effect, part) in enumerate(zip(own, parts, strict=True)):
        found = dict(zip((p.key for p in effect.parameters), part, strict=True))
        cases = effect.special_cases(part, laboratory.measurements)
        ways = giving_for(laboratory, current, place)
        for other in candidates:
            keys = [p.key for p in other.parameters]
            if set(keys) < set(found):
                ways.append((other, np.array([found[key] for key in keys])))
            elif other.name in cases:
                ways.append((other, cases[other.name]))
        for other, start in ways:
            if other.name not in current.model.names:
                models.append(Model((*own[:place], other, *own[place + 1 :])))
                starts.append(np.concatenate([*parts[:place], start, *parts[place + 1 :]]))
    fits = sole_ends(laboratory, current, base_fit(laboratory))
    if models:
        fits += fit_models(laboratory, models, starts, origin=current, race=False)
    return [f for f in fits if np.isfinite(f.chi_squared)]


def _join_last(rounds: list[Round], current: Fit, fits: list[Fit]) -> None:
    """Add fits to the last step that weighed the current model against others."""
    for step in reversed(rounds):
        if fits and any(set(f.model.names) == set(current.model.names) for f in step.fits):
            before = step.gains[0] + step.fits[0].bic
            step.fits = best_of_each([*step.fits, *fits])
            step.gains = [before - f.bic for f in step.fits]
            return


def on_finer_mesh(laboratory: Laboratory, fit: Fit) -> Fit:
    """Fit again on a finer mesh, extrapolated at the model that was found."""
    fine = Laboratory(
        laboratory.measurements,
        edge_count=int(_FINE * laboratory.edge_count),
        device=laboratory.device,
    )
    fine.clock = laboratory.clock
    fine.set_noise(laboratory.noise, laboratory.scatter_rates)
    if not fit.model.effects:
        laboratory.adopt(fine)
        return base_fit(laboratory)
    fine.refine(fit.model, fit.values)
    polished = fit_models(fine, [fit.model], [fit.values], origin=fit, race=False)[0]
    laboratory.adopt(fine)
    return polished


def _fit(
    laboratory, models, starts, origin, rival: float = np.inf, origins=None, promised: float = 0.0
) -> list[Fit]:
    if not models:
        return []
    # Half of what would let it join, for the problem is not linear.
    price = np.log(laboratory.effective[laboratory.measurements.train].sum())
    paid = 0 if origin is None else len(origin.values)
    least = [0.5 * (BIC_MARGIN + price * (len(v) - paid)) for v in starts]
    if origins:  # what begins where it was fitted has no more to gain
        least = [n if one is origin else 0.0 for n, one in zip(least, origins, strict=True)]
    least = [max(n, promised) for n in least]
    fits = fit_models(
        laboratory,
        models,
        starts,
        origin=origins or origin,
        least_gain=least,
        rival=rival,
    )
    if promised:  # what promises less stands where it began
        pairs = zip(fits, starts, strict=True)
        fits = [f for f, start in pairs if not np.array_equal(f.values, start)]
    return _past_folds(laboratory, [f for f in fits if np.isfinite(f.chi_squared)])


def _past_folds(laboratory, fits: list[Fit]) -> list[Fit]:
    """The fits, and the best of them once more from equilibria that are nearer to what was
    measured, and without trials that outweigh the rest, then whole.

    A trial whose rod turns over between the base model and the true one may hold its parameters
    back, where the others' squares would fall all the way. Most of all squares are that trial's, so
    fits are ranked by the others' (least trimmed squares, Rousseeuw 1984).
    """
    if _reaches_noise_of(fits):
        return fits
    fits = _settled(laboratory, fits)
    if _reaches_noise_of(fits):
        return fits
    trials, held = laboratory.measurements.train, []
    for fit in _without_profiles(fits):
        with suppress(DataError):
            misfit = laboratory.misfit(fit.model, fit.values, trials)
            stays = misfit < OUTWEIGHS * np.median(misfit)
            if not stays.all() and stays.mean() >= _MOST:
                trimmed = np.sort(misfit)[: int(np.ceil(_MOST * len(misfit)))].sum()
                held.append((float(trimmed), fit, stays))
    again = [(fit, stays) for _, fit, stays in sorted(held, key=lambda h: h[0])[:_AGAIN]]
    if not again:
        return fits
    own, stay = [fit for fit, _ in again], np.array([stays for _, stays in again], dtype=float)
    for weights in (stay, None):
        own = fit_models(
            laboratory, [f.model for f in own], [f.values for f in own],
            weights=weights, origin=own, race=False,
        )  # fmt: skip
        own = [f for f in own if np.isfinite(f.chi_squared)]
    # What does not come to the noise may only have come to another fold.
    return fits + [f for f in own if _reaches_noise_of([f])]


def _without_profiles(fits: list[Fit]) -> list[Fit]:
    return best_of_each([f for f in fits if not has_profile(f.model)])


def _reaches_noise_of(fits: list[Fit]) -> bool:
    """Whether one leaves no more squares than noise may."""
    return any(
        f.chi_squared < f.residual_count + FLUCTUATION * np.sqrt(2.0 * f.residual_count)
        for f in _without_profiles(fits)
    )


def _settled(laboratory, fits: list[Fit]) -> list[Fit]:
    """The fits, and the best of them once more from where rods stand nearer to what was measured,
    as often as they do, or where the way was long."""
    trials, own = laboratory.measurements.train, _without_profiles(fits)[:_AGAIN]
    for _ in range(_SETTLES):
        nearer = []
        for fit in own:
            with suppress(DataError):
                put = laboratory.settle(fit.model, fit.values, trials)
                if put or not fit.converged:
                    nearer.append(fit)
        if not nearer:
            break
        again = fit_models(
            laboratory, [f.model for f in nearer], [f.values for f in nearer],
            origin=nearer, race=False,
        )  # fmt: skip
        own = [
            f for f, before in zip(again, nearer, strict=True) if f.chi_squared < before.chi_squared
        ]
        fits = fits + own
    return fits


def instead_of_scatter(laboratory: Laboratory, empty: Fit, singles, rounds: list[Round], held_out):
    """(model, (before, after) RMS of markers held out): the best effect alone in the place of
    nothing, where the base model seems to leave scatter from trial to trial and one number that is
    the same in all of them is likelier. Squares of noise may vary by what it takes, but not so."""
    gain = gain_of_scatter(laboratory) if singles else 0.0
    if gain <= 0.0 or empty.bic - singles[0].bic < max(gain, BIC_MARGIN):
        return empty, held_out
    best, before = singles[0], held_out_error(laboratory, empty)
    ahead = held_out_error(laboratory, best)
    if ahead.squares.sum() >= before.squares.sum():
        return empty, held_out
    said = f"BIC falls by {empty.bic - best.bic:.0f}, by scatter from trial to trial {gain:.0f}"
    gains = [empty.bic - f.bic for f in singles]
    rounds.append(Round((), best, list(singles), gains, best.model.names, said))
    return best, (before.rms, ahead.rms)
