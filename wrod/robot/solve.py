"""From grip poses to a joint path: search, improve, check, time."""

from __future__ import annotations

import math
import time as clock
import warnings
from dataclasses import replace

import numpy as np

from wrod.errors import RobotError, WrodWarning
from wrod.planning.trajectory import Trajectory
from wrod.robot.attempt import Solution, Task
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import GripPath
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import one_torch_thread
from wrod.robot.model import Robot, load_robot
from wrod.robot.placement import Placement, candidates
from wrod.robot.timing import schedule

GRIP_ANGLES = tuple(math.radians(angle) for angle in (0, 30, 60, 90))


class UnreachedError(RobotError):
    """No joint path; carries what was tried, for a remedy.

    Attributes:
        task, best, places: what was asked for, the nearest solution, and the places tried.
    """

    def __init__(self, message: str, task: Task, best: Solution, places: list[Placement]):
        super().__init__(message)
        self.task, self.best, self.places = task, best, places


_LOST = 0.3  # [m] miss of the nearest branch from which on other grip angles are not tried
_REFINED = 4  # branches that are varied where none was good enough as it was
_DEEPER, _ROUNDS = 5, 8  # further searches near the best of them, and their rounds


def solve(
    trajectory: Trajectory,
    robot,
    placement,
    *,
    grip_angle,
    gripper_length,
    flange,
    tip,
    table_height,
    obstacles,
    grip_speed,
    rate,
    limit_margin,
    clearance,
    rod_radius,
    whole_job,
) -> JointPath:
    """See `wrod.robot.joint_path.solve_joint_path`."""
    started = clock.perf_counter()
    if not (math.isfinite(rate) and rate > 0):
        raise RobotError(f"rate is {rate!r}; give a positive number of samples per second")
    angles = _angles(grip_angle)
    fixed = None if _is_auto(placement) else Placement.parse(placement)
    if fixed is not None and table_height is not None:
        raise RobotError("a placement has the table's height in it; drop the table height")
    with one_torch_thread():
        arm = load_robot(robot, flange=flange, tip=tip, gripper_length=gripper_length)
        task = Task(
            arm,
            CollisionModel(arm),
            trajectory,
            GripPath(trajectory),
            limit_margin,
            clearance,
            rod_radius,
            None if obstacles is None else obstacles.capsules(),
            fixed is None and table_height is None,
        )
        heights = arm.table_heights if table_height is None else (float(table_height),)
        places = [fixed] if fixed else candidates(trajectory, arm, heights=heights)
        if not places:
            raise RobotError(
                "the pattern is too large for this robot: no placement keeps it within reach and "
                "off the pedestal"
            )
        best = attempt(task, places, angles, fixed is not None)
        if best.report.problem is not None:
            raise UnreachedError(_failure(best, fixed, task), task, best, places)
        path = _timed(arm, task.path, best, grip_speed, rate, clock.perf_counter() - started)
        return _with_job(path, task) if whole_job else path


def _with_job(path: JointPath, task: Task) -> JointPath:
    """The path with approach and retreat; as it is, with a warning, where there is no way."""
    from wrod.robot.job import with_job

    try:
        return with_job(path, task)
    except RobotError as error:
        warnings.warn(
            WrodWarning(f"the joint path begins and ends at the rod: {error}"), stacklevel=4
        )
        return replace(path, metadata={**path.metadata, "no_approach": str(error)})


def attempt(task: Task, places: list[Placement], angles, fixed: bool) -> Solution:
    """The first grip angle with a feasible path; else the best found near the best branches."""
    best, promising = None, []
    seeds = 12 if len(places) > 1 else 40
    for angle in angles:
        branches = task.branches(places, angle, seeds)
        found = task.best(branches)
        if best is None or found.report.shortfall < best.report.shortfall:
            best = found
        if best.report.problem is None:
            return best
        promising += branches[:_REFINED]
        if min(branch.miss.max() for branch in branches) > _LOST:
            return best  # no turn of the gripper makes up for that
    for branch in sorted(promising, key=task.cost)[:_REFINED]:
        found = task.finish(task.nearby(branch, fixed))
        if found.report.shortfall < best.report.shortfall:
            best = found
        if best.report.problem is None:
            return best
    for seed in range(_DEEPER):
        found = task.finish(task.nearby(best.branch, fixed, seed, _ROUNDS))
        if found.report.shortfall < best.report.shortfall:
            best = found
        if best.report.problem is None:
            break
    return best


def _failure(best: Solution, fixed: Placement | None, task: Task) -> str:
    where = f"placed at {best.branch.placement}" if fixed else "at the best placement found"
    what_to_do = "move the pattern or use placement 'auto'" if fixed else "use a smaller pattern"
    turned, room = turning(task)
    if turned > room:
        what_to_do = (
            f"the pattern turns the hand by {turned:.1f} rad about the vertical and joint "
            f"{task.robot.joint_names[-1]} by {room:.1f} rad in all, so use an arm whose last "
            "joint turns on and on (gen3), or draw fewer turns"
        )
    return f"no joint path {where}: {best.report.problem}; {what_to_do}"


def turning(task: Task) -> tuple[float, float]:
    """How far the pattern turns from its first direction to where it has turned most, and how far
    the arm's last joint, which follows it, can turn [rad]."""
    ahead = np.gradient(task.trajectory.contact[:, :2], axis=0)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return float(np.ptp(heading)), float(task.robot.upper[-1] - task.robot.lower[-1])


def _is_auto(placement) -> bool:
    return isinstance(placement, str) and placement == "auto"


def _angles(grip_angle) -> tuple[float, ...]:
    if isinstance(grip_angle, str):
        if grip_angle != "auto":
            raise RobotError(f"grip angle is {grip_angle!r}; give 'auto' or radians")
        return GRIP_ANGLES
    if not 0.0 <= float(grip_angle) <= math.pi / 2 + 1e-9:
        raise RobotError(f"grip angle is {grip_angle!r} rad; give 0 (along the rod) to pi/2")
    return (float(grip_angle),)


def _timed(
    arm: Robot, path: GripPath, solution: Solution, grip_speed, rate, seconds: float
) -> JointPath:
    timing = schedule(arm, solution.spline, path.travel[-1], grip_speed)
    time = np.arange(math.ceil(timing.duration * rate) + 1) / rate
    travel, speed = timing.travel(time)
    report, branch = solution.report, solution.branch
    nodes = solution.spline(path.travel)
    place = branch.placement
    steps = np.abs(np.diff(nodes, axis=0)).max(1)
    metadata = {
        "robot": arm.name,
        "gripper_length": arm.gripper_length,
        "placement": {"x": place.x, "y": place.y, "z": place.z, "yaw": place.yaw},
        "grip_angle": branch.grip.angle,
        "grip_roll": branch.grip.roll,
        "rate": rate,
        "duration": timing.duration,
        "grip_speed": timing.speed,
        "position_error": report.position_error,
        "rotation_error": report.rotation_error,
        "limit_margin": report.limit_margin,
        "gap": report.gap,
        "manipulability": report.manipulability,
        "largest_step": float(steps.max()),
        "largest_turn": float(path.turn.max()),
        "step_beyond_turn": float(
            ((steps - path.turn) * 0.005 / np.maximum(path.distance, 0.005)).max()
        ),
        "load": dict(zip(("velocity", "acceleration", "jerk"), timing.load, strict=True)),
        "seconds": round(seconds, 3),
        "units": "m, rad, s",
    }
    return JointPath(
        names=arm.joint_names,
        time=time,
        positions=solution.spline(travel),
        velocities=solution.spline(travel, 1) * speed[:, None],
        arc_length=path.arc_length(travel),
        node_time=timing.time_of(path.travel),
        node_positions=nodes,
        placement=place,
        grip=branch.grip,
        robot=arm,
        metadata=metadata,
    )
