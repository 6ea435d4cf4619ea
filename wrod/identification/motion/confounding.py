"""Which effects of a model of motion the recordings cannot tell apart."""

import numpy as np

from wrod.identification.effect import Effect, Model

CONFOUNDED = 0.9


def start_of(effect: Effect) -> np.ndarray:
    """Where fits of an effect start: at zero, or where it says if zero is blind to a part of it."""
    if any(p.anywhere for p in effect.parameters):
        return effect.starts(None)[0]
    return np.zeros(len(effect.parameters))


def correlations_of(rod, windows, model, values, left) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and (E, E) largest canonical correlations between effects' parameters."""
    everything = Model((*model.effects, *left))
    at = rod.linearise(windows, everything, np.concatenate([values, *(start_of(e) for e in left)]))
    names = everything.names
    parts = np.split(
        np.arange(len(at.gradient)), np.cumsum([len(e.parameters) for e in everything.effects])
    )[:-1]
    chosen = len(model.effects)
    own = np.concatenate(parts[:chosen])
    out = np.eye(len(names))

    def between(covariance, a, b):
        whiten_a, whiten_b = (
            np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(i, i)])) for i in (a, b)
        )
        return np.linalg.norm(whiten_a @ covariance[np.ix_(a, b)] @ whiten_b.T, 2)

    for j in range(len(names)):
        # An effect that was left out joins the chosen ones alone.
        index = own if j < chosen else np.concatenate([own, parts[j]])
        place = {int(p): k for k, p in enumerate(index)}
        covariance = np.linalg.inv(at.hessian[np.ix_(index, index)])
        for i in range(min(j, chosen)):
            a, b = ([place[int(p)] for p in parts[k]] for k in (i, j))
            out[i, j] = out[j, i] = between(covariance, a, b)
    return names, out


def confounded_pairs(names, correlation, chosen) -> tuple[dict, ...]:
    pairs = []
    for i in range(chosen):
        for j in range(i + 1, len(names)):
            if correlation[i, j] >= CONFOUNDED:
                what = "" if j < chosen else f"; {names[j]} was left out"
                pairs.append(
                    {
                        "effects": [names[i], names[j]],
                        "correlation": float(correlation[i, j]),
                        "evidence": f"correlation of the estimates {correlation[i, j]:.2f}{what}",
                    }
                )
    return tuple(sorted(pairs, key=lambda p: -p["correlation"]))
