"""The Sawyer of `robots/sawyer.urdf`: one table of joints, one of shapes; run it to write the file.

    python -m wrod.scenes.sawyer

Numbers are those of the manufacturer's public description (Apache-2.0); the shapes are primitives
of our own. +z is every joint's axis; lengths in metres, angles in radians.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from .gripper import GRIPPER_LENGTH, gripper_elements
from .urdf_writer import box, joint_element, link_element, rod_between, sphere

PATH = Path(__file__).parent / "robots" / "sawyer.urdf"

_Q = math.pi / 2
# name, parent, child, xyz, rpy, (lower, upper, max velocity [rad/s], max effort [N m])
JOINTS = (
    ("right_arm_mount", "base", "right_arm_base_link", (0, 0, 0), (0, 0, 0), None),
    ("pedestal_fixed", "base", "pedestal", (0, 0, 0), (0, 0, 0), None),
    ("right_j0", "right_arm_base_link", "right_l0", (0, 0, 0.08), (0, 0, 0),
     (-3.0503, 3.0503, 1.74, 80)),
    ("head_pan", "right_l0", "head", (0, 0, 0.2965), (0, 0, 0), (-5.0952, 0.9064, 1.8, 8)),
    ("right_j1", "right_l0", "right_l1", (0.081, 0.05, 0.237), (-_Q, _Q, 0),
     (-3.8095, 2.2736, 1.328, 80)),
    ("right_j2", "right_l1", "right_l2", (0, -0.14, 0.1425), (_Q, 0, 0),
     (-3.0426, 3.0426, 1.957, 40)),
    ("right_j3", "right_l2", "right_l3", (0, -0.042, 0.26), (-_Q, 0, 0),
     (-3.0439, 3.0439, 1.957, 40)),
    ("right_j4", "right_l3", "right_l4", (0, -0.125, -0.1265), (_Q, 0, 0),
     (-2.9761, 2.9761, 3.485, 9)),
    ("right_j5", "right_l4", "right_l5", (0, 0.031, 0.275), (-_Q, 0, 0),
     (-2.9761, 2.9761, 3.485, 9)),
    ("right_j6", "right_l5", "right_l6", (0, -0.11, 0.1053), (-_Q, -0.17453, 3.1416),
     (-4.7124, 4.7124, 4.545, 9)),
    ("right_hand", "right_l6", "right_hand", (0, 0, 0.0245), (0, 0, _Q), None),
)  # fmt: skip

COLORS = {
    "dark": (0.16, 0.16, 0.18, 1),
    "red": (0.52, 0.06, 0.07, 1),
    "light": (0.72, 0.73, 0.75, 1),
    "metal": (0.42, 0.43, 0.46, 1),
    "pad": (0.06, 0.06, 0.06, 1),
    "screen": (0.25, 0.45, 0.55, 1),
}

# link: (mass [kg], visuals, collisions)
LINKS = {
    "base": (0.0, (), ()),
    "pedestal": (
        0.0,
        (
            rod_between((0, 0, -0.86), (0, 0, -0.02), 0.105, "metal"),
            rod_between((0, 0, -0.02), (0, 0, 0), 0.13, "dark"),
            rod_between((0, 0, -0.86), (0, 0, -0.80), 0.16, "dark"),
            box((0.62, 0.10, 0.05), (0, 0, -0.875), "dark"),
            box((0.10, 0.62, 0.05), (0, 0, -0.875), "dark"),
        ),
        (rod_between((-0.02, 0, -0.60), (-0.02, 0, 0.02), 0.18),),
    ),
    "right_arm_base_link": (
        2.0687,
        (rod_between((0, 0, 0), (0, 0, 0.085), 0.095, "dark"),),
        (rod_between((0, 0, 0), (0, 0, 0.24), 0.08),),
    ),
    "right_l0": (
        5.3213,
        (
            rod_between((0, 0, 0), (0, 0, 0.30), 0.075, "red"),
            rod_between((0, 0, 0.285), (0, 0, 0.31), 0.06, "dark"),
            rod_between((0, 0, 0.237), (0.081, 0, 0.237), 0.065, "red"),
            rod_between((0.081, -0.045, 0.237), (0.081, 0.03, 0.237), 0.072, "dark"),
        ),
        (sphere(0.07, (0.08, 0, 0.23)),),
    ),
    "right_l1": (
        4.505,
        (
            rod_between((0, 0, -0.018), (0, 0, 0.1425), 0.068, "red"),
            sphere(0.068, (0, 0, 0.1425), "red"),
            rod_between((0, 0, 0.1425), (0, -0.14, 0.1425), 0.061, "dark"),
        ),
        (sphere(0.07, (0, 0, 0.1225)), rod_between((0, 0, -0.035), (0, 0, 0.105), 0.07)),
    ),
    "right_l2": (
        1.745,
        (
            rod_between((0, 0, 0), (0, 0, 0.26), 0.056, "red"),
            rod_between((0, 0, 0.0), (0, 0, 0.03), 0.0615, "dark"),
            sphere(0.056, (0, 0, 0.26), "red"),
            rod_between((0, -0.05, 0.26), (0, 0.062, 0.26), 0.052, "dark"),
        ),
        (rod_between((0, 0, -0.09), (0, 0, 0.25), 0.06), sphere(0.06, (0, 0, 0.26))),
    ),
    "right_l3": (
        2.5097,
        (
            rod_between((0, 0, -0.01), (0, 0, -0.1265), 0.052, "red"),
            sphere(0.052, (0, 0, -0.1265), "red"),
            rod_between((0, 0, -0.1265), (0, -0.125, -0.1265), 0.047, "dark"),
        ),
        (sphere(0.06, (0, -0.01, -0.12)),),
    ),
    "right_l4": (
        1.1136,
        (
            rod_between((0, 0, 0), (0, 0, 0.275), 0.044, "red"),
            rod_between((0, 0, 0), (0, 0, 0.03), 0.0475, "dark"),
            sphere(0.044, (0, 0, 0.275), "red"),
            rod_between((0, -0.048, 0.275), (0, 0.031, 0.275), 0.043, "dark"),
        ),
        (rod_between((0, 0, -0.04), (0, 0, 0.26), 0.045),),
    ),
    "right_l5": (
        1.5625,
        (
            rod_between((0, 0, -0.006), (0, 0, 0.1053), 0.043, "red"),
            sphere(0.045, (0, 0, 0.1053), "red"),
            rod_between((0, 0.035, 0.1053), (0, -0.08, 0.1053), 0.045, "dark"),
        ),
        (sphere(0.06, (0, 0, 0.1)),),
    ),
    "right_l6": (
        0.3292,
        (
            rod_between((0, 0, -0.032), (0, 0, 0.02), 0.043, "red"),
            box((0.05, 0.03, 0.03), (0, 0.045, -0.008), "dark"),
        ),
        (rod_between((0, 0.015, -0.035), (0, 0.015, 0.015), 0.055),),
    ),
    "right_hand": (
        0.0,
        (rod_between((0, 0, -0.006), (0, 0, 0.002), 0.036, "metal"),),
        (rod_between((0, 0, 0.005), (0, 0, 0.035), 0.035),),
    ),
    "head": (
        1.5795,
        (
            rod_between((0, 0, 0.0), (0, 0, 0.05), 0.04, "dark"),
            box((0.05, 0.26, 0.17), (0.01, 0, 0.12), "dark"),
            box((0.006, 0.22, 0.13), (0.036, 0, 0.125), "screen"),
        ),
        (sphere(0.18, (0, 0, 0.08)),),
    ),
}


def sawyer_urdf() -> str:
    """Text of the URDF: arm, head, pedestal and gripper."""
    robot = ElementTree.Element("robot", name="sawyer")
    for name, rgba in COLORS.items():
        material = ElementTree.SubElement(robot, "material", name=name)
        ElementTree.SubElement(material, "color", rgba=" ".join(f"{c:g}" for c in rgba))
    for name, (mass, visuals, collisions) in LINKS.items():
        robot.append(link_element(name, mass, visuals, collisions))
    for name, parent, child, xyz, rpy, limits in JOINTS:
        robot.append(joint_element(name, parent, child, xyz, rpy, limits))
    robot.extend(gripper_elements("right_hand", GRIPPER_LENGTH))
    ElementTree.indent(robot)
    note = "<!-- Written by `python -m wrod.scenes.sawyer`; change the tables there. -->"
    return f'<?xml version="1.0"?>\n{note}\n{ElementTree.tostring(robot, encoding="unicode")}\n'


if __name__ == "__main__":
    PATH.write_text(sawyer_urdf(), encoding="utf-8")
    print(PATH)
