"""The shapes of a Newton model that rods touch, as `wrod.substrate` knows them."""

from __future__ import annotations

import warnings

import numpy as np
from newton import GeoType, Model, ShapeFlags
from scipy.spatial.transform import Rotation

from wrod.errors import WrodWarning
from wrod.substrate import Box, Cylinder, Friction, Plane


class ModelShapes:
    """Planes, boxes and cylinders that collide with shapes, with the friction of their `mu`.

    A shape of world -1 touches the rods of every world, any other those of its own. A shape that
    no rod can touch is named in a warning.

    Attributes:
        rows: indices of the shapes into the model's.
    """

    def __init__(self, model: Model):
        self.model = model
        kinds = model.shape_type.numpy() if model.shape_count else np.zeros(0, dtype=int)
        flags = model.shape_flags.numpy() if model.shape_count else kinds
        scale = model.shape_scale.numpy() if model.shape_count else np.zeros((0, 3))
        collide = flags & int(ShapeFlags.COLLIDE_SHAPES) != 0
        endless = (kinds == GeoType.PLANE) & (scale[:, :2] == 0).all(axis=1)
        known = endless | (kinds == GeoType.BOX) | (kinds == GeoType.CYLINDER)
        self.rows = np.flatnonzero(collide & known)
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
        worlds = model.shape_world.numpy()[self.rows] if len(self.rows) else np.zeros(0, dtype=int)
        self._worlds = worlds

    def of(self, worlds: np.ndarray) -> tuple[list[list], list[list[Friction]]]:
        """Shapes and frictions for the rods of these worlds (rod,), in the units of the model."""
        described = [self._describe(i) for i in self.rows]
        friction = (
            [Friction(float(mu)) for mu in self.model.shape_material_mu.numpy()[self.rows]]
            if len(self.rows)
            else []
        )
        shapes, laws = [], []
        chosen = {}
        for world in worlds:
            if world not in chosen:
                chosen[world] = self._touched(world)
            shapes.append([described[k] for k in chosen[world]])
            laws.append([friction[k] for k in chosen[world]])
        return shapes, laws

    def carriers(self, worlds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bodies (rod, shape) that carry the shapes, -1 for none, and the shapes' places
        (rod, shape, 3) and quaternions (rod, shape, 4) on them."""
        model = self.model
        chosen = [self._touched(world) for world in worlds]
        width = max(map(len, chosen))
        body = np.full((len(worlds), width), -1, dtype=np.int32)
        pose = np.zeros((len(worlds), width, 7))
        pose[..., 6] = 1.0
        if len(self.rows):
            bodies, poses = model.shape_body.numpy(), model.shape_transform.numpy()
            for r, which in enumerate(chosen):
                body[r, : len(which)] = bodies[self.rows[which]]
                pose[r, : len(which)] = poses[self.rows[which]]
        return body, pose[..., :3], pose[..., 3:]

    def _touched(self, world: int) -> np.ndarray:
        return np.flatnonzero((self._worlds == -1) | (self._worlds == world))

    def _describe(self, i: int) -> Plane | Box | Cylinder:
        model = self.model
        kind = int(model.shape_type.numpy()[i])
        pose = model.shape_transform.numpy()[i].astype(float)
        body = int(model.shape_body.numpy()[i])
        turn = Rotation.from_quat(pose[3:])
        place = pose[:3]
        if body >= 0:
            carrier = model.body_q.numpy()[body].astype(float)
            place = carrier[:3] + Rotation.from_quat(carrier[3:]).apply(place)
            turn = Rotation.from_quat(carrier[3:]) * turn
        size = model.shape_scale.numpy()[i].astype(float)
        axis = tuple(turn.as_matrix()[:, 2])
        if kind == GeoType.PLANE:
            return Plane(tuple(place), axis)
        if kind == GeoType.BOX:
            return Box(tuple(place), tuple(size), tuple(turn.as_quat()))
        return Cylinder(tuple(place), size[0], size[1], axis)
