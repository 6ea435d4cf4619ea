"""Which effects the data ask for: forward selection, pairs, exchange, cross-validation.

Stopping rule. An effect joins the model if it lowers the Bayesian information criterion of the
train trials by `BIC_MARGIN` or more, takes away at least `LEAST_SHARE` of the base model's excess
of squares or, where the error is still above the noise, half of what is left of it (an effect's law
is never exactly the rod's: smaller gains would only mend its form), and lowers the squared error of
trials held out in cross-validation. Where the base model has no excess, the effect has to take as
much as squares of noise vary by themselves. No model has more than `MOST_EFFECTS`, and where two
effects leave more than half of the excess a third is not tried: what so many small effects mend is
not theirs.

Where no known effect reaches the noise, effects are built from profiles along the rod (`profiles`)
and tried by themselves, then beside the known ones. The noise is taken as declared, then estimated
from what the chosen model leaves; where it is another one, everything is weighed with it and chosen
anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.noise import estimate
from wrod.identification.clamped.pairs import likely_pairs
from wrod.identification.clamped.profiles import built_effects
from wrod.identification.clamped.verdict import AT_NOISE, BIC_MARGIN, Round, Selection, judge
from wrod.identification.effect import Effect, Model

LEAST_SHARE = 0.005
MOST_EFFECTS = 3
_FOLDS = 4
_FINE = 4 / 3
# How often to choose at most, each time with the noise that the last choice has left.
_NOISE_PASSES = 3
# Pairs to fit, and how many standard deviations of chi squared deserve them.
_PAIRS, _FLUCTUATION = 12, 5.0
# Leaner pairs to fit in the place of a chosen one, out of so many by superposition.
_LEANER, _LEANER_FROM = 6, 40


def select(
    laboratory: Laboratory, candidates: list[Effect], *, build: bool = False, progress=None
) -> Selection:
    """Find the effects that explain the laboratory's train trials.

    Args:
        build: whether to build effects where the candidates do not reach the noise.
    """
    pool, built = list(candidates), None
    for _ in range(_NOISE_PASSES):
        current, rounds, held_out = _search(laboratory, pool, progress)
        if build and built is None and not _reaches_noise(laboratory, current):
            built = built_effects(laboratory)[0]
            for more in (built, [*pool, *built]):
                other, steps, ahead = _search(laboratory, more, progress)
                if other.bic < current.bic - BIC_MARGIN:
                    current, rounds, held_out = other, [*rounds, *steps], ahead
                if _reaches_noise(laboratory, current):
                    break
            pool += built
        if not _noise_changed(laboratory, current):
            break
    final = _polished(laboratory, current)
    return judge(laboratory, final, _base_fit(laboratory), rounds, held_out)


def _reaches_noise(laboratory: Laboratory, fit: Fit) -> bool:
    """Whether a model is as near to the train trials as noise lets it, with plausible numbers."""
    m = laboratory.measurements
    rms = laboratory.rms(laboratory.predict(fit.model, fit.values), m.train)
    return rms <= AT_NOISE * m.noise_floor and not fit.model.at_bound(fit.values)


def _noise_changed(laboratory: Laboratory, current: Fit) -> bool:
    """Estimate the noise beside a model; whether it is another one than the choice was made with.

    Without an effect, or with errors that no noise of the declared size has, nothing would change.
    """
    noise, rates = estimate(laboratory, current.model, current.values)
    if noise.near(laboratory.noise):
        return False
    laboratory.set_noise(noise, rates)
    return bool(current.model.effects) or not _reaches_noise(laboratory, current)


def _search(laboratory: Laboratory, candidates, progress):
    """(model, rounds, (before, after) RMS of markers held out) with the present noise."""
    empty = _base_fit(laboratory)
    current, rounds = empty, []
    excess = max(empty.chi_squared - empty.residual_count, 0.0)
    fluctuation = np.sqrt(2.0 * empty.residual_count)
    held_out = _held_out(laboratory, empty)
    base_held_out = held_out
    while len(current.model.effects) < MOST_EFFECTS:
        fits = _extensions(laboratory, current, candidates, progress)
        if len(current.model.effects) == 1:
            fits += _pairs(laboratory, current, candidates, progress)
        if not fits:
            break
        best = min(fits, key=lambda f: f.bic)
        if len(best.model.effects) > 1 and current.bic - best.bic >= BIC_MARGIN:
            best, others = _exchanged(laboratory, best, candidates, progress)
            fits += others
        fits = _best_of_each(fits)
        gain = current.bic - best.bic
        taken = current.chi_squared - best.chi_squared
        left = current.chi_squared - current.residual_count
        share = taken / max(excess, fluctuation)
        # Where much is left to explain, an effect beside a far larger one may be small.
        more = left > (AT_NOISE**2 - 1) * current.residual_count and taken > 0.5 * left
        reason, ahead = "", held_out
        if gain < BIC_MARGIN:
            reason = f"BIC falls by {gain:.1f}, less than {BIC_MARGIN:g}"
        elif excess < _FLUCTUATION * fluctuation and taken < fluctuation:
            reason = f"takes {taken:.0f} squares, noise alone varies by {fluctuation:.0f}"
        elif share < LEAST_SHARE and not more:
            reason = f"takes {100 * share:.2g} % of the excess, less than {100 * LEAST_SHARE:g} %"
        else:
            try:
                ahead = _held_out(laboratory, best)
            except DataError:
                reason = "a trial held out has no equilibrium with it"
            if ahead[1] >= held_out[1]:
                reason = reason or "trials held out get worse"
        accepted = None if reason else best.model.names
        rounds.append(
            Round(
                current.model.names,
                best,
                fits,
                [current.bic - f.bic for f in fits],
                accepted,
                reason or f"BIC falls by {gain:.0f}, held-out error to {1e3 * ahead[0]:.3f} mm",
            )
        )
        if reason:
            break
        current, held_out = best, ahead
        left = current.chi_squared - current.residual_count
        if len(current.model.effects) > 1 and left > 0.5 * excess:
            break
    current = _pruned(laboratory, current)
    current = _leaner(laboratory, current, candidates, rounds, progress)
    if len(current.model.effects) > 1:
        # The one that does most by itself comes first.
        alone = [f.model.names[0] for f in rounds[0].fits]
        order = [alone.index(name) if name in alone else len(alone) for name in current.model.names]
        current = _reordered(current, sorted(range(len(order)), key=order.__getitem__))
    return current, rounds, (base_held_out[0], held_out[0])


def _base_fit(laboratory: Laboratory) -> Fit:
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


def _best_of_each(fits: list[Fit]) -> list[Fit]:
    best: dict[tuple[str, ...], Fit] = {}
    for fit in fits:
        key = tuple(sorted(fit.model.names))
        if key not in best or fit.chi_squared < best[key].chi_squared:
            best[key] = fit
    return sorted(best.values(), key=lambda f: f.bic)


def _extensions(laboratory, current: Fit, candidates, progress) -> list[Fit]:
    """Every candidate added to the current model, best first."""
    models, starts = [], []
    for effect in candidates:
        if effect.name not in current.model.names:
            for start in _starts(laboratory, effect):
                models.append(current.model.extended(effect))
                starts.append(np.concatenate([current.values, start]))
    return _best_of_each(_fit(laboratory, models, starts, current, progress))


def _pairs(laboratory, current: Fit, candidates, progress) -> list[Fit]:
    """Pairs that are likely by superposition: the best single effect may stand for two others."""
    if current.chi_squared - current.residual_count < _FLUCTUATION * np.sqrt(
        2.0 * current.residual_count
    ):
        return []
    chosen = likely_pairs(laboratory, candidates, _PAIRS)
    chosen = [
        (model, start) for model, start in chosen if current.model.names[0] not in model.names
    ]
    models, starts = [model for model, _ in chosen], [start for _, start in chosen]
    return _fit(laboratory, models, starts, None, progress, rival=current.chi_squared)


def _exchanged(laboratory, best: Fit, candidates, progress) -> tuple[Fit, list[Fit]]:
    """Try every other effect in the place of each earlier one: the first choice saw the others'
    work as its own. Once one has changed, the others have to prove themselves beside it. Returns
    every fit on the way as well."""
    # The last one was chosen from all, with the others as they are.
    places = len(best.model.effects) - 1
    tried, seen = 0, []
    while tried < places:
        # The effect in the first place makes room; one that stays moves to the end.
        parts = best.model.split(best.values)
        rest, values = Model(best.model.effects[1:]), np.concatenate(parts[1:])
        models, starts = [], []
        for effect in candidates:
            if effect.name not in best.model.names:
                for start in _starts(laboratory, effect):
                    models.append(rest.extended(effect))
                    starts.append(np.concatenate([values, start]))
        origin = replace(best, model=rest, values=values)
        others = _best_of_each(
            _fit(laboratory, models, starts, origin, progress, rival=best.chi_squared)
        )
        seen += others
        if others and others[0].bic < best.bic - 1e-6:
            best, tried = others[0], 0
        else:
            best, tried = _reordered(best, [*range(1, places + 1), 0]), tried + 1
    return best, seen


def _reordered(fit: Fit, places: Sequence[int]) -> Fit:
    """The same fit with its effects in another order."""
    own = fit.model.split(np.arange(len(fit.values)))
    order = np.concatenate([own[p] for p in places])
    return replace(
        fit,
        model=Model(tuple(fit.model.effects[p] for p in places)),
        values=fit.values[order],
        covariance=fit.covariance[np.ix_(order, order)],
    )


def _pruned(laboratory, current: Fit) -> Fit:
    """Drop what a later effect has made superfluous."""
    while len(current.model.effects) > 1:
        models, starts = [], []
        parts = current.model.split(current.values)
        for place in range(len(parts)):
            rest = [e for i, e in enumerate(current.model.effects) if i != place]
            models.append(Model(tuple(rest)))
            starts.append(np.concatenate([p for i, p in enumerate(parts) if i != place]))
        fits = fit_models(laboratory, models, starts, origin=current, race=False)
        best = min(fits, key=lambda f: f.bic)
        if best.bic > current.bic + BIC_MARGIN:
            break
        current = best
    return current


def _leaner(laboratory, current: Fit, candidates, rounds: list[Round], progress) -> Fit:
    """A pair of fewer parameters in the place of a pair, if it does as well; what was fitted for
    that joins the last step, so that the verdict may name it as confounded."""
    if len(current.model.effects) != 2 or not rounds:
        return current
    tried = {frozenset(f.model.names) for r in rounds for f in r.fits}
    pairs = [
        (model, start)
        for model, start in likely_pairs(laboratory, candidates, _LEANER_FROM)
        if len(start) < len(current.values) and frozenset(model.names) not in tried
    ][:_LEANER]
    models, starts = [model for model, _ in pairs], [start for _, start in pairs]
    fits = _best_of_each(
        _fit(laboratory, models, starts, None, progress, rival=current.chi_squared)
    )
    for step in reversed(rounds):
        if any(set(f.model.names) == set(current.model.names) for f in step.fits):
            step.fits += fits
            break
    return min([current, *fits], key=lambda f: f.bic)


def _fit(laboratory, models, starts, origin, progress, rival: float = np.inf) -> list[Fit]:
    if not models:
        return []
    fits = fit_models(
        laboratory,
        models,
        starts,
        origin=origin,
        least_gain=0.5 * BIC_MARGIN,
        rival=rival,
        progress=progress,
    )
    return [f for f in fits if np.isfinite(f.chi_squared)]


def _held_out(laboratory: Laboratory, fit: Fit) -> tuple[float, float]:
    """(RMS of markers [m], chi squared of everything) of train trials not fitted, in folds."""
    m, trials = laboratory.measurements, laboratory.measurements.train
    count = min(_FOLDS, len(trials))
    fold = np.arange(len(trials)) % count
    fits = [fit] * count
    if len(fit.values):
        weights = (fold != np.arange(count)[:, None]).astype(float)
        fits = fit_models(
            laboratory,
            [fit.model] * count,
            [fit.values] * count,
            weights=weights,
            origin=fit,
            race=False,
        )
    squares = chi_squared = 0.0
    markers = m.centerline[0].size
    for k, own in enumerate(fits):
        left = trials[fold == k]
        error = laboratory.target[left] - laboratory.observe(own.model, own.values, trials=left)
        squares += float((error**2)[:, :markers][laboratory.read[left, :markers]].sum())
        chi_squared += float((laboratory.whiten(error, left) ** 2).sum())
    count = laboratory.read[trials, :markers].sum()
    return float(np.sqrt(3.0 * squares / count)), chi_squared


def _polished(laboratory: Laboratory, fit: Fit) -> Fit:
    """Fit again on a finer mesh, extrapolated at the model that was found."""
    fine = Laboratory(
        laboratory.measurements,
        edge_count=int(_FINE * laboratory.edge_count),
        device=laboratory.device,
    )
    fine.set_noise(laboratory.noise, laboratory.scatter_rates)
    if not fit.model.effects:
        laboratory.adopt(fine)
        return _base_fit(laboratory)
    fine.refine(fit.model, fit.values)
    polished = fit_models(fine, [fit.model], [fit.values], origin=fit, race=False)[0]
    laboratory.adopt(fine)
    return polished
