"""Derivatives of a motion by model parameters, carried along with its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrod.identification.motion.start import first_nodes, held_ends
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.linear import banded
from wrod.kernels.stepping import motion_tangents as kernels
from wrod.solvers.statics import BandedSystem

if TYPE_CHECKING:
    from wrod.identification.motion.solver import MotionSolver

COMPLEX_STEP = 1e-30
# Inertia of an edge about its axis, per line mass: far too small to be seen.
SPIN_INERTIA = 1e-7
_KINDS = dict.fromkeys(
    ("stiffness", "rest_strain", "viscous_time", "gravity", "marker_offset"), wp.vec3d
) | {"softening": wp.vec2d}


def kind_of(key: str) -> type:
    """Warp type of a model's array."""
    return _KINDS.get(key, wp.float64)


def node_columns(node_count: int) -> np.ndarray:
    """Columns of the nodes' coordinates among the degrees of freedom."""
    return (4 * np.arange(node_count)[:, None] + np.arange(3)).ravel()


class Tangents:
    """Tangents of a run by every parameter."""

    def __init__(self, solver: MotionSolver, setup, rates, rods, nodes, dofs):
        self.solver, self.count = solver, len(rates)
        device = solver.device
        self.rods, self.nodes, self.dofs = rods, nodes, dofs
        P = self.count

        def imag(value):
            return np.imag(value) / COMPLEX_STEP

        arrays = [r.arrays() for r in rates]
        self.model = {}
        for key in arrays[0]:
            shape = np.shape(setup.arrays()[key])
            value = np.stack([np.broadcast_to(imag(a[key]), shape) for a in arrays])
            if key == "marker_offset":
                value = value[:, 1:-1]
            value = np.ascontiguousarray(value)
            self.model[key] = wp.array(value, dtype=kind_of(key), device=device)
        held = [held_ends(solver.windows, r, solver.substeps) for r in rates]
        self.held = wp.array(
            np.ascontiguousarray(np.stack([imag(h[0]) for h in held], axis=2)),
            dtype=wp.vec3d, device=device,
        )  # fmt: skip
        self.roll = wp.array(
            np.stack([np.broadcast_to(imag(r.roll + r.principal_angle), 2) for r in rates]),
            dtype=wp.float64, device=device,
        )  # fmt: skip
        first = np.stack(
            [imag(first_nodes(solver.windows, r, solver.substeps)) for r in rates], axis=2
        )
        self.first = np.zeros((2, rods, P, dofs))
        self.first[:, :, :, node_columns(nodes)] = first.transpose(1, 0, 2, 3, 4).reshape(
            2, rods, P, -1
        )

        def zeros():
            return wp.zeros((rods, P, dofs), dtype=wp.float64, device=device)

        self.now, self.older, self.velocity, self.velocity_older = (zeros() for _ in range(4))
        self.step_held, self.x = zeros(), zeros()
        self.strain, self.strain_older, self.strain_new = (
            wp.zeros((rods, P, nodes), dtype=wp.vec3d, device=device) for _ in range(3)
        )
        last = solver.windows.held.shape[1]
        markers = len(setup.marker_node) - 2
        self.seen = wp.zeros((rods, last, markers, P), dtype=wp.vec3d, device=device)

        # A processor's core takes all columns of a node, a GPU's threads one each.
        self.per_thread = P if wp.get_device(device).is_cpu else 1
        self.groups = -(-P // self.per_thread)

    def _launch(self, kernel, dim, inputs, outputs=()):
        wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=self.solver.device)

    def _elastic(self, batch, model, c, dt, strain_before, strain_older):
        names = ("rest_length", "stretching", "stiffness", "rest_strain", "viscous_time")
        names = (*names, "softening")
        s = batch.state
        self._launch(
            kernels.elastic_tangents,
            (self.rods, self.nodes - 1, self.groups),
            [model[k] for k in names] + [self.model[k] for k in names]
            + [wp.vec3d(*c), dt, s.dof, s.director, s.reference_twist]
            + [strain_before, strain_older, self.strain, self.strain_older, self.per_thread],
            [self.x.reshape((self.rods * self.count, self.dofs))],
        )  # fmt: skip

    def _solve(self, batch, system):
        """x <- solution of the step's matrix for x."""
        every = batch.every_rod
        hessian = batch.derivatives.hessian
        system.factorise(hessian, every)
        self._launch(
            banded.solve,
            (self.rods, self.count),
            [every, batch.free, system.factor],
            [self.x],
        )

    def _strains(self, batch, out):
        s = batch.state
        self._launch(
            kernels.measure_strain_tangents,
            (self.rods, self.nodes - 2, self.groups),
            [s.dof, s.director, self.now, self.per_thread],
            [out],
        )

    def begin(self, batch, model, time, grip_t, strain) -> None:
        """Tangents of the first configuration: nodes by the setup, angles by their equilibrium."""
        s = batch.state
        step = wp.zeros_like(self.now)
        self._launch(
            kernels.held_tangents,
            (self.rods, self.count, 2),
            [self.held, self.roll, s.tangent, grip_t, s.dof, batch.free, time],
            [step],
        )
        value = self.first[1].copy()
        ends = [3, -4]
        value[:, :, ends] = step.numpy()[:, :, ends]
        self.step_held.assign(value)
        product = wp.zeros_like(self.x)
        dim = (self.rods, self.count, self.dofs)
        hessian = batch.derivatives.hessian
        self._launch(banded.multiply, dim, [batch.every_rod, hessian, self.step_held], [product])
        self.x.assign(-product.numpy())
        self._elastic(batch, model, (0.0, 0.0, 0.0), 1.0, strain, strain)
        self._solve(batch, BandedSystem(batch))
        self.now.assign(self.x.numpy() + value)
        self._strains(batch, self.strain)
        wp.copy(self.strain_older, self.strain)
        self.step_held.zero_()

    def set_velocity(self, h) -> None:
        now = self.now.numpy().copy()
        earlier = now.copy()
        columns = node_columns(self.nodes)
        earlier[:, :, columns] = self.first[0][:, :, columns]
        self.earliest = earlier
        self.older.assign(earlier)
        self.velocity.assign((now - earlier) / h)
        wp.copy(self.velocity_older, self.velocity)

    def step(self, batch, model, system, c, dt, time, grip_t, history, strains) -> None:
        """Tangents of the step that the batch has just taken."""
        s = batch.state
        names = ("mass", "linear_drag", "quadratic_drag", "gravity")
        self._launch(
            kernels.inertial_tangents,
            (self.rods, self.nodes, self.count),
            [model[k] for k in names] + [self.model[k] for k in names]
            + [SPIN_INERTIA, wp.vec3d(*c), dt, s.dof, *history]
            + [self.now, self.older, self.velocity, self.velocity_older],
            [self.x],
        )  # fmt: skip
        self._elastic(batch, model, c, dt, *strains)
        self._launch(
            kernels.held_tangents,
            (self.rods, self.count, 2),
            [self.held, self.roll, s.tangent, grip_t, s.dof, batch.free, time],
            [self.step_held],
        )
        rows = min(7 + HALF_BANDWIDTH, self.dofs)
        self._launch(
            kernels.subtract_held,
            (self.rods, self.count, 2 * rows),
            [batch.derivatives.hessian, self.step_held, rows],
            [self.x],
        )
        self._solve(batch, system)
        self._launch(
            kernels.finish_tangents,
            (self.rods, self.count, self.dofs),
            [batch.free, wp.vec3d(*c), dt, self.x, self.step_held],
            [self.now, self.older, self.velocity, self.velocity_older],
        )
        self._strains(batch, self.strain_new)
        self.strain_older, self.strain, self.strain_new = (
            self.strain, self.strain_new, self.strain_older,
        )  # fmt: skip

    def centre(self, h) -> None:
        now, middle = self.now.numpy().copy(), self.older.numpy().copy()
        self.velocity.assign((1.5 * now - 2.0 * middle + 0.5 * self.earliest) / h)
        self.velocity_older.assign((now - self.earliest) / (2.0 * h))

    def observe(self, batch, place, offset, frame) -> None:
        s = batch.state
        self._launch(
            kernels.observe_tangents,
            (self.rods, place.shape[0], self.count),
            [place, offset, self.model["marker_offset"], s.dof, s.director, self.now, frame],
            [self.seen],
        )
