"""Motion of batches of rods: implicit time steps, each rod at its own pace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.lanes import WARP
from wrod.kernels.stepping import continuation
from wrod.kernels.stepping import dynamics as kernels
from wrod.kernels.stepping import newton_iteration as newton
from wrod.rods.batch import RodBatch, RodState, node_positions
from wrod.solvers.banded import BandedSystem
from wrod.solvers.bodies import Bodies
from wrod.solvers.contact import Contact
from wrod.solvers.inelastic import InternalVariables
from wrod.solvers.rod_contact import RodContact
from wrod.solvers.viscosity import Viscosity

SCHEMES = ("euler", "bdf2", "midpoint")
# Largest change of an edge in one Newton iteration, as a fraction of its length.
_STEP_LIMIT = 0.3
# A rod is cut out when it wants steps shorter than this fraction of the largest.
_SMALLEST_STEP = 1.0 / 4096.0
_GROWTH = 1.3
# Rounds that are taken without looking whether to go on: on end where a device decides by itself,
# and one after the other where it cannot.
_ROUNDS, _ROUNDS_BLIND, _ENDLESS = 128, 16, 2**31 - 1


class Motion(Protocol):
    """What moves prescribed degrees of freedom: called at the start of every step, it writes where
    they are at the end of the step into `state.dof` and may change `batch.free`.

    It does so by kernels alone: on a GPU the launches of a long `Dynamics.advance` are recorded and
    replayed."""

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState): ...


class Follower(Protocol):
    """What is carried along with the steps: called whenever steps of some rods were accepted, while
    `batch` still holds residual, matrix and configuration of their ends, and `start` their starts.

    It does its work by kernels alone, for the rods that are not 0 in `accepted`."""

    def follow(self, dynamics: Dynamics) -> None: ...


@dataclass(frozen=True)
class Progress:
    """Where a call of `Dynamics.advance` got, rod by rod (NumPy).

    Attributes:
        time: (rod,) time reached.
        diverged: (rod,) whether the rod was cut out because no step converged; its state is the
            last good one.
        steps: (rod,) accepted steps since the start of the simulation.
        iterations: (rod,) Newton iterations since then.
    """

    time: np.ndarray
    diverged: np.ndarray
    steps: np.ndarray
    iterations: np.ndarray


# What touches: the protocol of `Contact`, `RodContact` and Newton's shapes.
_IS_CONTACT = arguments.like("a wrod.Contact or wrod.RodContact", "add", "settle", "restart")


class Dynamics:
    """Time stepping of a batch; allocates everything once.

    Degrees of freedom that are not free stand still unless `motion` moves them.

    Args:
        batch: the rods, with node masses; their state is the initial configuration, at rest.
        scheme: "euler" (first order, dissipates), "bdf2" (second order, hardly dissipates) or
            "midpoint" (second order, a quarter of its error, dissipates nothing of itself; steps in
            which anything is touched are of "bdf2").
        radius: (rod,) or (rod, node - 1) radius of the section, for the rotational inertia of the
            edges.
        air_damping: (rod,) drag per mass and velocity [1/time].
        drag: (rod, node, 2) drag of each node per velocity, and per velocity squared, on top of it;
            default: none.
        internal_damping: Kelvin-Voigt time of the material [time], which does not oppose rigid
            motion: (rod,), or for every strain as in `wrod.solvers.viscosity.Viscosity`.
        contact: what the rods touch, one or several, or None; at most one `RodContact`.
        motion: what moves prescribed degrees of freedom, or None.
        follower: what is carried along with the steps, or None.
        bodies: rigid bodies that hold rods and move with them, or None.
        force_scale: (rod,) what residuals are measured against; default: the rod's weight, or
            k_b / L^2 if that is larger.
        tolerance: largest residual of a step over the force scale.
        max_iterations: of Newton; a step that needs more is halved.
        refuses_saddles: halve steps, too, whose matrix is indefinite where they end.
        keeps_recording: record the launches of a round on any device, and replay them in later
            calls of `advance` too, for callers that advance step by step. `motion` and contacts
            must then keep their arrays and numbers, or `forget_recording` be called. On a CPU no
            other thread may launch anything meanwhile: it would be recorded too.

    Raises:
        RodError: unknown scheme, a node without mass, or two `RodContact`.
    """

    @arguments.checked(
        RodError,
        batch=arguments.like("a wrod.RodBatch", "rod_count", "node_count", "state"),
        scheme=arguments.text,
        radius=arguments.numbers_of_any_shape,
        air_damping=arguments.array((), (None,)),
        drag=arguments.optional(arguments.numbers_of_any_shape),
        internal_damping=arguments.numbers_of_any_shape,
        contact=arguments.optional(
            arguments.either(_IS_CONTACT, arguments.several(_IS_CONTACT, 0))
        ),
        motion=arguments.optional(arguments.like("a motion", "prescribe")),
        follower=arguments.optional(arguments.like("a follower", "follow")),
        force_scale=arguments.optional(arguments.array((), (None,))),
        tolerance=arguments.number(1e-16, 1e3),
        max_iterations=arguments.whole(0, 10_000),
        refuses_saddles=arguments.flag,
        keeps_recording=arguments.flag,
    )
    def __init__(
        self,
        batch: RodBatch,
        *,
        scheme: str = "bdf2",
        radius: np.ndarray | float,
        air_damping: np.ndarray | float = 0.0,
        drag: np.ndarray | None = None,
        internal_damping: np.ndarray | float = 0.0,
        contact: Contact | RodContact | Sequence[Contact | RodContact] | None = None,
        motion: Motion | None = None,
        follower: Follower | None = None,
        bodies: Bodies | None = None,
        force_scale: np.ndarray | float | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 12,
        refuses_saddles: bool = True,
        keeps_recording: bool = False,
    ):
        if scheme not in SCHEMES:
            raise RodError(f"unknown scheme {scheme!r}; use one of {', '.join(SCHEMES)}")
        self.batch, self.contact, self.motion = batch, contact, motion
        self.follower, self.bodies = follower, bodies
        self._scheme, self.max_iterations = SCHEMES.index(scheme), max_iterations
        rods, device = batch.rod_count, batch.device
        if contact is None:
            contact = ()
        self.contacts = tuple(contact) if isinstance(contact, Sequence) else (contact,)
        coupling = [c for c in self.contacts if isinstance(c, RodContact)]
        if len(coupling) > 1:
            raise RodError("two RodContact for one batch; one covers all pairs of its edges")
        self.rod_contact = coupling[0] if coupling else None
        columns = 1 if bodies is None else 1 + bodies.columns
        self.system: Any = coupling[0].system if coupling else BandedSystem(batch, columns)
        self.system.widen(columns)
        self.start = RodState.zeros(rods, batch.node_count, device)
        self.start.assign(batch.state)

        def floats(value, name="value"):
            value = arguments.spread(value, (rods,), f"Dynamics: {name}", RodError)
            return wp.array(np.ascontiguousarray(value), dtype=wp.float64, device=device)

        self.mass = wp.array(_masses(batch, radius), dtype=wp.float64, device=device)
        self.refuses_saddles = int(refuses_saddles)
        self.air_damping = floats(air_damping, "air_damping")
        self.drag = None
        if drag is not None:
            shape = (rods, batch.node_count, 2)
            drag = np.ascontiguousarray(arguments.spread(drag, shape, "Dynamics: drag", RodError))
            self.drag = wp.array(drag, dtype=wp.vec2d, device=device)
        # The last change of velocity tells Newton's start, but for what hits something.
        self._growth = 0.0 if self.contacts else 0.5
        self.viscosity = Viscosity(batch, internal_damping)
        self.internal = InternalVariables(batch)
        scale = _force_scale(batch) if force_scale is None else force_scale
        self.force_scale = floats(scale, "force_scale")
        self.length_scale = floats(batch.rest_length.numpy().sum(axis=1))
        self.tolerance = tolerance
        self.rounding = wp.array(self._rounding(), dtype=wp.vec2d, device=device)
        self._allocate()
        for one in self.contacts:
            one.time_step = self.span
        self.keeps_recording = keeps_recording
        self._recording: tuple[tuple, object] | None = None

    def _allocate(self) -> None:
        """What every rod carries from step to step."""
        rods, device = self.batch.rod_count, self.batch.device

        def floats(value=0.0):
            return wp.full(rods, value, dtype=wp.float64, device=device)

        def ints():
            return wp.zeros(rods, dtype=wp.int32, device=device)

        self.step_tolerance, self.residual = floats(), floats()
        self.time, self.until, self.step, self.step_before = (floats() for _ in range(4))
        # Time from the start of the step to where its forces are; why a rod leaves its scheme.
        self.span, self._no_step = floats(), floats()
        self.leaves, self.touching = ints(), ints()
        self.wanted_step = floats()
        # Part of the last Newton step that was taken.
        self.taken = floats(1.0)
        self.coefficient = wp.zeros(rods, dtype=wp.vec3d, device=device)
        self.running, self.starting, self.active, self.converged = (ints() for _ in range(4))
        self.iteration, self.iteration_count = ints(), ints()
        self.accepted, self.rejected, self.diverged, self.step_count = (ints() for _ in range(4))
        # Rounds since last asked; whether to take another, and whether any rod still runs.
        self._rounds = wp.zeros(1, dtype=wp.int32, device=device)
        self._going = wp.zeros(2, dtype=wp.int32, device=device)
        self._goes_on = self._going[:1]  # a condition of a graph is one number
        shape = (rods, self.batch.dof_count)
        self.velocity, self.velocity_older = (
            wp.zeros(shape, dtype=wp.float64, device=device) for _ in range(2)
        )
        self.dof_older = wp.clone(self.batch.state.dof)
        self._end = wp.clone(self.batch.state.dof)
        # (rod, dof): forces that held prescribed degrees of freedom at the end of the last step.
        self.reaction = wp.zeros(shape, dtype=wp.float64, device=device)

    def forget_recording(self) -> None:
        """Record afresh: what `motion` or contacts launch has changed."""
        self._recording = None

    @arguments.checked(RodError, velocity=arguments.numbers_of_any_shape)
    def set_velocity(self, velocity: np.ndarray) -> None:
        """(rod, node, 3) velocities of the nodes now; the edges do not spin."""
        batch = self.batch
        dof = np.zeros((batch.rod_count, batch.node_count, 4))
        dof[:, :, :3] = arguments.spread(
            velocity, dof[:, :, :3].shape, "Dynamics: velocity", RodError
        )
        self.velocity.assign(dof.reshape(batch.rod_count, -1)[:, :-1])
        self.step_before.zero_()

    def restart(self, chosen: wp.array) -> None:
        """Let the rods that are not 0 in `chosen` (rod,) start anew from the batch's state, which
        must have its frames, and from `velocity`; one that was cut out takes part again."""
        self._per_rod(
            kernels.forget_history,
            [chosen],
            [self.step_before, self.wanted_step, self.diverged, self.leaves],
        )
        self._copy(chosen, self.batch.state, self.start)
        self.internal.restart(chosen)
        for contact in self.contacts:
            contact.restart(chosen)

    def velocities(self) -> np.ndarray:
        """(rod, node, 3) velocities of the nodes."""
        return node_positions(self.velocity.numpy())

    def energy(self) -> np.ndarray:
        """(rod,) kinetic plus potential energy, without that of contacts."""
        kinetic = 0.5 * np.sum(self.mass.numpy() * self.velocity.numpy() ** 2, axis=1)
        return kinetic + self.batch.evaluate(order=1).energy.numpy()

    @arguments.checked(
        RodError,
        until=arguments.array((), (None,)),
        step=arguments.number(),
        smallest_step=arguments.optional(arguments.number(above=0.0)),
        frames=arguments.optional(arguments.like("a Warp array", "ptr", "device", "shape")),
        frame_interval=arguments.number(above=0.0),
        progress=arguments.optional(arguments.callback),
    )
    def advance(
        self,
        until: np.ndarray | float,
        step: float,
        *,
        smallest_step: float | None = None,
        frames: wp.array | None = None,
        frame_interval: float = 1.0,
        progress: Callable[[np.ndarray], object] | None = None,
    ) -> Progress:
        """Let every rod that has not diverged move on to its time `until`.

        Args:
            until: (rod,) time to reach.
            step: largest time step; a rod whose step fails takes half of it, and recovers.
            smallest_step: a rod that wants less is cut out; default: step / 4096.
            frames: (rod, frame, dof) array that receives the configurations at the multiples of
                `frame_interval`.
            progress: called now and then with the (rod,) times.

        Raises:
            RodError: the step is not positive.
        """
        if not (np.isfinite(step) and step > 0):
            raise RodError(f"time step is {step!r}; give a positive finite number")
        batch = self.batch
        smallest = step * _SMALLEST_STEP if smallest_step is None else smallest_step
        self.until.assign(
            arguments.spread(until, (batch.rod_count,), "Dynamics.advance: until", RodError)
        )
        self._begin_advance(step)

        def take_round() -> None:
            self._take_round(step, smallest, frames, frame_interval)
            self._ask(_ROUNDS)

        array = None if frames is None else frames.ptr
        key = (step, smallest, self.tolerance, array, frame_interval)
        graph = self._recorded(key)
        taken = 0
        if graph is None:
            self._ask(_ROUNDS)
        going = graph is not None or self._going.numpy()[1] != 0
        while going:
            # Launches are replayed faster than they can be made, but recording costs as much as
            # taking them; the first round has compiled the kernels.
            if graph is None and taken > 0 and (self.keeps_recording or not self._on_cpu):
                graph = self._record(take_round)
                self._recording = (key, graph) if self.keeps_recording else None
            self._rounds.zero_()
            if graph is None:
                take_round()
            else:
                wp.capture_launch(graph)
            taken += 1
            going = self._going.numpy()[1] != 0
            if progress is not None and (graph is not None or taken % _ROUNDS == 0):
                progress(self.time.numpy().copy())
        if self.rod_contact is not None:
            self.rod_contact.check_capacity()
        return Progress(
            self.time.numpy().copy(),
            self.diverged.numpy() != 0,
            self.step_count.numpy().copy(),
            self.iteration_count.numpy().copy(),
        )

    def advance_by(self, duration: float, step: float) -> None:
        """Let every rod that has not diverged move on by a duration, as `advance` does, but tell
        nothing: from the second call on nothing is allocated, and nothing comes back to the host.
        May be captured into a graph of the caller's, after a first call.

        Args:
            duration: time to go on by.
            step: largest time step.

        Raises:
            RodError: it is captured on a device that cannot decide by itself how often to iterate
                (CUDA before 12.4).
        """
        smallest = step * _SMALLEST_STEP
        self._per_rod(kernels.set_until, [wp.float64(duration), self.time], [self.until])
        self._begin_advance(step)

        def take_rounds() -> None:
            def take_round() -> None:
                self._take_round(step, smallest, None, 1.0)
                self._ask(_ENDLESS)

            self._rounds.zero_()
            self._ask(_ENDLESS)
            wp.capture_while(self._goes_on, take_round)

        device = wp.get_device(self.batch.device)
        decides = device.is_cpu or wp.is_conditional_graph_supported()
        if device.is_capturing and not decides:
            raise RodError("a step in a CUDA graph needs CUDA 12.4 or newer; step without a graph")
        key = (duration, step, smallest, self.tolerance)
        graph = self._recorded(key)
        if graph is not None and not device.is_capturing:
            wp.capture_launch(graph)
            return
        take_rounds()
        if self.keeps_recording and decides and not device.is_capturing:
            with wp.ScopedCapture(device) as capture:
                take_rounds()
            self._recording = (key, capture.graph)

    def _begin_advance(self, step: float) -> None:
        self._per_rod(
            kernels.begin_advance,
            [wp.float64(step), self.until, self.time, self.diverged],
            [self.wanted_step, self.running, self.starting],
        )

    def _recorded(self, key: tuple) -> wp.Graph | None:
        """What was recorded for the same numbers."""
        if self._recording is not None and self._recording[0] == key:
            return self._recording[1]
        return None

    @property
    def is_recorded(self) -> bool:
        """Whether launches of a round are recorded and kept."""
        return self._recording is not None

    @property
    def _on_cpu(self) -> bool:
        return wp.get_device(self.batch.device).is_cpu

    def _take_round(self, step, smallest, frames, frame_interval) -> None:
        # A CPU's launches cost more than looking whether they have anything to do, unless they
        # are recorded.
        looks = self._on_cpu and not wp.get_device(self.batch.device).is_capturing
        if not looks or self.starting.numpy().any():
            self._begin()
        self._iterate(step, smallest)
        if not looks or self.active.numpy().any():
            self._correct()
        if not looks or self.accepted.numpy().any() or self.rejected.numpy().any():
            self._finish(frames, frame_interval)

    def _rounding(self) -> np.ndarray:
        """(rod, 2) relative residuals that rounding leaves: of stretching, and of inertia for a
        step of unit rate."""
        batch = self.batch
        edge = (batch.stretching_stiffness.numpy() / batch.rest_length.numpy()).max(axis=1)
        extent = np.abs(batch.positions()).max(axis=(1, 2)) + self.length_scale.numpy()
        unit = 4 * np.finfo(float).eps * extent / self.force_scale.numpy()
        return np.stack([unit * edge, unit * batch.node_mass.numpy().max(axis=1)], axis=1)

    def _ask(self, most: int) -> None:
        """Find out on the device whether to take another round, `most` of them at a time."""
        outputs = [self._rounds, self._going]
        self.batch.walk(kernels.ask_on, [self.running, most], outputs, rods=1)

    def _record(self, take_round: Callable[[], None]) -> wp.Graph:
        """What takes rounds until all rods are there, or for a while; asking a GPU from outside
        would make it wait."""
        device = self.batch.device
        decides = wp.get_device(device).is_cpu or wp.is_conditional_graph_supported()
        with wp.ScopedCapture(device) as capture:
            if decides:
                self._ask(_ROUNDS)
                wp.capture_while(self._goes_on, take_round)
            else:
                for _ in range(_ROUNDS_BLIND):
                    take_round()
        return capture.graph

    def _per_rod(self, kernel, inputs, outputs=()) -> None:
        batch = self.batch
        wp.launch(
            kernel,
            batch.rod_count,
            inputs=inputs,
            outputs=outputs,
            device=batch.device,
            block_dim=WARP,
        )

    def _per_dof(self, kernel, inputs, outputs=()) -> None:
        batch = self.batch
        dim = (batch.rod_count, batch.dof_count)
        wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=batch.device)

    def _begin(self) -> None:
        """Begin a step of the rods that have finished their last."""
        batch = self.batch
        self._per_rod(
            kernels.begin_step,
            [
                self._scheme,
                wp.float64(self.tolerance),
                self.rounding,
                self.viscosity.stretching_time,
                self.until,
                self.starting,
                self.time,
                self.step_before,
                self.wanted_step,
                self.leaves,
            ],
            [
                self.step,
                self.span,
                self.touching,
                self.coefficient,
                self.step_tolerance,
                self.iteration,
                self.active,
                self.converged,
                self.system.negative_pivots,
            ],
        )
        self.viscosity.begin(self.starting, self.coefficient, self.span)
        self.internal.begin(self.starting, self.span)
        if self.rod_contact is not None:
            self.rod_contact.prepare(self.starting, self.rejected, self.start.dof)
        if self.motion is not None:
            self.motion.prescribe(self.starting, self.time, self.span, self.start)
        if self.bodies is not None:
            self.bodies.begin(self.starting, self.span, self.start)
        self._per_dof(
            kernels.predict,
            [
                self.starting,
                batch.free,
                self.span,
                self.velocity,
                self.velocity_older,
                self.coefficient,
                wp.float64(self._growth),
            ],
            [batch.state.dof],
        )

    def _iterate(self, largest: float, smallest: float) -> None:
        """Residual and matrix of a Newton iteration of every rod, and the verdict on its step."""
        batch, start, out = self.batch, self.start, self.batch.derivatives
        dof = batch.state.dof
        batch.transport_frames(start, batch.state, self.active)
        batch.evaluate(order=2, active=self.active, model=self.viscosity.model)
        self._per_dof(
            kernels.add_inertia,
            [
                self.mass,
                self.air_damping,
                self.active,
                self.span,
                self.coefficient,
                dof,
                start.dof,
                self.dof_older,
                self.velocity,
                self.velocity_older,
            ],
            [out.gradient, out.hessian],
        )
        if self.drag is not None:
            wp.launch(
                kernels.add_drag,
                dim=(batch.rod_count, batch.node_count),
                inputs=[self.drag, self.active, self.span, self.coefficient, dof, start.dof]
                + [self.dof_older],
                outputs=[out.gradient, out.hessian],
                device=batch.device,
            )
        for contact in self.contacts:
            contact.add(self.active, dof, start.dof)
        batch.walk(
            newton.measure_residual,
            [
                batch.free,
                self.force_scale,
                self.length_scale,
                self.step_tolerance,
                out.gradient,
                self.active,
            ],
            [self.residual, self.converged],
        )
        if self.bodies is not None:
            self.bodies.balance(self)
        for contact in self.contacts:
            contact.refuse(self.converged, self.active, dof, start.dof)
        if self._scheme and self.contacts:
            self._per_dof(
                kernels.extrapolate,
                [self.converged, self.step, self.span, dof, start.dof],
                [self._end],
            )
            for contact in self.contacts:
                contact.find_touching(self.converged, self._end, start.dof, self.touching)
        self._judge(largest, smallest)

    def _judge(self, largest: float, smallest: float) -> None:
        """What becomes of every rod's step: taken, gone on with, or cut."""
        self._per_rod(
            kernels.judge_step,
            [
                self.until,
                self.max_iterations,
                wp.float64(largest),
                wp.float64(smallest),
                wp.float64(_GROWTH),
                self.refuses_saddles,
                self._scheme,
                self.converged,
                self.system.negative_pivots,
                self.step,
                self.span,
                self.coefficient,
                self.touching,
            ],
            [
                self.leaves,
                self.iteration,
                self.active,
                self.time,
                self.step_before,
                self.wanted_step,
                self.running,
                self.step_count,
                self.iteration_count,
                self.starting,
                self.accepted,
                self.rejected,
                self.diverged,
            ],
        )

    def _correct(self) -> None:
        """The step of a Newton iteration."""
        batch, out, bodies = self.batch, self.batch.derivatives, self.bodies
        self.system.factorise(out.hessian, self.active)
        if bodies is None:
            wp.copy(self.system.x, out.gradient.reshape(self.system.x.shape))
        else:
            bodies.load(self)
        self.system.solve(self.active)
        if bodies is not None:
            bodies.solve(self)
        self.system.shorten(self.active)
        batch.walk(
            kernels.take_newton_step,
            [wp.float64(_STEP_LIMIT), self.active, self.system.x],
            [batch.state.dof, self.taken],
        )
        if bodies is not None:
            bodies.move(self)

    def _finish(self, frames: wp.array | None, frame_interval: float) -> None:
        """Carry accepted steps over to the next, and take failed ones back."""
        batch, start, dof = self.batch, self.start, self.batch.state.dof
        if self.follower is not None:
            self.follower.follow(self)
        self.viscosity.finish(self.accepted)
        for contact in self.contacts:
            contact.settle(self.accepted, dof, start.dof)
        if self.bodies is not None:
            self.bodies.finish(self)
        if SCHEMES[self._scheme] == "midpoint":
            self._complete()
        self.internal.finish(self.accepted, self.step)
        if frames is not None:
            self._per_dof(
                kernels.record_frames,
                [wp.float64(frame_interval), self.accepted, self.time, self.step, dof, start.dof],
                [frames],
            )
        self._per_dof(
            kernels.shift_history,
            [
                self.accepted,
                batch.derivatives.gradient,
                batch.free if self.bodies is None else self.bodies.carried,
                self.step,
                self.span,
                self.coefficient,
                dof,
                start.dof,
            ],
            [self.dof_older, self.velocity, self.velocity_older, self.reaction],
        )
        if self.bodies is not None and SCHEMES[self._scheme] == "midpoint":
            # Velocities are of points that went straight on; on a body they turn.
            self.bodies.put(self.accepted, start)
            batch.transport_frames(start, batch.state, self.accepted)
        self._copy(self.accepted, batch.state, start)
        self._copy(self.rejected, start, batch.state)

    def _complete(self) -> None:
        """Bring accepted steps from where their forces are to their ends."""
        batch, start, dof = self.batch, self.start, self.batch.state.dof
        inputs = [self.accepted, self.step, self.span, dof, start.dof]
        self._per_dof(kernels.extrapolate, inputs, [dof])
        if self.motion is not None:
            self.motion.prescribe(self.accepted, self.time, self._no_step, start)
        batch.transport_frames(start, batch.state, self.accepted)

    def _copy(self, chosen: wp.array, source: RodState, target: RodState) -> None:
        batch = self.batch
        wp.launch(
            continuation.copy_configuration,
            dim=(batch.rod_count, batch.node_count),
            inputs=[chosen, source.dof, source.tangent, source.director, source.reference_twist],
            outputs=[target.dof, target.tangent, target.director, target.reference_twist],
            device=batch.device,
        )


def _masses(batch: RodBatch, radius) -> np.ndarray:
    """(rod, dof) lumped masses of the nodes, and of the edges m h^2 / 2 about their axis."""
    mass = batch.node_mass.numpy()
    # What is held, like a ghost node beyond a clamp, needs none.
    held = np.pad(batch.free.numpy(), ((0, 0), (0, 1))).reshape(*mass.shape, 4)[:, :, :3] == 0
    if not ((mass > 0) | held.any(axis=2)).all():
        raise RodError("node_mass holds a node without mass, which cannot be moved in time")
    rest = batch.rest_length.numpy()
    radius = np.asarray(radius, dtype=float)
    if radius.ndim < 2:
        radius = arguments.spread(radius, (batch.rod_count,), "Dynamics: radius", RodError)[:, None]
    radius = arguments.spread(radius, rest.shape, "Dynamics: radius", RodError)
    if not (np.isfinite(radius) & (radius > 0)).all():
        raise RodError("radius must be positive and finite")
    out = np.empty((batch.rod_count, batch.node_count, 4))
    out[:, :, :3] = mass[:, :, None]
    out[:, :-1, 3] = 0.5 * radius**2 * _line_density(batch, mass, rest) * rest
    return np.ascontiguousarray(out.reshape(batch.rod_count, -1)[:, :-1])


def _line_density(batch: RodBatch, mass: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(rod, edge) mean mass per length of the rods of each row; none of what goes on in a clamp."""
    out = np.zeros_like(rest)
    ends = [*batch.cut_edges, batch.node_count - 1]
    first = 0
    for last in ends:
        nodes = mass[:, first : last + 1]
        real = (nodes[:, 1:] > 0) & (nodes[:, :-1] > 0)
        length = np.where(real, rest[:, first:last], 0.0).sum(axis=1)
        density = (nodes.sum(axis=1) / length)[:, None]
        out[:, first:last] = np.where(real, density, 0.0)
        # A cut has an angle, which must have some inertia.
        out[:, last : last + 1] = density
        first = last + 1
    return out


def _force_scale(batch: RodBatch) -> np.ndarray:
    length = batch.rest_length.numpy().sum(axis=1)
    bend = batch.bending_stiffness.numpy()[:, 1:-1].max(axis=(1, 2)) / length**2
    gravity = np.linalg.norm(batch.gravity.numpy(), axis=1)
    return np.maximum(bend, batch.node_mass.numpy().sum(axis=1) * gravity)
