"""What effects promise to take away, and what a model would lose without one, if it were linear."""

import numpy as np

from wrod.identification.effect import Model
from wrod.identification.motion.confounding import linearised_beside, start_of


def losses_of(rod, windows, model: Model, values: np.ndarray) -> dict[str, float]:
    """Share by which the misfit would rise without each effect, the others fitted anew."""
    at = rod.linearise(windows, model, values)
    covariance = np.linalg.inv(at.hessian)
    out = {}
    for effect, i in zip(model.effects, model.split(np.arange(len(values))), strict=True):
        rise = 0.5 * values[i] @ np.linalg.solve(covariance[np.ix_(i, i)], values[i])
        out[effect.name] = float(rise / at.cost)
    return out


def promises_of(rod, windows, model, values, left):
    """[(promise, effect, start values, problem)] of every candidate, best first: what it takes away
    in the problem linearised by the model's parameters and its own, where it starts."""
    rod.misfit = None

    def gain(at):
        h = at.hessian * (1.0 + 1e-6 * np.eye(len(at.gradient)))
        return 0.5 * at.gradient @ np.linalg.solve(h, at.gradient)

    now, parts = linearised_beside(rod, windows, model, values, left)
    known = now.cost - gain(now)
    out = [
        (float((known - (at.cost - gain(at))) / now.cost), effect, start_of(effect), at)
        for effect, at in zip(left, parts, strict=True)
    ]
    return sorted(out, key=lambda o: -o[0])
