"""Arms by name: published frames and limits, primitive shapes of our own.

Frames and limits are numbers of the manufacturers' public descriptions and data sheets, named
with each arm; lengths in metres, angles in radians, every joint about +z. A link's shapes are
capsules (start, end, radius) in its frame that cover the real link's casing roughly, to a
centimetre or two: for exact clearances give the manufacturer's URDF with its meshes instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree

from .sawyer import COLORS
from .urdf_writer import joint_element, link_element, rod_between, sphere

_Q = math.pi / 2
_R = math.radians


@dataclass(frozen=True)
class ArmTable:
    """What an arm's URDF is written from.

    Attributes:
        source: where frames and limits are published.
        joints: (name, child link, xyz, rpy, (lower, upper, velocity, effort)) from the base up;
            limits of None for a fixed joint, a lower limit of None for a continuous one.
        links: link -> capsules (start, end, radius).
        flange: link that carries the gripper.
        color: of most of its links, by name in `sawyer.COLORS`.
    """

    source: str
    base: str
    joints: tuple
    links: dict
    flange: str
    color: str = "light"


def _ur(d1, a2, a3, d4, d5, d6, shoulder, wrist, radii, efforts, speeds, source) -> ArmTable:
    """A UR arm of its DH table; `shoulder`, `wrist`: sideways offsets of upper arm and forearm."""
    big, upper, lower, small = radii
    turn, half = 2 * math.pi, math.pi
    limits = [
        (-half if k == 2 else -turn, half if k == 2 else turn, speeds[k], efforts[k])
        for k in range(6)
    ]
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    children = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    frames = (
        ((0, 0, d1), (0, 0, 0)),
        ((0, 0, 0), (_Q, 0, 0)),
        ((a2, 0, 0), (0, 0, 0)),
        ((a3, 0, d4), (0, 0, 0)),
        ((0, -d5, 0), (_Q, 0, 0)),
        ((0, d6, 0), (-_Q, 0, 0)),
    )
    joints = tuple(
        (f"{name}_joint", f"{child}_link", *frame, limit)
        for name, child, frame, limit in zip(names, children, frames, limits, strict=True)
    )
    links = {
        "base_link": (((0, 0, 0.02), (0, 0, 0.05), big * 1.2),),
        "shoulder_link": (((0, 0, -0.04), (0, 0, 0.01), big),),
        "upper_arm_link": (
            ((0, 0, 0.02), (0, 0, shoulder), big),
            ((0, 0, shoulder), (a2, 0, shoulder), upper),
            ((a2, 0, shoulder), (a2, 0, shoulder - 0.06), upper),
        ),
        "forearm_link": (
            ((0, 0, wrist + 0.04), (0, 0, wrist), lower * 1.15),
            ((0, 0, wrist), (a3, 0, wrist), lower),
            ((a3, 0, wrist), (a3, 0, d4 - 0.09), small),
        ),
        "wrist_1_link": (((0, 0, -0.06), (0, 0, 0), small), ((0, 0, 0), (0, -0.035, 0), small)),
        "wrist_2_link": (((0, 0, -0.05), (0, 0, 0), small), ((0, 0, 0), (0, 0.035, 0), small)),
        "wrist_3_link": (((0, 0, -0.045), (0, 0, -0.03), small * 0.85),),
    }
    return ArmTable(source, "base_link", joints, links, "wrist_3_link")


def _panda() -> ArmTable:
    c = (0.0, 0.0, 0.0)
    frames = (
        ((0, 0, 0.333), c), (c, (-_Q, 0, 0)), ((0, -0.316, 0), (_Q, 0, 0)),
        ((0.0825, 0, 0), (_Q, 0, 0)), ((-0.0825, 0.384, 0), (-_Q, 0, 0)), (c, (_Q, 0, 0)),
        ((0.088, 0, 0), (_Q, 0, 0)),
    )  # fmt: skip
    limits = (
        (-2.8973, 2.8973, 2.175, 87), (-1.7628, 1.7628, 2.175, 87), (-2.8973, 2.8973, 2.175, 87),
        (-3.0718, -0.0698, 2.175, 87), (-2.8973, 2.8973, 2.61, 12), (-0.0175, 3.7525, 2.61, 12),
        (-2.8973, 2.8973, 2.61, 12),
    )  # fmt: skip
    joints = tuple(
        (f"panda_joint{k + 1}", f"panda_link{k + 1}", *frames[k], limits[k]) for k in range(7)
    )
    joints += (("panda_joint8", "panda_link8", (0, 0, 0.107), c, None),)
    d = 0.0424  # the camera's mount stands at 45 degrees on the flange
    links = {
        "panda_link0": (((-0.09, 0, 0.06), (0, 0, 0.06), 0.06),),
        "panda_link1": (((0, 0, -0.333), (0, 0, -0.05), 0.06),),
        "panda_link2": (((0, 0, -0.06), (0, 0, 0.06), 0.06),),
        "panda_link3": (((0, 0, -0.22), (0, 0, -0.07), 0.06),),
        "panda_link4": (((0, 0, -0.06), (0, 0, 0.06), 0.06),),
        "panda_link5": (
            ((0, 0, -0.31), (0, 0, -0.21), 0.06),
            ((0, 0.08, -0.20), (0, 0.08, -0.06), 0.025),
        ),
        "panda_link6": (((0, 0, -0.07), (0, 0, 0.01), 0.05),),
        "panda_link7": (
            ((0, 0, -0.06), (0, 0, 0.08), 0.04),
            ((d, d, 0.082), (d + 0.005, d + 0.005, 0.082), 0.03),
        ),
        "panda_link8": (),
    }  # fmt: skip
    source = "Franka Emika, FCI documentation and franka_description (Apache-2.0)"
    return ArmTable(source, "panda_link0", joints, links, "panda_link8")


def _iiwa() -> ArmTable:
    half = math.pi
    frames = (
        ((0, 0, 0.1575), (0, 0, 0)), ((0, 0, 0.2025), (_Q, 0, half)),
        ((0, 0.2045, 0), (_Q, 0, half)), ((0, 0, 0.2155), (_Q, 0, 0)),
        ((0, 0.1845, 0), (-_Q, half, 0)), ((0, 0, 0.2155), (_Q, 0, 0)),
        ((0, 0.081, 0), (-_Q, half, 0)),
    )  # fmt: skip
    ranges = (170, 120, 170, 120, 170, 120, 175)
    speeds = (85, 85, 100, 75, 130, 135, 135)
    efforts = (320, 320, 176, 176, 110, 40, 40)
    joints = tuple(
        (f"iiwa_joint_{k + 1}", f"iiwa_link_{k + 1}", *frames[k],
         (-_R(ranges[k]), _R(ranges[k]), _R(speeds[k]), efforts[k]))
        for k in range(7)
    )  # fmt: skip
    joints += (("iiwa_joint_ee", "iiwa_link_ee", (0, 0, 0.045), (0, 0, 0), None),)
    links = {
        "iiwa_link_0": (((-0.04, 0, 0.05), (0, 0, 0.09), 0.085),),
        "iiwa_link_1": (((0, 0, 0.02), (0, 0, 0.2025), 0.08),),
        "iiwa_link_2": (((0, 0, 0), (0, 0.2045, 0), 0.08),),
        "iiwa_link_3": (((0, 0, 0), (0, 0, 0.2155), 0.075),),
        "iiwa_link_4": (((0, 0, 0), (0, 0.1845, 0), 0.072),),
        "iiwa_link_5": (((0, 0, 0), (0, 0.015, 0.2155), 0.065),),
        "iiwa_link_6": (((0, 0, -0.01), (0, 0.03, 0.005), 0.065),),
        "iiwa_link_7": (((0, 0, 0), (0, 0, 0.02), 0.045),),
        "iiwa_link_ee": (),
    }
    source = "KUKA, LBR iiwa 14 R820 specification; frames as in iiwa_stack (BSD)"
    return ArmTable(source, "iiwa_link_0", joints, links, "iiwa_link_ee", "metal")


def _xarm7() -> ArmTable:
    turn = 2 * math.pi
    frames = (
        ((0, 0, 0.267), (0, 0, 0)), ((0, 0, 0), (-_Q, 0, 0)), ((0, -0.293, 0), (_Q, 0, 0)),
        ((0.0525, 0, 0), (_Q, 0, 0)), ((0.0775, -0.3425, 0), (_Q, 0, 0)), ((0, 0, 0), (_Q, 0, 0)),
        ((0.076, 0.097, 0), (-_Q, 0, 0)),
    )  # fmt: skip
    ranges = (
        (-turn, turn), (-2.059, 2.0944), (-turn, turn), (-0.19198, 3.927), (-turn, turn),
        (-1.69297, math.pi), (-turn, turn),
    )  # fmt: skip
    efforts = (50, 50, 30, 30, 30, 20, 20)
    joints = tuple(
        (f"joint{k + 1}", f"link{k + 1}", *frames[k], (*ranges[k], 3.14, efforts[k]))
        for k in range(7)
    )
    links = {
        "link_base": (((0, 0, 0.04), (0, 0, 0.10), 0.06),),
        "link1": (((0, 0, -0.10), (0, 0, 0), 0.055),),
        "link2": (((0, 0, 0), (0, -0.20, 0.01), 0.055),),
        "link3": (((0, 0, -0.06), (0, 0, 0), 0.05), ((0, 0, 0), (0.0525, 0, 0), 0.05)),
        "link4": (
            ((0, 0, 0), (0.0775, -0.06, 0.01), 0.05),
            ((0.0775, -0.06, 0.01), (0.0775, -0.17, 0.01), 0.047),
        ),
        "link5": (
            ((0, 0.03, -0.15), (0, 0.03, -0.03), 0.047),
            ((0, 0, 0), (0, 0.03, -0.03), 0.045),
        ),
        "link6": (
            ((0, 0, 0), (0.076, 0.02, 0), 0.045),
            ((0.076, 0.02, 0), (0.076, 0.05, 0), 0.042),
        ),
        "link7": (((0, 0, -0.04), (0, 0, -0.03), 0.036),),
    }  # fmt: skip
    source = "UFACTORY, xArm user manual and xarm_description (BSD)"
    return ArmTable(source, "link_base", joints, links, "link7")


def _gen3() -> ArmTable:
    half = math.pi
    frames = (
        ((0, 0, 0.15643), (half, 0, 0)), ((0, 0.005375, -0.12838), (_Q, 0, 0)),
        ((0, -0.21038, -0.006375), (-_Q, 0, 0)), ((0, 0.006375, -0.21038), (_Q, 0, 0)),
        ((0, -0.20843, -0.006375), (-_Q, 0, 0)), ((0, 0.00017505, -0.10593), (_Q, 0, 0)),
        ((0, -0.10593, -0.00017505), (-_Q, 0, 0)),
    )  # fmt: skip
    limits = (
        (None, None, 1.3963, 39), (-2.25, 2.25, 1.3963, 39), (None, None, 1.3963, 39),
        (-2.58, 2.58, 1.3963, 39), (None, None, 1.2218, 9), (-2.10, 2.10, 1.2218, 9),
        (None, None, 1.2218, 9),
    )  # fmt: skip
    children = (
        "shoulder_link", "half_arm_1_link", "half_arm_2_link", "forearm_link",
        "spherical_wrist_1_link", "spherical_wrist_2_link", "bracelet_link",
    )  # fmt: skip
    joints = tuple((f"joint_{k + 1}", children[k], *frames[k], limits[k]) for k in range(7))
    joints += (("end_effector", "end_effector_link", (0, 0, -0.061525), (half, 0, 0), None),)
    links = {
        "base_link": (((0, 0, 0.03), (0, 0, 0.10), 0.048),),
        "shoulder_link": (((0, 0, -0.03), (0, 0, -0.12), 0.046),),
        "half_arm_1_link": (((0, 0, 0), (0, -0.20, -0.01), 0.046),),
        "half_arm_2_link": (((0, 0, 0), (0, 0, -0.20), 0.046),),
        "forearm_link": (((0, 0, 0), (0, -0.20, -0.008), 0.044),),
        "spherical_wrist_1_link": (((0, 0, 0), (0, 0, -0.10), 0.038),),
        "spherical_wrist_2_link": (((0, 0, 0), (0, -0.10, 0), 0.038),),
        "bracelet_link": (
            ((0, 0, -0.02), (0, 0, -0.03), 0.038),
            ((0, -0.045, -0.03), (0, -0.05, -0.03), 0.025),
        ),
        "end_effector_link": (),
    }  # fmt: skip
    source = "Kinova, Gen3 user guide (7 DoF) and ros2_kortex (BSD)"
    return ArmTable(source, "base_link", joints, links, "end_effector_link", "light")


_UR_SOURCE = "Universal Robots, 'DH parameters for calculations of kinematics' and user manuals"
TABLES = {
    "panda": _panda(),
    "ur5e": _ur(
        0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996, 0.138, 0.007,
        (0.06, 0.055, 0.043, 0.043), (150, 150, 150, 28, 28, 28), (_R(180),) * 6, _UR_SOURCE,
    ),
    "ur10e": _ur(
        0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655, 0.176, 0.039,
        (0.08, 0.066, 0.052, 0.047), (330, 330, 150, 56, 56, 56),
        (_R(120), _R(120), *(_R(180),) * 4), _UR_SOURCE,
    ),
    "iiwa": _iiwa(),
    "xarm7": _xarm7(),
    "gen3": _gen3(),
}  # fmt: skip


def arm_urdf(name: str) -> ElementTree.Element:
    """Root element of the URDF of an arm in `TABLES`, without a gripper."""
    table = TABLES[name]
    robot = ElementTree.Element("robot", name=name)
    for color, rgba in COLORS.items():
        material = ElementTree.SubElement(robot, "material", name=color)
        ElementTree.SubElement(material, "color", rgba=" ".join(f"{c:g}" for c in rgba))
    for number, (link, capsules) in enumerate(table.links.items()):
        visuals, collisions = [], []
        for start, end, radius in capsules:
            shade = table.color if number % 2 else "dark"
            visuals += [rod_between(start, end, radius, shade)]
            visuals += [sphere(radius, point, shade) for point in (start, end)]
            collisions.append(rod_between(start, end, radius))
        robot.append(link_element(link, 1.0 if capsules else 0.0, visuals, collisions))
    parent = table.base
    for joint, child, xyz, rpy, limits in table.joints:
        bounded = limits is None or limits[0] is not None
        element = joint_element(
            joint, parent, child, xyz, rpy, limits if bounded else (0.0, 0.0, *limits[2:])
        )
        if not bounded:
            element.set("type", "continuous")
            for end in ("lower", "upper"):
                del element.find("limit").attrib[end]
        robot.append(element)
        parent = child
    return robot
