"""The part of `Contact` that deals with solids: contact of edges."""

from __future__ import annotations

import numpy as np
import warp as wp

from wrod.kernels.contact import edges as kernels
from wrod.rods.batch import RodBatch


class EdgeContact:
    """Contact of a batch's edges with the solids of a table of shapes.

    Args:
        batch: the rods; their cut edges touch nothing.
        radius: (rod, node) of the section [length]; not a number where nothing is touched.
        stiffness: (rod, node) per length of rod [force/length^2].
        skin: thickness over which the force rises, over the radius.
        table: (rod, shape) `wrod.kernels.contact.planes.Shape`.
        laws: static and kinetic friction (rod, shape), rolling (rod,).
        damping: relaxation time of the contact times sqrt(stiffness / mass), (rod,).
        roll_friction: (rod, shape) bound of the torque that keeps the roll, over normal force and
            radius; below 0 where it rolls.

    Attributes:
        push, moment: (rod, shape) force on each shape at the end of the last step, and its moment
            about the origin.
    """

    def __init__(
        self, batch: RodBatch, radius, stiffness, skin, table, laws, damping, roll_friction
    ):
        self.batch = batch
        device, edges = batch.device, batch.node_count - 1

        def floats(values):
            return wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device)

        radius = np.nan_to_num((radius[:, 1:] + radius[:, :-1]) / 2)
        radius[:, list(batch.cut_edges)] = 0.0
        stiffness = (stiffness[:, 1:] + stiffness[:, :-1]) / 2 * batch.rest_length.numpy()
        self.radius = floats(radius)
        self._table = table
        mass = batch.node_mass.numpy()
        mass = (mass[:, 1:] + mass[:, :-1]) / 2
        self._relaxation = floats(damping[:, None] * np.sqrt(mass / stiffness))
        self._law = [floats(stiffness), floats(skin * radius), *laws]
        self._roll = roll_friction
        shape = (batch.rod_count, table.shape[1], edges)
        self.bristle = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self.sliding = wp.zeros(shape, dtype=wp.int32, device=device)
        self.push = wp.zeros(table.shape, dtype=wp.vec3d, device=device)
        self.moment = wp.zeros(table.shape, dtype=wp.vec3d, device=device)
        self.turned = wp.zeros(shape, dtype=wp.float64, device=device)

    @property
    def _model(self) -> list:
        return [self._table, self.radius, self.batch.rest_length, *self._law]

    def _launch(self, kernel, inputs, outputs) -> None:
        batch = self.batch
        wp.launch(
            kernel, dim=self.radius.shape, inputs=inputs, outputs=outputs, device=batch.device
        )

    def add(self, step: wp.array, active: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        out, model = self.batch.derivatives, [*self._model, self._relaxation, self._roll]
        inputs = [*model, step, active, dof, dof_before, self.bristle, self.sliding]
        inputs.append(self.turned)
        self._launch(kernels.edge_contact, inputs, [out.gradient, out.hessian])

    def refuse(self, converged: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        inputs = [*self._model[:3], dof, dof_before]
        self._launch(kernels.refuse_tunnelling, inputs, [converged])

    def find_touching(self, chosen, dof, dof_before, touching: wp.array) -> None:
        inputs = [*self._model[:3], chosen, dof, dof_before]
        self._launch(kernels.find_touching, inputs, [touching])

    def settle(self, step, accepted, dof, dof_before, slip: wp.array, force: wp.array) -> None:
        inputs = [*self._model, self._relaxation, self._roll, step, accepted, dof, dof_before]
        pushes = [self.push, self.moment]
        wp.launch(
            kernels.clear_pushes,
            dim=self.push.shape,
            inputs=[accepted],
            outputs=pushes,
            device=self.batch.device,
        )
        outputs = [self.bristle, self.sliding, self.turned, slip, force, *pushes]
        self._launch(kernels.settle_edges, inputs, outputs)

    def penetration(self, dof: wp.array) -> np.ndarray:
        """(rod,) deepest penetration into any fixture [length]."""
        depth = wp.zeros(self.batch.rod_count, dtype=wp.float64, device=self.batch.device)
        self._launch(kernels.measure_depth, [self._table, self.radius, dof], [depth])
        return depth.numpy().copy()
