"""Distances between the true shapes of an arm's links (coal), where capsules leave a doubt.

Capsules contain their shapes, so their gaps are never too large. They are the broad phase: only
poses and pairs whose capsules come too near are looked at again, mesh against mesh.
"""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np

from wrod.errors import WrodWarning
from wrod.robot.mesh import read_mesh
from wrod.robot.urdf import LinkShape


class ExactShapes:
    """Collision shapes of an arm as coal's geometries.

    Attributes:
        shapes: of every link, in the order of `CollisionModel.shapes`.
    """

    def __init__(self, shapes: list[LinkShape]):
        import coal

        self._coal = coal
        self.shapes = shapes
        # Made when first asked for: large meshes take long.
        self._geometry = cache(lambda index: self._made(shapes[index]))
        self._vertices = cache(lambda index: _vertices(shapes[index]))

    @classmethod
    def of(cls, shapes: list[LinkShape]) -> ExactShapes | None:
        """The shapes, or None where there is no mesh among them or no library."""
        if all(shape.kind != "mesh" for shape in shapes):
            return None
        try:
            return cls(shapes)
        except ImportError:
            warnings.warn(
                "gaps between meshes are measured between capsules around them, which refuses "
                "more than needs be; install wrod[meshes] for the true ones",
                WrodWarning,
                stacklevel=3,
            )
            return None

    def _made(self, shape: LinkShape):
        coal = self._coal
        if shape.kind == "sphere":
            return coal.Sphere(float(shape.size[0]))
        if shape.kind == "cylinder":
            # As a capsule, which is what is meant in most descriptions, and what is planned with.
            return coal.Capsule(float(shape.size[0]), float(shape.size[1]))
        if shape.kind == "box":
            return coal.Box(*map(float, shape.size))
        vertices, faces = read_mesh(shape.mesh)
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(faces), len(vertices))
        points = coal.StdVec_Vec3s()
        for vertex in vertices * np.array(shape.size):
            points.append(vertex)
        triangles = coal.StdVec_Triangle()
        for face in faces:
            triangles.append(coal.Triangle(*map(int, face)))
        model.addSubModel(points, triangles)
        model.endModel()
        return model

    def gap(self, first: int, second: int, pose: np.ndarray, other: np.ndarray) -> float:
        """Distance [m] of two shapes at poses (4, 4) of their links; 0 where they meet."""
        coal = self._coal
        placed = []
        for index, link in ((first, pose), (second, other)):
            at = link @ self.shapes[index].pose
            placed.append(coal.Transform3s(np.ascontiguousarray(at[:3, :3]), at[:3, 3].copy()))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.enable_signed_distance = False
        a, b = self._geometry(first), self._geometry(second)
        distance = coal.distance(a, placed[0], b, placed[1], request, result)
        return max(float(distance), 0.0)

    def lowest(self, index: int, poses: np.ndarray) -> np.ndarray:
        """(K,) height [m] of the lowest point of a shape at poses (K, 4, 4) of its link."""
        points, radius = self._vertices(index)
        up = poses[:, 2, :3] @ points.T + poses[:, 2, 3:4]
        return up.min(1) - radius


def _vertices(shape: LinkShape) -> tuple[np.ndarray, float]:
    """Points (n, 3) in the link's frame and a radius [m] around them that make up the shape."""
    radius = 0.0
    if shape.kind == "mesh":
        points = read_mesh(shape.mesh)[0] * np.array(shape.size)
    elif shape.kind == "box":
        corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, 8).T
        points = corners * np.array(shape.size)
    else:
        half = shape.size[1] / 2 if shape.kind == "cylinder" else 0.0
        points, radius = np.array([[0, 0, -half], [0, 0, half]]), float(shape.size[0])
    return points @ shape.pose[:3, :3].T + shape.pose[:3, 3], radius
