"""When an effect joins a model, and when it stays: one rule, however small the effect is.

A real effect may be small beside another one, and what is small may be no effect: the noise of the
readings, one trial beside a fold, a form that is not quite the rod's of what is named already, the
solver's mesh. So size itself decides nothing. An effect joins where

- the Bayesian information criterion of the train trials falls by `BIC_MARGIN` with the noise there
  is (where the base model has no excess of squares, and none is hidden by scatter from trial to
  trial, it has to take as many as noise may vary by: the noise is not known yet),
- trials held out ask for it: fits that have not seen a trial take squares from it in proportion to
  those by which the effect moves its prediction, by a standard error of the ratio
  (`verdict.error_of_gains`), so that one trial that outweighs the others vouches for nothing,
- it is likelier by `EVIDENCE` than that what is named already has another form: a quantity that
  changes along the rod, or a moment that follows the curvature, by another law than its effect has;
  which is asked where the effect takes so little that this may be.

On the last fit's finer mesh it stays where that needs it as well, and trials that no choice has
seen are likelier with it beside the others. By simulation (tests/test_proof.py: the best of ten
effects on noise that is wrongly taken for white) 2 in 100 false ones pass both kinds of trials;
asked for two errors fewer would, but a fifth of the small true ones fail, and half of those that a
few trials show. What is only not sure is not named, and may be there all the same: errors that are
told are those beside it.
"""

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.held_out import HeldOut, held_out_error
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.moment_law import moment_law_of
from wrod.identification.clamped.refinement import EVIDENCE, evidence_of_form
from wrod.identification.clamped.steps import (
    FLUCTUATION,
    best_of_each,
    evident,
    has_profile,
    without,
)
from wrod.identification.clamped.verdict import (
    BIC_MARGIN,
    UNSEEN_GAIN,
    Round,
    error_of_gains,
    unseen_gain,
)
from wrod.identification.effect import Model
from wrod.identification.effects.law import Softening

# A form that is wrong by a fifth of what an effect does leaves a share of 0.04 of its squares.
_MAY_BE_FORM = 0.04


def judged(laboratory: Laboratory, empty: Fit, current: Fit, best: Fit, fits, held_out: HeldOut):
    """(step from a model to the best of its extensions, its held-out error): see the module."""
    gain, stays, ahead = current.bic - best.bic, "", held_out
    reason = too_little(laboratory, empty, current, best)
    if not reason:
        try:
            ahead = held_out_error(laboratory, best)
            reason = _unproven(held_out, ahead) or _form_of(laboratory, empty, current, best)
            if reason and current.model.effects and ahead.squares.sum() < held_out.squares.sum():
                stays = " + ".join(best.model.names)
        except DataError:
            reason = "a trial held out has no equilibrium with it"
    said = reason or f"BIC falls by {gain:.0f}, held-out error to {1e3 * ahead.rms:.3f} mm"
    gains, accepted = [current.bic - f.bic for f in fits], None if reason else best.model.names
    return Round(current.model.names, best, fits, gains, accepted, said, stays), ahead


def too_little(laboratory: Laboratory, empty: Fit, current: Fit, best: Fit) -> str:
    """Why what a model takes of the train trials' squares beyond another is none of its effect's;
    nothing where it is enough."""
    excess = max(empty.chi_squared - empty.residual_count, 0.0)
    fluctuation = np.sqrt(2.0 * empty.residual_count)
    gain = current.bic - best.bic
    taken = current.chi_squared - best.chi_squared
    if gain < BIC_MARGIN:
        return f"BIC falls by {gain:.1f}, less than {BIC_MARGIN:g}"
    # Scatter that was estimated beside it takes most of the squares of a small effect away.
    scattered = any(laboratory.noise.scatter)
    if not scattered and excess < FLUCTUATION * fluctuation and taken < fluctuation:
        return f"takes {taken:.0f} squares, noise alone varies by {fluctuation:.0f}"
    return ""


def _unproven(before: HeldOut, ahead: HeldOut) -> str:
    """Why trials held out do not ask for what a model has more; nothing where they do."""
    gain = before.squares - ahead.squares
    error = error_of_gains(gain, before.moved_by(ahead))
    if gain.sum() >= max(UNSEEN_GAIN, error):
        return ""
    if gain.sum() <= 0.0:
        return "trials held out get worse"
    return f"trials held out lose {gain.sum():.0f} ± {error:.0f} squares, which proves nothing"


def _form_of(laboratory: Laboratory, empty: Fit, current: Fit, best: Fit) -> str:
    """Why what a model takes beyond another may be the form of an effect that both have; nothing
    where it is no such thing."""
    excess = empty.chi_squared - empty.residual_count
    taken = current.chi_squared - best.chi_squared
    if taken > _MAY_BE_FORM * excess or has_profile(best.model):
        return ""
    seen = 0.5 * (evident(current) - evident(best))
    for place, effect in enumerate(current.model.effects):
        along = evidence_of_form(laboratory, current, place)
        form = max(along, evidence_of_law(laboratory, current, place))
        if seen < form + EVIDENCE:
            of = "along the rod" if form == along else "of bending"
            return (
                f"is seen by {seen:.1f} nats, another law {of} than that of {effect.name} by "
                f"{form:.1f}"
            )
    return ""


def evidence_of_law(laboratory: Laboratory, fit: Fit, place: int) -> float:
    """Log evidence that the moment follows the curvature by another law than that of the effect at
    a place of a model; none where that is no such law."""
    effect, parts = fit.model.effects[place], fit.model.split(fit.values)
    if not isinstance(effect, Softening):
        return -np.inf
    law = moment_law_of(laboratory)
    curvature = np.linspace(0.05, 1.0, 40) * law.curvatures[-1]
    share = effect.secant(curvature, parts[place]) - 1.0
    parts[place] = np.linalg.lstsq(law.secant(curvature), share)[0]
    own = tuple(law if e is effect else e for e in fit.model.effects)
    rich = fit_models(laboratory, [Model(own)], [np.concatenate(parts)], origin=fit, race=False)[0]
    return 0.5 * (evident(fit) - evident(rich)) if np.isfinite(rich.chi_squared) else -np.inf


def kept(laboratory: Laboratory, fit: Fit, rounds: list[Round]) -> Fit:
    """A model as it was fitted last, without effects that this mesh or unseen trials do not ask for
    beside the others; what was not sure joins `rounds`."""
    while len(fit.model.effects) > 1 and not has_profile(fit.model):
        models, starts = without(fit)
        poor = fit_models(laboratory, models, starts, origin=fit, race=False)
        for less in sorted(poor, key=lambda f: f.bic):
            gain, stays = less.bic - fit.bic, ""
            reason = f"BIC falls by {gain:.1f} on the last mesh" if gain < BIC_MARGIN else ""
            if not reason:
                taken = unseen_gain(laboratory, fit, less)[0]
                if taken > 0.0:
                    continue
                reason = f"unseen trials get {-taken:.0f} squares worse"
                stays = " + ".join(fit.model.names)
            step = Round(less.model.names, fit, best_of_each([fit]), [gain], None, reason, stays)
            rounds.append(step)
            fit = less
            break
        else:
            break
    return fit
