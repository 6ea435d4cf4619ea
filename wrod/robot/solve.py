"""From grip poses to a joint path: search, improve, check, time."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from wrod.errors import RobotError
from wrod.planning.trajectory import Trajectory
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import Grip, GripPath, grasp_targets
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import one_torch_thread, refine
from wrod.robot.model import Robot, load_robot
from wrod.robot.placement import Placement, candidates, contact_in_base
from wrod.robot.redundancy import GAP_ROOM, Surroundings, gaps, improve
from wrod.robot.report import PathReport, inspect
from wrod.robot.search import Branch, find_branches
from wrod.robot.timing import schedule

GRIP_ANGLES = tuple(math.radians(angle) for angle in (0, 30, 60, 90))
_COARSE = 0.025  # [m] of travel between the samples that are searched and improved
_DENSE = 0.0015  # [m] between those that the joint splines go through
_LAID = 0.004  # [m] between the points of the laid rod that gaps are measured to
_RANKED = 24  # different branches whose obstacles are looked at
_TRIED = 4  # branches that are improved and compared


@dataclass(frozen=True)
class _Solution:
    branch: Branch
    spline: Any
    report: PathReport


def solve(
    trajectory: Trajectory,
    robot,
    placement,
    *,
    grip_angle,
    gripper_length,
    flange,
    grip_speed,
    rate,
    limit_margin,
    clearance,
    rod_radius,
) -> JointPath:
    """See `wrod.robot.joint_path.solve_joint_path`."""
    started = clock.perf_counter()
    if not (math.isfinite(rate) and rate > 0):
        raise RobotError(f"rate is {rate!r}; give a positive number of samples per second")
    angles = _angles(grip_angle)
    fixed = None if _is_auto(placement) else Placement.parse(placement)
    with one_torch_thread():
        arm = load_robot(robot, flange=flange, gripper_length=gripper_length)
        path = GripPath(trajectory)
        model = CollisionModel(arm)
        places = [fixed] if fixed else candidates(trajectory, arm)
        if not places:
            raise RobotError(
                "the pattern is too large for this robot: no placement keeps it within reach and "
                "off the pedestal"
            )
        margins = (limit_margin, clearance, rod_radius)
        best = None
        for angle in angles:
            found = _solve_angle(arm, model, trajectory, path, places, angle, margins)
            if best is None or found.report.shortfall < best.report.shortfall:
                best = found
            if best.report.problem is None:
                break
        if best.report.problem is not None:
            where = f"placed at {best.branch.placement}" if fixed else "at the best placement found"
            raise RobotError(
                f"no joint path {where}: {best.report.problem}; "
                + ("move the pattern or use placement 'auto'" if fixed else "use a smaller pattern")
            )
        return _timed(arm, path, best, grip_speed, rate, clock.perf_counter() - started)


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


def _solve_angle(
    arm: Robot, model, trajectory, path: GripPath, places, angle: float, margins
) -> _Solution:
    """Best path over the placements at one grip angle, feasible or not."""
    # Along the rod the last joint takes any roll up; across it, the roll decides where the hand is.
    rolls = (0.0,) if angle == 0.0 else tuple(math.pi / 4 * k for k in range(8))
    if len(places) > 1 and len(rolls) > 1:
        places, rolls = places[:12], rolls[::2]
    choices = [(place, Grip(angle, roll)) for place in places for roll in rolls]
    count = max(24, math.ceil(path.travel[-1] / _COARSE))
    travel = np.linspace(0.0, path.travel[-1], count)
    branches = find_branches(arm, path, travel, choices, seeds=12 if len(places) > 1 else 40)
    ranked = sorted(
        _distinct(branches, _RANKED),
        key=lambda branch: (
            branch.cost + _crowding(model, trajectory, path, travel, branch, margins)
        ),
    )
    best = None
    for branch in ranked[:_TRIED]:
        solution = _finish(arm, model, trajectory, path, travel, branch, margins)
        key = (solution.report.shortfall, -solution.report.quality)
        if best is None or key < (best.report.shortfall, -best.report.quality):
            best = solution
    return best


def _distinct(branches: list[Branch], count: int) -> list[Branch]:
    """The first few that differ from each other by more than rounding."""
    kept: list[Branch] = []
    for branch in branches:
        if all(
            branch.placement != other.placement
            or np.abs(branch.positions - other.positions).max() > 0.1
            for other in kept
        ):
            kept.append(branch)
        if len(kept) == count:
            break
    return kept


def _crowding(model, trajectory, path: GripPath, travel, branch: Branch, margins) -> float:
    """Cost of a branch that comes near obstacles; the elbow may still gain a few centimetres."""
    import torch

    with torch.no_grad():
        near = gaps(
            model,
            torch.from_numpy(branch.positions.copy()),
            _surroundings(trajectory, path, branch.placement, travel, margins),
        )
    least = min(float(gap.min()) for gap in near.values())
    return 10.0 * max(0.0, GAP_ROOM - least)


def _surroundings(trajectory, path: GripPath, placement: Placement, travel, margins):
    """Obstacles at samples `travel` of the path."""
    # Points of the laid rod a few millimetres apart are enough for gaps of that size.
    length = trajectory.arc_length[-1] - trajectory.arc_length[0]
    stride = max(1, int(_LAID * (len(path) - 1) / max(length, 1e-9)))
    contact = contact_in_base(trajectory, placement)[::stride]
    laid = np.searchsorted(path.travel[::stride], travel + 1e-12, side="right")
    return Surroundings(placement.z, contact, laid, margins[2])


def _finish(
    arm: Robot, model, trajectory, path: GripPath, travel, branch: Branch, margins
) -> _Solution:
    """Improve a branch, fill it in between the samples, and check it."""
    limit_margin, clearance, _ = margins
    pose = branch.placement.base_from_world

    def targets(at):
        return grasp_targets(path.poses(at), branch.grip, pose)

    def around(at):
        return _surroundings(trajectory, path, branch.placement, at, margins)

    coarse = branch.positions
    if branch.miss.max() < 0.01:
        coarse = improve(arm, model, coarse, targets(travel), around(travel))
    dense = path.samples(_DENSE)
    filled, _ = refine(arm, CubicSpline(travel, coarse)(dense), targets(dense))
    spline = make_interp_spline(dense, filled, k=5)
    # Between the spline's knots, where nothing was solved: the honest place to check.
    check = np.sort(np.concatenate([path.travel, (dense[:-1] + dense[1:]) / 2]))
    report = inspect(
        arm,
        model,
        path,
        trajectory.arc_length,
        check,
        spline(check),
        targets(check),
        around(check),
        limit_margin,
        clearance,
    )
    return _Solution(branch, spline, report)


def _timed(
    arm: Robot, path: GripPath, solution: _Solution, grip_speed, rate, seconds: float
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
