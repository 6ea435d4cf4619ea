"""Where the pattern lies on the table before the robot: given, or chosen from a grid."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wrod.arguments import ONCE_ROUND, number, shown
from wrod.errors import RobotError
from wrod.planning.trajectory import Trajectory
from wrod.robot.capsules import capsules_of
from wrod.robot.model import Robot

PEDESTAL_ROOM = 0.08  # [m] the table begins this far from the shapes that do not move
TABLE_MARGIN = 0.06  # [m] of table around the pattern
_UNDER = 0.05  # [m] what ends so far below the top of a table stands under it


# No arm reaches further [m].
_FARTHEST = 100.0


@dataclass(frozen=True)
class Placement:
    """Pose of the trajectory's frame (the pattern, on the table at z = 0) in the robot's base.

    Attributes:
        x, y: origin of the pattern [m].
        z: height of the table, from the robot's base [m].
        yaw: rotation about the vertical [rad].
    """

    x: float
    y: float
    z: float
    yaw: float = 0.0

    def __post_init__(self) -> None:
        given = (self.x, self.y, self.z, self.yaw)
        if any(number(-_FARTHEST, _FARTHEST)(one) for one in given):
            raise RobotError(
                f"placement {shown(given)}: give finite numbers, metres and an angle, within "
                f"{_FARTHEST:g}"
            )

    @property
    def base_from_world(self) -> np.ndarray:
        """(4, 4) trajectory frame -> base frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s, 0, self.x], [s, c, 0, self.y], [0, 0, 1, self.z], [0, 0, 0, 1.0]])

    @property
    def world_from_base(self) -> np.ndarray:
        """(4, 4) pose of the robot's base in the trajectory's frame."""
        return np.linalg.inv(self.base_from_world)

    def to_base(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the trajectory's frame in the base frame [m]."""
        pose = self.base_from_world
        return points @ pose[:3, :3].T + pose[:3, 3]

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the base frame in the trajectory's frame [m]."""
        pose = self.world_from_base
        return points @ pose[:3, :3].T + pose[:3, 3]

    def __str__(self) -> str:
        return (
            f"x {self.x:.3f} m, y {self.y:.3f} m, table {self.z:.3f} m, "
            f"yaw {math.degrees(self.yaw):.1f} degrees"
        )

    @classmethod
    def parse(cls, value) -> Placement:
        """Placement from itself, four numbers (x, y, z [m], yaw [rad]) or "x,y,z,yaw in degrees".

        Raises:
            RobotError: it is none of these.
        """
        if isinstance(value, Placement):
            return value
        try:
            if isinstance(value, str):
                x, y, z, yaw = (float(word) for word in value.split(","))
                yaw = math.radians(yaw)
            else:
                x, y, z, yaw = (float(number) for number in value)
        except (TypeError, ValueError, OverflowError):
            raise RobotError(
                f"placement {value!r:.80} is not 'auto' and not x,y,z,yaw: position of the "
                "pattern's origin from the robot's base [m], with z the table's height, and yaw"
            ) from None
        if abs(yaw) > ONCE_ROUND:
            raise RobotError(
                f"placement {shown(value)} has a yaw of {yaw:.3g} rad, more than once round; in "
                "text it is in degrees, in four numbers in radians"
            )
        return cls(x, y, z, yaw)


def reach(robot: Robot) -> tuple[np.ndarray, float]:
    """Shoulder point in the base frame (3,) [m] and greatest distance of the grasp from it [m]."""
    frames = robot.link_poses(np.zeros(len(robot.joint_names)))
    moved = {joint.get("name"): link for link, (_, joint) in robot.urdf.above.items()}
    points = [frames[moved[name]][0, :3, 3] for name in robot.joint_names]
    points.append(frames[robot.tip][0, :3, 3])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return points[1], float(steps[1:].sum())


def foot(robot: Robot) -> np.ndarray:
    """(3,) where an arm that stands upright, and has its shoulder where this one has it, would be
    mounted, in the base frame [m]; heights are measured from there also of an arm that hangs."""
    mount = robot.mount
    shoulder, _ = reach(robot)
    return np.append(mount[:2, 3], shoulder[2] - mount[:3, 2] @ (shoulder - mount[:3, 3]))


@dataclass(frozen=True)
class Places:
    """What an arm reaches for: (n, 3) on the table and (m, 3) positions of the hand [m]."""

    contact: np.ndarray
    position: np.ndarray


def pedestal_clearance(robot: Robot, height: float) -> float:
    """Distance from the arm's axis at which a table begins whose top is at `height` [m]. What
    does not reach up to it, as the wide foot of a pedestal, stands under the table."""
    poses = robot.link_poses(np.zeros(len(robot.joint_names)))
    fixed, above = {robot.base}, robot.urdf.above.items()
    for _ in above:
        fixed |= {x for x, (up, joint) in above if up in fixed and joint.get("type") == "fixed"}
    reach = 0.0
    for shape in robot.shapes("collision"):
        if shape.link in fixed:
            pose = poses[shape.link][0]
            for *ends, radius in capsules_of(shape):
                points = np.stack(ends) @ pose[:3, :3].T + pose[:3, 3]
                if points[:, 2].max() + radius > height - _UNDER:
                    out = np.abs(points[:, 0] - robot.mount[0, 3]).max()
                    reach = max(reach, float(out) + radius)
    return reach + PEDESTAL_ROOM - 0.02


def off_pedestal(
    robot: Robot, trajectory: Trajectory | Places, height: float
) -> Callable[[Placement], bool]:
    """Whether at a placement nothing is laid where the arm stands, of tables of about `height`."""
    axis, clearance = foot(robot)[:2], pedestal_clearance(robot, height)

    def keeps_off(placement: Placement) -> bool:
        out = placement.to_base(trajectory.contact)[:, :2] - axis
        return bool(np.linalg.norm(out, axis=1).min() >= clearance)

    return keeps_off


def candidates(
    trajectory: Trajectory | Places,
    robot: Robot,
    count: int = 24,
    heights: tuple[float, ...] | None = None,
) -> list[Placement]:
    """Placements worth trying, the most central first.

    A grid of positions, table heights and turns is ranked by how far the grip stays from the ends
    of the arm's reach, keeping the table off the pedestal. Both are measured from where the arm
    is mounted; the placements, and `heights`, from the base.

    Args:
        heights: of the table [m]; None those of the robot.
    """
    shoulder, far = reach(robot)
    mount = foot(robot)
    if heights is None:
        heights = tuple(float(mount[2]) + height for height in robot.table_heights)
    clearances = {height: pedestal_clearance(robot, height) for height in heights}
    middle = (trajectory.contact[:, :2].min(0) + trajectory.contact[:, :2].max(0)) / 2
    grid = itertools.product(
        np.arange(0.45, 0.8, 0.07) * far / 1.3,
        np.array([-0.25, -0.1, 0.05, 0.2]) * min(far / 1.3, 1.0),
        heights,
        np.arange(8) * math.pi / 4,
    )
    ranked = []
    for radius, side, height, yaw in grid:
        turned = Placement(0.0, 0.0, 0.0, yaw).base_from_world[:2, :2] @ middle
        x, y = float(mount[0] + radius - turned[0]), float(mount[1] + side - turned[1])
        placement = Placement(x, y, float(height), float(yaw))
        out = placement.to_base(trajectory.contact)[:, :2] - mount[:2]
        near, clearance = np.linalg.norm(out, axis=1).min(), clearances[height]
        if near < clearance + TABLE_MARGIN or out[:, 0].min() < clearance:
            continue
        grip = placement.to_base(trajectory.position)
        distance = np.linalg.norm(grip - shoulder, axis=1) / far
        ranked.append((max(distance.max() - 0.62, 0.38 - distance.min()), placement))
    ranked.sort(key=lambda item: item[0])
    return [placement for _, placement in ranked[:count]]
