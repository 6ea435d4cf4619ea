"""Motion of a rod in many windows of recordings at once, with tangents by model parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod.batch import RodBatch, RodState
from wrod.identification.motion_data import MotionMeasurements, through_markers
from wrod.identification.motion_setup import MotionSetup
from wrod.kernels import banded, newton
from wrod.kernels import motion as kernels
from wrod.kernels.dynamics import take_newton_step
from wrod.statics import BandedSystem

COMPLEX_STEP = 1e-30
_STEP_LIMIT = 0.3
_TOLERANCE = 1e-7
_MAX_ITERATIONS = 25
# Inertia of an edge about its axis, per line mass: far too small to be seen.
_SPIN_INERTIA = 1e-7
_EULER, _BDF2 = (1.0, -1.0, 0.0), (1.5, -2.0, 0.5)


@dataclass(frozen=True)
class Windows:
    """Stretches of recordings in true time: frames that were lost are places without markers.

    Attributes:
        recording, start: (W,) where each begins.
        time: (W, F) frame durations since the window's first frame, for each recorded frame.
        seen: (W, F) whether there is such a frame.
        markers: (W, F, M, 3) what was recorded [m]; repeats the last frame where there is none.
        held: (W, K, 4, 3) held markers at every frame duration, interpolated where frames are lost.
        grip_director: (W, K, 2, 3) first director of each grip: across the line through its
            markers, carried along without roll from the recording's start, where it is the axis
            about which the rod bends on average, as seen along the grip: so a rod that hangs in
            one plane starts without twist.
        length_change: (W, M - 1) what to add to the rod's length between markers [m].
    """

    recording: np.ndarray
    start: np.ndarray
    time: np.ndarray
    seen: np.ndarray
    markers: np.ndarray
    held: np.ndarray
    grip_director: np.ndarray
    length_change: np.ndarray


def windows_of(
    measurements: MotionMeasurements,
    recordings: Sequence[int],
    starts: Sequence[int] = (0,),
    frames: int | None = None,
) -> Windows:
    """Windows of `frames` frames (default: all) that begin at each of `starts`."""
    m = measurements
    frames = m.frame_count if frames is None else min(frames, m.frame_count)
    pairs = [(r, s) for r in recordings for s in starts if s + 3 <= m.frame_count]
    recording, start = (np.array(a) for a in zip(*pairs, strict=True))
    index = start[:, None] + np.arange(frames)
    seen = index < m.frame_count
    index = np.minimum(index, m.frame_count - 1)
    clock = np.pad(np.cumsum(m.gap, axis=1), ((0, 0), (1, 0)))
    time = clock[recording[:, None], index] - clock[recording, start][:, None]
    last = int(time.max())
    held, director = [], []
    whole = {}
    for r, s in pairs:
        if r not in whole:
            whole[r] = _true_time(m, r, clock[r])
        a = clock[r, s] + np.arange(last + 1)
        a = np.minimum(a, clock[r, -1])
        held.append(whole[r][0][a])
        director.append(whole[r][1][a])
    return Windows(
        recording,
        start,
        time,
        seen,
        m.positions[recording[:, None], index],
        np.stack(held),
        np.stack(director),
        m.length_change(recording, start),
    )


def _true_time(m: MotionMeasurements, r: int, clock: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Held markers (K, 4, 3) and directors (K, 2, 3) at every frame duration of a recording."""
    from scipy.interpolate import PchipInterpolator

    x = m.positions[r][:, [0, 1, -2, -1]]
    times = np.arange(clock[-1] + 1)
    held = x if clock[-1] == len(x) - 1 else PchipInterpolator(clock, x, axis=0)(times)
    tangent = held[:, [1, 3]] - held[:, [0, 2]]
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    director = np.empty_like(tangent)
    across = m.bending_axis
    d = across - np.sum(across * tangent[0], axis=1, keepdims=True) * tangent[0]
    director[0] = d / np.linalg.norm(d, axis=1, keepdims=True)
    for k in range(1, len(times)):
        d = _transport(director[k - 1], tangent[k - 1], tangent[k])
        d -= np.sum(d * tangent[k], axis=1, keepdims=True) * tangent[k]
        director[k] = d / np.linalg.norm(d, axis=1, keepdims=True)
    return held, director


def _transport(v, t, u):
    """Turn (..., 3) vectors by the smallest rotation from t to u; analytic."""
    axis = np.cross(t, u)
    cosine = np.sum(t * u, axis=-1, keepdims=True)
    along = np.sum(axis * v, axis=-1, keepdims=True) / (1.0 + cosine)
    return cosine * v + np.cross(axis, v) + along * axis


def _unit(v):
    return v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True))


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

    # ---- the beginning ------------------------------------------------------------------------

    def _held(self, setup: MotionSetup) -> tuple[np.ndarray, ...]:
        """(W, K', 4, 3) held nodes, (W, K', 2, 3) tangents of the grips, material directors m1 and
        principal directors of bending there, at every time step; complex if the setup is."""
        w, fine = self.windows, self.substeps
        held, director = w.held, w.grip_director
        if fine > 1:
            held, director = _refine(held, fine), _refine(director, fine)
        near, far = held[:, :, [0, 2]], held[:, :, [1, 3]]
        t = _unit(far - near)
        m1 = _unit(director - np.sum(director * t, axis=-1, keepdims=True) * t)
        m2 = np.cross(t, m1)
        offset = setup.marker_offset[[0, 1, -2, -1]]
        turn = setup.held_turn
        nodes = np.stack([near[:, :, 0], far[:, :, 0], near[:, :, 1], far[:, :, 1]], axis=2)
        nodes = nodes.astype(complex)
        # The material frame in the grip, turned by its roll.
        c, s = np.cos(setup.roll)[:, None], np.sin(setup.roll)[:, None]
        a1, a2 = c * m1 + s * m2, -s * m1 + c * m2
        for k in range(4):
            e = k // 2
            o = offset[k]
            nodes[:, :, k] -= o[0] * a1[:, :, e] + o[1] * a2[:, :, e] + o[2] * t[:, :, e]
        # The outer node swings about the inner one.
        for e, outer, inner in ((0, 0, 1), (1, 3, 2)):
            arm = nodes[:, :, outer] - nodes[:, :, inner]
            axis = turn[e, 0] * m1[:, :, e] + turn[e, 1] * m2[:, :, e]
            nodes[:, :, outer] = nodes[:, :, inner] + arm + np.cross(axis, arm)
        c, s = np.cos(setup.principal_angle), np.sin(setup.principal_angle)
        return nodes, t, a1, c * a1 + s * a2

    def _first_nodes(self, setup: MotionSetup) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(W, 2, N, 3) nodes in the first two frames, held ones included."""
        w = self.windows
        markers = w.markers[:, :2].astype(complex)
        nodes, t, a1, _ = self._held(setup)
        inner = setup.marker_node
        s = np.concatenate([[0.0], np.cumsum(np.real(setup.rest_length))])
        if np.any(setup.marker_offset != 0):
            centre = self._without_offsets(setup, markers, a1)
        else:
            centre = markers
        fine = int(inner[2] - inner[1])
        grips = nodes[:, [0, self._first_gap()]]
        centre = np.concatenate([grips[:, :, :2], centre[:, :, 2:-2], grips[:, :, 2:]], axis=2)
        curve = through_markers(np.real(centre), fine, s[inner]) + 1j * through_markers(
            np.imag(centre), fine, s[inner]
        )
        count = (len(inner) - 1) * fine
        keep = [0, *range(fine, count - fine + 1), count]
        return curve[:, :, keep]

    def _without_offsets(self, setup, markers, a1) -> np.ndarray:
        """Markers moved back to the centreline with frames that twist evenly between the grips."""
        gap = self._first_gap()
        out = markers.copy()
        t = markers[:, :, 2:] - markers[:, :, :-2]
        t = _unit(np.concatenate([markers[:, :, 1:2] - markers[:, :, :1], t,
                                  markers[:, :, -1:] - markers[:, :, -2:-1]], axis=2))  # fmt: skip
        for f, step in ((0, 0), (1, gap)):
            frames = [_transport(a1[:, step, 0], t[:, f, 0], t[:, f, 0])]
            for k in range(1, t.shape[2]):
                frames.append(_transport(frames[-1], t[:, f, k - 1], t[:, f, k]))
            d = np.stack(frames, axis=1)
            end = a1[:, step, 1]
            y = np.sum(np.cross(d[:, -1], end) * t[:, f, -1], axis=-1)
            x = np.sum(d[:, -1] * end, axis=-1)
            twist = np.arctan2(np.real(y), np.real(x)) + 1j * (
                np.imag(y) * np.real(x) - np.imag(x) * np.real(y)
            ) / (np.real(x) ** 2 + np.real(y) ** 2)
            angle = twist[:, None] * (np.arange(t.shape[2]) / (t.shape[2] - 1))
            c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
            m1 = c * d + s * np.cross(t[:, f], d)
            m2 = np.cross(t[:, f], m1)
            o = setup.marker_offset
            out[:, f] -= o[:, :1] * m1 + o[:, 1:2] * m2 + o[:, 2:] * t[:, f]
        return out

    def _first_gap(self):
        """Time steps between the first two frames: one frame duration, or more if frames between
        them were lost in some window (then its markers count as that much slower)."""
        return self.substeps

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
        first = np.real(self._first_nodes(setup))
        gap = w.time[:, 1].astype(float)[:, None, None]
        # Where frames were lost between the first two, their difference is that of one.
        first[:, 0] = first[:, 1] + (first[:, 0] - first[:, 1]) / gap
        nodes, grip_t, _, grip_m1 = (np.real(a) for a in self._held(setup))
        batch = self._batch(values, first[:, 1], grip_m1[:, self._first_gap(), 0])
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
            columns = _Columns(self, setup, rates, rods, n, dofs)
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
        self.failed = np.zeros(rods, dtype=bool)
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

        def solve_step(c, dt, time, inertia=True):
            """Newton on one step; the last factorisation is that of the solution."""
            coefficient = wp.vec3d(*c)
            launch(
                kernels.set_viscous_rest,
                (rods, n - 2),
                [model["rest_length"], model["stiffness"], model["rest_strain"]]
                + [model["viscous_time"], coefficient, dt, strain_before, strain_older],
                [batch.bending_stiffness, batch.natural_curvature]
                + [batch.twisting_stiffness, batch.natural_twist],
            )
            active.fill_(1)
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
                        + [model["gravity"], _SPIN_INERTIA, coefficient, dt, state.dof]
                        + [before, older, velocity, velocity_older],
                        [out.gradient, out.hessian],
                    )
                launch(
                    newton.measure_residual,
                    rods,
                    [batch.free, *scales, tolerance, out.gradient, active],
                    [residual, converged],
                )
                left = active.numpy() != 0
                if not left.any() or iteration == _MAX_ITERATIONS:
                    self.failed |= left
                    break
                system.factorise(out.hessian, active)
                wp.copy(system.x, out.gradient.reshape(system.x.shape))
                system.solve(active)
                launch(
                    take_newton_step,
                    rods,
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

        # Twist of the first configuration: equilibrium of the angles with the nodes where they are.
        free_nodes = batch.free.numpy().copy()
        angles = np.zeros(dofs, dtype=bool)
        angles[3::4] = True
        batch.set_free(angles[None] & (free_nodes != 0))
        start.assign(state)
        roll(self._first_gap())
        solve_step((0.0, 0.0, 0.0), 1.0, self._first_gap(), inertia=False)
        self._measure_strains(batch, strain_before)
        wp.copy(strain_older, strain_before)
        if columns:
            columns.begin(batch, model, self._first_gap(), grip_t, strain_before)
        batch.set_free(free_nodes != 0)
        first_dof = state.dof.numpy().copy()
        wp.copy(before, state.dof)
        earlier = first_dof.copy()
        earlier.reshape(rods, -1)[:, _node_columns(n)] = first[:, 0].reshape(rods, -1)
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
            solve_step(c, h, time)
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
        out[:, :, 1:-1] = seen.numpy()[rods, w.time]
        out[:, :2] = w.markers[:, :2]
        out[:, :, [0, 1, -2, -1]] = w.markers[:, :, [0, 1, -2, -1]]
        if columns is None:
            return out, None
        rates = np.zeros((*out.shape[:3], columns.count, 3))
        rates[:, :, 1:-1] = columns.seen.numpy()[rods, w.time]
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
            kind = wp.vec3d if key in _VECTORS else wp.float64
            if key != "rest_length":
                value = value[None]
            value = np.ascontiguousarray(value, dtype=float)
            out[key] = wp.array(value, dtype=kind, device=self.device)
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


_VECTORS = ("stiffness", "rest_strain", "viscous_time", "gravity")


def _node_columns(node_count: int) -> np.ndarray:
    return (4 * np.arange(node_count)[:, None] + np.arange(3)).ravel()


def _refine(values: np.ndarray, fine: int) -> np.ndarray:
    """(W, K, ...) values at `fine` times as many instants, by cubic splines."""
    from scipy.interpolate import CubicSpline

    k = np.arange(values.shape[1])
    return CubicSpline(k, values, axis=1)(np.arange((len(k) - 1) * fine + 1) / fine)


class _Columns:
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
            kind = wp.vec3d if key in (*_VECTORS, "marker_offset") else wp.float64
            self.model[key] = wp.array(np.ascontiguousarray(value), dtype=kind, device=device)
        held = [solver._held(r) for r in rates]
        self.held = wp.array(
            np.ascontiguousarray(np.stack([imag(h[0]) for h in held], axis=2)),
            dtype=wp.vec3d, device=device,
        )  # fmt: skip
        self.roll = wp.array(
            np.stack([np.broadcast_to(imag(r.roll + r.principal_angle), 2) for r in rates]),
            dtype=wp.float64, device=device,
        )  # fmt: skip
        first = np.stack([imag(solver._first_nodes(r)) for r in rates], axis=2)
        gap = solver.windows.time[:, 1].astype(float)[:, None, None, None]
        first[:, 0] = first[:, 1] + (first[:, 0] - first[:, 1]) / gap
        self.first = np.zeros((2, rods, P, dofs))
        self.first[:, :, :, _node_columns(nodes)] = first.transpose(1, 0, 2, 3, 4).reshape(
            2, rods, P, -1
        )

        def zeros():
            return wp.zeros((rods, P, dofs), dtype=wp.float64, device=device)

        self.now, self.older, self.velocity, self.velocity_older = (zeros() for _ in range(4))
        self.step_held, self.product, self.x = (zeros() for _ in range(3))
        self.strain, self.strain_older, self.strain_new = (
            wp.zeros((rods, P, nodes), dtype=wp.vec3d, device=device) for _ in range(3)
        )
        last = solver.windows.held.shape[1]
        markers = len(setup.marker_node) - 2
        self.seen = wp.zeros((rods, last, markers, P), dtype=wp.vec3d, device=device)

    def _launch(self, kernel, dim, inputs, outputs=()):
        wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=self.solver.device)

    def _elastic(self, batch, model, c, dt, strain_before, strain_older):
        names = ("rest_length", "stretching", "stiffness", "rest_strain", "viscous_time")
        s = batch.state
        self._launch(
            kernels.elastic_tangents,
            (self.rods, self.nodes - 1, self.count),
            [model[k] for k in names] + [self.model[k] for k in names]
            + [wp.vec3d(*c), dt, s.dof, s.director, s.reference_twist]
            + [strain_before, strain_older, self.strain, self.strain_older],
            [self.x.reshape((self.rods * self.count, self.dofs))],
        )  # fmt: skip

    def _solve(self, batch, system):
        """x <- solution of the step's matrix for x, given what is held."""
        every = batch.every_rod
        dim = (self.rods, self.count, self.dofs)
        hessian = batch.derivatives.hessian
        self._launch(
            banded.multiply, dim, [every, hessian, self.step_held], [self.product]
        )
        self._launch(kernels.subtract_product, dim, [batch.free, self.product], [self.x])
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
            (self.rods, self.nodes - 2, self.count),
            [s.dof, s.director, self.now],
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
        self.x.zero_()
        self._elastic(batch, model, (0.0, 0.0, 0.0), 1.0, strain, strain)
        self._solve(batch, BandedSystem(batch))
        self.now.assign(self.x.numpy() + value)
        self._strains(batch, self.strain)
        wp.copy(self.strain_older, self.strain)
        self.step_held.zero_()

    def set_velocity(self, h) -> None:
        now = self.now.numpy().copy()
        earlier = now.copy()
        columns = _node_columns(self.nodes)
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
            + [_SPIN_INERTIA, wp.vec3d(*c), dt, s.dof, *history]
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
