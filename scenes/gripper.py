"""A parallel gripper of any length, closed on a rod.

Its frames: `gripper` sits on the flange, +z along the fingers, which close along y; `grasp` is
`length` away, where the rod is held.
"""

from __future__ import annotations

import math
from xml.etree import ElementTree

from .urdf_writer import box, joint_element, link_element, rod_between, sphere

GRIPPER_LENGTH = 0.15  # [m] from the flange to the grasp point
SHORTEST = 0.10  # [m] palm and fingers need this much
LINKS = ("gripper", "grasp")
_PALM = 0.055  # [m] length of the palm
_GAP = 0.0045  # [m] between the pads


def _turned_to(along) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a frame whose z points along a unit vector: no roll."""
    x, y, z = (float(value) for value in along)
    return 0.0, math.acos(max(-1.0, min(1.0, z))), math.atan2(y, x)


def gripper_elements(
    flange: str, length: float = GRIPPER_LENGTH, along=(0.0, 0.0, 1.0)
) -> list[ElementTree.Element]:
    """Links and fixed joints of the gripper mounted on the link `flange`.

    Args:
        flange: link that carries the gripper.
        length: from the flange to the grasp point [m], at least `SHORTEST`.
        along: unit vector in the flange's frame along which the fingers point.
    """
    if not SHORTEST <= length < 1.0:
        raise ValueError(f"gripper length is {length!r} m; give {SHORTEST} to 1 m")
    tip = length + 0.012
    visuals = [
        rod_between((0, 0, 0), (0, 0, 0.012), 0.032, "metal"),
        box((0.044, 0.084, _PALM - 0.012), (0, 0, (_PALM + 0.012) / 2), "dark"),
        box((0.046, 0.052, 0.014), (0, 0, _PALM - 0.016), "red"),
    ]
    for side in (-1.0, 1.0):
        root = side * (_GAP / 2 + 0.009)
        pad = side * (_GAP / 2 + 0.003)
        visuals += [
            box((0.020, 0.012, 0.026), (0, root, _PALM + 0.013), "metal"),
            box((0.018, 0.006, tip - _PALM), (0, pad, (tip + _PALM) / 2), "light"),
            box((0.014, 0.003, 0.026), (0, side * (_GAP / 2 + 0.0012), length), "pad"),
        ]
    collisions = [
        sphere(0.05, (0, 0, 0.03)),
        rod_between((0, 0, _PALM), (0, 0, length), 0.012),
    ]
    return [
        link_element("gripper", 0.3, visuals, collisions),
        joint_element("gripper_mount", flange, "gripper", (0, 0, 0), _turned_to(along)),
        link_element("grasp"),
        joint_element("grasp_point", "gripper", "grasp", (0, 0, length)),
    ]
