"""Capsules around a link's shapes: one for a primitive, a few for a mesh."""

from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from wrod.robot.mesh import read_mesh
from wrod.robot.urdf import LinkShape

_MOST = 4  # capsules around one mesh
_WORTH = 0.85  # one capsule more must shrink their volume to this share
_TURNS = 24  # directions in which the axis of a slab is moved sideways

Capsule = tuple[np.ndarray, np.ndarray, float]


def capsules_of(shape: LinkShape) -> list[Capsule]:
    """Ends (3,), (3,) and radius [m] of capsules around a shape, in its link's frame.

    Raises:
        RobotError: a mesh that cannot be read.
    """
    if shape.kind == "mesh":
        local = _mesh_capsules(shape.mesh, shape.size, shape.mesh.stat().st_mtime_ns)
        turn, at = shape.pose[:3, :3], shape.pose[:3, 3]
        return [(turn @ start + at, turn @ end + at, radius) for start, end, radius in local]
    if shape.kind == "sphere":
        half, radius, axis = 0.0, shape.size[0], np.eye(3)[2]
    elif shape.kind == "cylinder":
        radius, half, axis = shape.size[0], shape.size[1] / 2, np.eye(3)[2]
    else:
        size = np.array(shape.size)
        long = int(size.argmax())
        half, axis = size[long] / 2, np.eye(3)[long]
        radius = float(np.linalg.norm(np.delete(size, long)) / 2)
    offset = shape.pose[:3, :3] @ axis * half
    return [(shape.pose[:3, 3] - offset, shape.pose[:3, 3] + offset, float(radius))]


@lru_cache(maxsize=128)
def _mesh_capsules(path, scale: tuple[float, ...], stamp: int) -> list[Capsule]:
    """Capsules that together contain a mesh, cut into slabs along its longest direction."""
    vertices, faces = read_mesh(path)
    points = vertices[np.unique(faces)] * np.array(scale)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    first, last = (vertices[edges[:, k]] * np.array(scale) for k in (0, 1))
    axis = np.linalg.eigh(np.cov(points.T))[1][:, -1]
    along, start, end = points @ axis, first @ axis, last @ axis
    best, volume = None, np.inf
    for count in range(1, _MOST + 1):
        planes = np.linspace(along.min(), along.max(), count + 1)[1:-1]
        cuts = []  # where edges pass from slab to slab: the triangles lie between these points
        for plane in planes:
            crossing = (start - plane) * (end - plane) < 0
            share = ((plane - start) / np.where(end == start, 1.0, end - start))[crossing, None]
            cuts.append(first[crossing] + share * (last - first)[crossing])
        slab = np.searchsorted(planes, along)
        pieces = [
            np.concatenate([points[slab == k], *cuts[max(k - 1, 0) : k + 1]]) for k in range(count)
        ]
        fitted = [around(_outer(piece)) for piece in pieces if len(piece)]
        total = sum(np.pi * r**2 * (np.linalg.norm(b - a) + 4 / 3 * r) for a, b, r in fitted)
        if total < _WORTH * volume:
            best, volume = fitted, total
    return best


def _outer(points: np.ndarray) -> np.ndarray:
    """The corners of the points' convex hull: no others touch a capsule around them."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # flat, or too few
        return points


def around(points: np.ndarray) -> Capsule:
    """A tight capsule that contains points (n, 3), along their longest direction."""
    middle = (points.max(0) + points.min(0)) / 2
    axes = np.linalg.eigh(np.cov(points.T))[1].T if len(points) > 1 else np.eye(3)
    found = None
    for k, axis in enumerate(axes):
        side = np.delete(axes, k, axis=0)
        flat = (points - middle) @ side.T
        centre = _centre(flat)
        far = np.linalg.norm(flat - centre, axis=1)
        radius = float(far.max()) + 1e-9
        along = (points - middle) @ axis
        cap = np.sqrt(np.maximum(radius**2 - far**2, 0.0))
        low, high = (along + cap).min(), (along - cap).max()
        foot = middle + centre @ side
        if low > high:  # shorter than thick: a sphere
            centre3 = foot + axis * (low + high) / 2
            radius = float(np.linalg.norm(points - centre3, axis=1).max())
            low = high = (low + high) / 2
        size = np.pi * radius**2 * (high - low + 4 / 3 * radius)
        if found is None or size < found[0]:
            found = size, (foot + axis * low, foot + axis * high, radius)
    return found[1]


def _centre(flat: np.ndarray) -> np.ndarray:
    """Centre (2,) of nearly the least circle around points (n, 2), by steps to the farthest."""
    centre = (flat.max(0) + flat.min(0)) / 2
    for step in range(1, 4 * _TURNS):
        far = flat[np.linalg.norm(flat - centre, axis=1).argmax()]
        centre = centre + (far - centre) / (step + 1)
    return centre
