import dataclasses
import json
import re

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.robot.grip import Grip
from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import grasp_poses
from wrod.robot.model import load_robot
from wrod.robot.outputs import FORMATS, accelerations, export, ros_message, suited
from wrod.robot.placement import Placement


def a_path(name):
    robot = load_robot(name)
    count = len(robot.joint_names)
    time = np.arange(201) / 100.0
    phase = np.arange(count)
    positions = 0.3 * np.sin(time[:, None] + phase) + 0.1
    velocities = 0.3 * np.cos(time[:, None] + phase)
    return JointPath(
        robot.joint_names, time, positions, velocities, 0.01 * time, time[::10], positions[::10],
        Placement(0.5, 0.0, 0.0), Grip(), robot,
    )  # fmt: skip


@pytest.fixture(scope="module")
def ur():
    return a_path("ur5e")


def test_accelerations_are_the_second_derivative(ur):
    wanted = -0.3 * np.sin(ur.time[:, None] + np.arange(6))
    assert np.abs(accelerations(ur) - wanted).max() < 1e-4


def test_ros_files_hold_the_same_message(ur, tmp_path):
    files = export(ur, tmp_path, ["ros-yaml", "ros-json"])
    as_yaml, as_json = yaml.safe_load(files[0].read_text()), json.loads(files[1].read_text())
    assert as_yaml["joint_names"] == as_json["joint_names"] == list(ur.names)
    for message in (as_yaml, as_json):
        points = message["points"]
        got = np.array([p["positions"] for p in points])
        assert np.abs(got - ur.positions).max() < 1e-8
        time = [
            p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points
        ]
        assert np.abs(np.array(time) - ur.time).max() < 1e-9
        assert np.abs(np.array([p["velocities"] for p in points]) - ur.velocities).max() < 1e-8
    assert len(as_yaml["points"][0]["accelerations"]) == 6


def test_mcap_holds_the_message(ur, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    (file,) = export(ur, tmp_path, ["mcap"])
    with file.open("rb") as stream:
        ((schema, channel, message),) = list(reader.make_reader(stream).iter_messages())
    assert schema.name == "trajectory_msgs/JointTrajectory"
    assert channel.topic == "/joint_trajectory"
    assert json.loads(message.data) == ros_message(ur)


def test_urscript_goes_through_the_path(ur, tmp_path):
    (file,) = export(ur, tmp_path, ["urscript"])
    text = file.read_text()
    rows = np.array(
        [[float(v) for v in row.split(",")] for row in re.findall(r"servoj\(\[(.*?)\]", text)]
    )
    assert text.startswith("def wrod_path():") and text.rstrip().endswith("end")
    assert len(rows) == round(ur.time[-1] / 0.008) + 1
    assert np.abs(rows[0] - ur.positions[0]).max() < 1e-8
    assert np.abs(rows[125] - ur.positions[100]).max() < 1e-4  # 1 s


def test_libfranka_and_intera_tables(tmp_path):
    path = a_path("panda")
    (file,) = export(path, tmp_path, ["libfranka"])
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    assert np.allclose(np.diff(rows[:, 0]), 1e-3) and rows.shape[1] == 15
    wanted = 0.3 * np.sin(rows[:, :1] + np.arange(7)) + 0.1
    assert np.abs(rows[:, 1:8] - wanted).max() < 1e-8
    assert np.abs(rows[:, 8:] - 0.3 * np.cos(rows[:, :1] + np.arange(7))).max() < 1e-5
    sawyer = a_path("sawyer")
    (file,) = export(sawyer, tmp_path, ["intera"])
    assert file.read_text().splitlines()[0] == "time," + ",".join(sawyer.names)


def test_poses_are_forward_kinematics(ur, tmp_path):
    (file,) = export(ur, tmp_path, ["poses"])
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    poses = grasp_poses(ur.robot, ur.positions)
    assert np.abs(rows[:, 1:4] - poses[:, :3, 3]).max() < 1e-8
    turned = Rotation.from_quat(rows[:, 4:]).as_matrix()
    assert np.abs(turned - poses[:, :3, :3]).max() < 1e-8
    assert ((rows[1:, 4:] * rows[:-1, 4:]).sum(1) > 0).all()


def test_a_format_for_another_arm_is_refused_and_nothing_written(ur, tmp_path):
    with pytest.raises(RobotError, match="libfranka moves arms of seven joints"):
        export(ur, tmp_path, ["ros-json", "libfranka"])
    with pytest.raises(RobotError, match="unknown format 'karel'"):
        export(ur, tmp_path, ["karel"])
    assert not list(tmp_path.iterdir())
    assert "urscript" in suited(ur) and "libfranka" not in suited(ur)
    assert "libfranka" in suited(a_path("panda")) and "libfranka" not in suited(a_path("iiwa"))
    named = dataclasses.replace(ur, names=tuple(f"joint_a{k}" for k in range(1, 7)))  # a KUKA
    assert "urscript" not in suited(named)
    assert set(suited(ur)) <= set(FORMATS)


def test_phases_are_told_to_the_gripper_at_the_times_of_the_path(ur, tmp_path):
    whole = [
        {"name": name, "start": k * 0.4, "end": (k + 1) * 0.4}
        for k, name in enumerate(("approach", "grasp", "lay", "release", "retreat"))
    ]
    path = dataclasses.replace(ur, metadata={"phases": whole})
    phases, script, mcap = export(path, tmp_path, ["phases", "urscript", "mcap"])
    told = json.loads(phases.read_text())
    assert told["phases"] == whole
    assert told["gripper"] == [
        {"time": 0.4, "command": "close"}, {"time": pytest.approx(1.2), "command": "open"},
    ]  # fmt: skip
    lines = script.read_text().splitlines()
    body = lines[lines.index("def wrod_path():") :]
    for call, time in (("  wrod_close()", 0.4), ("  wrod_open()", 1.2)):
        assert sum(line.startswith("  servoj") for line in body[: body.index(call)]) == time / 0.008
    reader = pytest.importorskip("mcap.reader")
    with mcap.open("rb") as stream:
        said = [
            (message.log_time / 1e9, json.loads(message.data)["data"])
            for _, channel, message in reader.make_reader(stream).iter_messages()
            if channel.topic == "/phase"
        ]
    assert said == [(pytest.approx(p["start"]), p["name"]) for p in whole]
    assert path.phase_at(0.0) == "approach" and path.phase_at(0.9) == "lay"
