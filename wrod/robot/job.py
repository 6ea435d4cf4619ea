"""The whole job of an arm: from a neutral pose to the rod, grasp, lay, release, and back again.

The rod is presented as the plan begins: it hangs at the first pose of the grip from the clip of a
stand, which stays where it is in nobody's way, and else is taken away once the hand has it. The
hand comes along its fingers, closes, lays the rod and, straight ahead, what is left of it; opens,
moves back along its fingers and returns. What the hand does not hold is kept clear of: the arm's
links, the table, the obstacles, the stand, and the rod as it hangs.
"""

from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.robot.arm import ARM_ROOM, LINK_ROOM, Arm, gap_between
from wrod.robot.attempt import ArmTask, hanging_rod
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import grasp_poses, refine, solve_poses
from wrod.robot.placement import foot, reach
from wrod.robot.stand import stands, stays
from wrod.robot.tail import LaidTail, tails
from wrod.robot.timing import Course, gently, schedule
from wrod.robot.transfers import Hand
from wrod.robot.transit import Leg, Transit, find_way, reaching_down, seeds

# Where the hand may wait: distance from the arm's axis and height over the base as shares of the
# arm's reach, bearing off the pattern [degrees].
_OUT, _UP = (0.4, 0.5), (0.15, 0.3, 0.45)
_BEARINGS = (45, -45, 75, -75, 110, -110, 0)
_SEEDS = 8
_LIMIT_ROOM = 0.1  # [rad] of a neutral pose from the joints' limits
_LOOKED_AT, _NEUTRALS = 120, 6  # neutral poses that are checked, and from which ways are sought
GRASP_TIME = 1.0  # [s] the hand stands still while it closes, and while it opens
_BESIDE_ROD, _IN_AIR = 0.08, 0.25  # [m/s] of the hand
PHASES = ("approach", "grasp", "lay", "tail", "release", "retreat")


@dataclass(frozen=True)
class _Piece:
    """Joint positions (T, n) [rad] and velocities (T, n) [rad/s] at a fixed rate, and the length
    of rod that lies: (T,), or the same throughout [m]."""

    phase: str
    positions: np.ndarray
    velocities: np.ndarray
    laid: np.ndarray | float


def with_job(path: JointPath, task: ArmTask) -> JointPath:
    """A joint path with approach, grasp, release and retreat around its laying.

    Args:
        path: of the laying alone.
        task: that it solves.

    Returns:
        The path from and to a neutral pose, which has `phases` (`PHASES`, without "tail" where
        nothing of it can be laid), `neutral`, `stand` and `stand_stays`. The nodes' times are later
        by what comes before.

    Raises:
        RobotError: there is no neutral pose, or no way between it and the rod.
    """
    arm = Arm(task.robot, task.model, Hand.of(task.model), path.placement)
    rate = path.rate
    neutral, there, back, tail, stand, left_there = _ways(arm, task, path)
    first, end = path.arc_length[[0, -1]]
    last = path.positions[-1:] if tail is None else tail.positions[-1:]
    left = end if tail is None else tail.arc_length[-1]
    still = np.zeros_like(path.positions[:1])
    wait = max(1, round(GRASP_TIME * rate)) + 1
    pieces = [
        *_played("approach", task.robot, there, rate, first),
        _Piece("grasp", path.positions[:1].repeat(wait, 0), still.repeat(wait, 0), first),
        _Piece("lay", path.positions, path.velocities, path.arc_length),
        _Piece("release", last.repeat(wait, 0), still.repeat(wait, 0), left),
        *_played("retreat", task.robot, back, rate, left),
    ]
    if tail is not None:
        laid = _Piece("tail", tail.positions, tail.velocities, tail.arc_length)
        pieces.insert([piece.phase for piece in pieces].index("release"), laid)
    said = {"neutral": [float(q) for q in neutral], "stand": stand}
    if stand is not None:
        said["stand_stays"] = left_there
    return _joined(path, pieces, rate, said)


def _ways(arm: Arm, task: ArmTask, path: JointPath):
    """Neutral pose (n,) [rad], way from it to the first pose, way back to it from where the hand
    opens, the `LaidTail` before that or None, the stand's capsules or None, and whether it stays.

    Raises:
        RobotError: there is no such pose, or none with a way.
    """
    first = path.positions[0]
    found, where = None, "first"
    laid: list[LaidTail | None] = [*tails(path, task), None]
    for tail in laid:
        last = path.positions[-1] if tail is None else tail.positions[-1]
        done = task if tail is None else tail.task
        for stand, there in _stands(arm, task, path, tail):
            before = _around(arm, task, 0, stand)
            after = _around(arm, done, -1, stand if there else None)
            found, where = _between(arm, task, first, last, before, after)
            if found is not None:
                return *found, tail, stand, there
            if where != "first" and not there:
                break
        if where == "first":
            break
    if where is None:
        raise RobotError(
            f"an arm at {arm.placement} has no neutral pose beside the table; place it nearer"
        )
    raise RobotError(
        f"no way between a neutral pose and the {where} pose of the grip keeps clear of the arm, "
        "the table, the obstacles and the hanging rod; move the pattern with placement, or the "
        "obstacles"
    )


def _stands(arm: Arm, task: ArmTask, path: JointPath, tail: LaidTail | None):
    """Stands to try, each with whether it stays: one that can, the freest, and last None."""
    start, end, radius = arm.capsules(path.positions[:1])
    posts = stands(task.trajectory, (start[0], end[0], radius))
    if posts:
        played = path.positions if tail is None else np.vstack([path.positions, tail.positions])
        every = max(1, len(played) // _LOOKED_AT)
        moves = arm.capsules(np.vstack([played[::every], played[-1:]]))
        laid = task.trajectory if tail is None else tail.task.trajectory
        left = (post for post in posts if stays(post, moves, laid, task.rod_radius))
        yield from ((post, True) for post in islice(left, 1))
        yield posts[0], False
    yield None, False


def _between(arm: Arm, task: ArmTask, first, last, before, after):
    """Neutral pose, way there and way back, and None; or None and the pose of the grip, "first" or
    "last", to which there is none, or None where there is no neutral pose."""
    poses = neutral_poses(arm, task, first, last, [o for o in (before, after) if o is not None])
    where = None if len(poses) == 0 else "first"
    for neutral in poses[:_NEUTRALS]:
        there = find_way(arm, neutral, first, leave=False, arrive=True, other=before)
        if there is None:
            continue
        where = "last"
        back = find_way(arm, last, neutral, leave=True, arrive=False, other=after)
        if back is not None:
            return (neutral, there, back), None
    return None, where


def neutral_poses(arm: Arm, task: ArmTask, first, last, around: list) -> np.ndarray:
    """Joint positions (m, n) [rad] with the hand down, clear of everything, the nearest to the
    first and the last pose of the path first.

    Args:
        first, last: (n,) joint positions [rad].
        around: capsules in the table's frame that they keep clear of.
    """
    _, far = reach(task.robot)
    mount = foot(task.robot)
    contact = arm.placement.to_base(task.trajectory.contact).mean(0) - mount
    ahead = np.append(contact[:2] / max(np.linalg.norm(contact[:2]), 1e-9), 0.0)
    poses = []
    for out, up, bearing in product(_OUT, _UP, _BEARINGS):
        along = Rotation.from_euler("z", bearing, degrees=True).apply(ahead)
        pose = np.eye(4)
        pose[:3, :3] = reaching_down(along)
        pose[:3, 3] = mount + out * far * along
        pose[2, 3] = max(mount[2] + up * far, arm.placement.z + 0.2)
        poses.append(pose)
    starts = np.vstack([first, last, seeds(arm.robot, _SEEDS)])
    found, _ = solve_poses(arm.robot, np.array(poses), starts)
    found, missed = refine(
        arm.robot, found.reshape(-1, len(first)), np.repeat(poses, len(starts), axis=0)
    )
    q = found[np.abs(missed).max(1) < 1e-4]
    # Whole turns bring a joint nearer to where the path begins, where its limits allow them.
    turned = q + 2 * np.pi * np.round((first - q) / (2 * np.pi))
    q = np.where((turned > arm.robot.lower) & (turned < arm.robot.upper), turned, q)
    room = np.minimum(q - arm.robot.lower, arm.robot.upper - q).min(-1)
    q = q[room > _LIMIT_ROOM]
    if len(q) == 0:
        return q
    q = q[np.argsort(np.abs(q - first).max(1) + np.abs(q - last).max(1))][:_LOOKED_AT]
    rooms = arm.rooms(q)
    clear = (rooms["links"] > LINK_ROOM) & (rooms["table"] > 0.05)
    capsules = arm.capsules(q)
    for other in around:
        clear &= gap_between(capsules, other) > 2 * ARM_ROOM
    return q[clear]


def _around(arm: Arm, task: ArmTask, node: int, stand: list | None = None):
    """Capsules (1, C, 3), (1, C, 3), (C,) in the table's frame of what stands in the way, or
    None."""
    found = []
    if stand is not None:
        found.append(tuple(map(np.array, zip(*stand, strict=True))))
    hanging = hanging_rod(task.trajectory)
    if hanging is not None:
        points = hanging[node]
        found.append((points[:-1], points[1:], np.full(len(points) - 1, task.rod_radius)))
    if task.obstacles is not None:
        start, end, radius = task.obstacles
        found.append((arm.placement.to_world(start), arm.placement.to_world(end), radius))
    if not found:
        return None
    starts, ends, radii = map(np.concatenate, zip(*found, strict=True))
    return starts[None], ends[None], radii


def _played(phase: str, robot, way: Transit, rate: float, laid: float) -> list[_Piece]:
    """The legs of a way, each from rest to rest within the limits of every joint."""
    return [_Piece(phase, *_timed(robot, leg, rate), laid) for leg in way.legs]


def _timed(robot, leg: Leg, rate: float) -> tuple[np.ndarray, np.ndarray]:
    straight = len(leg.knots) == 2

    def curve(at: np.ndarray):
        return make_interp_spline(at, leg.knots, k=1) if straight else CubicSpline(at, leg.knots)

    places = np.linspace(0.0, 1.0, len(leg.knots))
    hand = grasp_poses(robot, curve(places)(np.linspace(0.0, 1.0, 20)))[:, :3, 3]
    length = float(np.linalg.norm(np.diff(hand, axis=0), axis=1).sum())
    # A turn on the spot takes its time too: a radian of a joint counts for 10 cm.
    length = max(length, 0.1 * float(np.abs(np.diff(leg.knots, axis=0)).sum(0).max()), 1e-4)
    speed = _BESIDE_ROD if not straight else _IN_AIR
    spline = curve(places * length)
    timing = schedule(robot, Course(spline, length), speed, gently)
    time = np.arange(np.ceil(timing.duration * rate) + 1) / rate
    travel, pace = timing.travel(time)
    return spline(travel), spline(travel, 1) * pace[:, None]


def _joined(path: JointPath, pieces: list[_Piece], rate: float, said: dict) -> JointPath:
    """One path of pieces that end where the next begins; that point is there once."""
    positions, velocities, laid, phases, count = [], [], [], [], 0
    before = 0
    for number, piece in enumerate(pieces):
        first = 0 if number == 0 else 1
        start = max(count - 1, 0)
        if piece.phase == "lay":
            before = start
        positions.append(piece.positions[first:])
        velocities.append(piece.velocities[first:])
        laid.append(np.broadcast_to(piece.laid, len(piece.positions))[first:])
        count += len(piece.positions) - first
        if phases and phases[-1]["name"] == piece.phase:
            phases[-1]["end"] = (count - 1) / rate
        else:
            phases.append({"name": piece.phase, "start": start / rate, "end": (count - 1) / rate})
    metadata = {
        **path.metadata,
        "lay_duration": path.metadata["duration"],
        "duration": (count - 1) / rate,
        "phases": phases,
        **{name: value for name, value in said.items() if value is not None},
    }
    return replace(
        path,
        time=np.arange(count) / rate,
        positions=np.concatenate(positions),
        velocities=np.concatenate(velocities),
        arc_length=np.concatenate(laid),
        node_time=path.node_time + before / rate,
        metadata=metadata,
    )
