"""Planes and solids that rods touch."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import ClassVar

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.contact import shapes as kernels
from wrod.kernels.contact import solids
from wrod.rods.device import resolve_device

_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
# How far a vertex may lie over a convex mesh, over its size, and triangles that are looked at
# together.
_FLAT, _TOGETHER = 1e-6, 1000


_VECTOR, _NUMBER = arguments.array((3,)), arguments.number()
_KINDS = {
    "point": _VECTOR, "normal": _VECTOR, "center": _VECTOR, "half_size": _VECTOR, "axis": _VECTOR,
    "rotation": arguments.array((4,)), "radius": _NUMBER, "half_height": _NUMBER,
}  # fmt: skip


class _Checked:
    """Its places and sizes are finite numbers; whether it has a size is judged where it is used."""

    def __post_init__(self) -> None:
        names = (one.name for one in fields(self))  # type: ignore[arg-type]
        arguments.check_fields(self, RodError, **{n: _KINDS[n] for n in names if n in _KINDS})


@dataclass(frozen=True)
class Plane(_Checked):
    """A half-space: everything below `point`, against `normal`."""

    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def _describe(self):
        return int(kernels.PLANE), self.point, turn_up_to(self.normal), (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Box(_Checked):
    """A box of half sizes `half_size` (3) [length] around `center`, turned by a quaternion xyzw."""

    center: tuple[float, float, float]
    half_size: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = _UPRIGHT

    def _describe(self):
        return int(solids.BOX), self.center, self.rotation, self.half_size


@dataclass(frozen=True)
class _OfRevolution(_Checked):
    """A solid of revolution about an axis."""

    center: tuple[float, float, float]
    radius: float
    half_height: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    kind: ClassVar[int]

    def _describe(self):
        size = (self.radius, self.half_height, 0.0)
        return self.kind, self.center, turn_up_to(self.axis), size


@dataclass(frozen=True)
class Cylinder(_OfRevolution):
    """A cylinder around `center` with its axis along `axis`."""

    kind = int(solids.CYLINDER)


@dataclass(frozen=True)
class Sphere(_Checked):
    """A ball of a radius [length] around `center`."""

    center: tuple[float, float, float]
    radius: float

    def _describe(self):
        return int(solids.SPHERE), self.center, _UPRIGHT, (self.radius, self.radius, 0.0)


@dataclass(frozen=True)
class Capsule(_OfRevolution):
    """A cylinder around `center` of that half height, with half balls on both ends."""

    kind = int(solids.CAPSULE)


@dataclass(frozen=True)
class Cone(_OfRevolution):
    """A cone whose apex is `half_height` from `center` along `axis`, its base as far behind."""

    kind = int(solids.CONE)


@dataclass(frozen=True)
class Ellipsoid(_Checked):
    """An ellipsoid of half axes `half_size` (3) around `center`, turned by a quaternion xyzw."""

    center: tuple[float, float, float]
    half_size: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = _UPRIGHT

    def _describe(self):
        return int(solids.ELLIPSOID), self.center, self.rotation, self.half_size


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles, whose corners run anticlockwise seen from outside; one that encloses
    nothing is a sheet that rods touch from both sides.

    An edge of a rod touches a convex one where it is nearest; one with hollows by what is nearest
    on all triangles about there (`wrod.kernels.contact.gap`).

    Attributes:
        vertices: (vertex, 3) in the mesh's own frame [length].
        triangles: (triangle, 3) indices of their corners.
        center, rotation: where its frame is, and a quaternion xyzw.
        device: where rods touch it: "cpu", "cuda:0", "auto".

    Raises:
        RodError: no triangles, a corner that is no vertex, or a vertex that is not finite.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = _UPRIGHT
    device: arguments.DeviceLike = "cpu"
    _mesh: wp.Mesh = field(init=False, repr=False)
    _hollow: bool = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices, dtype=float)
        triangles = np.asarray(self.triangles, dtype=np.int64).reshape(-1, 3)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise RodError("mesh vertices must be (vertex, 3) finite numbers")
        if not len(triangles) or triangles.min() < 0 or triangles.max() >= len(vertices):
            raise RodError("mesh triangles must be (triangle, 3) indices of its vertices")
        corner = vertices[triangles]
        area = np.linalg.norm(
            np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
        )
        triangles = triangles[area > 1e-12 * area.max()]
        object.__setattr__(self, "device", resolve_device(self.device))
        mesh = wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device=self.device),
            indices=wp.array(triangles.ravel(), dtype=wp.int32, device=self.device),
            support_winding_number=True,
        )
        object.__setattr__(self, "_mesh", mesh)
        object.__setattr__(self, "_hollow", _is_hollow(vertices, corner[area > 1e-12 * area.max()]))

    def moved(self, center, rotation) -> Mesh:
        """The same mesh in another place."""
        out = object.__new__(Mesh)
        out.__dict__.update(self.__dict__, center=center, rotation=rotation)
        return out

    def _describe(self):
        reach = float(np.linalg.norm(self.vertices, axis=1).max())
        size = (reach, 0.5 * reach if self._hollow else reach, reach)
        return int(solids.MESH), self.center, self.rotation, size


def _is_hollow(vertices: np.ndarray, corner: np.ndarray) -> bool:
    """Whether a vertex lies over the plane of a triangle (triangle, corner, 3)."""
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = across / np.linalg.norm(across, axis=1)[:, None]
    height = np.einsum("ij,ij->i", normal, corner[:, 0])
    over = _FLAT * np.abs(vertices).max()
    parts = range(0, len(normal), _TOGETHER)
    ends = [slice(a, a + _TOGETHER) for a in parts]
    return any(bool((vertices @ normal[p].T > height[p] + over).any()) for p in ends)


Shape = Plane | Box | Cylinder | Sphere | Capsule | Cone | Ellipsoid | Mesh


def shape_record(shape: Shape) -> kernels.Shape:
    """What kernels know of a shape.

    Raises:
        RodError: a size is not positive, or something is not finite.
    """
    kind, position, rotation, size = shape._describe()
    values = np.concatenate([position, rotation, size]).astype(float)
    sizes = size if kind == int(solids.ELLIPSOID) else size[:2]
    if not np.isfinite(values).all() or (kind != int(kernels.PLANE) and np.min(sizes) <= 0):
        raise RodError(f"{shape}: sizes must be positive and finite")
    out = kernels.Shape()
    out.kind = kind
    out.position = wp.vec3d(*map(float, position))
    turn = np.asarray(rotation, dtype=float)
    out.rotation = wp.quatd(*map(float, turn / np.linalg.norm(turn)))
    out.size = wp.vec3d(*map(float, size))
    if isinstance(shape, Mesh):
        out.mesh = shape._mesh.id
    return out


def turn_up_to(direction) -> tuple[float, float, float, float]:
    """Quaternion xyzw that turns z to `direction`.

    Raises:
        RodError: the direction has no length.
    """
    d = np.asarray(direction, dtype=float)
    size = np.linalg.norm(d)
    if not (np.isfinite(size) and size > 0):
        raise RodError(f"direction {direction!r} has no length; give a normal or an axis")
    d = d / size
    q = np.array([-d[1], d[0], 0.0, 1.0 + d[2]])
    if np.linalg.norm(q) < 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    return tuple(q / np.linalg.norm(q))
