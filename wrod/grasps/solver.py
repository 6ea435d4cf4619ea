"""Grasps of one mesh on one device: allocation, iteration, reading out. Dimensionless."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod.grasps.mesh import (
    WEIGHT,
    node_weights,
    rest_lengths,
    straight_pattern_guess,
)
from wrod.kernels.grasping import start as grasp_start
from wrod.kernels.grasping import straight as grasping
from wrod.rods.batch import RodBatch
from wrod.rods.rotation import (
    rotation_matrix,
    rotation_vector,
)
from wrod.solvers.banded import BorderedSystem
from wrod.solvers.stability import smallest_eigenvalue

# Largest change of an edge in one step, as a fraction of its length.
_STEP_LIMIT = 0.4
# Newton steps on one continuation step before it counts as failed.
_PATIENCE = 14
_MAX_ITERATIONS = 400
_FIRST_INCREMENT = 0.5


@dataclass
class GraspSolution:
    """Grasps on one mesh (NumPy); n grasps.

    Attributes:
        position, rotation, force: (n, 3) grip position, its frame as a rotation vector, force on
            the suspended rod at the contact.
        force_jacobian: (n, 3, 3) derivative of `force` by the grip position, contact edge held.
        shape: (n, node, 3) nodes from contact to grip; None unless asked for.
        arc_length: (n, node) their unstretched arc length; None unless asked for.
        twist: (n,) angle from contact to grip [rad]; None for straight rods, which have none.
        lowest, turning: (n,) lowest node and total turning of the rod [rad].
        converged, stable: (n,) bool.
        eigenvalue: (n,) smallest eigenvalue of the constrained Hessian; None unless asked for.
        iterations: (n,) int.
        residual: (n,) largest unbalanced force.
        thrust: (n,) F_x.
        position_sensitivity, rotation_sensitivity, force_sensitivity: (n, 3, 3) derivatives of
            component i by input j of (l_s, kappa, k_s); None unless asked for.
    """

    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    force_jacobian: np.ndarray
    lowest: np.ndarray
    turning: np.ndarray
    converged: np.ndarray
    stable: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    thrust: np.ndarray
    shape: np.ndarray | None = None
    arc_length: np.ndarray | None = None
    twist: np.ndarray | None = None
    eigenvalue: np.ndarray | None = None
    position_sensitivity: np.ndarray | None = None
    rotation_sensitivity: np.ndarray | None = None
    force_sensitivity: np.ndarray | None = None


class GraspSolver:
    """Solves n grasps on meshes of `edge_count` edges; allocates once, then launches.

    Args:
        suspended_length, curvature, stretch_ratio: (n,) inputs; curvature >= 0.
        edge_count: edges between contact and grip.
        closure: one of `wrod.kernels.grasping.straight`'s closures.
        device: Warp device.
        guess: nodes near the solution at the full curvature, (n, edge_count + 1, 3) or a Warp
            array of vec3d; without it the solver starts from the straight pattern and walks up
            the curvature.
        thrust: (n,) F_x of the guess.
        twisting_stiffness: over k_b. The rod of a grasp carries no twist unless it is naturally
            curved: then any positive value will do, and counts for stability only.
        mesh: rest lengths (n, edge_count) of (suspended_length, edge_count).
    """

    def __init__(
        self,
        suspended_length: np.ndarray,
        curvature: np.ndarray,
        stretch_ratio: np.ndarray,
        *,
        edge_count: int,
        closure: int,
        device: str,
        guess: np.ndarray | wp.array | None = None,
        thrust: np.ndarray | None = None,
        twisting_stiffness: float = 2.0 / 3.0,
        mesh: Callable[[np.ndarray, int], np.ndarray] = rest_lengths,
    ):
        n = len(suspended_length)
        self.inputs = (suspended_length, curvature, stretch_ratio)
        self.closure, self.device = int(closure), device
        edges = mesh(suspended_length, edge_count)
        cold = guess is None
        if cold:
            guess = straight_pattern_guess(edges)
        if isinstance(guess, np.ndarray):
            guess = wp.array(guess, dtype=wp.vec3d, device=device)
        rest = wp.array(
            np.concatenate([edges[:, :1], edges], axis=1), dtype=wp.float64, device=device
        )

        def floats(value=0.0):
            return wp.array(np.broadcast_to(value, (n,)), dtype=wp.float64, device=device)

        def ints(value=0):
            return wp.full(n, value, dtype=wp.int32, device=device)

        start = np.zeros(n) if cold else curvature
        self.target, self.curvature = floats(curvature), floats(start)
        position = wp.empty((n, edge_count + 2), dtype=wp.vec3d, device=device)
        wp.launch(
            grasp_start.place_ghost,
            dim=position.shape,
            inputs=[guess, rest, self.curvature],
            outputs=[position],
            device=device,
        )
        self.batch = batch = RodBatch(
            position,
            rest_length=rest,
            stretching_stiffness=stretch_ratio[:, None],
            bending_stiffness=1.0,
            twisting_stiffness=twisting_stiffness,
            node_mass=np.pad(node_weights(edges), ((0, 0), (1, 0))),
            gravity=(0.0, 0.0, -1.0),
            director=(0.0, 0.0, 1.0),
            device=device,
        )
        free = np.ones(batch.dof_count, dtype=bool)
        free[:11] = False
        free[-3:] = False
        batch.set_free(free)
        # Node 2 and the grip.
        self.system = BorderedSystem(batch, (8, 9, 10, -3, -2, -1))

        self.weight = floats(WEIGHT * suspended_length)
        self.curvature_saved = floats(start)
        # What rounding positions leaves: in the stiffest edge, over the whole rod, and in the
        # sharpest bend, near the contact.
        shortest = edges.min(axis=1)
        rounding = stretch_ratio / shortest * suspended_length
        rounding += 4.0 / shortest**3 * np.minimum(suspended_length, 5.0)
        self.tolerance = floats(np.maximum(1e-9, 8 * np.finfo(float).eps * rounding))
        self.condensed = wp.zeros(n, dtype=grasping.mat66d, device=device)
        self.reaction = wp.zeros(n, dtype=grasping.vec6d, device=device)
        self.dof_saved = wp.clone(batch.state.dof)
        self.increment = floats(_FIRST_INCREMENT)
        self.thrust = floats(0.0 if thrust is None else thrust)
        self.thrust_saved, self.slope_saved = floats(0.0 if thrust is None else thrust), floats()
        self.residual = floats(np.inf)
        self.saved, self.waited, self.iterations, self.status = (ints() for _ in range(4))
        self.active = ints(1)

    def run(self) -> GraspSolver:
        """Iterate until every grasp has converged or failed."""
        batch, out, system = self.batch, self.batch.derivatives, self.system
        for iteration in range(_MAX_ITERATIONS):
            batch.evaluate(order=2, active=self.active)
            self._condense(out.gradient, self.active, self.reaction)
            wp.launch(
                grasping.iterate_grasp,
                dim=batch.rod_count,
                inputs=[
                    batch.rest_length,
                    self.weight,
                    self.target,
                    self.closure,
                    self.tolerance,
                    wp.float64(_STEP_LIMIT),
                    _PATIENCE,
                    batch.free,
                    out.gradient,
                    out.hessian,
                    self.condensed,
                    self.reaction,
                    system.x,
                    batch.state.dof,
                    self.curvature,
                    self.thrust,
                    self.dof_saved,
                    self.curvature_saved,
                    self.thrust_saved,
                    self.slope_saved,
                    self.saved,
                    self.increment,
                    self.waited,
                    self.iterations,
                    self.active,
                    self.status,
                    self.residual,
                ],
                device=self.device,
            )
            batch.transport_frames(batch.state, batch.state, self.active)
            # Asking the device costs a synchronisation; a few spare iterations cost less.
            if iteration % 3 == 2 and not self.active.numpy().any():
                break
        return self

    def _condense(self, gradient: wp.array, active: wp.array, reaction: wp.array) -> None:
        """Factorise, and condense Hessian and gradient on node 2 and the grip."""
        self.system.eliminate(gradient, self.batch.derivatives.hessian, active)
        self._reduce(gradient, active, reaction)

    def _reduce(self, gradient: wp.array, active: wp.array, reaction: wp.array) -> None:
        batch = self.batch
        wp.launch(
            grasping.condense,
            dim=batch.rod_count,
            inputs=[active, batch.free, gradient, batch.derivatives.hessian, self.system.x],
            outputs=[self.condensed, reaction],
            device=self.device,
        )

    def refined(self, dof: wp.array | None = None) -> wp.array:
        """Guess (rod, 2 edges + 1) for the mesh of half the edges, on the device.

        `dof` are the degrees of freedom to take the shapes from, by default the present ones.
        """
        nodes = 2 * (self.batch.node_count - 2) + 1
        shape = wp.empty((self.batch.rod_count, nodes), dtype=wp.vec3d, device=self.device)
        wp.launch(
            grasp_start.refine_shape,
            dim=shape.shape,
            inputs=[self.batch.state.dof if dof is None else dof],
            outputs=[shape],
            device=self.device,
        )
        return shape

    def coarsened(self) -> wp.array:
        """Guess (rod, edges / 2 + 1) for the mesh of twice the edges."""
        nodes = np.ascontiguousarray(self.batch.positions()[:, 1::2])
        return wp.array(nodes, dtype=wp.vec3d, device=self.device)

    def solution(
        self, *, sensitivities: bool = False, eigenvalues: bool = False, shapes: bool = True
    ) -> GraspSolution:
        """Read the grasps out; only what is asked for leaves the device."""
        batch, n = self.batch, self.batch.rod_count
        force = -self.reaction.numpy()[:, 3:]
        force[:, 2] += self.weight.numpy()
        lowest = wp.empty(n, dtype=wp.float64, device=self.device)
        turning = wp.empty(n, dtype=wp.float64, device=self.device)
        wp.launch(
            grasp_start.check_shape,
            dim=n,
            inputs=[batch.state.dof],
            outputs=[lowest, turning],
            device=self.device,
        )
        result = GraspSolution(
            position=batch.state.dof[:, -3:].numpy().copy(),
            rotation=self._rotation(),
            force=force,
            force_jacobian=-self.condensed.numpy()[:, 3:, 3:],
            lowest=lowest.numpy(),
            turning=turning.numpy(),
            converged=self.status.numpy() == grasping.CONVERGED,
            stable=self.system.negative_pivots.numpy() == 0,
            iterations=self.iterations.numpy().copy(),
            residual=self.residual.numpy().copy(),
            thrust=self.thrust.numpy().copy(),
            shape=batch.positions()[:, 1:] if shapes else None,
            arc_length=self._arc_length() if shapes else None,
            twist=self._twist(),
        )
        if eigenvalues:
            # The factorisation that showed each grasp to be in balance is still here.
            result.eigenvalue = smallest_eigenvalue(
                batch,
                factor=self.system.factor,
                negative_pivots=self.system.negative_pivots.numpy(),
            )
        return result

    def _arc_length(self) -> np.ndarray:
        """(n, node) unstretched arc length from contact to grip."""
        edges = self.batch.rest_length.numpy()[:, 1:]
        return np.cumsum(np.pad(edges, ((0, 0), (1, 0))), axis=1)

    def _twist(self) -> np.ndarray | None:
        return None

    def _grip_frame(self):
        """Frame of the last edge, and the small rotation from its middle to the grip.

        The curvature falls linearly to zero at the moment-free grip, so over the last half edge
        the rod turns by an eighth of an edge times the curvature at the last inner node.
        """
        state = self.batch.state
        t = state.tangent[:, -2:].numpy()
        d1 = state.director[:, -1:].numpy()[:, 0]
        angle = state.dof[:, -4:-3].numpy()
        d2 = np.cross(t[:, 1], d1)
        m1 = np.cos(angle) * d1 + np.sin(angle) * d2
        # The contact's frame has its z along m1; its y is along -m2.
        frame = np.stack([t[:, 1], np.cross(m1, t[:, 1]), m1], axis=2)
        rest = self.batch.rest_length[:, -2:].numpy()
        fraction = rest[:, 1] / (4.0 * rest.sum(axis=1))
        chi = 1.0 + np.sum(t[:, 0] * t[:, 1], axis=1)
        binormal = 2.0 * np.cross(t[:, 0], t[:, 1]) / chi[:, None]
        return frame, t, chi, binormal, fraction

    def _rotation(self) -> np.ndarray:
        """(n, 3) rotation vectors of the grip's frame."""
        frame, _, _, binormal, fraction = self._grip_frame()
        return rotation_vector(rotation_matrix(fraction[:, None] * binormal) @ frame)
