"""Joint paths: what the arm is sent."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wrod.arguments import checked, shown
from wrod.errors import DataError
from wrod.files import check_arrays, decode_labels, read_fields, suffixed, write_csv, write_npz
from wrod.records import brief, freeze, plain
from wrod.robot.grip import Grip
from wrod.robot.model import Robot
from wrod.robot.placement import Placement
from wrod.robot.urdf import LinkShape

_FORMAT = "wrod-joint-path-1"
_ARRAYS = ("time", "positions", "velocities", "arc_length", "node_time", "node_positions")


@brief
@dataclass(frozen=True, eq=False)
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
        obstacles: shapes that it keeps clear of, in its base's frame [m]; none after `load`.
        metadata: settings, errors and margins; plain JSON values. `largest_step` [rad] is between
            nodes, `largest_turn` [rad] that of the rod's frame between nodes, which the last joint
            must follow, and `step_beyond_turn` [rad per 5 mm of the grip's way] the rest.

    Raises:
        DataError: an array is not as docs/formats.md has it of a joint path's file.
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
    obstacles: tuple[LinkShape, ...] = ()

    def __post_init__(self):
        for name, kind in (("placement", Placement), ("grip", Grip)):
            if not isinstance(getattr(self, name), kind):
                raise DataError(f"JointPath: {name} must be a {kind.__name__}")
        robot = self.robot
        if robot is not None and not (hasattr(robot, "joint_names") and hasattr(robot, "urdf")):
            raise DataError(f"JointPath: robot is {shown(robot)}; it must be a Robot")
        object.__setattr__(self, "metadata", plain(self.metadata, "JointPath: metadata"))
        found = check_arrays(self._arrays(), "JointPath", "JointPath")
        freeze(self, {name: found[name] for name in ("names", *_ARRAYS)})

    def _arrays(self) -> dict:
        """What its file holds, but for the units."""
        place = self.placement
        return {
            "format": _FORMAT,
            "names": self.names,
            **{name: getattr(self, name) for name in _ARRAYS},
            "placement": np.array([place.x, place.y, place.z, place.yaw]),
            "grip": np.array([self.grip.angle, self.grip.roll]),
            "metadata": json.dumps(self.metadata, sort_keys=True),
        }

    def __len__(self) -> int:
        return len(self.time)

    @property
    def rate(self) -> float:
        """Poses per second [Hz]."""
        return float(self.metadata["rate"])

    @property
    def pace(self) -> float:
        """Of the contact while it lays, as `wrod.pose_times` has it [m/s]."""
        return self.metadata["pace"]

    @property
    def steady_pace(self) -> float:
        """The pace that the arm could keep all along the laying [m/s]; less than `pace` where its
        limits ask for less somewhere."""
        return self.metadata["steady_pace"]

    @property
    def slowed(self) -> dict:
        """By how much "most" it lays more slowly than at its pace [-], and the stretches "at"
        [from, to] of the laid length [m] where it does, for the arm's limits."""
        return self.metadata["slowed"]

    @property
    def limit_margin(self) -> float:
        """Least distance of a joint from its limits [rad]."""
        return self.metadata["limit_margin"]

    @property
    def stand(self) -> list:
        """Capsules of what holds the rod until the hand does: start (3,) and end (3,) in the
        table's frame, radius [m]; empty where there is no room for one."""
        return self.metadata.get("stand", [])

    @property
    def stand_stays(self) -> bool:
        """Whether the stand is out of the way of all that follows; if not, it has to be taken away
        once the hand has the rod."""
        return bool(self.metadata.get("stand_stays"))

    @property
    def neutral(self) -> list[float] | None:
        """(n,) joint positions that it comes from and goes back to [rad]; None for the laying
        alone."""
        return self.metadata.get("neutral")

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

    def holds_stand(self, time: float) -> bool:
        """Whether the rod's stand is there at a time [s]: throughout, if it is in nobody's way, and
        else until the hand has the rod."""
        if not self.stand:
            return False
        grasped = next(phase["end"] for phase in self.phases if phase["name"] == "grasp")
        return self.stand_stays or time <= grasped + 1e-9

    @checked(DataError)
    def save(self, path: str | os.PathLike[str]) -> list[Path]:
        """Write `path` as CSV (fixed rate) and NPZ (also the nodes). Returns both paths."""
        csv, content = suffixed(path, ".csv"), self._arrays()
        head = ["time [s]", *(f"{name} [rad]" for name in self.names)]
        rows = np.column_stack([self.time, self.positions])
        said = [[f"{value:.9g}" for value in row] for row in rows]
        return [
            write_csv(csv, head, said, f"{_FORMAT} {content['metadata']}"),
            write_npz(suffixed(path, ".npz"), **content, units="SI: s, rad, m"),
        ]

    @classmethod
    @checked(DataError)
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
