"""Elements of a URDF file: primitive shapes, links and joints as ElementTree elements."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree import ElementTree


@dataclass(frozen=True)
class Shape:
    """A primitive in its link's frame. `size`: sphere (r,), cylinder (r, length), box (x, y, z)."""

    kind: str
    size: tuple[float, ...]
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    color: str = "dark"


def sphere(radius, xyz, color="dark") -> Shape:
    return Shape("sphere", (radius,), tuple(xyz), color=color)


def box(size, xyz, color="dark", rpy=(0.0, 0.0, 0.0)) -> Shape:
    return Shape("box", tuple(size), tuple(xyz), tuple(rpy), color)


def rod_between(start, end, radius, color="dark") -> Shape:
    """Cylinder from `start` to `end`; URDF cylinders lie along z, so pitch and yaw turn it."""
    delta = [b - a for a, b in zip(start, end, strict=True)]
    length = math.hypot(*delta)
    middle = tuple((a + b) / 2 for a, b in zip(start, end, strict=True))
    pitch = math.atan2(math.hypot(delta[0], delta[1]), delta[2])
    yaw = math.atan2(delta[1], delta[0])
    return Shape("cylinder", (radius, length), middle, (0.0, pitch, yaw), color)


def number(value: float) -> str:
    """Shortest text that keeps ten digits, without a negative zero."""
    return f"{round(value, 10) + 0.0:.10g}"


def numbers(values) -> str:
    return " ".join(number(value) for value in values)


def add_shape(parent: ElementTree.Element, tag: str, shape: Shape) -> None:
    """Append `shape` to a link as its next <visual> or <collision>."""
    element = ElementTree.SubElement(parent, tag)
    ElementTree.SubElement(element, "origin", xyz=numbers(shape.xyz), rpy=numbers(shape.rpy))
    geometry = ElementTree.SubElement(element, "geometry")
    if shape.kind == "sphere":
        ElementTree.SubElement(geometry, "sphere", radius=number(shape.size[0]))
    elif shape.kind == "cylinder":
        radius, length = shape.size
        ElementTree.SubElement(geometry, "cylinder", radius=number(radius), length=number(length))
    else:
        ElementTree.SubElement(geometry, "box", size=numbers(shape.size))
    if tag == "visual":
        ElementTree.SubElement(element, "material", name=shape.color)


def link_element(name: str, mass: float = 0.0, visuals=(), collisions=()) -> ElementTree.Element:
    """A <link>. Its inertia is that of a solid sphere of 6 cm: sawyer.md gives masses only."""
    link = ElementTree.Element("link", name=name)
    if mass > 0:
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=number(mass))
        moment = number(0.4 * mass * 0.06**2)
        off = {"ixy": "0", "ixz": "0", "iyz": "0"}
        ElementTree.SubElement(inertial, "inertia", ixx=moment, iyy=moment, izz=moment, **off)
    for shape in visuals:
        add_shape(link, "visual", shape)
    for shape in collisions:
        add_shape(link, "collision", shape)
    return link


def joint_element(
    name, parent, child, xyz, rpy=(0.0, 0.0, 0.0), limits=None
) -> ElementTree.Element:
    """A <joint> about +z, fixed without `limits` = (lower, upper, velocity, effort)."""
    kind = "fixed" if limits is None else "revolute"
    joint = ElementTree.Element("joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=numbers(xyz), rpy=numbers(rpy))
    if limits is not None:
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        lower, upper, velocity, effort = (number(value) for value in limits)
        ElementTree.SubElement(
            joint, "limit", lower=lower, upper=upper, velocity=velocity, effort=effort
        )
    return joint
