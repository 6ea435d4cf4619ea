"""Rods clamped along the table at the contact and held at the grip. Dimensionless."""

import numpy as np
import warp as wp

from wrod.grasps.mesh import WEIGHT, node_weights, rest_lengths, tolerance
from wrod.kernels.contact.table import table
from wrod.kernels.grasping import closures as grasping
from wrod.kernels.grasping import holding
from wrod.rods.batch import RodBatch
from wrod.rods.state import Derivatives
from wrod.solvers.banded import BorderedSystem
from wrod.solvers.recording import record, replay
from wrod.solvers.stability import smallest_eigenvalue
from wrod.solvers.statics import EquilibriumSolver, prescribe

# Largest change of an edge in one step, as a fraction of its length.
_STEP_LIMIT = 0.4
# Newton steps on one step of the way before it counts as failed.
_PATIENCE = 8
_MAX_ITERATIONS = 1500
_FIRST_INCREMENT = 0.2
# Of the table under rods that settle; they sink in by 1e-3.
_TABLE = 500.0
# Sideways waves that push rods off saddles, in turn [L_gb]; after the last one there is no more.
_PUSHES = (1e-3, 1e-2, 1e-1, 0.0)


class RodsOverTable(RodBatch):
    """Rods that rest on a frictionless table at z = 0 while `table_stiffness` is positive."""

    table_stiffness = 0.0

    @property
    def launched(self) -> tuple:
        return (*super().launched, self.table_stiffness)

    def evaluate(self, *, order=2, state=None, out=None, active=None, **options) -> Derivatives:
        out = super().evaluate(order=order, state=state, out=out, active=active, **options)
        if self.table_stiffness > 0.0:
            state = self.state if state is None else state
            active = self.every_rod if active is None else active
            self.launch(
                table,
                (self.rod_count, self.node_count - 2),
                [self.rest_length, wp.float64(self.table_stiffness), active, state.dof, order],
                [out.energy, out.gradient, out.hessian],
            )
        return out


def held_batch(
    stretch_ratio: np.ndarray, rest: np.ndarray, shape: np.ndarray, device: str
) -> RodsOverTable:
    """Straight isotropic rods (n, node, 3), clamped along x at the contact by ghosts, pinned at the
    grip. Of the contact's cell half bends, which clamps to second order."""
    behind = np.zeros((len(rest), 1, 3))
    behind[:, 0, 0] = -rest[:, 0]
    stiffness = np.ones(shape.shape[1] + 1)
    stiffness[1] = 2.0
    batch = RodsOverTable(
        np.concatenate([behind, shape], axis=1),
        rest_length=np.concatenate([rest[:, :1], rest], axis=1),
        stretching_stiffness=np.broadcast_to(stretch_ratio, len(rest))[:, None],
        bending_stiffness=stiffness,
        # Without twist in the rod any positive value will do; it counts for stability.
        twisting_stiffness=stiffness * (2.0 / 3.0),
        node_mass=np.pad(node_weights(rest), ((0, 0), (1, 0))),
        gravity=(0.0, 0.0, -1.0),
        director=(0.0, 0.0, 1.0),
        device=device,
    )
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,), pinned_nodes=(-1,))
    return batch


class HeldRods:
    """n suspended rods whose grips can be led about; allocates once, then launches.

    The contact is at the origin and the tangent there is x, clamped as `held_batch` does it. The
    grip holds a position and leaves the orientation free. Curvature at the contact is a result.

    Args:
        suspended_length, stretch_ratio: (n,) inputs.
        shape: (n, edge_count + 1, 3) nodes near an equilibrium, from contact to grip.
        device: Warp device.
    """

    def __init__(
        self,
        suspended_length: np.ndarray,
        stretch_ratio: np.ndarray,
        shape: np.ndarray,
        *,
        device: str = "cpu",
    ):
        n, nodes, _ = shape.shape
        self.length = np.asarray(suspended_length, dtype=np.float64)
        self.device = device
        edges = rest_lengths(self.length, nodes - 1)
        self.arc_length = np.concatenate([np.zeros((n, 1)), np.cumsum(edges, axis=1)], axis=1)
        self.weights = node_weights(edges)
        self.batch = batch = held_batch(stretch_ratio, edges, shape, device)
        self.system = BorderedSystem(batch, (-3, -2, -1))  # the grip

        def floats(value=0.0):
            return wp.array(np.broadcast_to(value, (n,)), dtype=wp.float64, device=device)

        def ints():
            return wp.zeros(n, dtype=wp.int32, device=device)

        self.tolerance = floats(tolerance(edges, stretch_ratio, 1e-8))
        self.start = wp.zeros(n, dtype=wp.vec3d, device=device)
        self.target = wp.zeros(n, dtype=wp.vec3d, device=device)
        self.reaction = wp.zeros(n, dtype=wp.vec3d, device=device)
        self.stiffness = wp.zeros(n, dtype=wp.mat33d, device=device)
        self.dof_saved = wp.clone(batch.state.dof)
        self.progress, self.progress_saved = floats(), floats(-1.0)
        self.increment, self.residual = floats(), floats(np.inf)
        self.waited, self.iterations, self.active, self.status = (ints() for _ in range(4))
        self._round: wp.Graph | None = None

    def __len__(self) -> int:
        return self.batch.rod_count

    def reset(self, shape: np.ndarray) -> None:
        """Start again from (n, edge_count + 1, 3) shapes near an equilibrium."""
        ghost = self.batch.positions()[:, :1]
        position = np.concatenate([ghost, shape], axis=1)
        self.batch.set_configuration(position, director=(0.0, 0.0, 1.0))
        self.status.zero_()

    def continue_to(self, position: np.ndarray, chosen: np.ndarray | None = None) -> np.ndarray:
        """Lead the chosen rods' grips to `position` and return who arrived.

        Args:
            position: (n, 3) where the grips should be; not the origin.
            chosen: (n,) bool; default: all.

        Returns:
            (n,) bool: in equilibrium at `position`. A rod that did not arrive is in equilibrium
            at the last place on the way that it could be followed to, or where it started.
        """
        batch = self.batch
        chosen = np.ones(len(self), dtype=bool) if chosen is None else chosen
        self.start.assign(self.grip_position())
        self.target.assign(np.ascontiguousarray(position, dtype=np.float64))
        self.active.assign(chosen.astype(np.int32))
        self.progress.zero_()
        # Where the first equilibrium is known the way back leads there.
        self.progress_saved.assign(np.where(self.status.numpy() == 0, -1.0, 0.0))
        self.dof_saved.assign(batch.state.dof)
        self.increment.fill_(_FIRST_INCREMENT)
        self.waited.zero_()
        status = self.status.numpy().copy()
        status[chosen] = 0
        self.status.assign(status)
        for iteration in range(_MAX_ITERATIONS):
            # The first round has compiled the kernels.
            if self._round is None and iteration > 0 and wp.get_device(self.device).is_cpu:
                self._round = record(self.device, self._walk)
            if self._round is None:
                self._walk()
            else:
                replay(self._round)
            # Asking the device costs a synchronisation; a few spare iterations cost less.
            if iteration % 3 == 2 and not self.active.numpy().any():
                break
        arrived = (self.status.numpy() == grasping.CONVERGED) & chosen
        self._stand_still(chosen & ~arrived)
        return arrived

    def _walk(self) -> None:
        """An iteration of every active rod, and its next step on the way."""
        batch, out = self.batch, self.batch.derivatives
        batch.evaluate(order=2, active=self.active)
        self._condense(out)
        batch.launch(
            holding.walk_grip,
            batch.rod_count,
            [self.start, self.target, self.tolerance, wp.float64(_STEP_LIMIT), _PATIENCE]
            + [batch.free, out.gradient, self.system.x]
            + [batch.state.dof, self.progress, self.dof_saved, self.progress_saved]
            + [self.increment, self.waited, self.iterations, self.active, self.status]
            + [self.residual],
        )
        batch.transport_frames(batch.state, batch.state, self.active)

    def settle(self, position: np.ndarray) -> np.ndarray:
        """Move the grips to (n, 3) `position` at once and let every rod fall to a minimum of its
        energy, if need be onto the table, as a real rod does; (n,) bool: who found one."""
        batch = self.batch
        dof = batch.state.dof.numpy().copy()
        dof[:, -3:] = position
        batch.table_stiffness = _TABLE
        solver = EquilibriumSolver(batch)
        for push in _PUSHES:
            batch.state.dof.assign(dof)
            batch.transport_frames(batch.state, batch.state, batch.every_rod)
            converged = solver.solve(max_iterations=200).converged
            self.active.fill_(1)
            batch.evaluate(order=2)
            self._condense(batch.derivatives)
            stuck = self.negative_pivots() > 0
            if not stuck.any():
                break
            # Newton's method can stop on a saddle; what rolls off it needs a push.
            dof = batch.state.dof.numpy().copy()
            wave = push * np.sin(np.pi * self.arc_length / self.length[:, None])
            dof[:, 5::4] += np.where(stuck[:, None], wave, 0.0)
        batch.table_stiffness = 0.0
        return converged & ~stuck

    def _stand_still(self, lost: np.ndarray) -> None:
        """Put the rods that were lost back to their last equilibrium and look at them there."""
        if not lost.any():
            return
        batch = self.batch
        dof = batch.state.dof.numpy().copy()
        dof[lost] = self.dof_saved.numpy()[lost]
        batch.state.dof.assign(dof)
        self.active.assign(lost.astype(np.int32))
        batch.transport_frames(batch.state, batch.state, self.active)
        batch.evaluate(order=2, active=self.active)
        self._condense(batch.derivatives)
        status = self.status.numpy().copy()
        status[lost] = grasping.FAILED
        self.status.assign(status)

    def _condense(self, out) -> None:
        batch, system = self.batch, self.system
        system.eliminate(out.gradient, out.hessian, self.active)
        inputs = [self.active, batch.free, out.gradient, out.hessian, system.x]
        outputs = [self.reaction, self.stiffness]
        batch.launch(holding.condense_grip, batch.rod_count, inputs, outputs)

    def negative_pivots(self) -> np.ndarray:
        """(n,) negative eigenvalues of the free Hessian where the rod stands."""
        return self.system.negative_pivots.numpy().copy()

    def eigenvalue(self) -> np.ndarray:
        """(n,) smallest eigenvalue of the free Hessian where the rod stands, per length."""
        return smallest_eigenvalue(
            self.batch, factor=self.system.factor, negative_pivots=self.negative_pivots()
        )

    def grip_position(self) -> np.ndarray:
        return self.batch.state.dof.numpy()[:, -3:].copy()

    def shape(self) -> np.ndarray:
        """(n, edge + 1, 3) nodes from contact to grip."""
        return self.batch.positions()[:, 1:].copy()

    def force(self) -> np.ndarray:
        """(n, 3) force of the table on the rod at the contact."""
        force = -self.reaction.numpy()
        force[:, 2] += WEIGHT * self.length
        return force

    def moment(self) -> np.ndarray:
        """(n, 3) moment of the table on the rod at the contact."""
        shape = self.shape()
        weight = np.zeros_like(shape)
        weight[:, :, 2] = -self.weights
        loads = np.cross(shape, weight).sum(axis=1)
        return -loads - np.cross(shape[:, -1], self.reaction.numpy())

    def lift(self) -> np.ndarray:
        """(n,) least 2 z(s) / s^2: positive where the rod is above the table everywhere, and near
        the contact its curvature."""
        return self._lifts().min(axis=1)

    def lowest(self) -> np.ndarray:
        """(n,) arc length at which `lift` is found."""
        index = self._lifts().argmin(axis=1)
        return self.arc_length[np.arange(len(self)), 1 + index]

    def _lifts(self) -> np.ndarray:
        return 2.0 * self.shape()[:, 1:, 2] / self.arc_length[:, 1:] ** 2
