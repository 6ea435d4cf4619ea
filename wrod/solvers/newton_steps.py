"""Implicit time steps by Newton's method: how each begins, iterates, is judged and ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.stepping import dynamics as kernels
from wrod.kernels.stepping import newton_iteration as newton
from wrod.kernels.stepping import pace
from wrod.solvers.bodies import Bodies
from wrod.solvers.inelastic import InternalVariables
from wrod.solvers.inertia import add_inertia
from wrod.solvers.steps import SCHEMES, Motion, Steps
from wrod.solvers.viscosity import Viscosity

# Largest change of an edge in one Newton iteration, as a fraction of its length.
_STEP_LIMIT = 0.3
_GROWTH = 1.3


class Follower(Protocol):
    """What is carried along with the steps: called whenever steps of some rods were accepted, while
    `batch` still holds residual, matrix and configuration of their ends, and `start` their starts.

    It does its work by kernels alone, for the rods that are not 0 in `accepted`."""

    def follow(self, dynamics: NewtonSteps) -> None: ...


class Touching(Protocol):
    """What rods, or bodies that hold them, touch; all of it by kernels alone.

    Attributes:
        time_step, iteration: (rod,) time from the start of the step to where its forces are, and
            number of the Newton iteration; `Dynamics` says them.
    """

    time_step: wp.array
    iteration: wp.array

    def add(self, active: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Add forces and stiffness at `dof` to the gradient and Hessian of active rods, or bodies.
        `dof_before` (rod, dof) is the start of the step here and below."""

    def refuse(self, converged: wp.array, active: wp.array, dof, dof_before) -> None:
        """Take the convergence of steps back that cannot stand."""

    def find_touching(self, chosen: wp.array, dof, dof_before, touching: wp.array) -> None:
        """Raise `touching` (rod,) of the chosen rods to 1 where they touch, to 2 in an impact."""

    def settle(self, accepted: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Carry the memory of accepted steps over to the next."""

    def restart(self, chosen: wp.array) -> None:
        """Forget what the chosen rods touched."""


class NewtonSteps(Steps):
    """The parts of a round: a Newton iteration of every rod, and what becomes of its step.

    What they work with are arguments of `wrod.solvers.dynamics.Dynamics`, which sets it.
    """

    contacts: tuple[Touching, ...]
    motion: Motion | None
    follower: Follower | None
    bodies: Bodies | None
    viscosity: Viscosity
    internal: InternalVariables
    mass: wp.array
    edge_mass: wp.array | None
    air_damping: wp.array
    drag: wp.array | None
    rounding: wp.array
    tolerance: float
    max_iterations: int
    shrinks: float
    refuses_saddles: bool
    _scheme: int
    growth: float
    _going: wp.array

    @arguments.checked(RodError, time=arguments.array((), (None,)))
    def relax(self, time: np.ndarray | float) -> None:
        """Let the moments of internal damping, of bending and twisting, relax in this time, (rod,)
        [time], from none where the rods are now. Before the first step.

        Raises:
            RodError: a time is negative or not finite.
        """
        self.viscosity.relax(time)

    @arguments.checked(RodError, drag=arguments.numbers_of_any_shape)
    def set_drag(self, drag: np.ndarray) -> None:
        """Drag of each node per velocity, and per velocity squared, on top of `air_damping`:
        (rod, node, 2), broadcast. The first time before the first step."""
        shape = (self.batch.rod_count, self.batch.node_count, 2)
        drag = np.ascontiguousarray(arguments.spread(drag, shape, "Dynamics: drag", RodError))
        if self.drag is None:
            self.drag = wp.zeros(shape[:2], dtype=wp.vec2d, device=self.batch.device)
        self.drag.assign(drag)

    def energy(self) -> np.ndarray:
        """(rod,) kinetic plus potential energy, without that of contacts."""
        kinetic = 0.5 * np.sum(self.mass.numpy() * self.velocity.numpy() ** 2, axis=1)
        if self.edge_mass is not None:
            stretching = np.diff(self.velocities(), axis=1) ** 2
            kinetic -= np.einsum("re,rek->r", self.edge_mass.numpy() / 12.0, stretching)
        return kinetic + self.batch.evaluate(order=1).energy.numpy()

    def contact_energy(self) -> np.ndarray:
        """(rod,) elastic energy of what touches, shapes and rods, with that of its friction."""
        stored = [contact.energy() for contact in self.contacts if hasattr(contact, "energy")]
        return sum(stored, np.zeros(self.batch.rod_count))

    def restart(self, chosen: wp.array) -> None:
        """Let the rods that are not 0 in `chosen` (rod,) start anew from the batch's state, which
        must have its frames, and from `velocity`; one that was cut out takes part again."""
        self._per_rod(pace.forget_history, [chosen], [self.pace])
        self.batch.copy_states(chosen, self.batch.state, self.start)
        self.viscosity.restart(chosen)
        self.internal.restart(chosen)
        for contact in self.contacts:
            contact.restart(chosen)

    def _take_round(self, step, smallest, frames, frame_interval) -> None:
        self._where_any((self.starting,), 2, self._begin)
        self._iterate(step, smallest)
        if self._decides:
            self.batch.launch_lanes(pace.ask_what, [self.pace], [self._going], rods=1)
        self._where_any((self.active,), 3, self._correct)
        ended = (self.accepted, self.rejected)
        self._where_any(ended, 4, lambda: self._finish(frames, frame_interval))

    def _where_any(self, chosen: tuple, place: int, launch: Callable[[], None]) -> None:
        """Launch what has something to do for chosen rods: in a recording for a CPU if `_going`
        says so at a place of it. A GPU's launches cost less than asking it: rounds of
        deployments would take it 6 to 10 % longer."""
        if self._decides:
            wp.capture_if(self._going[place : place + 1], launch)
        elif not wp.get_device(self.batch.device).is_cpu or any(c.numpy().any() for c in chosen):
            launch()

    @property
    def _decides(self) -> bool:
        """Whether launches are being recorded for a CPU, which looks by itself then."""
        device = wp.get_device(self.batch.device)
        return device.is_capturing and device.is_cpu

    def _begin(self) -> None:
        """Begin a step of the rods that have finished their last."""
        batch = self.batch
        if self.rod_contact is not None:
            self.rod_contact.bound_steps(self.starting, self.wanted_step)
        self._per_rod(
            pace.begin_step,
            [self._scheme, wp.float64(self.tolerance), self.rounding]
            + [self.viscosity.stretching_time],
            [self.pace, self.system.negative_pivots],
        )
        self.viscosity.begin(self.pace)
        self.internal.begin(self.starting, self.span)
        if self.rod_contact is not None:
            self.rod_contact.prepare(self.starting, self.start.dof)
        if self.motion is not None:
            self.motion.prescribe(self.starting, self.time, self.span, self.start)
        if self.bodies is not None:
            self.bodies.begin(self)
        batch.launch_dofs(
            kernels.predict,
            [self.pace, batch.free, wp.float64(self.growth)],
            [self.present],
        )

    def _iterate(self, largest: float, smallest: float) -> None:
        """Residual and matrix of a Newton iteration of every rod, and the verdict on its step."""
        batch, start, out = self.batch, self.start, self.batch.derivatives
        dof = batch.state.dof
        batch.transport_frames(start, batch.state, self.active)
        batch.evaluate(order=2, active=self.active, model=self.viscosity.model, energy=False)
        add_inertia(self, self.present, out)
        if self.bodies is not None:
            self.bodies.clear_contact()
        for contact in self.contacts:
            contact.add(self.active, dof, start.dof)
        batch.launch_lanes(
            newton.measure_residual,
            [batch.free, self.force_scale, self.length_scale, self.step_tolerance]
            + [out.gradient, self.active],
            [self.residual, self.converged],
        )
        if self.bodies is not None:
            self.bodies.balance(self)
        for contact in self.contacts:
            contact.refuse(self.converged, self.active, dof, start.dof)
        if self._scheme and self.contacts:
            end = dof
            if SCHEMES[self._scheme] == "midpoint":
                end = self._end
                batch.launch_dofs(kernels.extrapolate, [self.converged, self.present], [end])
            for contact in self.contacts:
                contact.find_touching(self.converged, end, start.dof, self.touching)
        self._judge(largest, smallest)

    def _judge(self, largest: float, smallest: float) -> None:
        """What becomes of every rod's step: taken, gone on with, or cut."""
        self._per_rod(
            pace.judge_step,
            [self.max_iterations, wp.float64(self.shrinks), wp.float64(largest)]
            + [wp.float64(smallest), wp.float64(_GROWTH), int(self.refuses_saddles), self._scheme]
            + [self.system.negative_pivots, self.residual],
            [self.pace],
        )

    def _correct(self) -> None:
        """The step of a Newton iteration."""
        batch, out, bodies = self.batch, self.batch.derivatives, self.bodies
        if bodies is None:
            self.system.eliminate(out.gradient, out.hessian, self.active)
        else:
            self.system.factorise(out.hessian, self.active)
            bodies.load(self)
            self.system.solve(self.active)
            bodies.solve(self)
        self.system.shorten(self.active)
        batch.launch_lanes(
            newton.take_newton_step,
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
        self.viscosity.finish(self.pace)
        for contact in self.contacts:
            contact.settle(self.accepted, dof, start.dof)
        if self.bodies is not None:
            self.bodies.finish(self)
        if SCHEMES[self._scheme] == "midpoint":
            self._complete()
        self.internal.finish(self.accepted, self.step)
        if frames is not None:
            batch.launch_dofs(
                pace.record_frames,
                [wp.float64(frame_interval), self.pace, dof, start.dof],
                [frames],
            )
        batch.launch_dofs(
            kernels.shift_history,
            [self.accepted, batch.derivatives.gradient]
            + [batch.free if self.bodies is None else self.bodies.carried],
            [self.present, self.reaction],
        )
        if self.bodies is not None and SCHEMES[self._scheme] == "midpoint":
            # Velocities are of points that went straight on; on a body they turn.
            self.bodies.put(self.accepted, start)
            batch.transport_frames(start, batch.state, self.accepted)
        batch.copy_states(self.accepted, batch.state, start)
        batch.copy_states(self.rejected, start, batch.state)

    def _complete(self) -> None:
        """Bring accepted steps from where their forces are to their ends."""
        batch, start = self.batch, self.start
        inputs = [self.accepted, self.present]
        batch.launch_dofs(kernels.extrapolate, inputs, [batch.state.dof])
        if self.motion is not None:
            self.motion.prescribe(self.accepted, self.time, self._no_step, start)
        batch.transport_frames(start, batch.state, self.accepted)
