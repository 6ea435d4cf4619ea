"""Whether a quantity that was found changes along the rod as its effect says, and what may be else.

An effect has a law along the rod: a constant, a straight line. One that is nearly the rod's reaches
the noise floor and stands for a law that is another one, with numbers that are wrong by many of
their standard errors. So beside every effect of natural curvature, stiffness or weight that was
chosen stands a profile of the same quantity, a Gaussian process of unknown size and smoothness.
What it has of evidence is marginal over both, by the noise that the richer model leaves (what the
poorer one leaves wrong passes for noise along the rod) and on the mesh that the poorer one was
polished on (a coarser one errs like a profile). It takes the effect's place if it has the evidence
and trials that no choice has seen are likelier with it as well. If it does not, it is not out of
the world: the errors that are reported are those beside it, so large as it may be for all that the
data say.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from wrod.errors import DataError
from wrod.identification.clamped.described import Described
from wrod.identification.clamped.drift import Drift, by_another_law
from wrod.identification.clamped.fit import Fit, fit_models
from wrod.identification.clamped.held_out import held_out_error
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.memory import Memory
from wrod.identification.clamped.noise import estimate
from wrod.identification.clamped.profiles import (
    KINDS,
    KNOTS,
    Found,
    ProfileEffect,
    as_basis,
    likeliest,
    root_of,
    told,
)
from wrod.identification.clamped.steps import has_profile, pruned, reordered
from wrod.identification.clamped.verdict import Round, changed_by
from wrod.identification.effect import Effect, Estimate, Model

# Kinds of profiles that effects have a law of.
_QUANTITIES = ("curvature", "stiffness", "weight")
# Log evidence of all trials from which a profile is likelier than the law, twenty to one [nats].
EVIDENCE = 3.0
# How often at most the profile is built with the noise beside it and from where it is then, and by
# how much its evidence changes where that need not be repeated [nats].
_PASSES, _SETTLED = 5, 1.0
# What a rod has beside its law is about as large as this share of what it has by it, or any other
# size: a half-Cauchy prior, on so many sizes in units of the latter.
_SHARE = 0.5
_SIZES = np.geomspace(0.01, 10.0, 19)
# Correlation lengths, over the free length.
_SMOOTH = np.array([0.12, 0.25, 0.5, 1.0])
# Knots that the report of a law tells.
_TOLD = np.arange(0, KNOTS, (KNOTS - 1) // 4)


@dataclass(frozen=True)
class _Beside:
    """A residual as a profile beside the effect at one place of a model, to first order; everything
    else of the model follows.

    Attributes:
        law, values: what the profile is about, None for the base model, and its parameters.
        present: (KNOTS * width,) the profile that the model has already.
        grams, projected: of the knots and with the residual, of the train trials and of all.
        size: of what the model has of the quantity, at most.
    """

    kind: str
    law: Effect | None
    values: np.ndarray
    present: np.ndarray
    grams: list[np.ndarray]
    projected: list[np.ndarray]
    size: float


def refined(
    laboratory: Laboratory,
    current: Fit,
    rounds: list[Round],
    held_out: tuple[float, float],
    profiles: bool = True,
) -> tuple[Fit, tuple[float, float], dict[int, Fit]]:
    """(model, (before, after) RMS of markers held out, by place what else it may be): a chosen
    model, with a profile in place of an effect whose law along the rod is not its own; what was
    weighed joins `rounds`.

    With a profile in it, the laboratory's noise is what that model leaves. What else a model may be
    is one with a profile about the effect at that place or with another law of what drifts, or one
    with an effect more, behind the last place, that was not sure enough to name: for `in_doubt`.

    Args:
        profiles: whether to weigh profiles at all.
    """
    declared, doubts = (laboratory.noise, laboratory.scatter_rates), {}
    there = has_profile(current.model)
    for place, effect in enumerate(current.model.effects if profiles else ()):
        kind = _kind_of(laboratory, effect)
        if kind is None or (there and not isinstance(effect, ProfileEffect)):
            continue
        poor, rich, before = current, None, np.inf
        for _ in range(_PASSES):
            rich, evidence, ahead = with_profile(laboratory, rich or poor, place, kind)
            if rich is None:
                break
            noise, rates = estimate(laboratory, rich.model, rich.values)
            if noise.near(laboratory.noise) and abs(evidence - before) < _SETTLED:
                break
            laboratory.set_noise(noise, rates)
            before = evidence
        if rich is not None and there:
            return _polished(laboratory, rich), held_out, {}
        if rich is not None:
            step, error = _weighed(laboratory, poor, rich, (evidence, ahead), place)
            rounds.append(step)
            if step.accepted:
                # What mended the law's form is needed no more.
                rich = pruned(laboratory, rich, [rich.model.effects[place]])
                return _polished(laboratory, rich), (held_out[0], error), {}
            doubts[place] = rich
        laboratory.set_noise(*declared)
    for place, effect in enumerate(current.model.effects):
        if isinstance(effect, Drift):
            for other in by_another_law(laboratory, current):
                if other.chi_squared < current.chi_squared + 2.0 * EVIDENCE:
                    doubts[place] = other
    return current, held_out, doubts | _refused(laboratory, current, rounds)


def _refused(laboratory: Laboratory, final: Fit, rounds: list[Round]) -> dict[int, Fit]:
    """By the place behind the last, the model with one effect more that was not sure enough to
    name (`acceptance`); nothing where there is none."""
    own, place = final.model.effects, len(final.model.effects)
    for step in reversed(rounds):
        effects = step.best.model.effects
        if step.stays and len(effects) == place + 1 and set(own) < set(effects):
            rest = [k for k, e in enumerate(effects) if e not in own]
            rich = reordered(step.best, [*(effects.index(e) for e in own), *rest])
            again = fit_models(laboratory, [rich.model], [rich.values], origin=rich, race=False)
            return {place: again[0]} if np.isfinite(again[0].chi_squared) else {}
    return {}


def in_doubt(fit: Fit, place: int, doubts: dict[int, Fit], measurements) -> dict[str, Estimate]:
    """What to report of the effect at one place of a model, of which some may be profiles as well.

    Parameters of an effect whose law along the rod may be another one are those of what the rod has
    at the ends, if they are as many as a straight line's, or else of what comes nearest along the
    rod. Errors are root mean squares about the values, over all that the rod may have by the data;
    so are those of some places, about the likeliest there.

    Args:
        doubts: of `refined`.
    """
    effect, own = fit.model.effects[place], fit.model.split(np.arange(len(fit.values)))[place]
    values, covariance = fit.values[own], fit.covariance[np.ix_(own, own)]
    if place in doubts and isinstance(doubts[place].model.effects[place], ProfileEffect):
        return _told_in_doubt(effect, values, doubts[place], place, measurements)
    for rich in doubts.values():
        there = rich.model.split(np.arange(len(rich.values)))[place]
        away = rich.values[there] - values
        beside = rich.covariance[np.ix_(there, there)] + np.outer(away, away)
        covariance = max(covariance, beside, key=np.trace)
    return effect.describe(values, covariance, measurements)


def _told_in_doubt(effect: Effect, values, rich: Fit, place: int, measurements):
    """`in_doubt` of an effect that may be a profile, as in the model `rich`."""
    profile, own = rich.model.effects[place], rich.model.split(np.arange(len(rich.values)))[place]
    assert isinstance(profile, ProfileEffect)
    found, covariance = rich.values[own], rich.covariance[np.ix_(own, own)]
    there, rates = told(profile.kind, profile, found, measurements)
    by_law, own_rates = told(profile.kind, effect, values, measurements)
    rows = slice(None)
    if len(values) == 2 * by_law.shape[1] and not np.allclose(own_rates[0], own_rates[-1]):
        rows = np.array([0, -1])
    back = np.linalg.pinv(own_rates[rows].reshape(-1, len(values)))
    rates, away = rates[rows].reshape(-1, len(found)), (there - by_law)[rows].ravel()
    moments = back @ (rates @ covariance @ rates.T + np.outer(away, away)) @ back.T
    return effect.describe(values, moments, measurements) | profile.describe(
        found, covariance, measurements, _TOLD
    )


def profile_of(laboratory: Laboratory, singles: Sequence[Fit], found: Found) -> ProfileEffect:
    """A profile that was found about the base model as an effect.

    Args:
        singles: effects alone, best first. What one of them leaves is nearer to linear: the first
            one of the same quantity is what the profile is about, where it asks for one.
    """
    for law in singles:
        if _kind_of(laboratory, law.model.effects[0]) == found.kind:
            own = _beside(laboratory, law, 0, found.kind)
            again = likeliest(found.kind, KINDS[found.kind].width, own.grams[0], own.projected[0])
            if again.evidence <= 0.0 or not again.basis.size:
                break
            rich = _fitted(laboratory, law, 0, own, again.basis)
            if rich is None:
                break
            return ProfileEffect(found.kind, again.basis, own.law, rich.values)
    return ProfileEffect(found.kind, found.basis)


def _kind_of(laboratory: Laboratory, effect: Effect) -> str | None:
    """The quantity that an effect changes, if nothing else, all along the rod and in every trial
    alike."""
    if isinstance(effect, ProfileEffect):
        return effect.kind
    if not isinstance(effect, (Described, Drift, Memory)):
        fields = changed_by(laboratory, [effect])
        for kind in _QUANTITIES:
            first, *others = KINDS[kind].fields
            if first in fields <= {first, *others}:
                return kind
    return None


def _beside(laboratory: Laboratory, fit: Fit, place: int, kind: str) -> _Beside:
    m, width = laboratory.measurements, KINDS[kind].width
    effect, parts = fit.model.effects[place], fit.model.split(fit.values)
    law: Effect | None = effect
    values, present = parts[place], np.zeros(width * KNOTS)
    size = np.linalg.norm(told(kind, effect, values, m)[0] - KINDS[kind].base, axis=1).max()
    if isinstance(effect, ProfileEffect):
        law, count = effect.about, effect.basis.shape[2]
        present = (effect.basis @ values[-count:]).T.ravel()
        values = values[:-count]
    effects = list(fit.model.effects)
    effects[place] = ProfileEffect(kind, as_basis(np.eye(width * KNOTS)), law)
    parts[place] = np.concatenate([values, present])
    model = Model(tuple(effects))
    seen, rates = laboratory.jacobian(model, np.concatenate(parts))
    first = sum(map(len, parts[:place])) + len(values)
    mine = np.arange(first, first + width * KNOTS)
    scale = np.array([p.scale for p in model.parameters])
    grams, projected = [], []
    for trials in (m.train, np.concatenate([m.train, m.test])):
        residual = laboratory.whiten((laboratory.target - seen)[trials], trials).ravel()
        columns = laboratory.whiten(rates[trials], trials).reshape(residual.size, -1)
        knots, theirs = columns[:, mine], np.delete(columns * scale, mine, axis=1)
        # Whatever else the model has follows.
        inner = theirs.T @ theirs + np.eye(theirs.shape[1])
        free = knots - theirs @ np.linalg.solve(inner, theirs.T @ knots)
        grams.append(knots.T @ free)
        projected.append(free.T @ residual + grams[-1] @ present)
    return _Beside(kind, law, values, present, grams, projected, float(size))


def _likenesses() -> list[np.ndarray]:
    """(KNOTS, KNOTS) covariances of profiles 1 large, of each smoothness: Matern's with one
    derivative, for rods have kinks that smoother ones would bend with errors that are too small."""
    place = np.linspace(0.0, 1.0, KNOTS)
    apart = np.sqrt(3.0) * np.abs(place[:, None] - place) / _SMOOTH[:, None, None]
    return list((1.0 + apart) * np.exp(-apart))


def _hypotheses(own: _Beside, gram, projected) -> tuple[np.ndarray, list[np.ndarray]]:
    """((H,) log of evidence times prior, over that of no profile; (KNOTS, KNOTS) prior covariances)
    of every size and smoothness."""
    width, smooth = KINDS[own.kind].width, _likenesses()
    prior = _SIZES / (1.0 + (_SIZES / _SHARE) ** 2)
    prior = np.log(prior / prior.sum() / len(smooth))
    found, known = [], []
    for like in smooth:
        root = root_of(like, width)
        small, modes = np.linalg.eigh(root.T @ gram @ root)
        towards = modes.T @ (root.T @ projected)
        for size, chance in zip(own.size * _SIZES, prior, strict=True):
            grown = size**2 * np.maximum(small, 0.0)
            taken = towards**2 * size**2 / (1.0 + grown)
            found.append(0.5 * taken.sum() - 0.5 * np.log1p(grown).sum() + chance)
            known.append(size**2 * like)
    return np.array(found), known


def _expected(own: _Beside) -> tuple[np.ndarray, float, float]:
    """((KNOTS, KNOTS) mean prior covariance of all profiles that the train trials leave possible,
    log evidence of a profile, by how much the log likelihood of trials ahead is higher with it)."""
    (train, known), (both, _) = (
        _hypotheses(own, g, p) for g, p in zip(own.grams, own.projected, strict=True)
    )
    evidence = logsumexp(train)
    like = np.einsum("h,hij->ij", np.exp(train - evidence), known)
    return like, float(evidence), float(logsumexp(both) - evidence)


def evidence_of_form(laboratory: Laboratory, fit: Fit, place: int) -> float:
    """Log evidence that the quantity of the effect at a place of a model changes along the rod by
    another law; none where it has no such quantity."""
    kind = _kind_of(laboratory, fit.model.effects[place])
    if kind is None:
        return -np.inf
    return _expected(_beside(laboratory, fit, place, kind))[1]


def with_profile(
    laboratory: Laboratory, current: Fit, place: int, kind: str
) -> tuple[Fit | None, float, float]:
    """(the model with a profile about one of its effects, None where it has no equilibrium; log
    evidence of that, and of the trials ahead, as of `_expected`)."""
    own = _beside(laboratory, current, place, kind)
    like, evidence, ahead = _expected(own)
    basis = as_basis(root_of(like, KINDS[kind].width))
    return _fitted(laboratory, current, place, own, basis), evidence, ahead


def _fitted(laboratory, current: Fit, place: int, own: _Beside, basis: np.ndarray) -> Fit | None:
    """The model with a profile of these components at the place; None without an equilibrium."""
    effects, parts = list(current.model.effects), current.model.split(current.values)
    effects[place] = ProfileEffect(own.kind, basis, own.law)
    start = np.linalg.lstsq(np.moveaxis(basis, 1, 0).reshape(-1, basis.shape[2]), own.present)[0]
    parts[place] = np.concatenate([own.values, start])
    rich = fit_models(
        laboratory, [Model(tuple(effects))], [np.concatenate(parts)], origin=current, race=False
    )[0]
    return rich if np.isfinite(rich.chi_squared) else None


def _polished(laboratory: Laboratory, fit: Fit) -> Fit:
    """Fitted again with the mesh's correction where the model is now."""
    laboratory.refine(fit.model, fit.values)
    return fit_models(laboratory, [fit.model], [fit.values], origin=fit, race=False)[0]


def _weighed(laboratory: Laboratory, poor: Fit, rich: Fit, log_odds, place) -> tuple[Round, float]:
    """(the step from one model to the other, RMS of markers held out with it)."""
    (seen, ahead), error, reason = log_odds, np.inf, ""
    evidence = seen + ahead
    if evidence < EVIDENCE:
        reason = f"the log evidence of a profile is {evidence:.1f}, less than {EVIDENCE:g}"
    elif ahead < 0.0:
        reason = f"unseen trials are less likely with a profile, by {-ahead:.1f} nats"
    else:
        try:
            error = held_out_error(laboratory, rich).rms
        except DataError:
            reason = "a trial held out has no equilibrium with it"
    said = f"the log evidence of a profile is {evidence:.1f}, held-out error {1e3 * error:.3f} mm"
    accepted, stays = None if reason else rich.model.names, ""
    if reason and evidence > -EVIDENCE:
        stays = rich.model.effects[place].name
    step = Round(poor.model.names, rich, [rich], [evidence], accepted, reason or said, stays)
    return step, float(error)
