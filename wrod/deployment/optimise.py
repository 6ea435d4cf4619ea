"""Plans that know the table: the grip's path is corrected until what stays lies on the pattern.

Optimal grasps say where the grip is to be if the laid part does not move. On a table of friction
0.2 to 0.6 it does: where the pattern bends, the rod slides as it touches down. The path has freedom
to spare, and this module uses it. Gauss-Newton with the derivatives of whole deployments
(`wrod.deployment.tangents`) finds smooth corrections of the grip's poses with which a sample of
rods and tables lie on the pattern, on average and at their worst.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from wrod.deployment.corrections import Corrections
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.expectation import (
    COARSE,
    COARSE_EDGE,
    JUDGING,
    JUDGING_EDGE,
    PACE,
    Unseen,
    balanced,
    edged,
    is_better,
    misplacement,
)
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.simulate import Trial, nodes_needed
from wrod.deployment.spread import Spread
from wrod.deployment.tangents import Directions
from wrod.deployment.together import Asked, Course, follow
from wrod.errors import PatternError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel

# Cost of a correction of 1 L_gb along the whole path, and of its second differences, over that of
# an error of 1 L_gb.
_SIZE, _ROUGHNESS = 6e-3, 2e-2
# Cost of an arm beyond its limits by all of one of them, at one pose.
_LIMIT = 1e2
# Largest change of a correction in one iteration [L_gb], what is left of it after a change for the
# worse, and where that ends; what it grows by after one that was cut to it and saved more than this
# part of what its model promised.
_STEP, _SHORTER, _SHORTEST = 0.35, 0.4, 0.01
_LONGER, _KEPT_PROMISE = 2.0, 0.5
# Steps of a plan at least, and at most: further ones where the last but one saved this part of the
# error. A step from so near [L_gb] is not laid by itself: what more steps save from there on, on
# fine meshes too, unseen rods do not feel.
_STEPS, _MORE, _SAVED, _NEAR = 2, 6, 0.2, 0.1
# Residual forces that are enough for them, see `lay`: these change what lies by 0.02 mm.
_TOLERANCE = 5e-3
# Numbers of nodes are multiples of this, so that a GPU lays many plans in few batches.
_ALIKE = 16
# Ranges of friction that call for more rods, by the largest over the least.
_WIDE = 1.5
# By which the sample has to lie better that nobody doubts it [m].
_PLAIN = 1e-3
# An iteration that leaves more than this part of the error is the last, and one that would by its
# model, of squares, is not tried.
_DONE = 0.95


@dataclass(frozen=True)
class Task:
    """A plan that is to know its table; see `optimise`."""

    pattern: Pattern
    rod: RodModel | RodMaterial
    trajectory: Trajectory
    friction: float | tuple[float, float] | Spread
    limits: Limits | None = None
    pace: float = PACE


class Limits(Protocol):
    """What the arm that is to follow a trajectory can do."""

    def excess(self, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far displacements (T, 3) [m] of its poses take the arm beyond its limits, in parts of
        these (m,), and the derivatives (m, T, 3) of that [1/m]; nothing where they do not."""
        ...


def optimise(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | Spread,
    *,
    limits: Limits | None = None,
    pace: float | tuple[float, float] = PACE,
    samples: int | None = None,
    hold: float = 0.05,
    judge: bool = True,
    device: str | None = "cpu",
) -> Trajectory:
    """Correct a trajectory's positions until what stays on the table lies on the pattern.

    Rods that cover the spread of friction, L_gb and natural curvature are laid together with their
    derivatives by smooth displacements of the grip; a Gauss-Newton step, limited in size, reduces
    their squared errors, the worse ones weighing more, and what the corrections cost in size and
    roughness. A step that makes it worse is taken back and shortened, after one that was cut and
    kept its promise the next may be twice as large. Meshes are coarse. Then disturbed rods that
    none of this has seen are laid on fine ones by each of the paths that were tried, but for those
    by which the sample lies worse by more than 1 mm. That by which they would lie best if they were
    spread evenly (`balanced`) is taken, but none rather than one that is not better than none by
    more than the standard error of the differences; what they show is what is expected of the plan.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: what is laid.
        trajectory: to start from, as `wrod.plan` returns it.
        friction: a coefficient, known to a tenth, a range, or a `Spread`.
        limits: of the arm, beyond which the path is not to be corrected; None: no arm.
        pace: at which the contact is to move [m/s], or a range: then the path is corrected for both
            of its ends and for their geometric mean, and the fastest is taken that does not lay
            unseen rods worse than the best by more than the standard error of the differences.
        samples: rods that are laid at a time; None: two, or four for a range that is wide.
        hold: length of the free end that is held at first [m].
        judge: whether to lay the unseen rods, without which nothing is expected of the plan and
            the sample decides.
        device: "cpu", "cuda:0" or "auto".

    Returns:
        The corrected trajectory. `optimised` holds the range of friction, the mean error of the
        sample before and after [m], whether a correction was "kept", the largest
        correction [m], the pace [m/s], and of each of the "paces" that were tried what was expected
        [m]; `expected` is what `expect` says.

    Raises:
        PatternError: friction is not usable, or the trajectory is too short to be laid.
    """
    values = np.unique(np.atleast_1d(np.asarray(pace, dtype=float)))
    if not (np.isfinite(values).all() and values[0] >= 5e-4 and values[-1] <= 10.0):
        raise PatternError(f"pace is {pace!r}; give a speed of the contact from 5e-4 to 10 m/s")
    if len(values) > 1:
        values = np.geomspace(values[0], values[-1], 3)
    tasks = [Task(pattern, rod, trajectory, friction, limits, float(v)) for v in values]
    how: dict[str, Any] = dict(samples=samples, hold=hold, device=device)
    made = optimise_each(tasks, judge=judge or len(tasks) > 1, **how)
    return made[0] if len(made) == 1 else _fastest(made)


def _fastest(made: list[Trajectory]) -> Trajectory:
    """Of plans from slow to fast, the fastest that is not clearly worse than the best."""
    said = [one.expected for one in made]
    best = min(said, key=_expected_error)
    chosen = [one for one, told in zip(made, said, strict=True) if not is_better(best, told)][-1]
    tried = [[one.optimised["pace"], one.expected["mean"]] for one in made]
    optimised = {**chosen.optimised, "paces": tried}
    return replace(chosen, metadata={**chosen.metadata, "optimised": optimised})


def _expected_error(told: dict) -> float:
    """Of what `expect` says, misplacement aside [m]."""
    return balanced(np.array(told["error_robot"]), np.array(told["beside"]))[0]


def optimise_each(
    tasks: Sequence[Task],
    *,
    samples: int | None = None,
    hold: float = 0.05,
    judge: bool = True,
    device: str | None = "cpu",
    progress: Callable[[int], object] | None = None,
) -> list[Trajectory]:
    """`optimise` of several plans: a GPU works on all at once, in little more time than on one.

    Rods that are laid in one batch have one number of nodes, the largest that any of them needs.
    """
    courses = [course(task, samples=samples, hold=hold, judge=judge) for task in tasks]
    return follow(courses, hold=hold, device=device, progress=progress)


def course(
    task: Task, *, samples: int | None = None, hold: float = 0.05, judge: bool = True
) -> Course[Trajectory]:
    """The deployments with which a plan is optimised, and then the plan; see `optimise`."""
    spread, trajectory = Spread.of(task.friction), task.trajectory
    lgb = task.rod.gravito_bending_length
    if samples is None:
        samples = 4 if spread.friction[1] > _WIDE * spread.friction[0] else 2
    corrections = Corrections(task.pattern, trajectory, lgb, hold)
    problem = _Problem(task, corrections, spread, samples, judge)
    states, ahead = yield from _descend(problem, judge)
    tried = [_Tried(one.values, one.errors.mean(), (0, one.measure)) for one in states]
    if judge:
        least = min(one.errors.mean() for one in states) + _PLAIN
        near = [one.values for one in states if one.errors.mean() <= least]
        tried = yield from problem.judged([*near, *ahead])
    best = _chosen(tried)
    corrected = corrections.apply(best.values)
    said = {
        "friction": list(spread.friction),
        "iterations": len(states) + judge,
        "errors": [float(states[0].errors.mean()), float(best.error)],
        "kept": bool(best.values.any()),
        "pace": task.pace,
        "largest_correction": float(
            lgb * np.abs(corrections.basis @ best.values.reshape(-1, 3)).max()
        ),
    }
    metadata = {**corrected.metadata, "optimised": said, "expected": best.expected}
    return replace(corrected, metadata=metadata)


@dataclass(frozen=True)
class _State:
    """What corrections `values` come to: mean errors (rod,) [m], their measure, and the value, the
    matrix and the slope of a quadratic model of their squares and of what the corrections cost."""

    values: np.ndarray
    errors: np.ndarray
    measure: float
    value: float
    matrix: np.ndarray
    slope: np.ndarray

    def saved(self, step: np.ndarray) -> float:
        """By the model, the share of the value that a step saves."""
        return float(-(self.slope + 0.5 * self.matrix @ step) @ step / max(self.value, 1e-300))


@dataclass(frozen=True)
class _Tried:
    """Corrections `values`, the mean error of the sample that is laid by them [m], what they are
    ordered by, least first, and what is expected of them."""

    values: np.ndarray
    error: float
    order: tuple[int, float]
    expected: dict | None = None


def _chosen(tried: list[_Tried]) -> _Tried:
    """The best; none but what is clearly better than no correction where that might be the best."""
    best, none = min(tried, key=lambda one: one.order), tried[0]
    doubted = none.expected is not None and not none.values.any()
    if doubted and not is_better(best.expected, none.expected):
        return none
    return best


class _Problem:
    """The squared errors of a sample of rods, and what corrections cost, near some corrections.

    With `alone` its meshes are its own, and a plan does not depend on which others are made with
    it; without, more plans fit into a batch.
    """

    def __init__(
        self, task: Task, corrections: Corrections, spread: Spread, samples: int, alone: bool
    ):
        self.task, self.corrections, self.alone = task, corrections, alone
        self.spread, self.samples = spread, samples
        self.cost = corrections.cost(_SIZE, _ROUGHNESS)

    def at(self, values: np.ndarray) -> Course[_State]:
        """What corrections come to on coarse meshes."""
        task, corrections = self.task, self.corrections
        asked = self._sample(values)
        mesh = asked.how["discretisation"]
        laid = yield self._meshed(asked.trials, asked.directions, mesh)
        parts = [misplacement(task.pattern, one) for one in laid]
        errors = np.array([np.hypot(*e.reshape(2, -1)).mean() for e, _ in parts])
        errors[[one.diverged for one in laid]] = np.inf
        matrix, slope = self.cost.copy(), self.cost @ values
        value = 0.5 * float(values @ slope)
        measure = 0.5 * float(errors.mean() + errors.max())
        if np.isfinite(errors).all():
            weights = 0.5 + 0.5 * errors / max(errors.mean(), 1e-12)
            for (error, rates), weight in zip(parts, weights, strict=True):
                scale = weight / (len(parts) * METRIC_POINTS * corrections.lgb**2)
                matrix += scale * rates.T @ rates
                slope += scale * rates.T @ error
                value += 0.5 * scale * float(error @ error)
        if not (np.isfinite(matrix).all() and np.isfinite(slope).all()):
            # Derivatives that ran away say nothing: no step is made from here.
            matrix, slope = self.cost.copy(), np.zeros_like(values)
        if task.limits is not None:
            excess, rates = task.limits.excess(corrections.displacement(values))
            rates = np.einsum("mtd,ctd->mc", rates, corrections.columns()[..., :3])
            matrix += _LIMIT * rates.T @ rates
            slope += _LIMIT * rates.T @ excess
            value += 0.5 * _LIMIT * float(excess @ excess)
            measure += corrections.lgb * float(np.sqrt(_LIMIT * excess @ excess))
        return _State(values, errors, measure, value, matrix, slope)

    def judged(self, points: list[np.ndarray]) -> Course[list[_Tried]]:
        """What unseen rods say of corrections, and what the sample does on fine meshes; all are
        laid together, which costs a GPU no more than one of them."""
        task, corrections = self.task, self.corrections
        unseen = Unseen.of(task.pattern, task.rod, self.spread)
        each = [self._sample(x).trials + unseen.laid_by(corrections.apply(x)) for x in points]
        mesh = edged(JUDGING, JUDGING_EDGE * corrections.lgb)
        laid = yield self._meshed([trial for one in each for trial in one], None, mesh)
        out = []
        for x in points:
            own, rest = laid[: self.samples], laid[self.samples : len(each[0])]
            laid = laid[len(each[0]) :]
            errors = [np.hypot(*misplacement(task.pattern, o)[0].reshape(2, -1)) for o in own]
            told = unseen.told(rest)
            measure = _expected_error(told)
            if task.limits is not None:
                excess, _ = task.limits.excess(corrections.displacement(x))
                measure += corrections.lgb * float(np.sqrt(_LIMIT * excess @ excess))
            out.append(_Tried(x, float(np.mean(errors)), (told["diverged"], measure), told))
        return out

    def _meshed(self, trials: list[Trial], directions, mesh: Discretisation) -> Asked:
        mesh = replace(mesh, tolerance=_TOLERANCE)
        if self.alone:
            count = -(-nodes_needed(trials, mesh.spacing) // _ALIKE) * _ALIKE
            mesh = replace(mesh, node_count=count)
        return Asked(trials, directions, {"discretisation": mesh, "speed": self.task.pace})

    def _sample(self, values: np.ndarray) -> Asked:
        return sample_of(self.task, self.corrections, self.spread, values, self.samples)


def sample_of(
    task: Task,
    corrections: Corrections,
    spread: Spread,
    values: np.ndarray,
    samples: int,
) -> Asked:
    """The rods that cover a spread, laid by a corrected path, with their derivatives by each of the
    corrections' values (3 count,) [L_gb], on coarse meshes."""
    now = corrections.apply(values)
    rest = Tail.none(now)  # nothing is asked of what comes after the pattern
    trials = [
        Trial(task.pattern, held, now, law, told, rest)
        for held, law, told in spread.sample(samples, task.rod)
    ]
    mesh = edged(COARSE, COARSE_EDGE * task.rod.gravito_bending_length)
    how = {"discretisation": mesh, "speed": PACE}
    return Asked(trials, [Directions.of_path(corrections.columns())] * samples, how)


def _descend(problem: _Problem, ahead: bool) -> Course[tuple[list[_State], list[np.ndarray]]]:
    """Corrections from none on, each better than the last or tried in vain; with `ahead` the last
    of them is not laid but comes beside the others."""
    best = yield from problem.at(np.zeros(3 * problem.corrections.count))
    states, radius, last = [best], _STEP, False
    for k in range(1, _MORE + 1):
        step = -np.linalg.solve(best.matrix, best.slope)
        length = float(np.abs(step).max())
        step *= min(1.0, radius / max(length, 1e-12))
        saved = best.saved(step)
        if saved < 1.0 - _DONE**2:
            break
        near = best.measure < _NEAR * problem.corrections.lgb
        last |= k == _MORE or (k >= _STEPS and near)
        if ahead and last:
            return states, [best.values + step]
        tried = yield from problem.at(best.values + step)
        states.append(tried)
        last |= k >= _STEPS and tried.measure > (1.0 - _SAVED) * best.measure
        if tried.measure < best.measure:
            idle = tried.measure > _DONE * best.measure
            promised = saved * best.value
            if length > radius and best.value - tried.value > _KEPT_PROMISE * promised:
                radius *= _LONGER
            best = tried
        else:
            radius = _SHORTER * min(radius, length)
            idle = not radius > _SHORTEST
        if idle or (last and not ahead):
            break
    return states, []
