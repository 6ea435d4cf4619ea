"""How the gripper holds the rod, and the path that the grasp then follows.

The rod's frame at the grip (columns of `Trajectory.rotation`) has its tangent first, pointing out
of the suspended rod. The grasp frame has +z along the fingers and closes along y. The pads press
across the rod's axis: y stands perpendicular to the tangent, and the rod lies in the pads' plane,
at `angle` to the fingers: at 0 it leaves the gripper along the fingers, at pi/2 it crosses them.
`roll` turns the gripper about the tangent. Both are constant over a path: an isotropic rod does
not feel which of its sides is held, but a roll that varied would twist it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.arguments import number
from wrod.errors import RobotError
from wrod.planning.pace import GripPath
from wrod.planning.trajectory import Trajectory
from wrod.records import checked_fields

TURN_LENGTH = 0.05  # [m] a turn of one radian counts as this much travel of the grip
_FINE = 20  # pieces between two nodes in which the travel is integrated
_SLOWEST = 1e-3  # [m/m] travel per laid length counts at least so much: the grip may stand still


@checked_fields(RobotError, angle=number(-1e3, 1e3), roll=number(-1e3, 1e3))
@dataclass(frozen=True)
class Grip:
    """A constant hold of the rod.

    Attributes:
        angle: between the fingers and the rod that leaves the gripper [rad].
        roll: of the gripper about the rod's tangent [rad].
    """

    angle: float = 0.0
    roll: float = 0.0

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) grasp frame in the rod's frame at the grip."""
        hold = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # z = -tangent
        tilt = Rotation.from_rotvec([0.0, self.angle, 0.0]).as_matrix()
        return Rotation.from_rotvec([self.roll, 0.0, 0.0]).as_matrix() @ tilt @ hold


class TravelledPath:
    """A trajectory as a smooth curve of poses: C2 splines through its nodes over the arc length.

    Grip poses are smooth functions of the laid length: where the grip swings by centimetres from
    node to node, splines over the laid length stay closest to what a finer plan gives between them.

    Attributes:
        travel: (T,) at the nodes: length of the grip's path, a turn counting `TURN_LENGTH` per
            radian [m]; the curve's parameter. `travel_at` is a spline of it over the laid length.
        grip: its poses over the laid length.
        distance, turn: (T - 1,) from node to node, of the grip [m] and of the rod's frame [rad].
    """

    def __init__(self, trajectory: Trajectory):
        position, arc = trajectory.position, trajectory.arc_length
        if len(position) < 3:
            raise RobotError(f"the trajectory has {len(position)} nodes; a joint path needs three")
        turns = Rotation.from_matrix(trajectory.rotation)
        self.turn = (turns[:-1].inv() * turns[1:]).magnitude()
        self.distance = np.linalg.norm(np.diff(position, axis=0), axis=1)
        self.grip = GripPath(arc, position, trajectory.rotation)
        fine = np.interp(np.arange((len(arc) - 1) * _FINE + 1) / _FINE, np.arange(len(arc)), arc)
        rate = np.hypot(
            np.linalg.norm(self.grip.position(fine, 1), axis=1),
            TURN_LENGTH * np.linalg.norm(self.grip.rotation(fine, 1), axis=1),
        )
        travel = cumulative_simpson(np.maximum(rate, _SLOWEST), x=fine, initial=0.0)
        self._arc, self.travel_at = CubicSpline(travel, fine), CubicSpline(fine, travel)
        self.travel = travel[::_FINE]

    def __len__(self) -> int:
        return len(self.travel)

    def poses(self, travel: np.ndarray) -> np.ndarray:
        """(K, 4, 4) rod's frame at the grip, in the trajectory's frame [m]."""
        poses = np.tile(np.eye(4), (len(travel), 1, 1))
        arc = self.arc_length(travel)
        position, rotation = self.grip(arc)
        poses[:, :3, 3], poses[:, :3, :3] = position, rotation.as_matrix()
        return poses

    def arc_length(self, travel: np.ndarray) -> np.ndarray:
        """(K,) laid length at points of the curve [m]."""
        return np.clip(self._arc(travel), self.grip.first, self.grip.last)

    def node_of(self, travel: float) -> int:
        """Nearest node of a point of the curve."""
        return int(np.abs(self.travel - travel).argmin())

    def samples(self, step: float) -> np.ndarray:
        """Travel of the nodes and of evenly spaced points between them, at most `step` apart."""
        pieces = [
            np.linspace(a, b, max(1, int(np.ceil((b - a) / step))), endpoint=False)
            for a, b in zip(self.travel[:-1], self.travel[1:], strict=True)
        ]
        return np.concatenate([*pieces, self.travel[-1:]])


def grasp_targets(poses: np.ndarray, grip: Grip, base_from_world: np.ndarray) -> np.ndarray:
    """Rod frames (K, 4, 4) in the trajectory's frame -> grasp poses in the robot's base frame."""
    targets = base_from_world @ poses
    targets[:, :3, :3] = targets[:, :3, :3] @ grip.rotation
    return targets
