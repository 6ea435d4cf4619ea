"""Options of an arm, checked before anything is solved."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from wrod.commands.surroundings import refuse_few_addresses
from wrod.errors import MissingExtraError, RobotError, WrodWarning
from wrod.options import option

_DEFAULT_ROBOT = "sawyer"

_NEEDED = {
    "torch": "robot", "pytorch_kinematics": "robot", "ruckig": "robot", "trimesh": "robot",
    "pxr": "scene",
}  # fmt: skip


@dataclass(frozen=True)
class RobotRequest:
    """What is asked of an arm."""

    robot: str = option(
        "sawyer, panda, ur5e, ur10e, iiwa, xarm7, gen3, or a URDF or xacro file.",
        default=_DEFAULT_ROBOT,
    )
    no_robot: bool = option("Leave out joint path and scene.")
    placement: str = option(
        "auto, or x,y,z,yaw of the pattern from the robot's base [m, degrees]; z is the table.",
        default="auto",
    )
    table_height: float | None = option(
        "Height of the table from the robot's base [m], for --placement auto; default: tries a few."
    )
    flange: str | None = option("Link that carries the gripper; default: the arm's last.")
    tip: str | None = option("Link of the arm's own gripper at the grasp point, +z along it.")
    gripper_length: float | None = option("From flange to grasp point [m]; 0.15.")
    speed: float | None = option("Speed of the contact [m/s]; that of the plan, or 0.02.")
    obstacles: Path | None = option(
        "JSON list of boxes, cylinders, spheres and meshes that stand in the way."
    )
    lay_only: bool = option(
        "Leave out approach, grasp, release and retreat: begin and end at the rod."
    )
    remedy: bool = option(
        "Where no joint path exists, look for what would help (default).",
        "--remedy/--no-remedy",
        default=True,
    )
    exports: tuple[str, ...] = option(
        "Also write ros-yaml, ros-json, mcap, urscript, libfranka, intera, poses or phases; all "
        "that suit the arm: all.",
        "--export",
    )
    view: bool = option("Then play the scene in a browser on this machine.")

    def check(self) -> RobotRequest:
        """Refuse in milliseconds what would fail after the plan.

        Returns:
            The request, without an arm where its libraries are missing and nobody asked for one.

        Raises:
            RobotError, SceneError: a bad option, a file that cannot be used, a missing library.

        Warns:
            WrodWarning: names the extra for an arm.
        """
        if self.no_robot:
            self._refuse_ignored()
            return self
        for module, extra in _NEEDED.items():
            if find_spec(module) is None:
                said = f"joint paths and scenes need {module}; install wrod[{extra}]"
                if self._given() or self.robot != _DEFAULT_ROBOT:
                    raise RobotError(f"{said}, or plan with --no-robot")
                warnings.warn(f"{said}; planned without an arm", WrodWarning, stacklevel=2)
                return replace(self, no_robot=True)
        refuse_few_addresses()
        if self.view and find_spec("viser") is None:
            raise MissingExtraError("viser")
        from wrod.robot.model import describe_robot
        from wrod.robot.obstacles import Obstacles
        from wrod.robot.outputs import FORMATS
        from wrod.robot.placement import Placement

        for name in self.exports:
            if name not in (*FORMATS, "all"):
                raise RobotError(
                    f"--export: unknown format {name!r}; known formats: {', '.join(FORMATS)}, all"
                )
        if self.placement != "auto":
            Placement.parse(self.placement)
            if self.table_height is not None:
                raise RobotError(
                    "--placement has the table's height in it; drop --table-height or --placement"
                )
        if self.obstacles is not None:
            Obstacles.load(self.obstacles).capsules()  # reads their meshes
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # said again when the arm is loaded
            describe_robot(
                self.robot, flange=self.flange, tip=self.tip, gripper_length=self.gripper_length
            )
        return self

    def _given(self) -> list[str]:
        """Options of an arm that were given, but for its name."""
        given = [
            f"--{name.replace('_', '-')}"
            for name in (
                "table_height", "flange", "tip", "gripper_length", "speed", "obstacles",
            )
            if getattr(self, name) is not None
        ]  # fmt: skip
        return given + (
            ["--export"] * bool(self.exports)
            + ["--view"] * self.view
            + ["--placement"] * (self.placement != "auto")
            + ["--lay-only"] * self.lay_only
        )

    def _refuse_ignored(self) -> None:
        given = ["--robot"] * (self.robot != _DEFAULT_ROBOT) + self._given()
        if given:
            raise RobotError(f"--no-robot and {', '.join(given)} exclude each other; drop either")

    def solve(self, trajectory, **changes):
        """The joint path of a trajectory.

        Args:
            changes: of this request, such as another `table_height`.

        Raises:
            RobotError: there is none.
        """
        from wrod.robot.model import load_robot
        from wrod.robot.obstacles import Obstacles
        from wrod.robot.solve import solve_joint_path

        robot = load_robot(
            self.robot, flange=self.flange, tip=self.tip, gripper_length=self.gripper_length
        )
        options = {
            "table_height": self.table_height,
            "obstacles": None if self.obstacles is None else Obstacles.load(self.obstacles),
            "placement": self.placement,
            "whole_job": not self.lay_only,
        }
        if self.speed is not None:
            options["pace"] = self.speed
        return solve_joint_path(trajectory, robot, **{**options, **changes})

    def export(self, joint_path, folder) -> list[Path]:
        """Write the formats that were asked for."""
        from wrod.robot.outputs import export, suited

        names = list(self.exports)
        if "all" in names:
            names = suited(joint_path)
        return export(joint_path, folder, names)
