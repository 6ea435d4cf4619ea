"""What a linearised model of motion says of effects: what they promise to take away, what it would
lose without them, and which of them the recordings cannot tell apart."""

import numpy as np

from wrod.identification.effect import Effect, Model

CONFOUNDED = 0.9
# Share of a parameter's own curvature below which what no recording tells is taken for round-off.
_TOLD = 1e-9


def start_of(effect: Effect) -> np.ndarray:
    """Where fits of an effect start: at zero, or where it says if zero is blind to a part of it."""
    if any(p.anywhere for p in effect.parameters):
        return effect.starts(None)[0]
    return np.zeros(len(effect.parameters))


def linearised_beside(rod, windows, model: Model, values: np.ndarray, left: list[Effect]):
    """The problem linearised by a model's parameters, and by those and each other effect's.

    Effects that start from nothing leave the model where it is, and share a run. One that starts
    from something moves it, so it has its own: two laws of bending that start at once are neither.

    Args:
        left: effects that are not in the model.

    Returns:
        `Linearised` of the model, and one for each effect of `left`.
    """
    starts = [start_of(e) for e in left]
    still = [k for k, start in enumerate(starts) if not start.any()]
    own = np.arange(len(values))
    together = Model((*model.effects, *(left[k] for k in still)))
    shared = rod.linearise(windows, together, np.concatenate([values, *(starts[k] for k in still)]))
    parts, first = {}, len(values)
    for k in still:
        parts[k] = shared.part(np.r_[own, np.arange(first, first + len(starts[k]))])
        first += len(starts[k])
    for k in range(len(left)):
        if k not in parts:
            moved = np.concatenate([values, starts[k]])
            parts[k] = rod.linearise(windows, model.extended(left[k]), moved)
    return shared.part(own), [parts[k] for k in range(len(left))]


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


def _root(hessian: np.ndarray) -> np.ndarray:
    """(P, P) of which the columns' products are the covariance of parameters, each in units of its
    own: correlations have none."""
    size = np.sqrt(np.diag(hessian))
    told = hessian / np.outer(size, size) + _TOLD * np.eye(len(size))
    return np.linalg.inv(np.linalg.cholesky(told))


def correlations_of(rod, windows, model, values, left) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and (E, E) largest canonical correlations between effects' parameters."""
    now, beside = linearised_beside(rod, windows, model, values, left)
    chosen = len(model.effects)
    names = (*model.names, *(e.name for e in left))
    parts = model.split(np.arange(len(values)))
    out = np.eye(len(names))

    def between(root, a, b):
        white_a, white_b = (np.linalg.qr(root[:, i])[0] for i in (a, b))
        return np.linalg.norm(white_a.T @ white_b, 2)

    for j in range(len(names)):
        # An effect that was left out joins the chosen ones alone.
        at = now if j < chosen else beside[j - chosen]
        last = parts[j] if j < chosen else np.arange(len(values), len(at.gradient))
        root = _root(at.hessian)
        for i in range(min(j, chosen)):
            out[i, j] = out[j, i] = between(root, parts[i], last)
    return names, out


def confounded_pairs(names, correlation, chosen) -> tuple[dict, ...]:
    pairs = [
        {
            "effects": [names[i], names[j]],
            "correlation": float(correlation[i, j]),
            "evidence": f"correlation of the estimates {correlation[i, j]:.2f}"
            + ("" if j < chosen else f"; {names[j]} was left out"),
        }
        for i in range(chosen)
        for j in range(i + 1, len(names))
        if correlation[i, j] >= CONFOUNDED
    ]
    return tuple(sorted(pairs, key=lambda p: -p["correlation"]))
