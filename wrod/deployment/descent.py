"""The descent of an optimised plan: what corrections of a grip's path come to, and steps between
them; see `wrod.deployment.optimise`."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

from wrod.deployment.corrections import Corrections
from wrod.deployment.discretisation import Discretisation
from wrod.deployment.expectation import (
    PACE,
    Unseen,
    balanced,
    coarse_mesh,
    distances,
    judging_mesh,
    misplacement,
)
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.result import METRIC_POINTS, metric_points
from wrod.deployment.simulate import Trial, nodes_needed
from wrod.deployment.spread import Spread
from wrod.deployment.tangents import Directions, Laid
from wrod.deployment.together import Asked, Course
from wrod.deployment.way import GripWay
from wrod.errors import PatternError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory, out_of_reach
from wrod.rods.model import Rod

# Cost of a correction of 1 L_gb along the whole path, and of its second differences, over that of
# an error of 1 L_gb.
_SIZE, _ROUGHNESS = 6e-3, 2e-2
# Cost of an arm beyond its limits by all of one of them, at one pose.
_LIMIT = 1e2
# Largest change of a correction in one iteration [L_gb], what is left of it after a change for the
# worse, and where that ends; what it grows by after one that was cut to it and saved more than this
# part of what its model promised, and what is left of a step that saved less.
_STEP, _SHORTER, _SHORTEST = 0.35, 0.4, 0.01
_LONGER, _KEPT_PROMISE, _SHORT = 2.0, 0.5, 0.5
# Steps of a plan at least, and at most: further ones where the last but one saved this part of the
# error. A step from so near [L_gb] is not laid by itself, unless the one before saved too little of
# what it promised: what more steps save from there on, on fine meshes too, unseen rods do not feel.
_STEPS, _MORE, _SAVED, _NEAR = 2, 3, 0.2, 0.03
# Parts of the largest change of the last step that are tried, for it is not laid by itself, and
# where rods stick and slide what lies has kinks.
_PARTS = 1.0, 0.4, 0.16
# Residual forces that are enough for them, see `lay`: these change what lies by 0.02 mm.
_TOLERANCE = 5e-3
# Numbers of nodes are multiples of this, so that a GPU lays many plans in few batches; and those of
# plans that are made by the thousand are at least that, which nearly all can do with.
_ALIKE, _TOGETHER = 16, 112
# An iteration that leaves more than this part of the error is the last, and one that would by its
# model, of squares, is not tried.
_DONE = 0.95
# An error of more than this after such steps [L_gb] is far, so many times as much after the least
# number of them. Then all begins anew, and each time so much more of the pattern counts [L_gb],
# fading out over the next length, for so many steps at most, and rods are laid so far beyond: an
# early bend that springs off moves all that comes after it, which says nothing of later ones.
# Corrections may be large, and cost this part of what they cost otherwise.
_FAR, _HOPELESS, _STRETCH, _FADE, _EACH, _BEYOND, _CHEAP = 0.2, 2.0, 3.0, 0.5, 4, 2.0, 0.1
# Corrections that begin so much before what counted last stay as they are meanwhile [L_gb]: what is
# laid before them is not laid again.
_BEHIND = 4.0


@dataclass(frozen=True)
class TableTask:
    """A plan that is to know its table; see `optimise`. No step begins after `until` [s of the
    monotonic clock]."""

    pattern: Pattern
    rod: Rod
    trajectory: Trajectory
    friction: float | tuple[float, float] | Spread
    limits: Limits | None = None
    pace: float = PACE
    until: float = np.inf


class Limits(Protocol):
    """What the arm that is to follow a trajectory can do."""

    def excess(self, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far displacements [m] and rotation vectors [rad] (T, 6) of its poses take the arm
        beyond its limits, in parts of these (m,), and the derivatives (m, T, 6) of that [1/m,
        1/rad]; nothing where they do not."""
        ...


def paces(pace: float | tuple[float, float]) -> np.ndarray:
    """(n,) for which a plan is corrected [m/s]: one, or the ends of a range and their mean.

    Raises:
        PatternError: out of bounds.
    """
    values = np.unique(np.atleast_1d(np.asarray(pace, dtype=float)))
    if not (np.isfinite(values).all() and values[0] >= 5e-4 and values[-1] <= 10.0):
        raise PatternError(f"pace is {pace!r}; give a speed of the contact from 5e-4 to 10 m/s")
    return values if len(values) == 1 else np.geomspace(values[0], values[-1], 3)


def expected_error(told: dict) -> float:
    """Of what `expect` says, misplacement aside [m]."""
    return balanced(np.array(told["error_robot"]), np.array(told["beside"]))[0]


@dataclass(frozen=True)
class State:
    """What corrections `values` come to: mean errors (rod,) [m], their measure, and the value, the
    matrix and the slope of a quadratic model of their squares and of what the corrections cost."""

    values: np.ndarray
    errors: np.ndarray
    measure: float
    value: float
    matrix: np.ndarray
    slope: np.ndarray

    def step(self, radius: float) -> tuple[np.ndarray, bool]:
        """The change by which the model's value gets least, and whether it was damped until none of
        it was larger than `radius`: cut, it would lose what is well determined with what is not."""
        stiff, modes = np.linalg.eigh(self.matrix)

        def damped(damping: float) -> np.ndarray:
            return -modes @ (modes.T @ self.slope / (stiff + damping))

        if not np.abs(damped(0.0)).max() > radius:
            return damped(0.0), False
        most = np.log(stiff[-1] + np.abs(self.slope).sum() / radius)
        root = brentq(lambda log: np.abs(damped(np.exp(log))).max() - radius, -50.0, most)
        return damped(np.exp(root)), True

    def saved(self, step: np.ndarray) -> float:
        """By the model, the share of the value that a step saves."""
        return float(-(self.slope + 0.5 * self.matrix @ step) @ step / max(self.value, 1e-300))

    def kept(self, step: np.ndarray, tried: State) -> bool:
        """Whether what it came to saved enough of what was promised."""
        return self.value - tried.value > _KEPT_PROMISE * self.saved(step) * self.value


@dataclass(frozen=True)
class Tried:
    """Corrections `values`, the mean error of the sample that is laid by them [m], what they are
    ordered by, least first, and what is expected of them."""

    values: np.ndarray
    error: float
    order: tuple[int, float]
    expected: dict | None = None


class Problem:
    """The squared errors of a sample of rods, and what corrections cost, near some corrections.

    Meshes are its own: a plan does not depend on which others are made with it. With `alone` they
    are as large as it needs, and what is far begins anew bend by bend, which takes ten times as
    long; without, more plans fit into a batch.
    """

    def __init__(
        self, task: TableTask, corrections: Corrections, spread: Spread, samples: int, alone: bool
    ):
        self.task, self.corrections, self.alone = task, corrections, alone
        self.spread, self.samples = spread, samples
        self.cost = corrections.cost(_SIZE, _ROUGHNESS)
        self.count = 0
        self.remembered = [LastDeployments() for _ in range(samples)]

    @property
    def is_over(self) -> bool:
        """Whether the time is over that was given."""
        return time.monotonic() > self.task.until

    def at(self, values: np.ndarray, end: float = np.inf, fixed: int = 0) -> Course[State]:
        """What corrections come to on coarse meshes, of the pattern up to `end` [m]; the first of
        their values are `fixed`."""
        laid = yield from self.laid(values, end, fixed)
        self.count += 1
        return self._state(values, laid, end, fixed)

    def laid(self, values: np.ndarray, end: float = np.inf, fixed: int = 0) -> Course[list[Laid]]:
        """What the sample lays by corrections, with its derivatives by each of their values
        (count,) [L_gb, rad] that is not `fixed`."""
        trials = self._sample(values, end)
        columns = self.corrections.columns(values)[fixed:, : len(trials[0].trajectory)]
        directions = [Directions.of_path(columns)] * self.samples
        asked = self._meshed(trials, directions, coarse_mesh(self.corrections.lgb))
        return (yield replace(asked, remembered=self.remembered) if fixed else asked)

    def fixed(self, before: float) -> int:
        """How many values have a say before so much of the pattern is laid [m]."""
        first = (self.corrections.basis > 1e-12).argmax(axis=0)
        laid = self.corrections.trajectory.arc_length[first]
        before += self.corrections.trajectory.remainder_length
        return len(self.corrections.axes) * int(np.sum(laid < before))

    def _state(self, values: np.ndarray, laid: list[Laid], end: float, fixed: int = 0) -> State:
        task, corrections = self.task, self.corrections
        parts = [misplacement(task.pattern, one) for one in laid]
        parts = [(error, np.pad(rates, ((0, 0), (fixed, 0)))) for error, rates in parts]
        s, _ = metric_points(task.pattern)
        counts = np.clip((end - s) / (_FADE * corrections.lgb) + 1.0, 0.0, 1.0)
        errors = np.array(
            [np.average(np.hypot(*e.reshape(2, -1)), weights=counts) for e, _ in parts]
        )
        # What no rod can follow may lie well all the same, and is refused when it is to be laid.
        far = bool(out_of_reach(corrections.apply(values)).any())
        errors[[one.diverged or far for one in laid]] = np.inf
        matrix, slope = self.cost.copy(), self.cost @ values
        value = 0.5 * float(values @ slope)
        measure = 0.5 * float(errors.mean() + errors.max())
        if np.isfinite(errors).all():
            weights = 0.5 + 0.5 * errors / max(errors.mean(), 1e-12)
            for (error, rates), weight in zip(parts, weights, strict=True):
                scale = weight / (len(parts) * METRIC_POINTS * corrections.lgb**2)
                scaled = scale * np.tile(counts, 2) * rates.T
                matrix += scaled @ rates
                slope += scaled @ error
                value += 0.5 * scale * float(np.tile(counts, 2) @ error**2)
        if not (np.isfinite(matrix).all() and np.isfinite(slope).all()):
            # Derivatives that ran away say nothing: no step is made from here.
            matrix, slope = self.cost.copy(), np.zeros_like(values)
        if task.limits is not None:
            excess, rates = task.limits.excess(corrections.moves(values))
            rates = np.einsum("mtd,ctd->mc", rates, corrections.columns())
            matrix += _LIMIT * rates.T @ rates
            slope += _LIMIT * rates.T @ excess
            value += 0.5 * _LIMIT * float(excess @ excess)
            measure += corrections.lgb * float(np.sqrt(_LIMIT * excess @ excess))
        matrix[:fixed], matrix[:, :fixed], slope[:fixed] = 0.0, 0.0, 0.0
        matrix[range(fixed), range(fixed)] = 1.0
        return State(values, errors, measure, value, matrix, slope)

    def judged(self, points: list[np.ndarray]) -> Course[list[Tried]]:
        """What unseen rods say of corrections, and what the sample does on fine meshes; all are
        laid together, which costs a GPU no more than one of them."""
        task, corrections = self.task, self.corrections
        unseen = Unseen.of(task.pattern, task.rod, self.spread)
        each = [self._sample(x) + unseen.laid_by(corrections.apply(x)) for x in points]
        trials = [trial for one in each for trial in one]
        laid = yield self._meshed(trials, None, judging_mesh(corrections.lgb))
        out = []
        for x in points:
            own, rest = laid[: self.samples], laid[self.samples : len(each[0])]
            laid = laid[len(each[0]) :]
            told = unseen.told(rest)
            measure = expected_error(told)
            if task.limits is not None:
                excess, _ = task.limits.excess(corrections.moves(x))
                measure += corrections.lgb * float(np.sqrt(_LIMIT * excess @ excess))
            lost = told["diverged"] + int(out_of_reach(corrections.apply(x)).sum())
            error = float(distances(task.pattern, own).mean())
            out.append(Tried(x, error, (lost, measure), told))
        return out

    def _meshed(self, trials: list[Trial], directions, mesh: Discretisation) -> Asked:
        needed = max(nodes_needed(trials, mesh.spacing), 0 if self.alone else _TOGETHER)
        count = -(-needed // _ALIKE) * _ALIKE
        mesh = replace(mesh, tolerance=_TOLERANCE, node_count=count)
        return Asked(trials, directions, {"discretisation": mesh, "speed": self.task.pace})

    def _sample(self, values: np.ndarray, end: float = np.inf) -> list[Trial]:
        """The rods that cover the spread, by a corrected path, up to `end` of the pattern [m]."""
        now, task = self.corrections.apply(values), self.task
        end += _BEYOND * self.corrections.lgb + now.remainder_length
        now = GripWay(now).until(end).path
        rest = Tail.none(now)  # nothing is asked of what comes after the pattern
        return [
            Trial(task.pattern, held, now, law, told, rest)
            for held, law, told in self.spread.sample(self.samples, task.rod)
        ]


def descend(problem: Problem, ahead: bool) -> Course[tuple[list[State], list[np.ndarray]]]:
    """Corrections from none on, each better than the last or tried in vain; with `ahead` those of
    the last step, of several lengths, are not laid but come beside the others."""
    states = [(yield from problem.at(np.zeros(problem.corrections.count)))]
    far = _FAR * problem.corrections.lgb
    last = yield from _steps(problem, states, ahead, _HOPELESS * far if problem.alone else np.inf)
    far_off = min(one.measure for one in states) > far
    if far_off and problem.alone and not problem.is_over:
        states.append((yield from _bend_by_bend(problem)))
        last = yield from _steps(problem, states, ahead)
    return states, last


def _steps(
    problem: Problem, states: list[State], ahead: bool, hopeless: float = np.inf
) -> Course[list[np.ndarray]]:
    """Adds what further steps from the best of the states come to, unless after the least number of
    them that is `hopeless` [m]."""
    best, radius, last, as_said = min(states, key=lambda one: one.measure), _STEP, False, True
    for k in range(1, _MORE + 1):
        step, damped = best.step(radius)
        saved = best.saved(step)
        if saved < 1.0 - _DONE**2:
            break
        near = best.measure < _NEAR * problem.corrections.lgb
        last |= k == _MORE or (k >= _STEPS and near and as_said) or problem.is_over
        if ahead and last:
            radius = min(radius, float(np.abs(step).max()))
            parts = _PARTS[:1] if problem.is_over else _PARTS
            return [best.values + best.step(part * radius)[0] for part in parts]
        tried = yield from problem.at(best.values + step)
        states.append(tried)
        # A step that is taken back, or saves little of what it promised, says nothing of a shorter
        # one.
        as_said = tried.measure < best.measure and best.kept(step, tried)
        last |= k >= _STEPS and as_said and tried.measure > (1.0 - _SAVED) * best.measure
        idle = as_said and tried.measure > _DONE * best.measure
        best, radius = _better(best, tried, step, radius, damped)
        given_up = k >= _STEPS and best.measure > hopeless
        if idle or given_up or (last and not ahead) or not radius > _SHORTEST:
            break
    return []


def _bend_by_bend(problem: Problem) -> Course[State]:
    """Corrections that are found for the beginning of the pattern first, and then for more and more
    of it, from no corrections on."""
    problem.cost = _CHEAP * problem.cost
    length, values = problem.task.pattern.length, np.zeros(problem.corrections.count)
    count, fixed = int(np.ceil(length / (_STRETCH * problem.corrections.lgb))), 0
    for bend in range(1, count + 1):
        end = length / count * bend
        best, radius = (yield from problem.at(values, end, fixed)), _STEP
        for _ in range(_EACH):
            step, damped = best.step(radius)
            near = best.measure < _NEAR * problem.corrections.lgb
            # One that was damped says nothing of what longer ones save, which come after it.
            most = best.saved(best.step(np.inf)[0])
            if near or problem.is_over or most < 1.0 - _DONE**2:
                break
            tried = yield from problem.at(best.values + step, end, fixed)
            idle = not damped and _DONE * best.measure < tried.measure < best.measure
            best, radius = _better(best, tried, step, radius, damped)
            if idle:
                break
        values, fixed = best.values, problem.fixed(end - _BEHIND * problem.corrections.lgb)
        if problem.is_over:
            break
    return best if fixed == 0 and bend == count else (yield from problem.at(values))


def _better(
    best: State, tried: State, step: np.ndarray, radius: float, damped: bool
) -> tuple[State, float]:
    """The better of two, of which the second is a step away, and the largest change of the next
    step."""
    if not tried.measure < best.measure:
        return best, _SHORTER * min(radius, float(np.abs(step).max()))
    if not best.kept(step, tried):
        return tried, min(radius, _SHORT * float(np.abs(step).max()))
    return tried, radius * (_LONGER if damped else 1.0)
