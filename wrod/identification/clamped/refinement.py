"""Whether a quantity that was found changes along the rod as its effect says.

An effect has a law along the rod: a constant, a straight line. One that is nearly the rod's reaches
the noise floor and stands for a law that is another one, with numbers that are wrong by many of
their standard errors. So wherever an effect of natural curvature, stiffness or weight was chosen,
a profile of the same quantity about it competes, as smooth and as large as the residual beside the
model says. It takes the effect's place if that lowers the information criterion with the noise that
the richer model leaves (what the poorer one leaves wrong passes for noise along the rod), improves
trials held out, and takes from trials that no choice has seen what an effect has to take.
"""

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.described import Described
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.noise import estimate
from wrod.identification.clamped.profiles import KINDS, KNOTS, Knots, ProfileEffect, likeliest
from wrod.identification.clamped.steps import has_profile, held_out_error
from wrod.identification.clamped.verdict import (
    BIC_MARGIN,
    Round,
    changed_by,
    is_proven,
    unseen_gain,
)
from wrod.identification.effect import Model


def refined(
    laboratory: Laboratory, current: Fit, rounds: list[Round], held_out: tuple[float, float]
) -> tuple[Fit, tuple[float, float]]:
    """(model, (before, after) RMS of markers held out): a chosen model, with profiles in place of
    effects whose law along the rod is not theirs; what was weighed joins `rounds`.

    With a profile in it, the laboratory's noise is what that model leaves.
    """
    if has_profile(current.model):
        return current, held_out
    for place, effect in enumerate(current.model.effects):
        kind = _kind_of(laboratory, effect)
        if kind is None:
            continue
        before = laboratory.noise, laboratory.scatter_rates
        rich = _with_profile(laboratory, current, place, kind)
        if rich is None:
            continue
        laboratory.set_noise(*estimate(laboratory, rich.model, rich.values))
        pair = fit_models(
            laboratory,
            [current.model, rich.model],
            [current.values, rich.values],
            origin=rich,
            race=False,
        )
        step, ahead = _weighed(laboratory, *pair)
        rounds.append(step)
        if step.accepted:
            return pair[1], (held_out[0], ahead)
        laboratory.set_noise(*before)
    return current, held_out


def _kind_of(laboratory: Laboratory, effect) -> str | None:
    """What an effect changes, if nothing else and all along the rod."""
    if isinstance(effect, Described):
        return None
    fields = changed_by(laboratory, [effect])
    kinds = [kind for kind, own in KINDS.items() if fields and fields <= own.fields]
    return kinds[0] if kinds and "bending" in fields | {"bending"} else None


def _with_profile(laboratory: Laboratory, current: Fit, place: int, kind: str) -> Fit | None:
    """The model with a profile about one of its effects; None where the residual asks for none."""
    trials, width = laboratory.measurements.train, KINDS[kind].width
    knots = Knots((kind,))
    own = np.array([p.scale for p in current.model.parameters])
    seen, rates = laboratory.jacobian(
        current.model.extended(knots), np.concatenate([current.values, np.zeros(width * KNOTS)])
    )
    residual = laboratory.whiten((laboratory.target - seen)[trials], trials).ravel()
    columns = laboratory.whiten(rates[trials], trials).reshape(residual.size, -1)
    theirs, mine = columns[:, : len(own)] * own, columns[:, len(own) :]
    # The effects' own parameters follow.
    inner = theirs.T @ theirs + np.eye(len(own))
    free = mine - theirs @ np.linalg.solve(inner, theirs.T @ mine)
    found = likeliest(kind, width, mine.T @ free, free.T @ residual)
    if found.evidence <= 0.0 or not found.basis.size:
        return None
    effects, parts = list(current.model.effects), current.model.split(current.values)
    effects[place] = ProfileEffect(kind, found.basis, effects[place])
    parts[place] = np.concatenate([parts[place], np.zeros(found.basis.shape[2])])
    rich = fit_models(
        laboratory, [Model(tuple(effects))], [np.concatenate(parts)], origin=current, race=False
    )[0]
    return rich if np.isfinite(rich.chi_squared) else None


def _weighed(laboratory: Laboratory, poor: Fit, rich: Fit) -> tuple[Round, float]:
    """(the step from one model to the other, RMS of markers held out with it)."""
    gain, ahead, reason = poor.bic - rich.bic, np.inf, ""
    if gain < BIC_MARGIN:
        reason = f"BIC falls by {gain:.1f}, less than {BIC_MARGIN:g}"
    else:
        try:
            (_, squares), (ahead, better) = (held_out_error(laboratory, f) for f in (poor, rich))
            if better >= squares:
                reason = "trials held out get worse"
            elif not is_proven(unseen_gain(laboratory, rich, poor)):
                reason = "unseen trials do not prove it"
        except DataError:
            reason = "a trial held out has no equilibrium with it"
    said = reason or f"BIC falls by {gain:.0f}, held-out error to {1e3 * ahead:.3f} mm"
    accepted = None if reason else rich.model.names
    return Round(poor.model.names, rich, [rich], [gain], accepted, said), float(ahead)
