"""Plans that know the table: the grip's path is corrected until what stays lies on the pattern.

Optimal grasps say where the grip is to be if the laid part does not move. On a table of friction
0.2 to 0.6 it does: where the pattern bends, the rod slides as it touches down. The path has freedom
to spare, and this module uses it. Gauss-Newton with the derivatives of whole deployments
(`wrod.deployment.tangents`) finds smooth corrections of the grip's poses with which a sample of
rods and tables lie on the pattern, on average and at their worst.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wrod.deployment.corrections import Corrections
from wrod.deployment.expectation import (
    COARSE,
    COARSE_EDGE,
    FINE,
    FINE_EDGE,
    TOLERANCE,
    edged,
    expect_each,
    is_better,
    misplacement,
)
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.simulate import Trial
from wrod.deployment.spread import Spread
from wrod.deployment.tangents import Directions, Laid, lay
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel

# Cost of a correction of 1 L_gb along the whole path, and of its second differences, over that of
# an error of 1 L_gb.
_SIZE, _ROUGHNESS = 6e-3, 2e-2
# Largest change of a correction in one iteration [L_gb], what is left of it after a change for the
# worse, and where that ends.
_STEP, _SHORTER, _SHORTEST = 0.35, 0.4, 0.01
# Times that the sample is laid at most, on coarse meshes and then on fine ones.
_COARSE_ITERATIONS, _FINE_ITERATIONS = 3, 3
# Ranges of friction that call for more rods, by the largest over the least.
_WIDE = 1.5
# A saving of the sample [m] that nobody doubts.
_PLAIN = 1e-3
# An iteration that leaves more than this part of the error is the last.
_DONE = 0.95


def optimise(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | Spread,
    *,
    samples: int | None = None,
    hold: float = 0.05,
    judge: bool = True,
    device: str | None = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Correct a trajectory's positions until what stays on the table lies on the pattern.

    Rods that cover the spread of friction, L_gb and natural curvature are laid together with their
    derivatives by smooth displacements of the grip; a Gauss-Newton step, limited in size, reduces
    their squared errors, the worse ones weighing more, and what the corrections cost in size and
    roughness. A step that makes it worse is taken back and shortened. First they are laid on coarse
    meshes, then on fine ones. Then disturbed rods that none of this has seen are laid: what they
    show is what is expected of the plan. Where the sample is better by less than 1 mm, they are
    laid without the correction as well, which is kept if they lie better with it by twice the
    standard error of the differences.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: what is laid.
        trajectory: to start from, as `wrod.plan` returns it.
        friction: a coefficient, known to a tenth, a range, or a `Spread`.
        samples: rods that are laid at a time; None: two, or four for a range that is wide.
        hold: length of the free end that is held at first [m].
        judge: whether to lay the unseen rods, without which nothing is expected of the plan and
            every correction is kept.
        device: "cpu", "cuda:0" or "auto".
        progress: called with the fraction done since the last call.

    Returns:
        The corrected trajectory. `metadata["optimised"]` holds the range of friction, the mean
        error of the sample at each iteration [m], whether the correction was "kept", and the
        largest correction [m]; `metadata["expected"]` is what `expect` says.

    Raises:
        PatternError: friction is not usable, or the trajectory is too short to be laid.
    """
    spread, lgb = Spread.of(friction), rod.gravito_bending_length
    if samples is None:
        samples = 4 if spread.friction[1] > _WIDE * spread.friction[0] else 2
    corrections = Corrections(pattern, trajectory, lgb, hold)
    problem = _Problem(pattern, rod, corrections, spread, samples, hold, device)
    rounds = (
        (edged(COARSE, COARSE_EDGE * lgb), _COARSE_ITERATIONS),
        (edged(FINE, FINE_EDGE * lgb), _FINE_ITERATIONS),
    )
    done = _share_of(sum(count for _, count in rounds) + 2, progress)
    x, history = np.zeros(3 * corrections.count), []
    for how, count in rounds:
        best = problem.at(how, x)
        history.append(float(best.errors.mean()))
        best = _descend(best, partial(problem.at, how), count - 1, history)
        x, left = best.values, float(best.errors.mean())
        done(count)
    corrected = corrections.apply(x)
    plain = history[0] - left > _PLAIN
    expected, kept = None, True
    if judge:
        other = None if plain else trajectory
        how = {"hold": hold, "device": device}
        expected, kept = _judged(pattern, rod, corrected, other, spread, **how)
        if not kept:
            corrected, x = corrections.apply(0.0 * x), 0.0 * x
    done(2)
    said = {
        "friction": list(spread.friction),
        "iterations": len(history),
        "errors": history,
        "kept": kept,
        "largest_correction": float(lgb * np.abs(corrections.basis @ x.reshape(-1, 3)).max()),
    }
    metadata = {**corrected.metadata, "optimised": said, "expected": expected}
    return replace(corrected, metadata=metadata)


def _share_of(most: int, progress: Callable[[float], None] | None) -> Callable[[int], None]:
    """What tells the share of `most` things that a count of them is."""

    def done(count: int) -> None:
        if progress is not None:
            progress(count / most)

    return done


def _judged(pattern, rod, corrected, other, spread: Spread, **how) -> tuple[dict, bool]:
    """What is expected of the better plan, and whether that is the corrected one; None for the
    other keeps it."""
    candidates = [corrected] if other is None else [corrected, other]
    expected, *others = expect_each(pattern, rod, candidates, spread, **how)
    kept = not others or is_better(expected, others[0])
    return expected if kept else others[0], kept


@dataclass(frozen=True)
class _State:
    """What corrections `values` come to: mean errors (rod,) [m], their measure, and the matrix and
    the slope of its quadratic model."""

    values: np.ndarray
    errors: np.ndarray
    measure: float
    matrix: np.ndarray
    slope: np.ndarray


class _Problem:
    """The squared errors of a sample of rods, and what corrections cost, near some corrections."""

    def __init__(self, pattern, rod, corrections: Corrections, spread, samples, hold, device):
        self.pattern, self.rod, self.corrections = pattern, rod, corrections
        self.spread, self.samples = spread, samples
        self.options = {"hold": hold, "device": device}
        self.cost = corrections.cost(_SIZE, _ROUGHNESS)

    def at(self, how: dict, values: np.ndarray) -> _State:
        laid = laid_sample(
            self.pattern, self.rod, self.corrections, self.spread, values,
            samples=self.samples, **self.options, **how,
        )  # fmt: skip
        parts = [misplacement(self.pattern, one) for one in laid]
        errors = np.array([np.hypot(*e.reshape(2, -1)).mean() for e, _ in parts])
        errors[[one.diverged for one in laid]] = np.inf
        matrix, slope = self.cost.copy(), self.cost @ values
        if np.isfinite(errors).all():
            weights = 0.5 + 0.5 * errors / max(errors.mean(), 1e-12)
            for (error, rates), weight in zip(parts, weights, strict=True):
                scale = weight / (len(parts) * METRIC_POINTS * self.corrections.lgb**2)
                matrix += scale * rates.T @ rates
                slope += scale * rates.T @ error
        return _State(values, errors, 0.5 * float(errors.mean() + errors.max()), matrix, slope)


def laid_sample(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
    corrections: Corrections,
    spread: Spread,
    values: np.ndarray,
    *,
    samples: int = 2,
    hold: float = 0.05,
    device: str | None = "cpu",
    **how,
) -> list[Laid]:
    """The rods that cover a spread, laid by a corrected path, with their derivatives by each of the
    corrections' values (3 count,) [L_gb]; `how` as for `lay`, by default on coarse meshes."""
    now = corrections.apply(values)
    rest = tail(pattern, rod, now)
    return lay(
        [
            Trial(pattern, held, now, law, told, rest)
            for held, law, told in spread.sample(samples, rod)
        ],
        [Directions.of_path(corrections.columns())] * samples,
        hold=hold,
        device=device,
        tolerance=TOLERANCE,
        **(how or edged(COARSE, COARSE_EDGE * rod.gravito_bending_length)),
    )


def _descend(
    best: _State, at: Callable[[np.ndarray], _State], count: int, history: list[float]
) -> _State:
    """The best of so many steps from there; `history` gets their mean errors."""
    radius = _STEP
    for _ in range(count):
        step = -np.linalg.solve(best.matrix, best.slope)
        length = float(np.abs(step).max())
        tried = at(best.values + step * min(1.0, radius / max(length, 1e-12)))
        history.append(float(tried.errors.mean()))
        if tried.measure < best.measure:
            enough = tried.measure > _DONE * best.measure
            best = tried
            if enough:
                break
        else:
            radius = _SHORTER * min(radius, length)
            if not radius > _SHORTEST:
                break
    return best
