"""Ways of an arm whose hand is empty: up from the table, through the air, down to the next rod."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.patterns.curve import smoothstep
from wrod.robot.arm import Arm
from wrod.robot.kinematics import refine, solve_poses
from wrod.robot.model import Robot

BACK = 0.06  # [m] a hand moves back along its fingers before it goes elsewhere
_SHORTER = (0.045, 0.03)  # [m] where it cannot; pads end 25 mm behind the rod's end
_ASIDE = 0.03  # [m] and pads are 18 mm wide
_SHARE = 0.6  # of the joints' speed limits that empty hands use
_LINE_SPEED, _HAND_SPEED = 0.08, 0.6  # [m/s] of hands beside a rod, and in the air
_CHECKED = 0.04  # [rad] between the points of a way that are checked
_SEEDS = 24
# Where an arm may wait: distance of the grasp from its base, height above the table [m], and its
# bearing off the table's middle [degrees].
_PARKED = [
    (r, h, b) for b in (60, -60, 85, -85, 110, -110) for r in (0.36, 0.44) for h in (0.35, 0.45)
]
_TURNED = 0.05  # [m/rad] of reach over the table that less turning aside is worth
_VIAS, _SPREAD = 60, 0.7  # random ways round obstacles, their deviation [rad]


@dataclass(frozen=True)
class Leg:
    """A part of a way, from rest to rest.

    Attributes:
        knots: (m, n) joint positions evenly over it [rad].
        duration: [s].
    """

    knots: np.ndarray
    duration: float

    def at(self, u: np.ndarray) -> np.ndarray:
        """(k, n) joint positions at shares u (k,) of the duration."""
        share = smoothstep(u)
        places = np.linspace(0.0, 1.0, len(self.knots))
        if len(self.knots) == 2:
            return self.knots[0] + share[:, None] * (self.knots[1] - self.knots[0])
        return CubicSpline(places, self.knots)(share)


@dataclass(frozen=True)
class Transit:
    """Legs one after the other."""

    legs: tuple[Leg, ...]

    @property
    def duration(self) -> float:
        return sum(leg.duration for leg in self.legs)

    def at(self, time: np.ndarray) -> np.ndarray:
        """(k, n) joint positions at times (k,) [s]; at rest before and after."""
        out = np.repeat(self.legs[0].knots[:1], len(time), axis=0)
        begin = 0.0
        for leg in self.legs:
            here = time >= begin
            out[here] = leg.at((time[here] - begin) / leg.duration)
            begin += leg.duration
        return out


def _points(knots: np.ndarray) -> np.ndarray:
    """(k, n) points of a leg that are near each other."""
    way = np.abs(np.diff(knots, axis=0)).max(1).sum()
    return Leg(knots, 1.0).at(np.linspace(0.0, 1.0, max(3, int(2 * way / _CHECKED))))


def _timed(arm: Arm, knots: np.ndarray, speed: float = _HAND_SPEED) -> Leg:
    """With the speeds and accelerations of a smoothstep within the limits of joints and hand."""
    way = np.abs(np.diff(knots, axis=0)).sum(0)
    fast = (1.875 * way / (_SHARE * arm.robot.velocity)).max()
    hard = np.sqrt(5.774 * way / arm.robot.acceleration).max()
    hand = arm.grasps(_points(knots))[:, :3, 3]
    step = np.linalg.norm(np.diff(hand, axis=0), axis=1).max()
    return Leg(knots, float(max(fast, hard, step * (len(hand) - 1) / speed, 0.2)))


def reaching_down(along: np.ndarray) -> np.ndarray:
    """(3, 3) of a hand over the table whose fingers close along a horizontal direction (3,)."""
    down = [0.0, 0.0, -1.0]
    return np.column_stack([np.cross(along, down), along, down])


def seeds(robot: Robot, count: int) -> np.ndarray:
    """(count, n) joint positions [rad] from which such a hand is sought, the same each time."""
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return np.random.default_rng(3).uniform(0.8 * lower, 0.8 * upper, (count, len(lower)))


def park(arm: Arm, middle: np.ndarray) -> np.ndarray:
    """(n,) joint positions where an arm waits: turned aside, hand down, drawn back from the table.

    Args:
        middle: (3,) of the table [m].

    Raises:
        RobotError: there is no such pose.
    """
    mount = arm.robot.mount[:2, 3]
    local = (arm.placement.base_from_world @ [*middle, 1.0])[:2] - mount
    ahead = np.array([*local / np.linalg.norm(local), 0.0])
    poses = np.tile(np.eye(4), (len(_PARKED), 1, 1))
    for pose, (reach, height, off) in zip(poses, _PARKED, strict=True):
        along = Rotation.from_euler("z", off, degrees=True).apply(ahead)
        pose[:3, :3] = reaching_down(along)
        pose[:3, 3] = reach * along + [*mount, arm.placement.z + height]
    found, reached = solve_poses(arm.robot, poses, seeds(arm.robot, _SEEDS))
    room = np.minimum(found - arm.robot.lower, arm.robot.upper - found).min(-1)
    choice, seed = np.nonzero(reached & (room > 0.15))
    q = found[choice, seed]
    if len(q):
        rooms = arm.rooms(q)
        start, end = (p @ ahead for p in arm.in_base(arm.capsules(q))[:2])
        over = (np.maximum(start, end) + arm.model.radius).max(1)
        cost = over + _TURNED * np.radians(np.abs(np.array(_PARKED)[choice, 2]))
        cost[(rooms["links"] < 0.03) | (rooms["table"] < 0.05)] = np.inf
        if np.isfinite(cost).any():
            return q[int(cost.argmin())]
    raise RobotError(
        f"an arm at {arm.placement} has no pose in which it could wait; place it nearer"
    )


def retreat(arm: Arm, positions: np.ndarray) -> Leg | None:
    """Straight back along the fingers from joint positions (n,), as far as `BACK` where the arm
    can, and at least so far that the pads are off the rod; where it cannot, aside, so that the rod
    leaves the pads between them. None if it can neither."""
    ways = [((0.0, 0.0, -1.0), back) for back in (BACK, *_SHORTER)]
    ways += [((side, 0.0, 0.0), _ASIDE) for side in (1.0, -1.0)]
    for direction, distance in ways:
        leg = _straight(arm, positions, np.array(direction), distance)
        if leg is not None:
            return leg
    return None


def _straight(arm: Arm, positions: np.ndarray, direction, distance: float) -> Leg | None:
    """A straight way of the grasp along a direction in its own frame, which it does not turn."""
    start = arm.grasps(positions[None])[0]
    steps = np.linspace(0.0, distance, 5)
    poses = np.repeat(start[None], len(steps), axis=0)
    poses[:, :3, 3] += steps[:, None] * (start[:3, :3] @ direction)
    goals = arm.placement.base_from_world @ poses
    knots = [positions]
    for goal in goals[1:]:
        q, error = refine(arm.robot, knots[-1][None], goal[None])
        if np.abs(error).max() > 1e-4:
            return None
        knots.append(q[0])
    knots = np.array(knots)
    room = np.minimum(knots - arm.robot.lower, arm.robot.upper - knots)
    return None if room.min() < 0.0 else _timed(arm, knots, _LINE_SPEED)


def find_way(
    arm: Arm,
    first: np.ndarray,
    last: np.ndarray,
    *,
    leave: bool,
    arrive: bool,
    wait: np.ndarray | None = None,
    other=None,
) -> Transit | None:
    """A way between joint positions (n,) that keeps clear of the table and the arm's own links.

    Args:
        first, last: where it begins and ends [rad].
        leave, arrive: whether a rod is there, from which the hand moves straight back.
        wait: where the arm passes on the way; None: nowhere.
        other: capsules of another arm that stands still, which is kept clear of, too.

    Returns:
        None if none was found.
    """
    back = retreat(arm, first) if leave else None
    ahead = retreat(arm, last) if arrive else None
    if (leave and back is None) or (arrive and ahead is None):
        return None
    legs = [back] if back else []
    stops = [back.knots[-1] if back else first, ahead.knots[-1] if ahead else last]
    if wait is not None:
        stops.insert(1, wait)
    for a, b in pairwise(stops):
        if np.abs(b - a).max() > 1e-9:
            part = _through_air(arm, a, b, other)
            if part is None:
                return None
            legs += part
    if ahead:
        legs.append(Leg(ahead.knots[::-1], ahead.duration))
    return Transit(tuple(legs)) if legs else Transit((Leg(np.stack([first, last]), 0.2),))


def _through_air(arm: Arm, a: np.ndarray, b: np.ndarray, other) -> list[Leg] | None:
    """Straight in the joints' space, or round what is in the way; None if neither."""
    straight = np.stack([a, b])
    if arm.clear(_points(straight), other).all():
        return [_timed(arm, straight)]
    rng = np.random.default_rng(5)
    lower, upper = np.maximum(arm.robot.lower, -4.7), np.minimum(arm.robot.upper, 4.7)
    vias = (a + b) / 2 + _SPREAD * rng.standard_normal((_VIAS, len(a)))
    vias = np.clip(vias, lower + 0.1, upper - 0.1)
    shortest = np.argsort(np.maximum(np.abs(vias - a), np.abs(vias - b)).max(1))
    for via in vias[shortest[arm.clear(vias[shortest], other)]]:
        ways = [np.stack([a, via]), np.stack([via, b])]
        if arm.clear(np.concatenate([_points(way) for way in ways]), other).all():
            return [_timed(arm, way) for way in ways]
    return None
