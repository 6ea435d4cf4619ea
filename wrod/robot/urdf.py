"""Reading a URDF: its links and shapes, and one clear sentence for what is missing from it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.robot.urdf_checks import check_urdf, parse_xml


@dataclass(frozen=True)
class LinkShape:
    """A visual or collision shape of a link.

    Attributes:
        link: name of the link.
        kind: "sphere", "cylinder", "box" or "mesh".
        size: sphere (radius,), cylinder (radius, length), box (x, y, z), mesh scale (x, y, z) [m].
        pose: (4, 4) pose of the shape in the link's frame [m].
        color: (3,) red, green, blue in 0..1, or None.
        mesh: file of a mesh, else None.
    """

    link: str
    kind: str
    size: tuple[float, ...]
    pose: np.ndarray
    color: tuple[float, float, float] | None = None
    mesh: Path | None = None


@dataclass(frozen=True)
class UrdfFile:
    """A parsed URDF whose links, parents and mesh files are known to exist."""

    path: Path
    root: ElementTree.Element

    @property
    def links(self) -> list[str]:
        return [link.get("name", "") for link in self.root.findall("link")]

    @property
    def joints(self) -> list[ElementTree.Element]:
        return self.root.findall("joint")

    @property
    def base_link(self) -> str:
        """The one link that is no joint's child."""
        children = {joint.find("child").get("link") for joint in self.joints}
        roots = [name for name in self.links if name not in children]
        if len(roots) != 1:
            raise RobotError(
                f"{self.path}: {len(roots)} links have no parent ({', '.join(roots) or 'none'}); "
                "a robot needs exactly one root link"
            )
        return roots[0]

    def require_link(self, name: str, role: str) -> None:
        if name not in self.links:
            raise RobotError(
                f"{self.path}: no link {name!r} for the {role}; its links are "
                f"{', '.join(self.links)}"
            )

    def deepest_link(self) -> str:
        """The link at the end of the longest chain of moving joints."""
        moving = {"revolute", "continuous", "prismatic"}
        parent = {
            j.find("child").get("link"): (j.find("parent").get("link"), j.get("type") in moving)
            for j in self.joints
        }

        def depth(link: str) -> tuple[int, int]:
            count = steps = 0
            while link in parent:
                link, moves = parent[link]
                count, steps = count + moves, steps + 1
            return count, -steps

        return max(self.links, key=depth)

    def shapes(self, tag: str) -> list[LinkShape]:
        """All shapes of every link; `tag` is "visual" or "collision"."""
        colors = {
            material.get("name"): _color(material) for material in self.root.findall("material")
        }
        found = []
        for link in self.root.findall("link"):
            for element in link.findall(tag):
                found.append(self._shape(link.get("name"), element, colors))
        return found

    def _shape(self, link: str, element: ElementTree.Element, colors: dict) -> LinkShape:
        pose = _origin(element.find("origin"))
        material = element.find("material")
        color = None
        if material is not None:
            color = _color(material) or colors.get(material.get("name"))
        geometry = element.find("geometry")
        shape = next(iter(geometry)) if geometry is not None and len(geometry) else None
        if shape is None or shape.tag not in ("sphere", "cylinder", "box", "mesh"):
            raise RobotError(
                f"{self.path}: link {link!r} has a {element.tag} without sphere, cylinder, box or "
                "mesh"
            )
        if shape.tag == "mesh":
            scale = tuple(_floats(shape.get("scale", "1 1 1")))
            return LinkShape(
                link, "mesh", scale, pose, color, self.mesh_path(shape.get("filename"))
            )
        if shape.tag == "sphere":
            size = (float(shape.get("radius")),)
        elif shape.tag == "cylinder":
            size = (float(shape.get("radius")), float(shape.get("length")))
        else:
            size = tuple(_floats(shape.get("size")))
        return LinkShape(link, shape.tag, size, pose, color)

    def mesh_path(self, name: str) -> Path:
        """File that a mesh name means: relative to the URDF, or `package://` of a folder above it.

        Raises:
            RobotError: there is no such file.
        """
        if name.startswith("package://"):
            package, _, rest = name.removeprefix("package://").partition("/")
            folders = [p for p in self.path.resolve().parents]
            candidates = [p / rest for p in folders if p.name == package]
            candidates += [p / package / rest for p in folders]
        else:
            candidates = [self.path.parent / name.removeprefix("file://")]
        for candidate in candidates:
            if candidate.is_file():
                return candidate
        raise RobotError(
            f"{self.path}: mesh {name!r} is missing (looked at {candidates[0]}); put it there or "
            "remove the mesh from the file"
        )


def read_urdf(path: str | os.PathLike[str]) -> UrdfFile:
    """Parse a URDF and check that it is whole.

    Raises:
        RobotError: the file is missing, not XML, not a robot, names a link that it does not
            have, or names a mesh file that does not exist.
    """
    path = Path(path)
    root = parse_xml(path)
    check_urdf(root, path)
    urdf = UrdfFile(path, root)
    for mesh in root.iter("mesh"):
        urdf.mesh_path(mesh.get("filename", ""))
    return urdf


def _origin(element: ElementTree.Element | None) -> np.ndarray:
    pose = np.eye(4)
    if element is not None:
        pose[:3, 3] = _floats(element.get("xyz", "0 0 0"))
        rpy = _floats(element.get("rpy", "0 0 0"))
        pose[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    return pose


def _floats(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def _color(material: ElementTree.Element) -> tuple[float, float, float] | None:
    color = material.find("color")
    return None if color is None else tuple(_floats(color.get("rgba", "0.5 0.5 0.5 1"))[:3])
