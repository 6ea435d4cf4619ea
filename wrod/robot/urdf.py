"""Reading a URDF: its links and shapes, and one clear sentence for what is missing from it."""

import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.files.markup import read_markup
from wrod.files.reading import shown
from wrod.robot.expansion import expanded, folders_of
from wrod.robot.urdf_checks import check_urdf

# Usual names of the link that a gripper is screwed to, whole or as the end of one.
_FLANGES = (
    "right_hand", "tool0", "flange", "link8", "link_eef", "ee_link", "end_effector_link", "link_ee",
)  # fmt: skip


# Words in the names of joints and links that belong to a gripper.
_FINGERS = ("gripper", "finger", "jaw", "knuckle", "thumb")


def _is_finger(joint: ElementTree.Element) -> bool:
    """Whether a joint moves a part of a gripper: it follows another joint, or is called so. A wrist
    moves all of the gripper."""
    child = joint.find("child").get("link", "")
    names = f"{joint.get('name', '')} {child}".lower()
    called = any(word in names for word in _FINGERS) and "wrist" not in names
    return called or joint.find("mimic") is not None


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
    """A parsed URDF that `read_urdf` has checked: a tree of links whose shapes are whole."""

    path: Path
    root: ElementTree.Element

    @property
    def links(self) -> list[str]:
        return [link.get("name", "") for link in self.root.findall("link")]

    @property
    def joints(self) -> list[ElementTree.Element]:
        return self.root.findall("joint")

    @property
    def above(self) -> dict[str, tuple[str, ElementTree.Element]]:
        """Of each link but the first, the link that it hangs from, and the joint between them."""
        return {j.find("child").get("link"): (j.find("parent").get("link"), j) for j in self.joints}

    @property
    def base_link(self) -> str:
        """The one link that is no joint's child."""
        above = self.above
        return next(name for name in self.links if name not in above)

    def require_link(self, name: str, role: str) -> None:
        if name not in self.links:
            raise RobotError(
                f"{self.path}: no link {name!r:.80} for the {role}; its links are "
                f"{shown(', '.join(self.links), 1000)}"
            )

    def flange(self) -> str:
        """The link that carries a gripper: fixed to the end of the longest chain of revolute
        joints (fingers that slide or turn do not count), the one of a flange's usual names if there
        is one.
        """
        parent = {
            link: (above, "finger" if _is_finger(joint) else joint.get("type"))
            for link, (above, joint) in self.above.items()
        }

        def turns(link: str) -> int:
            count = 0
            while link in parent:
                link, kind = parent[link]
                count += kind in ("revolute", "continuous")
            return count

        ends = [x for x in self.links if parent.get(x, ("", ""))[1] in ("revolute", "continuous")]
        if not ends:
            return self.base_link
        last = max(ends, key=turns)
        fixed = [last]
        for link in fixed:
            fixed += [x for x, (above, kind) in parent.items() if above == link and kind == "fixed"]
        for name in _FLANGES:
            for link in fixed:
                if link == name or link.endswith(name):
                    return link
        return last

    def approach(self, flange: str) -> np.ndarray:
        """(3,) direction in which a gripper points from a flange, in its frame: +z, which frames of
        their own have by convention, or the axis of the joint that turns it, towards what the file
        hangs on it."""
        _, turning = self.above.get(flange, ("", None))
        if turning is None or turning.get("type") not in ("revolute", "continuous"):
            return np.array([0.0, 0.0, 1.0])
        element = turning.find("axis")
        axis = np.array(_floats("1 0 0" if element is None else element.get("xyz", "1 0 0")))
        axis = axis / max(np.linalg.norm(axis), 1e-12)
        hung = [j for j in self.joints if j.find("parent").get("link") == flange]
        along = sum(float(_origin(j.find("origin"))[:3, 3] @ axis) for j in hung)
        if abs(along) < 1e-6:  # nothing tells: the positive side of its largest component
            along = axis[np.abs(axis).argmax()]
        return axis * np.sign(along)

    def beyond(self, link: str) -> set[str]:
        """All links that hang from a link."""
        above, found, queue = self.above, set(), [link]
        while queue:
            at = queue.pop()
            below = [child for child, (parent, _) in above.items() if parent == at]
            found |= set(below)
            queue += below
        return found

    def never_in_contact(self) -> set[frozenset[str]]:
        """Pairs of links whose contact an SRDF beside the file disables; empty without one."""
        for folder in (self.path.parent, self.path.parent.parent / "srdf"):
            for name in (self.path.stem, self.root.get("name", "")):
                file = folder / f"{name}.srdf"
                if name and file.is_file():
                    return _disabled_pairs(file)
        return set()

    def shapes(self, tag: str) -> list[LinkShape]:
        """All shapes of every link; `tag` is "visual" or "collision"."""
        colors = {
            material.get("name"): _color(material) for material in self.root.findall("material")
        }
        return [
            self._shape(link.get("name"), element, colors)
            for link in self.root.findall("link")
            for element in link.findall(tag)
        ]

    def _shape(self, link: str, element: ElementTree.Element, colors: dict) -> LinkShape:
        pose = _origin(element.find("origin"))
        material = element.find("material")
        color = None
        if material is not None:
            color = _color(material) or colors.get(material.get("name"))
        shape = next(iter(element.find("geometry")))
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
        """File that a mesh name means: relative to the URDF, or `package://` of a package, see
        `folders_of`.

        Raises:
            RobotError: there is no such file.
        """
        hint = "put it there or remove the mesh from the file"
        if name.startswith(("package://", "model://")):
            package, _, rest = name.partition("://")[2].partition("/")
            candidates = [folder / rest for folder in folders_of(package, self.path)]
            hint = (
                f"put the package {package!r:.80} beside the URDF or name its parent folder in "
                "ROS_PACKAGE_PATH"
            )
        elif name.startswith(("http://", "https://")):
            raise RobotError(
                f"{self.path}: mesh {shown(name)!r} is on the net; download it and name the file"
            )
        else:
            candidates = [self.path.parent / name.removeprefix("file://")]
        for candidate in candidates:
            if candidate.is_file():
                return candidate
        raise RobotError(
            f"{self.path}: mesh {shown(name)!r} is missing (looked at {shown(candidates[0])}); "
            f"{shown(hint, 200)}"
        )


def read_urdf(path: str | os.PathLike[str]) -> UrdfFile:
    """Parse a URDF and check that it is whole; one that holds xacro's elements is expanded first.

    Raises:
        RobotError: the file is missing, not XML, not a robot, names a link that it does not
            have, or names a mesh file that does not exist.
    """
    path = Path(path)
    what = "a URDF file"
    root = None if path.suffix == ".xacro" else read_markup(path, what, error=RobotError)
    if root is None or any(element.tag.startswith("xacro:") for element in root):
        root = read_markup(path, what, content=expanded(path), error=RobotError)
    for element in root.iter():  # other programs' own, whose prefixes are seldom declared
        for name in [name for name in element.attrib if ":" in name or name == "xmlns"]:
            del element.attrib[name]
    check_urdf(root, path)
    urdf = UrdfFile(path, root)
    for mesh in root.iter("mesh"):
        urdf.mesh_path(mesh.get("filename", ""))
    return urdf


def _disabled_pairs(path: Path) -> set[frozenset[str]]:
    root = read_markup(path, "an SRDF file", error=RobotError)
    return {
        frozenset((pair.get("link1", ""), pair.get("link2", "")))
        for pair in root.iter("disable_collisions")
    }


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
    if color is None:
        return None
    red, green, blue, *_ = _floats(color.get("rgba", "0.5 0.5 0.5 1"))
    return red, green, blue
