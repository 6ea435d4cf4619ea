"""Joint paths in the formats that robots' own software reads."""

import csv
import io
import json
import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError, needed_extras
from wrod.files import write_atomically
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import grasp_poses
from wrod.rods.rotation import one_hemisphere

# name -> (file, what it is)
FORMATS = {
    "ros-yaml": "trajectory_msgs.yaml",
    "ros-json": "trajectory_msgs.json",
    "mcap": "trajectory.mcap",
    "urscript": "path.script",
    "libfranka": "libfranka.csv",
    "intera": "intera.csv",
    "poses": "poses.csv",
    "phases": "phases.json",
}
_UR_STEP = 0.008  # [s] of servoj: the arm's own rate is a multiple of 125 / s


def accelerations(path: JointPath) -> np.ndarray:
    """(T, n) joint accelerations [rad/s^2], differences of the velocities."""
    if len(path.time) < 3:
        return np.zeros_like(path.velocities)
    return np.gradient(path.velocities, path.time, axis=0, edge_order=2)


@needed_extras()
def export(path: JointPath, folder: str | os.PathLike[str], formats: list[str]) -> list[Path]:
    """Write a joint path in each of some formats; see `FORMATS`.

    Args:
        path: with its robot, for "poses".

    Raises:
        RobotError: an unknown format, a missing library, or an arm that the format is not for.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise RobotError(
            f"unknown format {unknown[0]!r}; known formats: {', '.join(FORMATS)} (or all)"
        )
    writers: dict[str, Callable[[JointPath], bytes]] = {
        "ros-yaml": lambda p: _yaml(ros_message(p)).encode(),
        "ros-json": lambda p: (json.dumps(ros_message(p), indent=1) + "\n").encode(),
        "mcap": _mcap,
        "urscript": lambda p: urscript(p).encode(),
        "libfranka": lambda p: _table(p, "libfranka").encode(),
        "intera": lambda p: _table(p, "intera").encode(),
        "poses": lambda p: _poses(p).encode(),
        "phases": lambda p: (json.dumps(phases(p), indent=1) + "\n").encode(),
    }
    # All are made before any is written: nothing is left behind half.
    made = [(Path(folder) / FORMATS[name], writers[name](path)) for name in formats]
    return [_written(file, data) for file, data in made]


def _written(path: Path, data: bytes) -> Path:
    return write_atomically(path, lambda file: file.write(data), "wb")


def suited(path: JointPath) -> list[str]:
    """The formats that suit a joint path's arm, of those whose libraries are there."""
    names = ["ros-yaml", "ros-json", "poses", "phases"]
    names += ["mcap"] * (find_spec("mcap") is not None)
    # Joints bear the makers' names in all descriptions, with prefixes.
    names += ["urscript"] * path.names[-1].endswith("wrist_3_joint")
    names += ["libfranka"] * any(arm in path.names[0] for arm in ("panda", "fr3", "fer", "franka"))
    names += ["intera"] * (path.names[0] == "right_j0")
    return names


def phases(path: JointPath) -> dict:
    """What the arm does when, and when its gripper closes and opens [s]; plain values.

    Times are those of every other format of the same path.
    """
    found = {p["name"]: p for p in path.phases}
    gripper = [
        {"time": found[name]["start"], "command": command}
        for name, command in (("grasp", "close"), ("release", "open"))
        if name in found
    ]
    return {"format": "wrod-phases-1", "phases": path.phases, "gripper": gripper, "units": "s"}


def ros_message(path: JointPath) -> dict:
    """The path as a `trajectory_msgs/msg/JointTrajectory`, plain values."""
    second = accelerations(path)
    points = []
    for k, time in enumerate(path.time):
        whole, nano = divmod(round(float(time) * 1e9), 10**9)
        points.append(
            {
                "positions": [round(float(v), 9) for v in path.positions[k]],
                "velocities": [round(float(v), 9) for v in path.velocities[k]],
                "accelerations": [round(float(v), 9) for v in second[k]],
                "effort": [],
                "time_from_start": {"sec": whole, "nanosec": nano},
            }
        )
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(path.names),
        "points": points,
    }


def _yaml(message: dict) -> str:
    """The message as YAML: every point on lines of its own, numbers in flow style."""
    stamp = message["header"]["stamp"]
    lines = [
        "header:",
        f"  stamp: {{sec: {stamp['sec']}, nanosec: {stamp['nanosec']}}}",
        '  frame_id: ""',
        f"joint_names: [{', '.join(message['joint_names'])}]",
        "points:",
    ]
    for point in message["points"]:
        start = point["time_from_start"]
        lines += [
            f"- positions: [{_row(point['positions'])}]",
            f"  velocities: [{_row(point['velocities'])}]",
            f"  accelerations: [{_row(point['accelerations'])}]",
            "  effort: []",
            f"  time_from_start: {{sec: {start['sec']}, nanosec: {start['nanosec']}}}",
        ]
    return "\n".join(lines) + "\n"


def _row(values) -> str:
    return ", ".join(f"{float(value):.9f}" for value in values)


def _mcap(path: JointPath) -> bytes:
    """One JSON message of the ROS type on the topic /joint_trajectory, and the name of every phase
    when it begins on /phase."""
    from mcap.writer import Writer

    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start(profile="", library="wrod")
    number = {"type": "array", "items": {"type": "number"}}
    point = {name: number for name in ("positions", "velocities", "accelerations", "effort")}
    point["time_from_start"] = {
        "type": "object",
        "properties": {"sec": {"type": "integer"}, "nanosec": {"type": "integer"}},
    }
    schema = {
        "type": "object",
        "properties": {
            "header": {"type": "object"},
            "joint_names": {"type": "array", "items": {"type": "string"}},
            "points": {"type": "array", "items": {"type": "object", "properties": point}},
        },
    }
    kind = writer.register_schema(
        "trajectory_msgs/JointTrajectory", "jsonschema", json.dumps(schema).encode()
    )
    channel = writer.register_channel("/joint_trajectory", "json", kind)
    writer.add_message(channel, 0, json.dumps(ros_message(path)).encode(), 0)
    text = {"type": "object", "properties": {"data": {"type": "string"}}}
    word = writer.register_schema("std_msgs/String", "jsonschema", json.dumps(text).encode())
    topic = writer.register_channel("/phase", "json", word)
    for phase in path.phases if len(path.phases) > 1 else ():
        at = round(1e9 * phase["start"])
        writer.add_message(topic, at, json.dumps({"data": phase["name"]}).encode(), at)
    writer.finish()
    return buffer.getvalue()


def urscript(path: JointPath) -> str:
    """A URScript program: to the start in the joints, then `servoj` at the controller's pace.

    Raises:
        RobotError: the arm has no six joints.
    """
    if len(path.names) != 6:
        raise RobotError(
            f"URScript moves arms of six joints, and this one has {len(path.names)}; choose "
            "another format"
        )
    time = np.arange(0.0, path.time[-1] + _UR_STEP / 2, _UR_STEP)
    rows = np.column_stack([np.interp(time, path.time, q) for q in path.positions.T])
    starts = [phase["start"] for phase in path.phases]
    calls = {"grasp": "  wrod_close()", "release": "  wrod_open()"}
    lines = []
    if len(starts) > 1:
        # The gripper's own commands differ from maker to maker.
        lines += [
            "def wrod_close():",
            '  textmsg("close the gripper")  # put its command here; it has a second',
            "end",
            "def wrod_open():",
            '  textmsg("open the gripper")  # put its command here; it has a second',
            "end",
        ]
    lines += [
        "def wrod_path():",
        "  # Written by wrod: check it at reduced speed first. Units: rad, s.",
        f"  movej([{_row(rows[0])}], a=0.5, v=0.3)",
        f"  # {len(rows)} points, {_UR_STEP} s apart",
    ]
    number = 0
    for at, q in zip(time, rows, strict=True):
        while number < len(starts) and at >= starts[number] - 1e-9:
            name = path.phases[number]["name"]
            lines.append(f"  # {name}")
            if name in calls:
                lines.append(calls[name])
            number += 1
        lines.append(f"  servoj([{_row(q)}], t={_UR_STEP}, lookahead_time=0.1, gain=300)")
    return "\n".join([*lines, "  stopj(1.0)", "end", ""])


def _table(path: JointPath, kind: str) -> str:
    """CSV: for libfranka every millisecond with velocities, for intera its own column names."""
    if kind == "intera":
        return _csv(["time", *path.names], np.column_stack([path.time, path.positions]))
    if len(path.names) != 7:
        raise RobotError(
            f"libfranka moves arms of seven joints, and this one has {len(path.names)}; choose "
            "another format"
        )
    curve = CubicHermiteSpline(path.time, path.positions, path.velocities)
    time = np.round(np.arange(0.0, path.time[-1] + 5e-4, 1e-3), 6)
    time = np.minimum(time, path.time[-1])
    names = [f"q{k + 1}" for k in range(7)] + [f"dq{k + 1}" for k in range(7)]
    return _csv(["time", *names], np.column_stack([time, curve(time), curve(time, 1)]))


def _csv(head: list[str], rows: np.ndarray) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([head, *([f"{value:.9g}" for value in row] for row in rows)])
    return text.getvalue()


def _poses(path: JointPath) -> str:
    """CSV of timed poses of the grasp in the robot's base frame, unit quaternions x, y, z, w."""
    if path.robot is None:
        raise RobotError("poses need the robot; load the joint path with it")
    poses = grasp_poses(path.robot, path.positions)
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = np.column_stack([path.time, poses[:, :3, 3], one_hemisphere(turns)])
    return _csv(["time [s]", "x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw"], rows)
