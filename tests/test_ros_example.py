"""The ROS 2 example against stand-ins of ROS's own messages: what it sends, and what it refuses."""

import dataclasses
import importlib.util
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from test_outputs import a_path

from wrod.robot.outputs import export

EXAMPLE = Path(__file__).parents[1] / "examples" / "send_joint_path_ros2.py"


@dataclasses.dataclass
class Duration:
    sec: int = 0
    nanosec: int = 0


@dataclasses.dataclass
class Point:
    positions: list
    velocities: list
    accelerations: list
    time_from_start: Duration


@dataclasses.dataclass
class Trajectory:
    joint_names: list
    points: list = dataclasses.field(default_factory=list)


class Done:
    """A future that has come."""

    def __init__(self, value):
        self.value = value

    def result(self):
        return self.value


class Controller:
    """A robot whose joints stand somewhere, and what it was sent."""

    def __init__(self, names, positions):
        self.state = types.SimpleNamespace(name=names, position=positions)
        self.goal = self.topic = None

    def modules(self):
        def client(node, action, name):
            self.topic = name
            finished = types.SimpleNamespace(result=types.SimpleNamespace(error_string=""))
            handle = types.SimpleNamespace(get_result_async=lambda: Done(finished))

            def send(goal):
                self.goal = goal
                return Done(handle)

            return types.SimpleNamespace(wait_for_server=lambda: True, send_goal_async=send)

        listeners = []
        node = types.SimpleNamespace(
            create_subscription=lambda kind, topic, call, depth: listeners.append(call),
            get_logger=lambda: types.SimpleNamespace(info=lambda text: None),
        )
        follow = types.SimpleNamespace(Goal=lambda trajectory: trajectory)
        found = {
            "rclpy": {
                "init": lambda: None, "create_node": lambda name: node, "ok": lambda: True,
                "spin_once": lambda node: [call(self.state) for call in listeners],
                "spin_until_future_complete": lambda node, future: None,
                "shutdown": lambda: None,
            },
            "rclpy.action": {"ActionClient": client},
            "builtin_interfaces.msg": {"Duration": Duration},
            "control_msgs.action": {"FollowJointTrajectory": follow},
            "sensor_msgs.msg": {"JointState": object},
            "trajectory_msgs.msg": {
                "JointTrajectory": Trajectory, "JointTrajectoryPoint": Point,
            },
        }  # fmt: skip
        modules = {}
        for name, members in found.items():
            for part in (name.split(".")[0], name):
                modules.setdefault(part, types.ModuleType(part))
            for key, value in members.items():
                setattr(modules[name], key, value)
        return modules


@pytest.fixture
def sent(tmp_path, monkeypatch):
    """Runs the example for a path of a UR5e and a robot that stands some radians from its start."""
    path = a_path("ur5e")
    (file,) = export(path, tmp_path, ["ros-yaml"])

    def run(off):
        robot = Controller(list(path.names)[::-1], list(path.positions[0][::-1] + off))
        for name, module in robot.modules().items():
            monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.setattr(sys, "argv", ["send", str(file), "/arm_controller"])
        spec = importlib.util.spec_from_file_location("send_joint_path_ros2", EXAMPLE)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        module.send()
        return path, robot

    return run


def test_example_sends_the_whole_path_to_the_controller(sent):
    path, robot = sent(0.05)
    assert robot.topic == "/arm_controller/follow_joint_trajectory"
    assert robot.goal.joint_names == list(path.names)
    assert len(robot.goal.points) == len(path)
    positions = np.array([point.positions for point in robot.goal.points])
    assert np.abs(positions - path.positions).max() < 1e-8
    time = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in robot.goal.points]
    assert np.abs(np.array(time) - path.time).max() < 1e-9


def test_example_refuses_an_arm_that_stands_elsewhere(sent):
    with pytest.raises(SystemExit, match=r"0\.30 rad from the start"):
        sent(0.3)
