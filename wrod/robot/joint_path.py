"""Joint paths: what the arm is sent, solved from a grip trajectory."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import RobotError
from wrod.files import decode_labels, read_fields, write_atomically
from wrod.planning.trajectory import Trajectory
from wrod.robot.grip import Grip
from wrod.robot.model import Robot
from wrod.robot.placement import Placement

_FORMAT = "wrod-joint-path-1"


@dataclass(frozen=True)
class JointPath:
    """Joint positions over time at a fixed rate, in the order of the manufacturer's interface.

    Attributes:
        names: (n,) joints, from base to hand (`right_j0` ... `right_j6`).
        time: (T,) [s], evenly spaced from 0.
        positions: (T, n) [rad].
        velocities: (T, n) [rad/s].
        arc_length: (T,) length of rod that lies on the table [m].
        node_time: (N,) when each node of the trajectory is passed [s].
        node_positions: (N, n) joint positions at the trajectory's nodes [rad].
        placement: where the pattern lies before the robot.
        grip: how the gripper holds the rod.
        robot: the arm, with its gripper; None after `load`.
        metadata: settings, errors and margins; plain JSON values. `largest_step` [rad] is between
            nodes, `largest_turn` [rad] that of the rod's frame between nodes, which the last joint
            must follow, and `step_beyond_turn` [rad per 5 mm of the grip's way] the rest.
    """

    names: tuple[str, ...]
    time: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    arc_length: np.ndarray
    node_time: np.ndarray
    node_positions: np.ndarray
    placement: Placement
    grip: Grip
    robot: Robot | None = None
    metadata: dict = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def phases(self) -> list[dict]:
        """What the arm does when, in order: {"name", "start" [s], "end" [s]}; names are those of
        `wrod.robot.job.PHASES`. The hand closes in "grasp" and opens in "release"."""
        whole = [{"name": "lay", "start": 0.0, "end": float(self.time[-1])}]
        return self.metadata.get("phases", whole)

    def phase_at(self, time: float) -> str:
        """Name of the phase at a time [s]."""
        late = [p["name"] for p in self.phases if p["start"] <= time + 1e-9]
        return late[-1] if late else self.phases[0]["name"]

    def save(self, path: str | os.PathLike[str]) -> list[Path]:
        """Write `path` as CSV (fixed rate) and NPZ (also the nodes). Returns both paths."""
        path = Path(path)

        def write_csv(file):
            file.write(f"# {_FORMAT} {json.dumps(self.metadata, sort_keys=True)}\n")
            writer = csv.writer(file)
            writer.writerow(["time [s]", *(f"{name} [rad]" for name in self.names)])
            rows = np.column_stack([self.time, self.positions])
            writer.writerows([[f"{value:.9g}" for value in row] for row in rows])

        def write_npz(file):
            place = self.placement
            np.savez_compressed(
                file,
                format=_FORMAT,
                names=np.array(self.names),
                time=self.time,
                positions=self.positions,
                velocities=self.velocities,
                arc_length=self.arc_length,
                node_time=self.node_time,
                node_positions=self.node_positions,
                placement=np.array([place.x, place.y, place.z, place.yaw]),
                grip=np.array([self.grip.angle, self.grip.roll]),
                units="SI: s, rad, m",
                metadata=json.dumps(self.metadata, sort_keys=True),
            )

        return [
            write_atomically(path.with_suffix(".csv"), write_csv),
            write_atomically(path.with_suffix(".npz"), write_npz, "wb"),
        ]

    @classmethod
    def load(cls, path: str | os.PathLike[str], robot: Robot | None = None) -> JointPath:
        """Read a joint path's NPZ file.

        Raises:
            DataError: the file is missing, truncated or not a joint path.
        """
        data = read_fields(path, "JointPath")
        label, what = data.pop("metadata"), "the metadata of a joint path"
        placement, grip = data.pop("placement"), data.pop("grip")
        return cls(
            placement=Placement(*map(float, placement)),
            grip=Grip(*map(float, grip)),
            robot=robot,
            metadata=decode_labels(label, dict, f"{path}: metadata", what),
            **data,
        )


@arguments.checked(
    RobotError,
    trajectory=arguments.like("a wrod.Trajectory", "arc_length", "position", "rotation"),
    robot=arguments.either(arguments.path, arguments.like("a Robot", "joint_names", "chain")),
    grip_angle=arguments.either(arguments.text, arguments.number(-1e3, 1e3)),
    gripper_length=arguments.optional(arguments.number(1e-3, 10.0)),
    flange=arguments.optional(arguments.text),
    tip=arguments.optional(arguments.text),
    table_height=arguments.optional(arguments.number(-10.0, 10.0)),
    obstacles=arguments.optional(arguments.like("a wrod.robot.Obstacles", "shapes", "capsules")),
    placement=arguments.either(
        arguments.text, arguments.like("a Placement", "x", "y", "yaw"), arguments.array((4,))
    ),
    grip_speed=arguments.number(1e-4, 10.0),
    rate=arguments.number(1.0, 1e4),
    limit_margin=arguments.number(0.0, 3.0),
    clearance=arguments.number(0.0, 1.0),
    rod_radius=arguments.number(1e-6, 1.0),
)
def solve_joint_path(
    trajectory: Trajectory,
    robot: str | os.PathLike[str] | Robot = "sawyer",
    placement="auto",
    *,
    grip_angle: float | str = "auto",
    gripper_length: float | None = None,
    flange: str | None = None,
    tip: str | None = None,
    table_height: float | None = None,
    obstacles=None,
    grip_speed: float = 0.02,
    rate: float = 100.0,
    limit_margin: float = 0.02,
    clearance: float = 0.005,
    rod_radius: float = 0.004,
    whole_job: bool = False,
) -> JointPath:
    """Joint path of an arm that moves the grip along a trajectory.

    Many inverse kinematics branches are followed along the path at once; the best are improved by
    the freedom that the grip leaves the arm, checked between the nodes as well as at them, and
    timed. See `wrod.robot` for the steps.

    Args:
        trajectory: grip poses [m].
        robot: "sawyer", a URDF file, or a `Robot`.
        placement: "auto", or the pose of the trajectory's frame in the robot's base: a
            `Placement`, four numbers (x, y, z [m], yaw [rad]), or "x,y,z,yaw in degrees". z is
            the table's height.
        grip_angle: between the fingers and the rod that leaves the gripper [rad], 0 (the rod's end
            lies along the fingers) to pi/2 (the rod crosses them), or "auto": the smallest that
            works. The gripper's roll about the rod is constant.
        gripper_length: from the flange to the grasp point [m], 0.15 by default.
        flange, tip: link that carries the gripper, or the arm's own grasp point (see `load_robot`).
        table_height: from the robot's base [m], where the placement is "auto"; None tries a few.
        obstacles: `Obstacles` that the arm must keep clear of.
        grip_speed: along the path [m/s], a turn of one radian counting as 5 cm.
        rate: of the output [1/s].
        limit_margin: least distance from the joint limits [rad].
        clearance: least gap between links, table, pedestal and laid rod [m].
        rod_radius: [m] of the laid rod.
        whole_job: begin and end in a neutral pose, with approach, grasp, release and retreat around
            the laying (see `JointPath.phases`); where there is no way, a warning says why and the
            path begins and ends at the rod.

    Raises:
        RobotError: the robot cannot be loaded, or no joint path was found: the sentence names the
            node, what fails there and by how much.
    """
    from wrod.robot.solve import solve

    return solve(
        trajectory,
        robot,
        placement,
        grip_angle=grip_angle,
        gripper_length=gripper_length,
        flange=flange,
        tip=tip,
        table_height=table_height,
        obstacles=obstacles,
        grip_speed=grip_speed,
        rate=rate,
        limit_margin=limit_margin,
        clearance=clearance,
        rod_radius=rod_radius,
        whole_job=whole_job,
    )
