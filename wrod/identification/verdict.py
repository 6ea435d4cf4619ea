"""The verdict on a chosen model, and what these data cannot tell apart."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wrod.identification.effect import Model
from wrod.identification.fit import Fit
from wrod.identification.laboratory import Laboratory

BIC_MARGIN = 10.0
AT_NOISE = 1.1
PARTLY = 0.9
_CORRELATED = 0.95


@dataclass
class Round:
    """One step of the selection: every candidate for the next model, best first."""

    current: tuple[str, ...]
    best: Fit
    fits: list[Fit]
    gains: list[float]
    accepted: tuple[str, ...] | None
    reason: str


@dataclass
class Selection:
    """What was chosen and why.

    Attributes:
        verdict: adequate, explained, partly-explained or unexplained.
        fit: the chosen model, polished on a finer mesh.
        rounds: the steps that led there.
        cross_validation: (before, after) RMS of held-out marker errors [m] of the chosen model.
        confounded: pairs of names that these data cannot tell apart, with the evidence.
        ranking: every effect alone on the base model, best first.
        leading: the chosen model even where the verdict names no effect.
    """

    verdict: str
    reason: str
    fit: Fit
    leading: Fit
    ranking: list[Fit]
    rounds: list[Round]
    base_chi_squared: float
    cross_validation: tuple[float, float]
    confounded: list[dict] = field(default_factory=list)


def judge(
    laboratory: Laboratory,
    fit: Fit,
    empty: Fit,
    rounds: list[Round],
    cross_validation: tuple[float, float],
) -> Selection:
    """The verdict on a chosen model.

    Args:
        fit: the chosen model; empty: the base model as a fit, both on the laboratory's mesh.
        rounds: the steps that led there.
        cross_validation: (before, after) RMS of held-out marker errors [m].
    """
    m = laboratory.measurements
    floor = m.noise_floor
    before = m.rms(laboratory.predict(Model(), np.zeros(0)), m.test)
    after = m.rms(laboratory.predict(fit.model, fit.values), m.test)
    share = (before**2 - after**2) / max(before**2 - floor**2, 1e-300)
    if not fit.model.effects and before <= AT_NOISE * floor:
        verdict = "adequate"
        reason = f"the base model's test error is {before / floor:.2f} times the noise floor"
    elif fit.model.effects and after <= AT_NOISE * floor:
        verdict = "explained"
        reason = f"what is left on test trials is {after / floor:.2f} times the noise floor"
    elif fit.model.effects and share >= PARTLY:
        verdict = "partly-explained"
        reason = (
            f"{100 * share:.0f} % of the excess error is gone, but {after / floor:.2f} times the "
            "noise floor is left: the effects named may stand for one that is not known here"
        )
    else:
        verdict = "unexplained"
        reason = (
            f"no effect, nor any few together, takes {100 * PARTLY:.0f} % of the excess error; "
            f"{before / floor:.2f} times the noise floor stays"
        )
    named = empty if verdict == "unexplained" else fit
    selection = Selection(
        verdict,
        reason,
        named,
        fit,
        rounds[0].fits if rounds else [],
        rounds,
        empty.chi_squared,
        cross_validation,
    )
    selection.confounded = _confounded(fit, rounds)
    return selection


def _confounded(fit: Fit, rounds: list[Round]) -> list[dict]:
    """Rivals that the data do not rule out, and parameters that trade against each other."""
    found = []
    accepted = [step for step in rounds if step.accepted is not None]
    if accepted:
        best = accepted[-1].best
        for rival in accepted[-1].fits:
            gap = rival.bic - best.bic
            # A rival that contains the winner and adds nothing is no rival.
            empty = len(rival.values) > len(best.values) and (
                rival.chi_squared > best.chi_squared - BIC_MARGIN
            )
            own = sorted(set(best.model.names) - set(rival.model.names))
            other = sorted(set(rival.model.names) - set(best.model.names))
            if own and other and gap < BIC_MARGIN and not empty:
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
            if owner[i] != owner[j] and abs(correlation[i, j]) > _CORRELATED:
                found.append(
                    {
                        "effects": [owner[i], owner[j]],
                        "evidence": f"{keys[i]} and {keys[j]} correlate by {correlation[i, j]:.2f}",
                    }
                )
    return found
