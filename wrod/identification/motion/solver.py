"""Motion of a rod in many windows of recordings at once, with tangents by model parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.start import first_nodes, held_ends
from wrod.identification.motion.tangents import SPIN_INERTIA, Tangents, kind_of, node_columns
from wrod.identification.motion.windows import Windows
from wrod.kernels.stepping import motion as kernels
from wrod.kernels.stepping import newton_iteration as newton
from wrod.kernels.stepping.dynamics import take_newton_step
from wrod.rods.batch import RodBatch, RodState
from wrod.solvers.statics import BandedSystem

_STEP_LIMIT = 0.3
_TOLERANCE = 1e-7
_MAX_ITERATIONS = 25
# Springs that hold an edge's angle in a flow to equilibrium, over its twisting stiffness.
_TWIST_SPRINGS = (1.0, 0.3, 0.1, 0.03, 0.01)
_EULER, _BDF2 = (1.0, -1.0, 0.0), (1.5, -2.0, 0.5)


class MotionSolver:
    """Predicts windows with a model: BDF2 of fixed steps in true time, all windows in lockstep.

    Args:
        windows: what to predict; the first two frames and the held markers are looked at.
        rate: frames per second.
        substeps: time steps in a frame's duration.
        device: Warp device.
        free_roll: let the rod turn about its axis in the grips.
    """

    def __init__(
        self,
        windows: Windows,
        rate: float,
        *,
        substeps: int = 1,
        device: str = "cpu",
        free_roll: bool = False,
    ):
        self.windows, self.rate, self.substeps = windows, rate, substeps
        self.device, self.free_roll = device, free_roll

    @property
    def failed(self) -> np.ndarray:
        """(W,) whether a step of the last run did not converge."""
        return self.last_good < np.iinfo(np.int64).max

    # ---- the run -----------------------------------------------------------------------------

    def run(
        self, setup: MotionSetup, rates: Sequence[MotionSetup] = (), frames: int | None = None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Predict all markers of all windows.

        Args:
            setup: the model.
            rates: setups whose imaginary parts are `COMPLEX_STEP` times a parameter's rate.

        Returns:
            (W, F, M, 3) markers [m], and (W, F, M, P, 3) their derivatives.
        """
        w, device = self.windows, self.device
        values = {k: np.real(v) for k, v in setup.arrays().items()}
        # Every window's own lengths, on top of the model's.
        pieces = np.diff(setup.marker_node)
        change = np.repeat(w.length_change / pieces, pieces, axis=1)
        values["rest_length"] = values["rest_length"] + change
        model = self._upload(values)
        count = len(rates)
        first = np.real(first_nodes(w, setup, self.substeps))
        nodes, grip_t, _, grip_m1 = (np.real(a) for a in held_ends(w, setup, self.substeps))
        batch = self._batch(values, first[:, 1], grip_m1[:, self.substeps, 0])
        rods, n = batch.rod_count, batch.node_count
        dofs = batch.dof_count
        state = batch.state
        held_w = wp.array(np.ascontiguousarray(nodes), dtype=wp.vec3d, device=device)
        grip_t = wp.array(np.ascontiguousarray(grip_t), dtype=wp.vec3d, device=device)
        grip_d = wp.array(np.ascontiguousarray(grip_m1), dtype=wp.vec3d, device=device)

        def zeros(*shape, dtype=wp.float64):
            return wp.zeros(shape, dtype=dtype, device=device)

        start = RodState.zeros(rods, n, device)
        before, older, velocity, velocity_older = (zeros(rods, dofs) for _ in range(4))
        strain_before, strain_older, strain_now = (zeros(rods, n, dtype=wp.vec3d) for _ in range(3))
        columns = None
        if count:
            columns = Tangents(self, setup, rates, rods, n, dofs)
        system = BandedSystem(batch, right_hand_sides=1)
        force_scale = float(values["mass"].sum() * np.linalg.norm(values["gravity"]))
        residual, converged, active = (
            zeros(rods),
            zeros(rods, dtype=wp.int32),
            wp.ones(rods, dtype=wp.int32, device=device),
        )
        tolerance = wp.full(rods, _TOLERANCE, dtype=wp.float64, device=device)
        scales = (
            wp.full(rods, force_scale, dtype=wp.float64, device=device),
            wp.full(rods, 1.0, dtype=wp.float64, device=device),
        )
        place = wp.array(setup.marker_node[1:-1].astype(np.int32), dtype=wp.int32, device=device)
        offset = np.ascontiguousarray(values["marker_offset"][None, 1:-1])
        offset = wp.array(offset, dtype=wp.vec3d, device=device)
        last = w.held.shape[1] - 1
        seen = zeros(rods, last + 1, len(setup.marker_node) - 2, dtype=wp.vec3d)
        self.last_good = np.full(rods, np.iinfo(np.int64).max)
        self.iterations = 0

        def launch(kernel, dim, inputs, outputs=()):
            wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=device)

        def roll(time):
            launch(
                kernels.roll_held,
                (rods, 2),
                [state.director, state.tangent, grip_t, grip_d, batch.free, time],
                [state.dof],
            )

        def solve_step(c, dt, time, which, inertia=True, springs=0.0):
            """Newton on one step of some rods; (rods,) which of them did not converge.

            The last factorisation is that of the solution.
            """
            coefficient = wp.vec3d(*c)
            launch(
                kernels.set_viscous_rest,
                (rods, n - 2),
                [model["rest_length"], model["stiffness"], model["rest_strain"]]
                + [model["viscous_time"], model["softening"]]
                + [coefficient, dt, strain_before, strain_older],
                [batch.bending_stiffness, batch.natural_curvature, batch.softening]
                + [batch.twisting_stiffness, batch.natural_twist],
            )
            active.assign(which.astype(np.int32))
            for iteration in range(_MAX_ITERATIONS + 1):
                batch.transport_frames(start, state, active)
                if iteration == 0:
                    roll(time)
                batch.evaluate(order=2)
                out = batch.derivatives
                if inertia:
                    launch(
                        kernels.add_motion,
                        (rods, n),
                        [model["mass"], model["linear_drag"], model["quadratic_drag"]]
                        + [model["gravity"], SPIN_INERTIA, coefficient, dt, state.dof]
                        + [before, older, velocity, velocity_older],
                        [out.gradient, out.hessian],
                    )
                elif springs:
                    launch(
                        kernels.hold_angles,
                        (rods, n - 1),
                        [anchor, wp.float64(springs), state.dof],
                        [out.gradient, out.hessian],
                    )
                batch.walk(
                    newton.measure_residual,
                    [batch.free, *scales, tolerance, out.gradient, active],
                    [residual, converged],
                )
                left = active.numpy() != 0
                if not left.any() or iteration == _MAX_ITERATIONS:
                    return left
                system.factorise(out.hessian, active)
                wp.copy(system.x, out.gradient.reshape(system.x.shape))
                system.solve(active)
                batch.walk(
                    take_newton_step,
                    [wp.float64(_STEP_LIMIT), active, system.x],
                    [state.dof],
                )
                self.iterations += 1

        def record(frame):
            launch(
                kernels.observe,
                (rods, place.shape[0]),
                [place, offset, state.dof, state.director, frame],
                [seen],
            )
            if columns:
                columns.observe(batch, place, offset, frame)

        # Twist of the first configuration: equilibrium of the angles with the nodes where they are,
        # from even twist. Where Newton fails, a rod with bends of its own has several such states:
        # implicit steps of a flow lead downhill to one.
        free_nodes = batch.free.numpy().copy()
        angles = np.zeros(dofs, dtype=bool)
        angles[3::4] = True
        batch.set_free(angles[None] & (free_nodes != 0))
        start.assign(state)
        roll(self.substeps)
        even = state.dof.numpy().copy()
        even[:, 3::4] = np.linspace(even[:, 3], even[:, -4], n - 1, axis=1)
        state.dof.assign(even)
        anchor = wp.clone(state.dof)
        still = ((0.0, 0.0, 0.0), 1.0, self.substeps)
        left = solve_step(*still, np.ones(rods, dtype=bool), inertia=False)
        if left.any():
            twisting = float(values["stiffness"][:, 2].mean() / values["rest_length"].mean())
            for springs in _TWIST_SPRINGS:
                state.dof.assign(np.where(left[:, None], anchor.numpy(), state.dof.numpy()))
                springs *= twisting
                worse = solve_step(*still, left, inertia=False, springs=springs)
                good = left & ~worse
                anchor.assign(np.where(good[:, None], state.dof.numpy(), anchor.numpy()))
            left = solve_step(*still, left, inertia=False)
            # The last state of the flow will do: what the steps need is a start.
            state.dof.assign(np.where(left[:, None], anchor.numpy(), state.dof.numpy()))
            batch.transport_frames(start, state, batch.every_rod)
        self._measure_strains(batch, strain_before)
        wp.copy(strain_older, strain_before)
        if columns:
            columns.begin(batch, model, self.substeps, grip_t, strain_before)
        batch.set_free(free_nodes != 0)
        first_dof = state.dof.numpy().copy()
        wp.copy(before, state.dof)
        earlier = first_dof.copy()
        earlier.reshape(rods, -1)[:, node_columns(n)] = first[:, 0].reshape(rods, -1)
        older.assign(earlier)
        frame_time = 1.0 / self.rate
        velocity.assign((first_dof - earlier) / frame_time)
        wp.copy(velocity_older, velocity)
        if columns:
            columns.set_velocity(frame_time)
        record(1)

        # The first step is central: it spans a frame, as the difference of the first two does.
        steps = [(_EULER, frame_time, 2 * self.substeps)]
        dt = frame_time / self.substeps
        ratio = dt / frame_time
        for k in range(2 * self.substeps + 1, last * self.substeps + 1):
            c = _BDF2
            if k == 2 * self.substeps + 1:
                c = ((1 + 2 * ratio) / (1 + ratio), -(1 + ratio), ratio**2 / (1 + ratio))
            steps.append((c, dt, k))
        for index, (c, h, time) in enumerate(steps):
            start.assign(state)
            growth = 0.0 if index == 0 else 0.5
            launch(
                kernels.extrapolate,
                (rods, dofs),
                [h, velocity, velocity_older, growth],
                [state.dof],
            )
            launch(kernels.move_held, (rods, 4), [held_w, time], [state.dof])
            going = self.last_good > time
            # The last good step of a rod was the one before; it is left alone from here on.
            self.last_good[solve_step(c, h, time, going) & going] = time - 1
            if columns:
                columns.step(
                    batch, model, system, c, h, time, grip_t,
                    (before, older, velocity, velocity_older), (strain_before, strain_older),
                )  # fmt: skip
            self._measure_strains(batch, strain_now)
            launch(
                kernels.finish_motion,
                (rods, dofs),
                [wp.vec3d(*c), h, state.dof],
                [before, older, velocity, velocity_older],
            )
            if index == 0:
                self._centre(before, older, velocity, velocity_older, earlier, frame_time)
                if columns:
                    columns.centre(frame_time)
            strain_older, strain_before, strain_now = strain_before, strain_now, strain_older
            if time % self.substeps == 0:
                record(time // self.substeps)
        return self._collect(seen, columns)

    def _centre(self, before, older, velocity, velocity_older, earliest, h) -> None:
        """Second-order velocities in the second and third frame, from all three."""
        now, middle = before.numpy().copy(), older.numpy().copy()
        velocity.assign((1.5 * now - 2.0 * middle + 0.5 * earliest) / h)
        velocity_older.assign((now - earliest) / (2.0 * h))

    def _collect(self, seen, columns):
        """Predictions at the recorded frames; the first two and the held markers as recorded."""
        w = self.windows
        rods = np.arange(len(w.recording))[:, None]
        out = w.markers.copy()
        # A rod whose steps no longer converged keeps its last shape.
        reached = np.maximum(self.last_good // self.substeps, 1)[:, None]
        time = np.minimum(w.time, reached)
        out[:, :, 1:-1] = seen.numpy()[rods, time]
        out[:, :2] = w.markers[:, :2]
        out[:, :, [0, 1, -2, -1]] = w.markers[:, :, [0, 1, -2, -1]]
        if columns is None:
            return out, None
        rates = np.zeros((*out.shape[:3], columns.count, 3))
        rates[:, :, 1:-1] = columns.seen.numpy()[rods, time]
        rates[:, :2] = 0.0
        rates[:, :, [0, 1, -2, -1]] = 0.0
        return out, rates

    def _measure_strains(self, batch, out) -> None:
        s = batch.state
        wp.launch(
            kernels.measure_strains,
            (batch.rod_count, batch.node_count - 2),
            inputs=[s.dof, s.director, s.reference_twist],
            outputs=[out],
            device=self.device,
        )

    def _upload(self, values: dict[str, np.ndarray]) -> dict[str, wp.array]:
        out = {}
        for key, value in values.items():
            if key == "marker_offset":
                continue
            if key != "rest_length":
                value = value[None]
            value = np.ascontiguousarray(value, dtype=float)
            out[key] = wp.array(value, dtype=kind_of(key), device=self.device)
        return out

    def _batch(self, values, position, director) -> RodBatch:
        batch = RodBatch(
            position,
            rest_length=values["rest_length"],
            stretching_stiffness=values["stretching"],
            bending_stiffness=np.ones((1, position.shape[1], 2)),
            twisting_stiffness=np.ones((1, position.shape[1])),
            natural_curvature=np.zeros((1, position.shape[1], 2)),
            natural_twist=np.zeros((1, position.shape[1])),
            softening=values["softening"],
            director=director,
            device=self.device,
        )
        free = np.ones(batch.dof_count, dtype=bool)
        free[[*range(3), *range(4, 7)]] = False
        free[[*range(-7, -4), *range(-3, 0)]] = False
        if not self.free_roll:
            free[[3, -4]] = False
        batch.set_free(free)
        return batch
