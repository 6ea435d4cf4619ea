"""Plans that know the table: the grip's path is corrected until what stays lies on the pattern.

Optimal grasps say where the grip is to be if the laid part does not move. On a table of friction
0.2 to 0.6 it does: where the pattern bends, the rod slides as it touches down. The path has freedom
to spare, and this module uses it. Gauss-Newton with the derivatives of whole deployments
(`wrod.deployment.tangents`) finds smooth corrections of the grip's poses with which a sample of
rods and tables lie on the pattern, on average and at their worst.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from wrod import arguments
from wrod.deployment.corrections import Corrections
from wrod.deployment.descent import (
    Limits,
    Problem,
    TableTask,
    Tried,
    descend,
    expected_error,
    paces,
)
from wrod.deployment.expectation import PACE, independent, is_better, rougher
from wrod.deployment.spread import Spread, samples_of
from wrod.deployment.together import Course, follow
from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod

# By which the sample has to lie better that nobody doubts it [m].
_PLAIN = 1e-3


def optimise(
    pattern: Pattern,
    rod: Rod,
    trajectory: Trajectory,
    friction: float | tuple[float, float] | Spread,
    *,
    limits: Limits | None = None,
    pace: float | tuple[float, float] = PACE,
    samples: int | None = None,
    hold: float = 0.05,
    judge: bool = True,
    time_limit: float | None = None,
    device: arguments.DeviceLike = "cpu",
) -> Trajectory:
    """Correct a trajectory's poses until what stays on the table lies on the pattern.

    Gauss-Newton steps for a sample of rods that covers the spread, on coarse meshes; of what these
    lead to, and of the path as it was, that is taken by which disturbed rods lie best that none of
    it has seen (docs/deployment.md has it step by step).

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
        time_limit: [s] after which no step begins: the best so far is judged; None: none.
        device: "cpu", "cuda:0" or "auto".

    Returns:
        The corrected trajectory. `optimised` holds the range of friction, the mean error of the
        sample before and after [m], whether a correction was "kept", the largest
        correction [m] and turn [rad], the pace [m/s], and of each of the "paces" that were tried
        what was expected [m], and whether it "ended_early"; `expected` is what `expect` says.

    Raises:
        PatternError: friction is not usable, or the trajectory is too short to be laid.
    """
    return optimise_rivals(
        [(pattern, trajectory)], rod, friction, limits=limits, pace=pace, judge=judge,
        time_limit=time_limit, samples=samples, hold=hold, device=device,
    )  # fmt: skip


def optimise_rivals(
    rivals: Sequence[tuple[Pattern, Trajectory]],
    rod: Rod,
    friction: float | tuple[float, float] | Spread,
    *,
    limits: Limits | None = None,
    pace: float | tuple[float, float] = PACE,
    judge: bool = True,
    time_limit: float | None = None,
    **how,
) -> Trajectory:
    """`optimise` of each of several patterns and their trajectories, such as a pattern with one
    remainder and with another; what is returned is the plan by which unseen rods lie best."""
    values = paces(pace)
    until = np.inf if time_limit is None else time.monotonic() + time_limit
    tasks = [
        TableTask(pattern, rod, trajectory, friction, limits, v, until)
        for pattern, trajectory in rivals
        for v in values.tolist()
    ]
    made = optimise_each(tasks, judge=judge or len(tasks) > 1, **how)
    count = len(values)
    return best_of([_fastest(made[k : k + count]) for k in range(0, len(made), count)])


def best_of(made: list[Trajectory]) -> Trajectory:
    """Of optimised plans, that by which unseen rods lie best."""
    if len(made) == 1:
        return made[0]
    return min(made, key=lambda one: (one.expected["diverged"], expected_error(one.expected)))


def _fastest(made: list[Trajectory]) -> Trajectory:
    """Of plans from slow to fast, the fastest that is not clearly worse than the best."""
    if len(made) == 1:
        return made[0]
    said = [one.expected for one in made]
    best = min(said, key=expected_error)
    chosen = [one for one, told in zip(made, said, strict=True) if not is_better(best, told)][-1]
    tried = [[one.optimised["pace"], one.expected["mean"]] for one in made]
    optimised = {**chosen.optimised, "paces": tried}
    return replace(chosen, metadata={**chosen.metadata, "optimised": optimised})


def optimise_each(
    tasks: Sequence[TableTask],
    *,
    samples: int | None = None,
    hold: float = 0.05,
    judge: bool = True,
    device: arguments.DeviceLike = "cpu",
    progress: Callable[[int], object] | None = None,
) -> list[Trajectory]:
    """`optimise` of several plans: a GPU works on all at once, in little more time than on one.

    No plan depends on which others are made with it.
    """
    courses = [course(task, samples=samples, hold=hold, judge=judge) for task in tasks]
    return follow(courses, hold=hold, device=device, progress=progress)


def course(
    task: TableTask,
    *,
    samples: int | None = None,
    hold: float = 0.05,
    judge: bool = True,
    straight: bool = False,
) -> Course[Trajectory]:
    """The deployments with which a plan is optimised, and then the plan; see `optimise`. One that
    is `straight` has the orientations of the trajectory."""
    spread, trajectory = Spread.of(task.friction), task.trajectory
    lgb = task.rod.gravito_bending_length
    if samples is None:
        samples = samples_of(spread)
    corrections = Corrections(task.pattern, trajectory, lgb, hold, straight=straight)
    problem = Problem(task, corrections, spread, samples, judge)
    states, ahead = yield from descend(problem, judge)
    early = problem.is_over
    tried = [Tried(one.values, one.errors.mean(), (0, one.measure)) for one in states]
    if judge:
        best = min(states, key=lambda one: one.errors.mean())
        near = [states[0]] if states[0].errors.mean() <= best.errors.mean() + _PLAIN else []
        near += [best] if best.values.any() else []
        tried = yield from problem.judged([*(one.values for one in near), *ahead])
    best = _chosen(tried)
    corrected = corrections.apply(best.values)
    said = {
        "friction": list(spread.friction),
        "iterations": problem.count + judge,
        "errors": [float(states[0].errors.mean()), float(best.error)],
        "kept": bool(best.values.any()),
        "pace": task.pace,
        "ended_early": early,
        **corrections.largest(best.values),
    }
    if best.expected is not None:
        paths = [corrected, trajectory] if said["kept"] else [trajectory]
        said["rougher"] = yield from rougher(
            task.pattern, task.rod, paths, best.expected, task.pace
        )
    metadata = {**corrected.metadata, "optimised": said, "expected": best.expected}
    return replace(corrected, metadata=metadata)


def _chosen(tried: list[Tried]) -> Tried:
    """The best; none but what is clearly better than no correction where that might be the best."""
    best, none = min(tried, key=lambda one: one.order), tried[0]
    if none.expected is None or none.values.any() or best is none:
        return best
    among = independent([one.expected for one in tried[1:]], none.expected)
    return best if is_better(best.expected, none.expected, among) else none
