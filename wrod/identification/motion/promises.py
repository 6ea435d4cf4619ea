"""What effects promise to take away, and what a model would lose without one, if it were linear."""

import numpy as np

from wrod.identification.effect import Model
from wrod.identification.motion.confounding import start_of


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
    """[(promise, effect, start values, indices)] of every candidate, best first, and the problem
    linearised by the parameters of all, of which the indices are those of the extended model."""
    start = [start_of(e) for e in left]
    everything = Model((*model.effects, *left))
    rod.misfit = None
    at = rod.linearise(windows, everything, np.concatenate([values, *start]))

    def gain(index):
        h = at.hessian[np.ix_(index, index)] * (1.0 + 1e-6 * np.eye(len(index)))
        return 0.5 * at.gradient[index] @ np.linalg.solve(h, at.gradient[index])

    own = np.arange(len(values))
    known, first, out = gain(own), len(values), []
    for effect, zero in zip(left, start, strict=True):
        index = np.r_[own, np.arange(first, first + len(zero))]
        first += len(zero)
        promise = (gain(index) - known) / at.cost
        out.append((float(promise), effect, zero, index))
    return sorted(out, key=lambda o: -o[0]), at
