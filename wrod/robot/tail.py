"""The arm's way along the tail: what hangs from the hand at the pattern's end, laid down."""

from dataclasses import dataclass, replace

import numpy as np

from wrod.planning.pace import TAIL_FASTER
from wrod.planning.tail import with_tail
from wrod.planning.trajectory import part_of
from wrod.robot.attempt import ArmTask
from wrod.robot.grip import TravelledPath
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import refine
from wrod.robot.knots import COARSEST, joint_spline
from wrod.robot.timing import Course, schedule

FINGERS = 0.012  # [m] from the grasp point to the outside of the gripper's fingers
_STEP = 0.02  # [m] of travel between the poses that are followed
_HALVINGS = 5  # of the travel between what the arm can lay of a tail and what it cannot
_SHORTER = (1.0, 0.8, 0.5)  # shares of what it can, where the hand finds no way back from its end
_LEAST = 0.02  # [m] of rod: less is not worth the way


@dataclass(frozen=True)
class LaidTail:
    """Joint positions (K, n) [rad] and velocities (K, n) [rad/s] at a path's rate, laid length
    (K,) [m], and the task whose trajectory ends where the hand opens."""

    positions: np.ndarray
    velocities: np.ndarray
    arc_length: np.ndarray
    task: ArmTask


def tails(path: JointPath, task: ArmTask):
    """Ways on from the end of a joint path that lay the tail, the longest first.

    The arm goes on from where it is, with least motion, at the same hold of the rod; as far as it
    keeps what the task asks for.
    """
    joined = with_tail(task.trajectory, None, FINGERS + task.clearance)
    if joined is None:
        return
    way = TravelledPath(joined)
    longer = replace(task, trajectory=joined, path=way)
    begin = way.travel[len(task.trajectory) - 1]
    low, high = begin, way.travel[-1]
    if _followed(path, longer, begin, high) is not None:
        low = high
    for _ in range(_HALVINGS if low < high else 0):
        middle = (low + high) / 2
        if _followed(path, longer, begin, middle) is None:
            high = middle
        else:
            low = middle
    for share in _SHORTER:
        end = begin + share * (low - begin)
        if way.arc_length(np.array([end]))[0] - task.trajectory.arc_length[-1] < _LEAST:
            return
        found = _followed(path, longer, begin, end)
        if found is not None:
            yield found


def _followed(path: JointPath, task: ArmTask, begin: float, end: float) -> LaidTail | None:
    """The way between two points of the task's travel [m], None where the arm cannot go it."""

    def targets(at):
        return task.targets(path.placement, path.grip, at)

    coarse = np.linspace(begin, end, max(6, int(np.ceil((end - begin) / _STEP)) + 1))
    followed = [path.positions[-1]]
    for goal in targets(coarse)[1:]:
        q, error = refine(task.robot, followed[-1][None], goal[None])
        if np.abs(error).max() > 1e-6:
            return None
        followed.append(q[0])
    knots = np.linspace(begin, end, max(8, int(np.ceil((end - begin) / COARSEST)) + 1))
    spline, knots = joint_spline(task.robot, targets, coarse, np.array(followed), knots)
    check = np.sort(np.concatenate([knots, (knots[:-1] + knots[1:]) / 2]))
    report = task.inspected(path.placement, check, spline(check), targets(check))
    if report.problem is not None:
        return None
    first, last = task.path.arc_length(np.array([begin, end]))
    course = Course.of_plan(spline, task.path, float(first), float(last))
    timing = schedule(task.robot, course, TAIL_FASTER * path.pace)
    rate = path.rate
    time = np.arange(np.ceil(timing.duration * rate) + 1) / rate
    travel, speed = timing.travel(time)
    laid = task.path.arc_length(travel)
    cut = part_of(task.trajectory, task.trajectory.arc_length < laid[-1] + 1e-9)
    return LaidTail(
        spline(travel),
        spline(travel, 1) * speed[:, None],
        laid,
        replace(task, trajectory=cut, path=TravelledPath(cut)),
    )
