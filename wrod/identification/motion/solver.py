"""Motion of a rod in many windows of recordings at once, with tangents by model parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import warp as wp

from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.start import first_nodes, held_ends, rods_on_mesh
from wrod.identification.motion.tangents import SPIN_INERTIA, MotionTangents, node_columns, uploaded
from wrod.identification.motion.windows import Windows
from wrod.kernels.stepping import observed as kernels
from wrod.kernels.stepping.viscosity import measure_strains
from wrod.rods.state import RodState
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.newton_steps import NewtonSteps
from wrod.solvers.statics import EquilibriumSolver, prescribe

_TOLERANCE = 1e-7
_MAX_ITERATIONS = 25
# Runs that are kept, and from how many time steps of nodes on recording is next to nothing.
_MOST_KEPT, _LONG = 8, 60_000


class MotionRun:
    """Predicts windows with a model: BDF2 of fixed steps in true time, all windows in lockstep.

    It moves the held ends of its `Dynamics`.

    Args:
        windows: what to predict; the first two frames and the held markers are looked at.
        rate: frames per second.
        setup: the model.
        rates: setups whose imaginary parts are `COMPLEX_STEP` times a parameter's rate.
        substeps: time steps in a frame's duration.
        device: Warp device.

    Attributes:
        batch: the rods, one per window.
        kind: what runs have to share of which one goes on in the arrays of the other.
        last: number of the last step, counted from the first frame.
        taken: number of the last one that all rods have been sent to.
        step_rate: steps per second.
        seen: (W, K, M - 2) markers but the outermost, at every frame's duration.
        tangents: the derivatives, or None.
    """

    def __init__(
        self,
        windows: Windows,
        rate: float,
        setup: MotionSetup,
        rates: Sequence[MotionSetup] = (),
        *,
        substeps: int = 1,
        device: str = "cpu",
    ):
        self.windows, self.substeps, self.device = windows, substeps, device
        self.frame_time, self.step_rate = 1.0 / rate, rate * substeps
        w = windows
        values = {k: np.real(v) for k, v in setup.arrays().items()}
        # Every window's own lengths, on top of the model's.
        pieces = np.diff(setup.marker_node)
        change = np.repeat(w.length_change / pieces, pieces, axis=1)
        values["rest_length"] = values["rest_length"] + change
        rows = {k: v if k == "rest_length" else v[None] for k, v in values.items()}
        rows["marker_offset"] = rows["marker_offset"][:, 1:-1]
        self.model = uploaded(rows, device)
        ends = held_ends(w, setup, self.substeps)
        self.first = np.real(first_nodes(w, setup, self.substeps, ends))
        nodes, grip_t, _, grip_m1 = (np.real(a) for a in ends)
        self.held, self.grip_tangent, self.grip_director = (
            wp.array(np.ascontiguousarray(a), dtype=wp.vec3d, device=device)
            for a in (nodes, grip_t, grip_m1)
        )
        self.batch = rods_on_mesh(
            values,
            self.first[:, 1],
            grip_m1[:, self.substeps, 0],
            values["mass"][:, None] * values["gravity"],
            device,
            rest_length=values["rest_length"],
            node_mass=values["mass"],
        )
        prescribe(self.batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
        self._equilibria = EquilibriumSolver(self.batch)
        frames = w.held.shape[1]
        self.last = (frames - 1) * self.substeps
        place = setup.marker_node[1:-1].astype(np.int32)
        self.place = wp.array(place, dtype=wp.int32, device=device)
        shape = (self.batch.rod_count, frames, self.place.shape[0])
        self.seen = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self.tangents = MotionTangents(self, setup, rates) if len(rates) else None
        # The material damps stretching as it damps bending.
        viscous = values["viscous_time"][:, [0, 1, 2, 0]]
        length, mass = values["rest_length"], values["mass"]
        density = mass.sum() / length.sum(axis=1, keepdims=True)
        self.dynamics = Dynamics(
            self.batch,
            scheme="bdf2",
            radius=np.sqrt(2.0 * SPIN_INERTIA / (density * length)),
            internal_damping=viscous[None],
            motion=self,
            force_scale=mass.sum() * np.linalg.norm(values["gravity"], axis=-1).mean(),
            tolerance=_TOLERANCE,
        )
        if (relaxation := values["viscous_time"][None, :, 3]).any():
            self.dynamics.viscosity.relax(relaxation)
        self.dynamics.set_drag(np.stack([values["linear_drag"], values["quadratic_drag"]], axis=1))
        self.dynamics.follower, self.dynamics.max_iterations = self, _MAX_ITERATIONS
        # Windows are predicted with the steps that their frames give.
        self.dynamics.refuses_saddles = False
        self.taken = self.substeps
        self._sent = wp.zeros(1, dtype=wp.int32, device=device)
        self._arrays = list(_arrays_of(self, set()))
        laws = [id(kernel) for kernel, _ in self.batch.energies]
        flags = self.batch.softens, self.dynamics.viscosity.relaxes, substeps, self.step_rate
        self.kind = (*flags, *laws, *((a.shape, a.dtype) for a in self._arrays))

    def instead_of(self, other: MotionRun) -> MotionRun:
        """The `other`, of the same `kind`, as this one, which has not begun, in its own arrays:
        what it has recorded goes on with it."""
        for own, new in zip(other._arrays, self._arrays, strict=True):
            wp.copy(own, new)
        other.windows, other.first, other.taken = self.windows, self.first, self.taken
        if self.tangents:
            other.tangents.first = self.tangents.first
        return other

    def prescribe(self, running, time, step, start: RodState) -> None:
        """Put the held edges where their grips are, and let Newton's method start near by."""
        self._hold(running, time, step, start)
        batch, dynamics = self.batch, self.dynamics
        batch.launch(
            kernels.lead_nodes,
            (batch.rod_count, batch.node_count - 4),
            [wp.float64(dynamics.growth), running],
            [dynamics.present],
        )

    def _hold(self, running, time, step, start: RodState) -> None:
        batch = self.batch
        batch.launch(
            kernels.hold_ends,
            (batch.rod_count, 2),
            [self.held, self.grip_tangent, self.grip_director]
            + [self.substeps, self.step_rate, running, time, step]
            + [start.tangent, start.director],
            [batch.state.dof],
        )

    def begin(self) -> None:
        """Predict the first frames, until the launches of a step are recorded.

        What is recorded is whatever is launched meanwhile, by any thread: begin one after another.
        """
        self._twist()
        batch, dynamics, tangents = self.batch, self.dynamics, self.tangents
        h, rods = self.frame_time, batch.rod_count
        first_dof = batch.state.dof.numpy().copy()
        earlier = first_dof.copy()
        earlier[:, node_columns(batch.node_count)] = self.first[:, 0].reshape(rods, -1)
        dynamics.velocity.assign((first_dof - earlier) / h)
        dynamics.velocity_older.assign(dynamics.velocity)
        if tangents:
            tangents.set_velocity(h)
        self._observe(batch.every_rod)
        # Of several substeps the first step, as long as a frame, is taken once.
        dynamics.keeps_recording = self.substeps == 1
        # The first step is central: it spans a frame, as the difference of the first two does.
        self._go_to(2 * self.substeps, h)
        now = batch.state.dof.numpy().copy()
        dynamics.velocity.assign((1.5 * now - 2.0 * first_dof + 0.5 * earlier) / h)
        dynamics.velocity_older.assign((now - earlier) / (2.0 * h))
        if tangents:
            tangents.centre(h)
        dynamics.keeps_recording = True
        while self.taken < self.last and not dynamics.is_recorded:
            self._go_to(self.taken + 1, h / self.substeps)

    def finish(self) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        """Predict the others.

        Returns:
            (W, F, M, 3) markers [m], the first two frames and the held markers as recorded;
            (W, F, M, P, 3) their derivatives, or None; and (W,) whether a step did not converge.
        """
        if self.taken < self.last:
            self._go_to(self.last, self.frame_time / self.substeps)
        # The last step that converged, counted from the first frame; then a rod keeps its shape.
        last = self.substeps + np.rint(self.dynamics.time.numpy() * self.step_rate).astype(int)
        w, tangents = self.windows, self.tangents
        rods = np.arange(len(w.recording))[:, None]
        time = np.minimum(w.time, np.maximum(last // self.substeps, 1)[:, None])
        out = w.markers.copy()
        out[:, 2:, 2:-2] = self.seen.numpy()[rods, time[:, 2:], 1:-1]
        if tangents is None:
            return out, None, last < self.last
        rates, seen = np.zeros((*out.shape[:3], tangents.count, 3)), tangents.seen.numpy()
        for k in range(len(rates)):
            rates[k, 2:, 2:-2] = seen[k, time[k, 2:], 1:-1]
        return out, rates, last < self.last

    def _go_to(self, number: int, h: float) -> None:
        """Take all steps, `h` long, until one, every rod at its own pace."""
        first = self.taken + round(h * self.step_rate) - self.substeps
        self._sent.fill_(number - self.substeps)
        # A step that fails is not halved: its rod is left where it was.
        self.dynamics.advance(
            first / self.step_rate, 1.0001 * h, smallest_step=0.9 * h, then=self._go_on
        )
        self.taken = number

    def _go_on(self) -> None:
        pace, inputs = self.dynamics.pace, [self._sent, self.step_rate]
        self.batch.launch(kernels.go_on, self.batch.rod_count, inputs, [pace])

    def follow(self, dynamics: NewtonSteps) -> None:
        """Carry the tangents along, and look at the markers of rods that have come to a frame."""
        if self.tangents:
            self.tangents.follow(dynamics)
        self._observe(dynamics.accepted)

    def _observe(self, chosen: wp.array) -> None:
        batch, state = self.batch, self.batch.state
        when = [chosen, self.dynamics.time, self.substeps, self.step_rate]
        self.batch.launch(
            kernels.observe,
            (batch.rod_count, self.place.shape[0]),
            [self.place, self.model["marker_offset"], *when, state.dof, state.director],
            [self.seen],
        )
        if self.tangents:
            self.tangents.observe(self.place, when)

    def _twist(self) -> None:
        """Twist of the first configuration: equilibrium of the angles with the nodes where they
        are, from even twist. A rod with bends of its own has several such states."""
        batch = self.batch
        free = batch.free.numpy() != 0
        angles = np.zeros(batch.dof_count, dtype=bool)
        angles[3::4] = True
        start = RodState.zeros(batch.rod_count, batch.node_count, self.device)
        start.assign(batch.state)
        none = wp.zeros(batch.rod_count, dtype=wp.float64, device=self.device)
        self._hold(batch.every_rod, none, none, start)
        even = batch.state.dof.numpy().copy()
        even[:, 3::4] = np.linspace(even[:, 3], even[:, -4], batch.node_count - 1, axis=1)
        batch.state.dof.assign(even)
        batch.set_free(angles[None] & free)
        self.dynamics.internal.forget(batch.every_rod)
        # What is found when it does not converge will do: what the steps need is a start.
        self._equilibria.solve(tolerance=_TOLERANCE)
        if self.tangents:
            self.tangents.begin(self._strains())
        batch.set_free(free)
        self.dynamics.restart(batch.every_rod)

    def _strains(self) -> wp.array:
        """(rod, node) strains of the present configuration."""
        batch, s = self.batch, self.batch.state
        shape = (batch.rod_count, batch.node_count)
        out = wp.zeros(shape, dtype=wp.vec4d, device=self.device)
        self.batch.launch(
            measure_strains, shape, [batch.every_rod, s.dof, s.director, s.reference_twist], [out]
        )
        return out


class Runs:
    """Runs one after another, which go on in the arrays of earlier ones of their kind: of short
    motions most of the time goes into recording launches."""

    def __init__(self) -> None:
        self._kept: list[MotionRun] = []

    def begun(self, *given, **options) -> MotionRun:
        """A run of these arguments that has begun."""
        run = MotionRun(*given, **options)
        for k, other in enumerate(self._kept):
            if other.kind == run.kind:
                run = run.instead_of(self._kept.pop(k))
                break
        run.begin()
        return run

    def keep(self, runs: Sequence[MotionRun]) -> None:
        """Take short runs that have finished on a CPU for others; long ones are large."""
        for r in runs:
            if r.device == "cpu" and r.batch.rod_count * r.batch.node_count * r.last < _LONG:
                self._kept.append(r)
        del self._kept[:-_MOST_KEPT]


def _arrays_of(thing: object, seen: set[int]) -> Iterator[wp.array]:
    """The arrays of a run and of what it is made of, in the order in which they were made."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, wp.array):
        yield thing
    elif isinstance(thing, dict | list | tuple) or hasattr(thing, "__dict__"):
        own = thing if isinstance(thing, dict | list | tuple) else vars(thing)
        for part in own.values() if isinstance(own, dict) else own:
            yield from _arrays_of(part, seen)
