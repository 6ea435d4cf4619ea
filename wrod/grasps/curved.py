"""Grasps of naturally curved rods on one mesh: the straight rod's grasp, walked into the curvature.

The laid rod keeps one roll: between contact and table there is no twist, so no twisting moment at
the contact either. Its bending moment is that of the pattern's curvature less the rod's own. At the
grip the bending moment is zero, as for a straight rod, which leaves the rod's natural curvature
there; its twisting moment is what the grip's roll has to supply. One freedom is left, as before.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from wrod.grasps.mesh import two_sided_rest_lengths
from wrod.grasps.solver import GraspSolution, GraspSolver
from wrod.kernels.grasping import curved as curved_grasping
from wrod.kernels.grasping import straight as grasping
from wrod.rods.batch import node_positions
from wrod.rods.rotation import rotation_matrix, rotation_vector
from wrod.solvers.banded import BorderedSystem

# Natural curvature that is added at once at first, and the least that is tried [1/L_gb]. The twist
# that it brings grows with the length, and Newton's method does not foresee where it rolls the rod.
_INCREMENT, _LEAST_INCREMENT = 0.5, 1e-3
_LONG = 4.0
_QUICK = 6
_STEP_LIMIT = 0.4
_PATIENCE = 14
_MAX_ITERATIONS = 200
# Balance that is enough on the way, as for straight rods.
_ON_THE_WAY = 1e-4
# The first slopes of a closure's minimum are taken between grasps this far apart in thrust.
_THRUST_STEP, _THRUST_DONE = 0.5, 1e-7


class CurvedGraspSolver(GraspSolver):
    """Solves n grasps of naturally curved rods; see `GraspSolver` for everything else.

    Args:
        natural_curvature: (n, 2) curvature at rest [1/L_gb] where the rod is laid straight: towards
            +y (left) and +z (up).
        poisson: Poisson's ratio; the twisting stiffness is k_b / (1 + poisson).
    """

    def __init__(
        self,
        *inputs: np.ndarray,
        natural_curvature: np.ndarray,
        poisson: float,
        guess: np.ndarray | wp.array | None = None,
        thrust: np.ndarray | None = None,
        **options,
    ):
        if guess is None:
            # With some of a coarse mesh's edges at the grip, the contact has too few to start cold.
            straight = GraspSolver(*inputs, **options).run().solution()
            guess = _on_mesh(straight, two_sided_rest_lengths(inputs[0], options["edge_count"]))
            thrust = straight.thrust
        super().__init__(
            *inputs,
            twisting_stiffness=1.0 / (1.0 + poisson),
            mesh=two_sided_rest_lengths,
            guess=guess,
            thrust=thrust,
            **options,
        )
        # The first material director at the contact points up, the second to the right.
        self.natural = np.stack([natural_curvature[:, 1], -natural_curvature[:, 0]], axis=1)

    def run(self) -> CurvedGraspSolver:
        super().run()
        self._straight = wp.clone(self.batch.state.dof)
        free = self.batch.free.numpy().copy()
        free[:, -4] = 0
        self.batch.set_free(free)
        rods = self.batch.rod_count
        # Roll of the first edge, node 2, roll and position of the grip.
        self.system = BorderedSystem(self.batch, (7, 8, 9, 10, -4, -3, -2, -1))
        self._condensed = wp.zeros((rods, 8, 8), dtype=wp.float64, device=self.device)
        self._reaction = wp.zeros((rods, 8), dtype=wp.float64, device=self.device)
        self._imbalance = wp.zeros(rods, dtype=wp.float64, device=self.device)
        self._walk()
        return self

    def refined(self) -> wp.array:
        """As for a straight rod, whose grasp the finer mesh starts from too."""
        return super().refined(self._straight)

    def coarsened(self) -> wp.array:
        nodes = np.ascontiguousarray(node_positions(self._straight.numpy())[:, 1::2])
        return wp.array(nodes, dtype=wp.vec3d, device=self.device)

    # ---- Newton ------------------------------------------------------------------------------

    def _walk(self) -> None:
        """Newton with continuation: every rod at its own pace from straight to its curvature."""
        batch, rods = self.batch, self.batch.rod_count
        size = np.linalg.norm(self.natural, axis=1)
        most = _INCREMENT * np.minimum(1.0, _LONG / self.inputs[0])
        increment = np.minimum(most / np.maximum(size, 1e-300), 1.0)
        reached, progress = np.zeros(rods), increment.copy()
        tolerance, thrust = self.tolerance.numpy(), self.thrust.numpy().copy()
        thrust_before, slope_before = np.full(rods, np.nan), np.zeros(rods)
        running = self.status.numpy() == grasping.CONVERGED
        waited = np.zeros(rods, dtype=int)
        iterations = self.iterations.numpy().copy()
        saved = batch.state.dof.numpy().copy()
        converged = np.zeros(rods, dtype=bool)
        self._bend(progress)
        for _ in range(_MAX_ITERATIONS):
            if not running.any():
                break
            active = wp.array(running.astype(np.int32), dtype=wp.int32, device=self.device)
            stiffness, force, imbalance = self._evaluate(active)
            iterations += running
            matrix, unknowns = self._border_matrix(stiffness)
            wrong = np.concatenate([force[:, :4], (force[:, 5] + thrust)[:, None]], axis=1)
            worst = np.maximum(imbalance, np.abs(wrong).max(axis=1))
            there = progress == 1.0
            rate, change, slope = self._to_minimum(
                stiffness, force, matrix, unknowns, thrust, thrust_before, slope_before
            )
            on_the_way = ~there | (np.abs(change) > _THRUST_DONE)
            wanted = np.where(on_the_way, np.maximum(tolerance, _ON_THE_WAY), tolerance)
            # Slopes of neighbouring grasps are compared: they have to be sharper than the step.
            sharp = np.maximum(tolerance, 1e-3 * np.abs(change))
            wanted = np.where(there & on_the_way, np.minimum(wanted, sharp), wanted)
            balanced = running & (worst <= wanted)
            done = balanced & ~on_the_way
            converged |= done
            running &= ~done
            further, along = balanced & ~done & ~there, balanced & ~done & there
            lost = running & ~balanced & ((waited >= _PATIENCE) | ~np.isfinite(worst))
            newton = running & ~balanced & ~lost
            increment[further & (waited <= _QUICK)] *= 2.0
            waited = np.where(newton, waited + 1, 0)
            reached[further] = progress[further]
            increment[lost] *= 0.25
            given_up = lost & ((increment * size < _LEAST_INCREMENT) | there & (reached == 1.0))
            running &= ~given_up
            if along.any():
                reached[along] = 1.0
                thrust_before[along], slope_before[along] = thrust[along], slope[along]
                thrust[along] += change[along]
            step = _solve(matrix, np.where(newton[:, None], -wrong, 0.0))
            step[along] = change[along, None] * rate[along]
            motion = np.einsum("rij,rj->ri", unknowns, step)
            self._take(newton | along, newton, motion)
            if further.any() or lost.any() or along.any():
                state = batch.state.dof.numpy().copy()
                saved[further | along] = state[further | along]
                state[lost] = saved[lost]
                batch.state.dof.assign(state)
                progress[further | lost] = np.minimum(reached + increment, 1.0)[further | lost]
                self._bend(progress)
            batch.transport_frames(batch.state, batch.state, active)
        self._finish(converged, thrust, iterations)

    def _bend(self, progress: np.ndarray) -> None:
        nodes = self.batch.node_count
        now = np.repeat((progress[:, None] * self.natural)[:, None], nodes, axis=1)
        self.batch.natural_curvature.assign(now)

    def _evaluate(self, active: wp.array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Hessian (n, 8, 8) and gradient (n, 8) condensed on the border, and what is unbalanced."""
        batch, system = self.batch, self.system
        out = batch.evaluate(order=2, active=active)
        system.eliminate(out.gradient, out.hessian, active)
        rods, device = batch.rod_count, self.device
        wp.launch(
            curved_grasping.condense,
            dim=(rods, 8),
            inputs=[system.border, batch.free, active, out.gradient, out.hessian, system.x],
            outputs=[self._condensed, self._reaction],
            device=device,
        )
        wp.launch(
            curved_grasping.measure_imbalance,
            dim=rods,
            inputs=[batch.free, active, out.gradient],
            outputs=[self._imbalance],
            device=device,
        )
        return (
            self._condensed.numpy().copy(),
            self._reaction.numpy().copy(),
            self._imbalance.numpy().copy(),
        )

    def _border_matrix(self, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative (n, 5, 5) of the border equations by the unknowns, and what these move.

        Equations: balance of the first edge's roll and of node 2, thrust. Unknowns: stretch of the
        first edge, roll and position of the grip; `unknowns` (n, 8, 5) takes them to the border.
        """
        rest = self.batch.rest_length.numpy()[:, 1]
        angle = np.arctan(0.5 * self.curvature.numpy() * rest)
        unknowns = np.zeros((len(rest), 8, 5))
        unknowns[:, 1, 0], unknowns[:, 2, 0] = np.cos(angle), np.sin(angle)
        unknowns[:, 4:, 1:] = np.eye(4)
        return stiffness[:, [0, 1, 2, 3, 5]] @ unknowns, unknowns

    def _to_minimum(self, stiffness, force, matrix, unknowns, thrust, thrust_before, slope_before):
        """Rates of the unknowns by the thrust, change of the thrust towards the closure's minimum,
        and the slope there; see `wrod.kernels.grasping.straight.thrust_step`."""
        rods = len(thrust)
        if self.closure == grasping.ZERO_TENSION:
            return np.zeros((rods, 5)), np.zeros(rods), np.zeros(rods)
        weight = self.weight.numpy()
        pull = np.broadcast_to([0.0, 0.0, 0.0, 0.0, -1.0], (rods, 5))
        rate = _solve(matrix, pull)
        force_rate = -np.einsum("rij,rjk,rk->ri", stiffness[:, 6:8], unknowns, rate)
        counted = 1 if self.closure == grasping.MIN_FRICTION else 2
        held = np.stack([-force[:, 6], weight - force[:, 7]], axis=1)
        slope = thrust + (held * force_rate)[:, :counted].sum(axis=1)
        steepness = 1.0 + (force_rate**2)[:, :counted].sum(axis=1)
        moved = thrust - thrust_before
        with np.errstate(divide="ignore", invalid="ignore"):
            secant = (slope - slope_before) / moved
        better = (np.abs(moved) > 1e-7) & (secant > 0.05 * steepness)
        steepness = np.where(better, secant, steepness)
        return rate, np.clip(-slope / steepness, -_THRUST_STEP, _THRUST_STEP), slope

    def _take(self, moving: np.ndarray, newton: np.ndarray, motion: np.ndarray) -> None:
        device = self.device
        wp.launch(
            curved_grasping.take_step,
            dim=self.batch.rod_count,
            inputs=[
                self.system.border,
                self.batch.free,
                wp.float64(_STEP_LIMIT),
                wp.array(moving.astype(np.int32), dtype=wp.int32, device=device),
                wp.array(newton.astype(np.float64), dtype=wp.float64, device=device),
                wp.array(motion, dtype=wp.float64, device=device),
                self.system.x,
                self.batch.state.dof,
            ],
            device=device,
        )

    # ---- Reading out -------------------------------------------------------------------------

    def _finish(self, converged: np.ndarray, thrust: np.ndarray, iterations: np.ndarray) -> None:
        """Leave what `GraspSolver.solution` reads, the factorisation of every rod included."""
        self._evaluate(self.batch.every_rod)
        status = np.where(converged, int(grasping.CONVERGED), int(grasping.FAILED))
        self.status.assign(status.astype(np.int32))
        self.iterations.assign(iterations.astype(np.int32))
        self.thrust.assign(thrust)
        residual = self._imbalance.numpy()
        border = np.abs(self._reaction.numpy()[:, :4]).max(axis=1)
        self.residual.assign(np.maximum(residual, border))
        kept = [1, 2, 3, 5, 6, 7]
        self.reaction.assign(np.ascontiguousarray(self._reaction.numpy()[:, kept]))
        self.condensed.assign(np.ascontiguousarray(self._condensed.numpy()[:, kept][:, :, kept]))

    def _rotation(self) -> np.ndarray:
        """(n, 3) rotation vectors of the rod's frame at the grip.

        Over the last half edge the curvature falls linearly to the natural one, and the twist goes
        on as it was.
        """
        frame, t, _, binormal, _ = self._grip_frame()
        last = self.batch.rest_length.numpy()[:, -1]
        m1 = frame[:, :, 2]
        # The curvature vector at rest: t x (dt/ds), in the frame of the last edge.
        m2 = np.cross(t[:, 1], m1)
        bent = self.natural[:, :1] * m1 + self.natural[:, 1:] * m2
        own = np.cross(t[:, 1], bent)
        rest = self.batch.rest_length.numpy()[:, -2:]
        inner = binormal / (0.5 * rest.sum(axis=1))[:, None]
        bend = 0.5 * last[:, None] * own + last[:, None] / 8.0 * (inner - own)
        turn = rotation_matrix(bend + self._last_twist()[:, None] * t[:, 1])
        return rotation_vector(turn @ frame)

    def _last_twist(self) -> np.ndarray:
        """(n,) twist over the last half edge, which goes on as it was [rad]."""
        state, rest = self.batch.state, self.batch.rest_length.numpy()[:, -2:]
        angle = state.dof.numpy()[:, [-8, -4]]
        twist = angle[:, 1] - angle[:, 0] + state.reference_twist.numpy()[:, -2]
        return twist * rest[:, 1] / rest.sum(axis=1)

    def _twist(self) -> np.ndarray:
        state = self.batch.state
        inner = state.reference_twist.numpy()[:, 1:-1].sum(axis=1)
        dof = state.dof.numpy()
        return dof[:, -4] - dof[:, 3] + inner + self._last_twist()


def _on_mesh(straight: GraspSolution, rest_length: np.ndarray) -> np.ndarray:
    """(n, node, 3) shapes of solved grasps at the nodes of another mesh."""
    nodes = np.cumsum(np.pad(rest_length, ((0, 0), (1, 0))), axis=1)
    rods = zip(nodes, straight.arc_length, straight.shape, strict=True)
    # The last node of both meshes is the grip, but for rounding.
    return np.stack([CubicSpline(s, q)(np.minimum(at, s[-1])) for at, s, q in rods])


def _solve(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """(n, k) solutions of (n, k, k) systems; a system that has none gives a step that fails."""
    finite = np.isfinite(matrix).all(axis=(1, 2))
    usable = np.where(finite[:, None, None], matrix, 0.0)
    regular = np.abs(np.linalg.det(usable)) > 0.0
    usable = np.where(regular[:, None, None], usable, np.eye(rhs.shape[1]))
    return np.linalg.solve(usable, rhs[:, :, None])[:, :, 0]
