"""Whether a quantity that was found changes along the rod as its effect says.

An effect has a law along the rod: a constant, a straight line. One that is nearly the rod's reaches
the noise floor and stands for a law that is another one, with numbers that are wrong by many of
their standard errors. So wherever an effect of natural curvature, stiffness or weight was chosen,
a profile of the same quantity about it competes, as smooth and as large as the residual beside the
model says. It takes the effect's place if it has the evidence by the noise that the richer model
leaves (what the poorer one leaves wrong passes for noise along the rod), improves trials held out,
and takes squares from trials that no choice has seen.
"""

from collections.abc import Sequence

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.described import Described
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.noise import estimate
from wrod.identification.clamped.profiles import (
    KINDS,
    KNOTS,
    Found,
    Knots,
    ProfileEffect,
    likeliest,
)
from wrod.identification.clamped.steps import has_profile, held_out_error
from wrod.identification.clamped.verdict import UNSEEN_GAIN, Round, changed_by, unseen_gain
from wrod.identification.effect import Effect, Model

# Kinds of profiles that effects have a law of.
_QUANTITIES = ("curvature", "stiffness", "weight")
# Log evidence from which a profile is likelier than the law, twenty to one [nats]. A profile that
# need not be costs a name and wider errors, a law that is not the rod's costs wrong numbers: so
# less is asked than of an effect that joins, and of unseen trials one standard error.
_EVIDENCE = 3.0
# How often the noise is estimated beside the profile and the profile built with that noise.
_NOISE_PASSES = 3


def refined(
    laboratory: Laboratory, current: Fit, rounds: list[Round], held_out: tuple[float, float]
) -> tuple[Fit, tuple[float, float]]:
    """(model, (before, after) RMS of markers held out): a chosen model, with profiles in place of
    effects whose law along the rod is not theirs; what was weighed joins `rounds`.

    With a profile in it, the laboratory's noise is what that model leaves.
    """
    if has_profile(current.model):
        return current, held_out
    declared = laboratory.noise, laboratory.scatter_rates
    for place, effect in enumerate(current.model.effects):
        kind = _kind_of(laboratory, effect)
        if kind is None:
            continue
        poor = current
        for _ in range(_NOISE_PASSES):
            rich, evidence = _with_profile(laboratory, poor, place, kind)
            if rich is None:
                break
            noise, rates = estimate(laboratory, rich.model, rich.values)
            if noise.near(laboratory.noise):
                break
            laboratory.set_noise(noise, rates)
            poor = fit_models(laboratory, [poor.model], [poor.values], origin=poor, race=False)[0]
        if rich is not None:
            step, ahead = _weighed(laboratory, poor, rich, evidence)
            rounds.append(step)
            if step.accepted:
                return rich, (held_out[0], ahead)
        laboratory.set_noise(*declared)
    return current, held_out


def profile_of(laboratory: Laboratory, singles: Sequence[Fit], found: Found) -> ProfileEffect:
    """A profile that was found about the base model as an effect.

    Args:
        singles: effects alone, best first. What one of them leaves is nearer to linear: the first
            one of the same quantity is what the profile is about, where it asks for one.
    """
    for law in singles:
        if _kind_of(laboratory, law.model.effects[0]) == found.kind:
            rich, _ = _with_profile(laboratory, law, 0, found.kind)
            if rich is None:
                break
            (effect,) = rich.model.effects
            assert isinstance(effect, ProfileEffect)
            return ProfileEffect(found.kind, effect.basis, effect.about, rich.values)
    return ProfileEffect(found.kind, found.basis)


def _kind_of(laboratory: Laboratory, effect: Effect) -> str | None:
    """The quantity that an effect changes, if nothing else and all along the rod."""
    if not isinstance(effect, Described):
        fields = changed_by(laboratory, [effect])
        for kind in _QUANTITIES:
            first, *others = KINDS[kind].fields
            if first in fields <= {first, *others}:
                return kind
    return None


def _with_profile(
    laboratory: Laboratory, current: Fit, place: int, kind: str
) -> tuple[Fit | None, float]:
    """(the model with a profile about one of its effects, log evidence of that [nats]); None where
    the residual asks for no profile."""
    trials, width = laboratory.measurements.train, KINDS[kind].width
    own = np.array([p.scale for p in current.model.parameters])
    seen, rates = laboratory.jacobian(
        current.model.extended(Knots((kind,))),
        np.concatenate([current.values, np.zeros(width * KNOTS)]),
    )
    residual = laboratory.whiten((laboratory.target - seen)[trials], trials).ravel()
    columns = laboratory.whiten(rates[trials], trials).reshape(residual.size, -1)
    theirs, mine = columns[:, : len(own)] * own, columns[:, len(own) :]
    # The effects' own parameters follow.
    inner = theirs.T @ theirs + np.eye(len(own))
    free = mine - theirs @ np.linalg.solve(inner, theirs.T @ mine)
    found = likeliest(kind, width, mine.T @ free, free.T @ residual)
    if found.evidence <= 0.0 or not found.basis.size:
        return None, 0.0
    effects, parts = list(current.model.effects), current.model.split(current.values)
    effects[place] = ProfileEffect(kind, found.basis, effects[place])
    parts[place] = np.concatenate([parts[place], np.zeros(found.basis.shape[2])])
    rich = fit_models(
        laboratory, [Model(tuple(effects))], [np.concatenate(parts)], origin=current, race=False
    )[0]
    return (rich if np.isfinite(rich.chi_squared) else None), found.evidence


def _weighed(laboratory: Laboratory, poor: Fit, rich: Fit, evidence: float) -> tuple[Round, float]:
    """(the step from one model to the other, RMS of markers held out with it)."""
    ahead, reason = np.inf, ""
    if evidence < _EVIDENCE:
        reason = f"the log evidence of a profile is {evidence:.1f}, less than {_EVIDENCE:g}"
    else:
        try:
            (_, squares), (ahead, better) = (held_out_error(laboratory, f) for f in (poor, rich))
            gain, error = unseen_gain(laboratory, rich, poor)
            if better >= squares:
                reason = "trials held out get worse"
            elif gain < max(UNSEEN_GAIN, error):
                reason = f"takes {gain:.1f} ± {error:.1f} squares from unseen trials, too few"
        except DataError:
            reason = "a trial held out has no equilibrium with it"
    said = reason or (
        f"the log evidence of a profile is {evidence:.1f}, held-out error {1e3 * ahead:.3f} mm"
    )
    accepted, stays = (None, "another law along the rod") if reason else (rich.model.names, "")
    return Round(poor.model.names, rich, [rich], [evidence], accepted, said, stays), float(ahead)
