"""The robot: an arm from a URDF with a gripper, its limits and frames (pytorch-kinematics)."""

import copy
import os
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from wrod import arguments
from wrod.errors import RobotError, WrodWarning, needed_extras
from wrod.robot.grasp_jacobian import GraspJacobian
from wrod.robot.urdf import LinkShape, UrdfFile, read_urdf
from wrod.robot.urdf_checks import chain_limits, check_reach
from wrod.scenes import gripper as gripper_model
from wrod.scenes import sawyer
from wrod.scenes.arms import TABLES, arm_urdf
from wrod.scenes.urdf_writer import joint_element, link_element

ROBOTS = ("sawyer", *TABLES)
GRASP_LINK = "grasp"

# Joint acceleration and jerk limits [rad/s^2], [rad/s^3]. A URDF has none; these are gentle for
# an arm of Sawyer's class, and a path at quasi-static speed stays far below them.
ACCELERATION = 2.0
JERK = 20.0


@dataclass(frozen=True)
class Robot:
    """An arm that holds a gripper, ready for batched kinematics in float64.

    Attributes:
        name: name of the robot in its URDF.
        urdf: the description, with the gripper.
        xml: the same as text, for other loaders.
        tip: link whose pose is planned: `grasp`, +z along the fingers, closing along y.
        joint_names: (n,) moving joints from base to tip.
        lower, upper: (n,) joint limits [rad]; infinite for continuous joints.
        velocity, acceleration, jerk: (n,) limits [rad/s], [rad/s^2], [rad/s^3].
        chain: `pytorch_kinematics.SerialChain` from the base to the tip.
        tree: `pytorch_kinematics.Chain` of every link.
        gripper_length: from the flange to the grasp point [m].
    """

    name: str
    urdf: UrdfFile
    xml: str
    tip: str
    joint_names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    chain: Any
    tree: Any
    gripper_length: float

    @property
    def base(self) -> str:
        return self.urdf.base_link

    @property
    def table_heights(self) -> tuple[float, ...]:
        """Heights of a table [m], from the arm's mount, that are tried in this order.

        Sawyer stands on its own pedestal before the table; other arms are bolted to a stand whose
        height is the user's to choose, and one that hangs works below its shoulder.
        """
        if self.name == "sawyer":
            return (-0.55, -0.4, -0.25)
        return (-0.45, -0.6, -0.75, -0.9) if self.mount[2, 2] < -0.5 else (0.0, -0.15, -0.3, -0.45)

    def shapes(self, tag: str) -> list[LinkShape]:
        """Shapes of every link; `tag` is "visual" or "collision"."""
        return self.urdf.shapes(tag)

    @cached_property
    def jacobian(self) -> GraspJacobian:
        """Jacobian and pose of the grasp by joint positions."""
        return GraspJacobian(self.chain)

    @cached_property
    def mount(self) -> np.ndarray:
        """(4, 4) pose in the base frame [m] of the link that stands still under the first joint:
        the base itself, unless the file begins with a world or a cell that holds the arm."""
        first = next(j for j in self.urdf.joints if j.get("name") == self.joint_names[0])
        poses = self.link_poses(np.zeros(len(self.joint_names)))
        return poses[first.find("parent").get("link")][0]

    @needed_extras()
    def link_poses(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Poses of every link in the base frame.

        Args:
            positions: (n_poses, n) joint positions [rad].

        Returns:
            link name -> (n_poses, 4, 4) [m]; joints beside the arm (the head) stand at 0.
        """
        import torch

        positions = np.atleast_2d(np.asarray(positions, dtype=np.float64))
        names = self.tree.get_joint_parameter_names()
        full = torch.zeros((len(positions), len(names)), dtype=torch.float64)
        for column, name in enumerate(self.joint_names):
            full[:, names.index(name)] = torch.from_numpy(positions[:, column].copy())
        frames = self.tree.forward_kinematics_tensor(full).numpy()
        return {
            name: frames[self.tree.frame_to_idx[name]]
            for name in self.tree.get_frame_names(exclude_fixed=False)
        }


@needed_extras()
@arguments.checked(
    RobotError,
    robot=arguments.either(arguments.path, arguments.like("a Robot", "joint_names", "chain")),
    flange=arguments.optional(arguments.text),
    tip=arguments.optional(arguments.text),
    gripper_length=arguments.optional(arguments.number(1e-3, 10.0)),
    acceleration=arguments.optional(arguments.number(1e-3, 1e3)),
    jerk=arguments.optional(arguments.number(1e-3, 1e5)),
)
def load_robot(
    robot: str | os.PathLike[str] | Robot = "sawyer",
    *,
    flange: str | None = None,
    tip: str | None = None,
    gripper_length: float | None = None,
    acceleration: float | None = None,
    jerk: float | None = None,
) -> Robot:
    """Load an arm by name or from a URDF file, and put the gripper on it.

    Args:
        robot: a name of `ROBOTS` (sawyer, panda, ur5e, ur10e, iiwa, xarm7, gen3), a URDF or xacro
            file, or a `Robot` (returned as it is).
        flange: link that carries wrod's gripper; by default the end of the longest chain of
            revolute joints. What the file hangs on it gives way.
        tip: link of the file's own gripper at the grasp point, +z along the fingers, which close
            along y; then no gripper is added.
        gripper_length: from the flange to the grasp point [m], 0.15 by default. A URDF that has a
            link `grasp` of its own keeps its gripper.
        acceleration, jerk: joint limits [rad/s^2], [rad/s^3]; a URDF has none.

    Raises:
        RobotError: the file, a link or a mesh is missing, the file cannot be read, a joint has no
            limits, or the arm has fewer than six joints.

    Warns:
        WrodWarning: links beyond the flange gave way to the gripper.
    """
    if isinstance(robot, Robot):
        return robot
    urdf, length = describe_robot(robot, flange=flange, tip=tip, gripper_length=gripper_length)
    return _build(urdf, length, acceleration or ACCELERATION, jerk or JERK)


@needed_extras()
def describe_robot(
    robot: str | os.PathLike[str],
    *,
    flange: str | None = None,
    tip: str | None = None,
    gripper_length: float | None = None,
) -> tuple[UrdfFile, float]:
    """The URDF with its gripper, and the gripper's length [m]; checked in milliseconds.

    Args, Raises, Warns: see `load_robot`.
    """
    name = os.fspath(robot)
    if name == "sawyer":
        urdf = read_urdf(sawyer.PATH)
    elif name in TABLES:
        urdf = UrdfFile(Path(name), arm_urdf(name))
    elif Path(name).suffix not in (".urdf", ".xacro", ".xml") and not Path(name).is_file():
        raise RobotError(
            f"unknown robot {name!r:.80}; known robots: {', '.join(ROBOTS)} (or give a URDF file)"
        )
    else:
        urdf = read_urdf(name)
    described = _described(urdf, flange, tip, gripper_length)
    chain_limits(urdf.path, described[0].joints, GRASP_LINK)
    return described


def _described(
    urdf: UrdfFile, flange: str | None, tip: str | None, gripper_length: float | None
) -> tuple[UrdfFile, float]:
    if tip is None:
        return _with_gripper(urdf, flange, gripper_length)
    if flange is not None or gripper_length is not None:
        raise RobotError(
            "a tip is a point of the arm's own gripper, and flange and gripper length belong to "
            "wrod's; give either the one or the others"
        )
    urdf.require_link(tip, "tip")
    root = copy.deepcopy(urdf.root)
    if tip != GRASP_LINK:
        if GRASP_LINK in urdf.links:
            raise RobotError(
                f"{urdf.path}: has a link {GRASP_LINK!r} of its own; leave out the tip"
            )
        root.append(link_element(GRASP_LINK))
        root.append(joint_element("grasp_point", tip, GRASP_LINK, (0, 0, 0)))
    return UrdfFile(urdf.path, root), float("nan")


def _with_gripper(
    urdf: UrdfFile, flange: str | None, length: float | None
) -> tuple[UrdfFile, float]:
    """Put on our gripper, or change its length, unless the file brings a `grasp` of its own."""
    ours = {"gripper", GRASP_LINK} <= set(urdf.links)
    if GRASP_LINK in urdf.links and not ours:
        if length is not None:
            raise RobotError(
                f"{urdf.path}: has a link {GRASP_LINK!r} of its own, so gripper_length cannot be "
                "set; leave it out or remove that link"
            )
        return urdf, float("nan")
    wanted = gripper_model.GRIPPER_LENGTH if length is None else length
    if flange is None:
        flange, _ = urdf.above.get("gripper") or (urdf.flange(), None)
    urdf.require_link(flange, "gripper's flange")
    beyond = urdf.beyond(flange)
    moved = sorted(beyond - set(gripper_model.LINKS))
    if moved:
        warnings.warn(
            f"{urdf.path}: {', '.join(moved)} beyond the flange {flange!r:.80} give way to wrod's "
            "gripper; name the grasp point with tip to keep them",
            WrodWarning,
            stacklevel=4,
        )
    root = copy.deepcopy(urdf.root)
    gone = beyond | set(gripper_model.LINKS)
    for element in list(root):
        child = element.find("child")
        mine = element.tag == "link" and element.get("name") in gone
        if mine or (child is not None and child.get("link") in gone):
            root.remove(element)
    try:
        root.extend(gripper_model.gripper_elements(flange, float(wanted), urdf.approach(flange)))
    except ValueError as error:
        raise RobotError(str(error)) from error
    known = {material.get("name") for material in root.findall("material")}
    for name, rgba in sawyer.COLORS.items():
        if name not in known:
            material = ElementTree.Element("material", name=name)
            ElementTree.SubElement(material, "color", rgba=" ".join(f"{c:g}" for c in rgba))
            root.insert(0, material)
    return UrdfFile(urdf.path, root), float(wanted)


def _build(urdf: UrdfFile, gripper_length: float, acceleration: float, jerk: float) -> Robot:
    import pytorch_kinematics as pk
    import torch

    xml = ElementTree.tostring(urdf.root, encoding="unicode")
    bare = copy.deepcopy(urdf.root)
    for link in bare.findall("link"):  # the parser of the chain needs no shapes and warns of some
        for element in list(link):
            link.remove(element)
    for element in [e for e in bare if e.tag not in ("link", "joint")]:
        bare.remove(element)
    for joint in bare.findall("joint"):
        unread = ("dynamics", "safety_controller", *(["axis"] * (joint.get("type") == "fixed")))
        for element in [e for e in joint if e.tag in unread]:
            joint.remove(element)
    try:
        tree = pk.build_chain_from_urdf(ElementTree.tostring(bare))
        chain = pk.SerialChain(tree, GRASP_LINK)
    except Exception as error:
        raise RobotError(f"{urdf.path}: not a usable URDF ({error})") from error
    tree, chain = tree.to(dtype=torch.float64), chain.to(dtype=torch.float64)
    names, lower, upper, velocity = chain_limits(urdf.path, urdf.joints, GRASP_LINK)
    check_reach(urdf.path, chain, lower, upper)
    count = len(names)
    return Robot(
        name=urdf.root.get("name", urdf.path.stem),
        urdf=urdf,
        xml=xml,
        tip=GRASP_LINK,
        joint_names=names,
        lower=lower,
        upper=upper,
        velocity=velocity,
        acceleration=np.full(count, float(acceleration)),
        jerk=np.full(count, float(jerk)),
        chain=chain,
        tree=tree,
        gripper_length=gripper_length,
    )
