"""Derivatives of a motion by model parameters, carried along with its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
import warp as wp

from wrod.identification.motion.start import first_nodes, held_ends, moves_ends
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.stepping import motion_tangents as kernels
from wrod.kernels.stepping import observed_tangents, yield_tangents
from wrod.rods.arrays import filled
from wrod.solvers.banded import BandedSystem, multiply_banded
from wrod.solvers.steps import unit_pace

if TYPE_CHECKING:
    from wrod.identification.motion.windows import Windows
    from wrod.rods.batch import RodBatch
    from wrod.solvers.newton_steps import NewtonSteps

COMPLEX_STEP = 1e-30
# Inertia of an edge about its axis, per line mass: far too small to be seen.
SPIN_INERTIA = 1e-7
_KINDS = dict.fromkeys(("stiffness", "rest_strain", "gravity", "marker_offset"), wp.vec3d) | {
    "softening": wp.vec2d,
    "viscous_time": wp.vec4d,
    "inelastic": wp.vec4d,
}


# What moments and tensions depend on, as the kernel of their tangents takes it.
ELASTIC = (
    "rest_length", "stretching", "stiffness", "rest_strain", "viscous_time", "softening"
)  # fmt: skip


def uploaded(values: dict[str, np.ndarray], device: str) -> dict[str, wp.array]:
    """Arrays of `MotionSetup.arrays`, real, with one more axis in front, on a device."""
    return {
        key: wp.array(
            np.ascontiguousarray(value, dtype=float), dtype=_KINDS.get(key, wp.float64),
            device=device,
        )
        for key, value in values.items()
    }  # fmt: skip


def rates_of(setup, rates) -> dict[str, np.ndarray]:
    """(P, ...) rates of `MotionSetup.arrays` by parameters; arguments as of `MotionTangents`."""
    arrays = [r.arrays() for r in rates]
    return {
        key: np.stack([np.broadcast_to(_rate(a[key]), nominal.shape) for a in arrays])
        for key, nominal in setup.arrays().items()
    }


def _rate(value: np.ndarray) -> np.ndarray:
    return np.imag(value) / COMPLEX_STEP


def node_columns(node_count: int) -> np.ndarray:
    """Columns of the nodes' coordinates among the degrees of freedom."""
    return (4 * np.arange(node_count)[:, None] + np.arange(3)).ravel()


class Run(Protocol):
    """What is followed: `wrod.identification.motion.solver.MotionRun`."""

    batch: RodBatch
    windows: Windows
    substeps: int
    step_rate: float
    device: str
    model: dict[str, wp.array]
    grip_tangent: wp.array


class MotionTangents:
    """Tangents of a run by every parameter; a follower of its `Dynamics`.

    Args:
        run: the run, its batch in the first configuration.
        setup: the model.
        rates: setups whose imaginary parts are `COMPLEX_STEP` times a parameter's rate.
    """

    def __init__(self, run: Run, setup, rates):
        self.run, self.batch, self.count = run, run.batch, len(rates)
        windows, substeps, device = run.windows, run.substeps, run.device
        rods, nodes, dofs = run.batch.rod_count, run.batch.node_count, run.batch.dof_count
        P = self.count
        by_key = rates_of(setup, rates)
        by_key["marker_offset"] = by_key["marker_offset"][:, 1:-1]
        self.model = uploaded(by_key, device)
        instants = (windows.held.shape[1] - 1) * substeps + 1
        held, first = np.zeros((rods, instants, P, 4, 3)), np.zeros((2, rods, P, nodes, 3))
        moves = [moves_ends(r) for r in rates]
        self.moves = wp.array(np.array(moves, dtype=np.int32), dtype=wp.int32, device=device)
        for j, r in enumerate(rates):
            if moves[j]:
                ends = held_ends(windows, r, substeps)
                held[:, :, j] = _rate(ends[0])
                start = _rate(first_nodes(windows, r, substeps, ends))
                first[:, :, j] = start.swapaxes(0, 1)
        self.held = wp.array(held, dtype=wp.vec3d, device=device)
        self.roll = wp.array(
            np.stack([np.broadcast_to(_rate(r.roll + r.principal_angle), 2) for r in rates]),
            dtype=wp.float64, device=device,
        )  # fmt: skip
        self.first = np.zeros((2, rods, P, dofs))
        self.first[:, :, :, node_columns(nodes)] = first.reshape(2, rods, P, -1)

        def zeros():
            return wp.zeros((rods, P, dofs), dtype=wp.float64, device=device)

        self.now, self.older, self.velocity, self.velocity_older = (zeros() for _ in range(4))
        self.step_held, self.x = zeros(), zeros()
        self.strain, self.strain_older, self.strain_new = (
            wp.zeros((rods, P, nodes), dtype=wp.vec4d, device=device) for _ in range(3)
        )
        # Of bends that yield: the model's rates, and those of what nodes remember.
        shape = (rods, P, nodes) if run.batch.inelastic is not None else (0, 0, 0)
        self.kept = wp.zeros(shape, dtype=wp.vec4d, device=device)
        own = {key: self.model[key] for key in yield_tangents.Rates.vars}
        self.yielding = filled(yield_tangents.Rates(), own)
        markers = len(setup.marker_node) - 2
        self.seen = wp.zeros((rods, windows.held.shape[1], markers, P), wp.vec3d, device=device)
        self.system = BandedSystem(run.batch)
        # A processor's core takes all columns of a node, a GPU's threads one each.
        self.per_thread = P if wp.get_device(device).is_cpu else 1
        self.groups = -(-P // self.per_thread)
        self.dofs_per_thread = dofs if wp.get_device(device).is_cpu else 1

    def _launch(self, kernel, dim, inputs, outputs=()):
        dim = (self.batch.rod_count, *dim)
        wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=self.run.device)

    def _elastic(self, pace, strain_before, strain_older):
        batch, s = self.batch, self.batch.state
        rows = self.x.reshape((batch.rod_count * self.count, batch.dof_count))
        self._launch(
            kernels.elastic_tangents,
            (batch.node_count - 1, self.groups),
            [self.run.model[k] for k in ELASTIC] + [self.model[k] for k in ELASTIC]
            + [pace, s.dof, s.director, s.reference_twist]
            + [strain_before, strain_older, self.strain, self.strain_older, self.per_thread],
            [rows],
        )  # fmt: skip
        if batch.inelastic is not None:
            self._launch(
                yield_tangents.yield_tangents,
                (batch.node_count - 2, self.groups),
                [batch.elastic_model, self.yielding, batch.inelastic, self.kept, pace]
                + [s.dof, s.director, self.per_thread],
                [rows],
            )

    def _solve(self, accepted):
        """x <- solution of the step's matrix for x."""
        self.system.factorise(self.batch.derivatives.hessian, accepted)
        self.system.solve_in(self.x, accepted)

    def _strains(self, pace, out):
        batch, s = self.batch, self.batch.state
        self._launch(
            observed_tangents.measure_strain_tangents,
            (batch.node_count - 1, self.groups),
            [pace.accepted, s.dof, s.director, self.now, self.per_thread],
            [out],
        )
        if batch.inelastic is not None:
            self._launch(
                yield_tangents.carry_yield_tangents,
                (batch.node_count - 2, self.groups),
                [batch.elastic_model, self.yielding, batch.inelastic, pace, s.dof, s.director]
                + [out, self.per_thread],
                [self.kept],
            )

    def _hold(self, pace, out):
        batch, run = self.batch, self.run
        self._launch(
            kernels.held_tangents,
            (self.count, 2),
            [self.moves, self.held, self.roll]
            + [batch.state.tangent, run.grip_tangent, batch.state.dof]
            + [pace, run.substeps, run.step_rate],
            [out],
        )

    def begin(self, strain: wp.array) -> None:
        """Tangents of the first configuration: nodes by the setup, angles by their equilibrium.

        Args:
            strain: (rod, node) strains there.
        """
        batch = self.batch
        every, rest = batch.every_rod, unit_pace(batch, 0.0, 0.0, 0.0)
        step = wp.zeros_like(self.now)
        self._hold(rest, step)
        value = self.first[1].copy()
        ends = [3, -4]
        value[:, :, ends] = step.numpy()[:, :, ends]
        self.step_held.assign(value)
        product = wp.zeros_like(self.x)
        hessian = batch.evaluate(order=2).hessian
        multiply_banded(batch, every, hessian, self.step_held, product)
        self.x.assign(-product.numpy())
        self._elastic(rest, strain, strain)
        self._solve(every)
        self.now.assign(self.x.numpy() + value)
        self._strains(rest, self.strain)
        wp.copy(self.strain_older, self.strain)
        self.step_held.zero_()

    def set_velocity(self, h) -> None:
        """Begin with the difference of the first two frames, `h` apart."""
        now = self.now.numpy().copy()
        earlier = now.copy()
        columns = node_columns(self.batch.node_count)
        earlier[:, :, columns] = self.first[0][:, :, columns]
        self.earliest = earlier
        self.older.assign(earlier)
        self.velocity.assign((now - earlier) / h)
        wp.copy(self.velocity_older, self.velocity)

    def follow(self, dynamics: NewtonSteps) -> None:
        """Tangents of the steps that have been accepted."""
        pace, batch, model = dynamics.pace, self.batch, self.run.model
        accepted = dynamics.accepted
        device = wp.get_device(batch.device)
        if device.is_cpu and not device.is_capturing and not accepted.numpy().any():
            return
        names = ("mass", "linear_drag", "quadratic_drag", "gravity")
        masses, others = names[:1], names[1:]
        history = [dynamics.start.dof, dynamics.dof_older]
        history += [dynamics.velocity, dynamics.velocity_older]
        self._launch(
            kernels.inertial_tangents,
            (batch.node_count, self.groups),
            [model[k] for k in masses] + [SPIN_INERTIA] + [model[k] for k in others]
            + [self.model[k] for k in names]
            + [pace, batch.state.dof, *history]
            + [self.now, self.older, self.velocity, self.velocity_older, self.per_thread],
            [self.x],
        )  # fmt: skip
        past = [dynamics.viscosity.strain, dynamics.viscosity.strain_older]
        self._elastic(pace, *past)
        self._hold(pace, self.step_held)
        rows = min(7 + HALF_BANDWIDTH, batch.dof_count)
        self._launch(
            kernels.subtract_held,
            (2 * rows, self.groups),
            [accepted, self.moves, batch.derivatives.hessian, self.step_held, rows]
            + [self.per_thread],
            [self.x],
        )
        self._solve(accepted)
        self._launch(
            kernels.finish_tangents,
            (self.count, batch.dof_count // self.dofs_per_thread),
            [pace, self.x, self.step_held, self.dofs_per_thread],
            [self.now, self.older, self.velocity, self.velocity_older],
        )
        self._strains(pace, self.strain_new)
        self._launch(
            observed_tangents.shift_strain_tangents,
            (batch.node_count - 1, self.groups),
            [model["viscous_time"], self.model["viscous_time"], pace, batch.state.dof]
            + [batch.state.director, batch.state.reference_twist, *past]
            + [self.strain_new, self.per_thread],
            [self.strain, self.strain_older],
        )

    def centre(self, h) -> None:
        """As the run centres its velocities."""
        now, middle = self.now.numpy().copy(), self.older.numpy().copy()
        self.velocity.assign((1.5 * now - 2.0 * middle + 0.5 * self.earliest) / h)
        self.velocity_older.assign((now - self.earliest) / (2.0 * h))

    def observe(self, place, when: list) -> None:
        """Record the markers' tangents, with what says whose and in which frame."""
        s = self.batch.state
        self._launch(
            observed_tangents.observe_tangents,
            (place.shape[0], self.groups),
            [place, self.run.model["marker_offset"], self.model["marker_offset"], *when]
            + [s.dof, s.director, self.now, self.per_thread],
            [self.seen],
        )
