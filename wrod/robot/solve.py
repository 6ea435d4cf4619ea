"""From grip poses to a joint path: search, improve, check, time."""

import math
import os
import time as clock
import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from wrod import arguments
from wrod.errors import RobotError, WrodWarning, needed_extras
from wrod.planning.pace import USUAL_PACE, pace_of, pose_times
from wrod.planning.trajectory import Trajectory
from wrod.robot.attempt import ArmTask, Solution
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import TravelledPath
from wrod.robot.job import with_job
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import one_torch_thread
from wrod.robot.model import Robot, load_robot
from wrod.robot.placement import Placement, candidates
from wrod.robot.search import Branch
from wrod.robot.tail import FINGERS
from wrod.robot.timing import Course, laid_slowly, schedule
from wrod.robot.variation import vary

GRIP_ANGLES = tuple(math.radians(angle) for angle in (0, 30, 60, 90))


class UnreachedError(RobotError):
    """No joint path; carries what was tried, for a remedy.

    Attributes:
        task, best, places: what was asked for, the nearest solution, and the places tried.
    """

    def __init__(self, message: str, task: ArmTask, best: Solution, places: list[Placement]):
        super().__init__(message)
        self.task, self.best, self.places = task, best, places


_MANY, _PLACES = 400, 24  # places that are looked at for the rod's sake, and for the arm's
_LOST = 0.3  # [m] miss of the nearest branch from which on other grip angles are not tried
_REFINED = 4  # branches that are varied where none was good enough as it was
_FOLLOWED, _VARIED = 0.05, 6  # [m] miss up to which branches are varied by derivatives; so many
_DEEPER, _ROUNDS = 5, 8  # further searches near the best of them, and their rounds
_RADIUS = 0.004  # [m] of a rod that a trajectory does not name
FAR = 2.5  # [rad] beyond a last joint's turn, from where on elbow and tilt do not make up for it


@needed_extras()
@arguments.checked(
    RobotError,
    robot=arguments.either(arguments.path, arguments.like("a Robot", "joint_names", "chain")),
    grip_angle=arguments.either(arguments.text, arguments.number(-1e3, 1e3)),
    table_height=arguments.optional(arguments.number(-10.0, 10.0)),
    obstacles=arguments.optional(arguments.like("a wrod.robot.Obstacles", "shapes", "capsules")),
    placement=arguments.either(
        arguments.text, arguments.like("a Placement", "x", "y", "yaw"), arguments.array((4,))
    ),
    pace=arguments.optional(arguments.number(1e-4, 10.0)),
    rate=arguments.number(1.0, 1e4),
    limit_margin=arguments.number(0.0, 3.0),
    clearance=arguments.number(0.0, 1.0),
    time_limit=arguments.optional(arguments.number(0.0)),
)
def solve_joint_path(
    trajectory: Trajectory,
    robot: str | os.PathLike[str] | Robot = "sawyer",
    placement="auto",
    *,
    grip_angle: float | str = "auto",
    table_height: float | None = None,
    obstacles=None,
    pace: float | None = None,
    rate: float = 100.0,
    limit_margin: float = 0.02,
    clearance: float = 0.005,
    whole_job: bool = False,
    time_limit: float | None = None,
) -> JointPath:
    """Joint path of an arm that moves the grip along a trajectory.

    Branches of inverse kinematics are followed along the path; the best are improved by the freedom
    that the grip leaves, checked between the nodes too, and timed (steps: `wrod.robot`).

    Args:
        trajectory: grip poses [m]; the laid rod is as thick as its `rod`, or 4 mm in radius where
            it does not say. What hangs beyond the grip is kept clear of if a grip angle does that:
            where the arm may meet it all the same says `wrod.robot.beyond.met_beyond`.
        robot: "sawyer", a URDF file, or a `Robot` of `wrod.load_robot`, which is asked for another
            flange, gripper or limits.
        placement: "auto", or the pose of the trajectory's frame in the robot's base: a
            `Placement`, four numbers (x, y, z [m], yaw [rad]), or "x,y,z,yaw in degrees". z is
            the table's height.
        grip_angle: between the fingers and the rod that leaves the gripper [rad], 0 (the rod's end
            lies along the fingers) to pi/2 (the rod crosses them), or "auto": the smallest that
            works. The gripper's roll about the rod is constant.
        table_height: from the robot's base [m], where the placement is "auto"; None tries a few.
        obstacles: `Obstacles` that the arm must keep clear of.
        pace: of the contact [m/s], as `wrod.pose_times` has it, slower where the arm's limits ask
            for it (`JointPath.slowed`); None: that of the plan, or 0.02.
        rate: of the output [1/s].
        limit_margin: least distance from the joint limits [rad].
        clearance: least gap between links, table, pedestal and laid rod [m].
        whole_job: begin and end in a neutral pose, with approach, grasp, release and retreat around
            the laying (see `JointPath.phases`); where there is no way, a warning says why and the
            path begins and ends at the rod.
        time_limit: [s] after which the search ends with the nearest that was found.

    Raises:
        RobotError: the robot cannot be loaded, or no joint path was found: the sentence names the
            node, what fails there and by how much.
    """
    started = clock.perf_counter()
    angles = _angles(grip_angle)
    auto = isinstance(placement, str) and placement == "auto"
    fixed = None if auto else Placement.parse(placement)
    if fixed is not None and table_height is not None:
        raise RobotError("a placement has the table's height in it; drop the table height")
    with one_torch_thread():
        arm, rod = load_robot(robot), trajectory.rod
        task = ArmTask(
            arm,
            CollisionModel(arm),
            trajectory,
            TravelledPath(trajectory),
            limit_margin,
            clearance,
            _RADIUS if rod is None else rod.radius,
            None if obstacles is None else obstacles.capsules(),
            fixed is None and table_height is None,
            math.inf if time_limit is None else clock.monotonic() + time_limit,
        )
        best = _solved(task, _places(task, fixed, table_height), angles, fixed)
        pace = pace or pace_of(trajectory) or USUAL_PACE
        path = _timed(task, best, pace, rate, clock.perf_counter() - started)
        path = _with_job(path, task) if whole_job else path
        return path if obstacles is None else replace(path, obstacles=tuple(obstacles.shapes))


def _places(task: ArmTask, fixed: Placement | None, table_height) -> list[Placement]:
    """Where the pattern may lie: at the given place, or at those that keep it within reach."""
    arm = task.robot
    heights = None if table_height is None else (float(table_height),)
    count = _PLACES if task.obstacles is None else _MANY
    places = [fixed] if fixed else candidates(task.trajectory, arm, count, heights)
    if not places:
        raise RobotError(
            "the pattern is too large for this robot: no placement keeps it within reach and "
            "off the pedestal"
        )
    if task.obstacles is None:
        return places
    rooms = [task.rod_gap(task.surroundings(place, task.travel)) for place in places]
    free = [place for place, (gap, _) in zip(places, rooms, strict=True) if gap > task.clearance]
    if not free:
        gap, sample = max(rooms)
        node = task.path.node_of(task.travel[sample])
        raise RobotError(
            f"the hanging rod comes within {1e3 * max(gap, 0.0):.0f} mm of an obstacle at node "
            f"{node}{'' if fixed else ', wherever the pattern is placed'}; move the obstacle"
        )
    return free[:_PLACES]


def _solved(task: ArmTask, places: list[Placement], angles, fixed: Placement | None) -> Solution:
    best = attempt(task, places, angles, fixed is not None)
    if best.report.problem is not None:
        raise UnreachedError(_failure(best, fixed, task), task, best, places)
    return best


def _with_job(path: JointPath, task: ArmTask) -> JointPath:
    """The path with approach and retreat; as it is, with a warning, where there is no way."""
    try:
        return with_job(path, task)
    except RobotError as error:
        warnings.warn(
            WrodWarning(f"the joint path begins and ends at the rod: {error}"), stacklevel=4
        )
        return replace(path, metadata={**path.metadata, "no_approach": str(error)})


def attempt(task: ArmTask, places: list[Placement], angles, fixed: bool) -> Solution:
    """The first grip angle with a feasible path that keeps clear of what hangs beyond the grip, or
    of the feasible ones that which meets it last; else the best found near the best branches, as
    far as the task's time goes."""
    best: Solution | None = None
    promising: list[Branch] = []
    seeds = 12 if len(places) > 1 else 40
    for angle in angles:
        branches = task.branches(places, angle, seeds)
        best = _better(task, best, task.best(branches))
        if best.report.problem is None and task.room_beyond(best) == math.inf:
            return best
        promising += branches[:_REFINED]
        if min(branch.miss.max() for branch in branches) > _LOST:
            return best  # no turn of the gripper makes up for that
    if best.report.problem is None:
        return best
    turned, room = turning(task)
    if turned > room + FAR or low_end(task.trajectory, task.clearance) is not None:
        return best
    for branch, improved in _others(task, sorted(promising, key=task.cost), fixed):
        best = _better(task, best, task.finish(branch, improved))
        if best.report.problem is None or task.is_over():
            return best
    for seed in range(_DEEPER):
        best = _better(task, best, task.finish(task.nearby(best.branch, fixed, seed, _ROUNDS)))
        if best.report.problem is None or task.is_over():
            break
    return best


def _better(task: ArmTask, best: Solution | None, found: Solution) -> Solution:
    if best is None or found.report.shortfall < best.report.shortfall:
        return found
    feasible = best.report.problem is found.report.problem is None
    return found if feasible and task.room_beyond(found) > task.room_beyond(best) else best


def _others(task: ArmTask, promising: list[Branch], fixed: bool) -> Iterator[tuple[Branch, bool]]:
    """Branches near the promising ones: by chance, then by derivatives, which improve them."""
    near = []
    for branch in promising[:_REFINED]:
        near.append(task.nearby(branch, fixed))
        yield near[-1], False
    followed = [branch for branch in near + promising if branch.miss.max() < _FOLLOWED]
    for branch in sorted(followed, key=task.cost)[:_VARIED]:
        yield vary(task, branch, fixed), True


def _failure(best: Solution, fixed: Placement | None, task: ArmTask) -> str:
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


def turning(task: ArmTask) -> tuple[float, float]:
    """How far the pattern turns the hand from one side to the other, and how far the arm's last
    joint, which follows it, can turn [rad]."""
    turned = float(np.ptp(headings(task.trajectory)))
    return turned, float(task.robot.upper[-1] - task.robot.lower[-1])


def headings(trajectory: Trajectory) -> np.ndarray:
    """(T,) how far the hand has turned about the vertical, with the pattern and its spin [rad]."""
    ahead = np.gradient(trajectory.contact[:, :2], axis=0)
    share = trajectory.arc_length / trajectory.arc_length[-1]
    return np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])) + trajectory.spin * share


def low_end(trajectory, clearance: float) -> float | None:
    """Share of the laid length at which the fingers come down to the table; None if they do not."""
    low = trajectory.position[:, 2] < FINGERS + clearance
    if not low.any():
        return None
    first = int(np.argmax(low))
    arc = trajectory.arc_length
    return float(arc[max(first - 1, 0)] / arc[-1])


def _angles(grip_angle) -> tuple[float, ...]:
    if isinstance(grip_angle, str):
        if grip_angle != "auto":
            raise RobotError(f"grip angle is {grip_angle!r}; give 'auto' or radians")
        return GRIP_ANGLES
    if not 0.0 <= float(grip_angle) <= math.pi / 2 + 1e-9:
        raise RobotError(f"grip angle is {grip_angle!r} rad; give 0 (along the rod) to pi/2")
    return (float(grip_angle),)


def _timed(
    task: ArmTask, solution: Solution, pace: float, rate: float, seconds: float
) -> JointPath:
    arm, path, arc = task.robot, task.path, task.trajectory.arc_length
    timing = schedule(arm, Course.of_plan(solution.spline, path), pace)
    passed = timing.time_of(path.travel)
    most, slowly = laid_slowly(pose_times(task.trajectory, pace), passed, arc)
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
        "pace": pace,
        "steady_pace": pace / timing.stretched,
        "slowed": {"most": most, "at": slowly},
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
        node_time=passed,
        node_positions=nodes,
        placement=place,
        grip=branch.grip,
        robot=arm,
        metadata=metadata,
    )
