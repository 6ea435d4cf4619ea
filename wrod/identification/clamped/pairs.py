"""Pairs of effects that may act together, found by linear superposition about the base model.

One effect at a time, a selection can be led astray: the best single effect may stand for a pair of
others. Every effect is linearised once, at each of its starts; all pairs are then small least
squares problems, and the likeliest ones deserve a fit.
"""

from dataclasses import dataclass

import numpy as np

from wrod.identification.clamped.equilibria import ClampedSolver
from wrod.identification.clamped.fit import of_trials_with_rates, solved
from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.effect import Effect, Model


@dataclass
class _Linear:
    """One effect about one of its starts, in units of the noise and of the priors."""

    effect: Effect
    start: np.ndarray
    columns: slice
    shift: np.ndarray


def likely_pairs(
    laboratory: Laboratory, candidates: list[Effect], count: int
) -> list[tuple[Model, np.ndarray]]:
    """The `count` pairs of lowest linearised BIC, each with values to start from."""
    m = laboratory.measurements
    base = laboratory.observe(Model(), np.zeros(0), trials=m.train)
    residual = laboratory.whiten(laboratory.target[m.train] - base, m.train).ravel()
    readings = laboratory.effective[m.train].sum()
    parts, blocks, first = [], [], 0
    # A wind is iterated over its whole batch.
    for group in ([e for e in candidates if e.follows_shape == windy] for windy in (False, True)):
        for effect, start, seen, rates in _linearised(laboratory, group):
            scale = np.array([p.scale for p in effect.parameters])
            rates = of_trials_with_rates(rates)
            blocks.append((laboratory.whiten(rates, m.train) * scale).reshape(residual.size, -1))
            columns = slice(first, first + len(start))
            first += len(start)
            shift = laboratory.whiten(seen - base, m.train).ravel()
            parts.append(_Linear(effect, start, columns, shift))
    jacobian = np.concatenate(blocks, axis=1)
    gram = jacobian.T @ jacobian
    found: dict[tuple[str, str], tuple[float, Model, np.ndarray]] = {}
    for i, a in enumerate(parts):
        for b in parts[i + 1 :]:
            if a.effect is b.effect:
                continue
            left = residual - a.shift - b.shift
            columns = np.r_[a.columns, b.columns]
            model = Model((a.effect, b.effect))
            start = np.concatenate([a.start, b.start])
            prior = (start - model.prior_mean(start)) / np.array(
                [p.scale for p in model.parameters]
            )
            matrix = gram[np.ix_(columns, columns)] + np.eye(len(columns))
            rhs = jacobian[:, columns].T @ left - prior
            cost = left @ left + prior @ prior - rhs @ solved(matrix, rhs)
            cost += len(start) * np.log(readings)
            key = (a.effect.name, b.effect.name)
            if key not in found or cost < found[key][0]:
                found[key] = (float(cost), model, start)
    ranked = sorted(found.values(), key=lambda entry: entry[0])
    return [(model, start) for _, model, start in ranked[:count]]


def _linearised(laboratory: Laboratory, group: list[Effect]):
    """(effect, start, readings there, their derivatives) of every start with an equilibrium."""
    m = laboratory.measurements
    chosen = [(e, start) for e in group for start in e.starts(m)]
    if not chosen:
        return
    models, starts = [Model((e,)) for e, _ in chosen], [start for _, start in chosen]
    base = ClampedSetup.base(m, m.train, laboratory.edge_count)
    state = tuple(a[m.train] for a in laboratory.base_state)
    solver = ClampedSolver([base] * len(chosen), device=laboratory.device, start=state)
    setups = [model.setup(base, start) for model, start in zip(models, starts, strict=True)]
    reached = np.all(solver.solve(setups), axis=1)
    prediction = solver.predict(setups)
    rates = laboratory.rates(solver, models, starts, base)
    for c, (effect, start) in enumerate(chosen):
        if reached[c]:
            seen = laboratory.observed(models[c], start, setups[c], prediction, c).real
            yield effect, start, seen + laboratory.mesh_correction[m.train], rates[c]
