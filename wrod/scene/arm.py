"""The arm on the stage: one Xform per link, nested as its joints are, with its visual shapes."""

import re

import numpy as np

from wrod.robot.mesh import read_mesh
from wrod.robot.model import Robot
from wrod.scene.primitives import Materials, add_mesh, add_shape, set_pose
from wrod.scene.workplace import BASE_HEIGHT

_GREY = (0.45, 0.45, 0.48)


def add_arm(
    stage, path: str, robot: Robot, base: np.ndarray, positions, times, materials: Materials
) -> None:
    """Add an arm whose links move.

    Args:
        path: prim of the base link; other links are its descendants.
        base: (4, 4) pose of the base [m].
        positions: (T, n) joint positions [rad].
        times: (T,) time codes.
    """
    poses = robot.link_poses(positions)
    children: dict[str, list[str]] = {}
    for joint in robot.urdf.joints:
        children.setdefault(joint.find("parent").get("link"), []).append(
            joint.find("child").get("link")
        )
    shapes: dict[str, list] = {}
    for shape in robot.shapes("visual"):
        shapes.setdefault(shape.link, []).append(shape)

    def add_link(link: str, path: str, local: np.ndarray) -> None:
        from pxr import UsdGeom

        prim = UsdGeom.Xform.Define(stage, path).GetPrim()
        set_pose(prim, local, times)
        add_visuals(stage, path, shapes.get(link, []), materials)
        for child in children.get(link, []):
            relative = np.linalg.inv(poses[link]) @ poses[child]
            add_link(child, f"{path}/{prim_name(child)}", relative)

    add_link(robot.base, path, np.broadcast_to(base, (len(times), 4, 4)))


def reach_of(robot: Robot, base: np.ndarray, positions) -> tuple[list[np.ndarray], np.ndarray]:
    """(n, 3) places of each link of an arm on its way, and of its pedestal's foot [m]; arguments as
    those of `add_arm`."""
    poses = robot.link_poses(positions[:: max(1, len(positions) // 20)])
    links = [pose[:, :3, 3] @ base[:3, :3].T + base[:3, 3] for pose in poses.values()]
    feet = [[x, y, -BASE_HEIGHT] for x in (-0.3, 0.3) for y in (-0.3, 0.3)]
    return links, (base @ robot.mount)[:3, 3] + feet


def add_visuals(stage, path: str, shapes, materials: Materials) -> None:
    """Visual shapes of one link below its prim."""
    for number, shape in enumerate(shapes):
        name = f"{path}/{shape.kind}_{number}"
        color = shape.color or _GREY
        if shape.kind == "mesh":
            vertices, faces = read_mesh(shape.mesh)
            add_mesh(stage, name, vertices, faces, shape.size, shape.pose, materials, color)
        else:
            add_shape(stage, name, shape.kind, shape.size, shape.pose, materials, color)


def prim_name(name: str) -> str:
    """A link's name as a USD identifier."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    return name if name[:1].isalpha() or name[:1] == "_" else f"_{name}"
