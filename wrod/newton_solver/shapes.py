"""The shapes of a Newton model that rods touch, as `wrod.solvers.contact` knows them."""

from __future__ import annotations

import warnings

import numpy as np
from newton import GeoType, Model, ShapeFlags
from scipy.spatial.transform import Rotation

from wrod.errors import WrodWarning
from wrod.solvers.contact import Box, Cylinder, Friction, Plane


class ModelShapes:
    """Planes, boxes and cylinders that collide with shapes, with the friction of their `mu`.

    A shape of world -1 touches the rods of every world, any other those of its own. A shape that
    no rod can touch is named in a warning.

    Attributes:
        rows: indices of the shapes into the model's.
    """

    def __init__(self, model: Model):
        self.model = model
        kinds, flags, scale = (self._read(n) for n in ("type", "flags", "scale"))
        collide = flags & int(ShapeFlags.COLLIDE_SHAPES) != 0
        endless = (kinds == GeoType.PLANE) & (scale[:, :2] == 0).all(axis=1)
        known = endless | (kinds == GeoType.BOX) | (kinds == GeoType.CYLINDER)
        self.rows = np.flatnonzero(collide & known)
        self._worlds = self._read("world")[self.rows]
        unknown = np.flatnonzero(collide & ~known)
        if len(unknown):
            names = [
                f"{model.shape_label[i]} ({GeoType(kinds[i]).name.lower()})" for i in unknown[:3]
            ]
            warnings.warn(
                f"rods pass through {len(unknown)} shapes: {', '.join(names)}"
                f"{' and others' if len(unknown) > 3 else ''}; they touch endless planes, boxes "
                "and cylinders only",
                WrodWarning,
                stacklevel=4,
            )

    def of(self, worlds: np.ndarray) -> tuple[list[list], list[list[Friction]]]:
        """Shapes and frictions for the rods of these worlds (rod,), in the units of the model."""
        described = self._describe()
        friction = [Friction(float(mu)) for mu in self._read("material_mu")[self.rows]]
        chosen = [self._touched(world) for world in worlds]
        return [[described[k] for k in row] for row in chosen], [
            [friction[k] for k in row] for row in chosen
        ]

    def carriers(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bodies (rod, shape) that carry the shapes, -1 for none, and the shapes' places
        (rod, shape, 3) and quaternions (rod, shape, 4) on them."""
        chosen = [self._touched(world) for world in worlds]
        shape = (len(worlds), max(map(len, chosen)))
        body = np.full(shape, -1, dtype=np.int32)
        pose = np.zeros((*shape, 7))
        pose[..., 6] = 1.0
        bodies, poses = self._read("body")[self.rows], self._read("transform")[self.rows]
        for r, row in enumerate(chosen):
            body[r, : len(row)] = bodies[row]
            pose[r, : len(row)] = poses[row]
        return body, pose[..., :3], pose[..., 3:]

    def _read(self, name: str) -> np.ndarray:
        """One of the model's arrays of shapes; of no shapes too."""
        width = {"scale": (3,), "transform": (7,)}.get(name, ())
        array = getattr(self.model, f"shape_{name}")
        return array.numpy() if self.model.shape_count else np.zeros((0, *width), dtype=np.int32)

    def _touched(self, world: int) -> np.ndarray:
        return np.flatnonzero((self._worlds == -1) | (self._worlds == world))

    def _describe(self) -> list[Plane | Box | Cylinder]:
        """The shapes where the model has them."""
        bodies = self.model.body_q.numpy().astype(float)
        out = []
        for kind, carrier, pose, size in zip(
            self._read("type")[self.rows],
            self._read("body")[self.rows],
            self._read("transform")[self.rows].astype(float),
            self._read("scale")[self.rows].astype(float),
            strict=True,
        ):
            place, turn = pose[:3], Rotation.from_quat(pose[3:])
            if carrier >= 0:
                holder = Rotation.from_quat(bodies[carrier, 3:])
                place, turn = bodies[carrier, :3] + holder.apply(place), holder * turn
            axis = tuple(turn.as_matrix()[:, 2])
            if kind == GeoType.PLANE:
                out.append(Plane(tuple(place), axis))
            elif kind == GeoType.BOX:
                out.append(Box(tuple(place), tuple(size), tuple(turn.as_quat())))
            else:
                out.append(Cylinder(tuple(place), size[0], size[1], axis))
        return out
