"""The shapes of a Newton model that rods touch, as `wrod.solvers.solids` knows them."""

import warnings
from dataclasses import dataclass

import numpy as np
from newton import BodyFlags, GeoType, Model, ShapeFlags
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from wrod.errors import WrodWarning
from wrod.solvers.friction import Friction
from wrod.solvers.solids import Box, Capsule, Cone, Cylinder, Ellipsoid, Mesh, Plane, Shape, Sphere

_TURNED: dict[GeoType, type[Box | Ellipsoid]] = {GeoType.BOX: Box, GeoType.ELLIPSOID: Ellipsoid}
_ON_AXIS: dict[GeoType, type[Cylinder | Capsule | Cone]] = {
    GeoType.CYLINDER: Cylinder, GeoType.CAPSULE: Capsule, GeoType.CONE: Cone,
}  # fmt: skip
_MESHES = (GeoType.MESH, GeoType.CONVEX_MESH, GeoType.HFIELD)
_SOLIDS = (*_TURNED, *_ON_AXIS, GeoType.SPHERE, *_MESHES)
# A plane with ends is a sheet as thick as this fraction of its shorter side; an endless one on a
# body that moves with rods, which touch solids there, ends after so many metres.
_THINNESS, _ENDLESS = 1e-3, 1e3
_STANDARD_GRAVITY = 9.81
# Of the weight of a body that others move, one edge is to bear so much as if it moved with rods: it
# bears all sunk in by half a radius. Its load is of the step before, with which stiffer contact
# shakes.
_PART_OF_OTHERS = 0.04


@dataclass(frozen=True)
class RodPlaces:
    """Rows of rods: their worlds (row,), and by row the slots of the bodies that move with them."""

    worlds: np.ndarray
    slots: list[dict[int, int]]


@dataclass(frozen=True)
class Carriers:
    """What carries shapes.

    Attributes:
        body: (row, shape) bodies that others move, -1 for none.
        slot: (row, shape) slots of bodies that move with the rods, -1 for none.
        place, turn: (row, shape, 3) and (row, shape, 4) places and quaternions on these bodies.
        burden: (row, shape) weight on Earth of the bodies that move with the rods, and a part of
            that of bodies that others move by forces [N].
        mass: (row, shape) of the latter, with all that joints tie them to [kg]; 0 for none.
    """

    body: np.ndarray
    slot: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    burden: np.ndarray
    mass: np.ndarray


class ModelShapes:
    """Planes and solids that collide with shapes, with the friction of their `mu`.

    A shape of world -1 touches the rods of every world, any other those of its own; one on a body
    that moves with rods those that share its steps. A shape that no rod can touch is named in a
    warning.

    Args:
        model: the Newton model.
        own: (body,) bodies that move with rods.

    Attributes:
        rows: indices of the shapes into the model's.
    """

    def __init__(self, model: Model, own: np.ndarray):
        self.model = model
        kinds, flags, scale = (self._read(n) for n in ("type", "flags", "scale"))
        collide = flags & int(ShapeFlags.COLLIDE_SHAPES) != 0
        sides = scale[:, :2] > 0
        planes = (kinds == GeoType.PLANE) & (sides.all(axis=1) | ~sides.any(axis=1))
        body = self._read("body")
        owned = np.zeros(len(kinds), dtype=bool)
        owned[body >= 0] = own[body[body >= 0]]
        # Newton's detection knows bodies by their groups; those without one touch nothing at all.
        collide &= ~owned | (self._read("collision_group") != 0)
        known = planes | np.isin(kinds, [int(k) for k in _SOLIDS])
        self.rows = np.flatnonzero(collide & known)
        self._worlds = self._read("world")[self.rows]
        self._owner = np.where(owned, body, -1)[self.rows]
        self._meshes: dict[int, Mesh] = {}
        unknown = np.flatnonzero(collide & ~known)
        if len(unknown):
            names = [
                f"{model.shape_label[i]} ({GeoType(kinds[i]).name.lower()})" for i in unknown[:3]
            ]
            warnings.warn(
                f"rods pass through {len(unknown)} shapes: {', '.join(names)}"
                f"{' and others' if len(unknown) > 3 else ''}; they touch no planes that end on "
                "two sides alone",
                WrodWarning,
                stacklevel=4,
            )

    def of(self, rods: RodPlaces) -> tuple[list[list], list[list[Friction]]]:
        """Shapes and frictions for the rods of these rows, in the units of the model."""
        described = self._describe()
        friction = [Friction(float(mu)) for mu in self._read("material_mu")[self.rows]]
        chosen = self._touched(rods)
        return [[described[k] for k in row] for row in chosen], [
            [friction[k] for k in row] for row in chosen
        ]

    def carriers(self, rods: RodPlaces) -> Carriers:
        """What carries the shapes that rods touch."""
        chosen = self._touched(rods)
        shape = (len(chosen), max(map(len, chosen)))
        body, slot = np.full((2, *shape), -1, dtype=np.int32)
        burden, mass, pose = np.zeros(shape), np.zeros(shape), np.zeros((*shape, 7))
        pose[..., 6] = 1.0
        bodies, poses = self._read("body")[self.rows], self._read("transform")[self.rows]
        poses, kinds, sizes = poses.astype(float), self._read("type")[self.rows], self._sizes()
        for k in np.flatnonzero((kinds == GeoType.PLANE) & sizes[:, :2].all(axis=1)):
            # The middle of a sheet lies below its plane.
            axis = Rotation.from_quat(poses[k, 3:]).as_matrix()[:, 2]
            poses[k, :3] -= _half_thickness(sizes[k]) * axis
        weight = _STANDARD_GRAVITY * self.model.body_mass.numpy()
        moving = _moving_masses(self.model)
        pushed = self.model.body_flags.numpy() & int(BodyFlags.DYNAMIC) != 0
        for r, row in enumerate(chosen):
            pose[r, : len(row)] = poses[row]
            for k, one in enumerate(row):
                owner = int(self._owner[one])
                if owner < 0:
                    body[r, k] = bodies[one]
                    if bodies[one] >= 0 and pushed[bodies[one]]:
                        burden[r, k] = _PART_OF_OTHERS * weight[bodies[one]]
                        mass[r, k] = moving[bodies[one]]
                else:
                    slot[r, k] = rods.slots[r][owner]
                    burden[r, k] = weight[owner]
        return Carriers(body, slot, pose[..., :3], pose[..., 3:], burden, mass)

    def indices(self, rods: RodPlaces) -> np.ndarray:
        """(rod, shape) of the shapes in the model, -1 where a row has fewer than others."""
        chosen = [self.rows[touched] for touched in self._touched(rods)]
        out = np.full((len(chosen), max(map(len, chosen))), -1, dtype=np.int32)
        for row, found in zip(out, chosen, strict=True):
            row[: len(found)] = found
        return out

    def _read(self, name: str) -> np.ndarray:
        """One of the model's arrays of shapes; of no shapes too."""
        width = {"scale": (3,), "transform": (7,)}.get(name, ())
        array = getattr(self.model, f"shape_{name}")
        return array.numpy() if self.model.shape_count else np.zeros((0, *width), dtype=np.int32)

    def _sizes(self) -> np.ndarray:
        """(shape, 3) scales of the shapes, planes without ends on bodies that move with rods being
        as large as can be."""
        out = self._read("scale")[self.rows].astype(float)
        planes = (self._read("type")[self.rows] == GeoType.PLANE) & (self._owner >= 0)
        out[planes & ~out[:, :2].any(axis=1)] = _ENDLESS
        return out

    def _touched(self, rods: RodPlaces) -> list[np.ndarray]:
        """Indices into `rows` of what the rods of each row touch."""
        out = []
        for world, slots in zip(rods.worlds, rods.slots, strict=True):
            near = (self._worlds == -1) | (self._worlds == world)
            out.append(
                np.flatnonzero(np.where(self._owner < 0, near, np.isin(self._owner, list(slots))))
            )
        return out

    def _describe(self) -> list[Shape]:
        """The shapes where the model has them."""
        bodies = self.model.body_q.numpy().astype(float)
        out = []
        for shape, kind, carrier, pose, size in zip(
            self.rows,
            self._read("type")[self.rows],
            self._read("body")[self.rows],
            self._read("transform")[self.rows].astype(float),
            self._sizes(),
            strict=True,
        ):
            place, turn = pose[:3], Rotation.from_quat(pose[3:])
            if carrier >= 0:
                holder = Rotation.from_quat(bodies[carrier, 3:])
                place, turn = bodies[carrier, :3] + holder.apply(place), holder * turn
            out.append(self._solid(int(shape), GeoType(kind), tuple(place), turn, size))
        return out

    def _solid(self, shape: int, kind: GeoType, place: tuple, turn: Rotation, size) -> Shape:
        axis, quaternion = tuple(turn.as_matrix()[:, 2]), tuple(turn.as_quat())
        if kind == GeoType.PLANE:
            if not size[:2].all():
                return Plane(place, axis)
            deep = _half_thickness(size)
            center = tuple(np.subtract(place, np.multiply(deep, axis)))
            return Box(center, (0.5 * size[0], 0.5 * size[1], deep), quaternion)
        if kind == GeoType.SPHERE:
            return Sphere(place, size[0])
        if kind in _TURNED:
            return _TURNED[kind](place, tuple(size), quaternion)
        if kind in _ON_AXIS:
            return _ON_AXIS[kind](place, size[0], size[1], axis)
        if shape not in self._meshes:
            source = self.model.shape_source[shape]
            device = str(self.model.device)
            self._meshes[shape] = Mesh(*_triangles(source, kind, size), device=device)
        return self._meshes[shape].moved(place, quaternion)


def _moving_masses(model: Model) -> np.ndarray:
    """(body,) mass of the articulation that a body is of, or its own [kg]."""
    out = model.body_mass.numpy().astype(float)
    if model.joint_count:
        child, tied = model.joint_child.numpy(), model.joint_articulation.numpy()
        for articulation in np.unique(tied[tied >= 0]):
            bodies = np.unique(child[tied == articulation])
            out[bodies] = out[bodies].sum()
    return out


def _half_thickness(size: np.ndarray) -> float:
    """Of the sheet that a plane of that size is."""
    return 0.5 * _THINNESS * float(size[:2].min())


def _triangles(source, kind: GeoType, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh, a convex hull or a height field, scaled."""
    if kind == GeoType.HFIELD:
        return _ground(source, scale)
    vertices = np.asarray(source.vertices, dtype=float) * scale
    triangles = np.asarray(source.indices).reshape(-1, 3)
    if kind == GeoType.CONVEX_MESH:
        hull = ConvexHull(vertices)
        triangles = hull.simplices.copy()
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
        triangles[inward] = triangles[inward][:, ::-1]
    elif np.prod(scale) < 0:
        triangles = triangles[:, ::-1]
    return vertices, triangles


def _ground(field, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A height field as the surface of the ground beneath it, as deep as it is wide."""
    rows, columns = field.nrow, field.ncol
    x, y = np.meshgrid(
        np.linspace(-field.hx, field.hx, columns), np.linspace(-field.hy, field.hy, rows)
    )
    top = field.min_z + np.asarray(field.data, dtype=float) * (field.max_z - field.min_z)
    bottom = np.full_like(top, field.min_z - min(field.hx, field.hy))
    vertices = np.concatenate([np.stack([x, y, z], axis=2).reshape(-1, 3) for z in (top, bottom)])
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    upper = np.concatenate([np.stack(t, axis=2).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    below = rows * columns
    border = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2::-1, 0]])
    u, v = border[:-1], border[1:]
    walls = np.concatenate(
        [np.column_stack([u, u + below, v + below]), np.column_stack([u, v + below, v])]
    )
    return vertices * scale, np.concatenate([upper, upper[:, ::-1] + below, walls])
