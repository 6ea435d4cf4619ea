"""Gradients of a simulator's steps on a `wp.Tape`."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import newton
import numpy as np
import warp as wp

from wrod.errors import RodError
from wrod.kernels.stepping import body_exchange_adjoint as body_kernels
from wrod.kernels.stepping import carrying_adjoint as carrying_kernels
from wrod.kernels.stepping import exchange_adjoint as kernels
from wrod.kernels.stepping.trace import drop, spoil
from wrod.newton_solver.carried_gradients import CarriedGradients
from wrod.newton_solver.group import RodGroup
from wrod.newton_solver.meeting_gradients import MeetingGradients
from wrod.newton_solver.taken_steps import STATE, StepEnd, Taken, gradient_of, numbers_of
from wrod.newton_solver.tapes import off_tape
from wrod.rods.discretisation import of_free_part
from wrod.solvers.adjoint import StepAdjoint
from wrod.solvers.body_adjoint import BodyAdjoint
from wrod.solvers.compiling import compile_steps
from wrod.solvers.trace import Trace, require_differentiable

# Properties with a gradient: in the orders in which `want_properties` and `want_of_rods` take them.
_OF_NODES = (
    "edge_stretching_stiffness", "node_bending_stiffness", "node_twisting_stiffness",
    "node_natural_curvature", "node_natural_twist", "node_mass",
)  # fmt: skip
_OF_RODS = ("rod_internal_damping", "rod_air_damping", "rod_radius", "edge_rest_length")
PROPERTIES = (*_OF_NODES, *_OF_RODS)
# Mass that is spread along edges goes with the masses of nodes and the lengths of edges at once.
_OF_LUMPS = {"node_mass", "edge_rest_length"}
# Steps of a rod that are kept beside those that it should take: where some have to be cut.
_SPARE = 6


def leave_gradients(model: newton.Model, consistent: bool) -> None:
    """Take the gradients of properties away that a tape gives none for."""
    der = model.der
    kept = {*PROPERTIES, *STATE} - (_OF_LUMPS if consistent else set())
    for name, value in vars(der).items():
        if isinstance(value, wp.array) and name not in kept:
            value.requires_grad = False


class GroupGradients:
    """Keeps the steps of a group, and goes back through them."""

    def __init__(self, group: RodGroup):
        self.group = group
        self._trace: Trace | None = None
        self._adjoint: StepAdjoint | None = None
        self._last: weakref.ref | None = None

    def listen(self, parts: int) -> None:
        """Keep the steps from now on, `parts` of each rod.

        Raises:
            RodError: they have no adjoint.
        """
        dynamics, device = self.group.dynamics, wp.get_device(self.group.device)
        require_differentiable(dynamics)
        if device.is_capturing and (device.is_cpu or self._adjoint is None):
            raise RodError(
                "a step in a graph has gradients on a GPU, once a step outside has been taken on a "
                "tape and gone back through"
            )
        if self._trace is None or self._trace.room < parts + _SPARE:
            self._trace = Trace(dynamics, 2 * parts + _SPARE)
        if dynamics.follower is not self._trace:
            dynamics.follower = self._trace
            dynamics.forget_recording()

    def rest(self) -> None:
        """Keep nothing any more."""
        dynamics = self.group.dynamics
        if dynamics.follower is not None:
            dynamics.follower = None
            dynamics.forget_recording()
        self._last = None

    def take(self, tape: wp.Tape, director: wp.array, poses: tuple[wp.array, wp.array]) -> Taken:
        """The step that was just taken, between these poses of the bodies."""
        group = self.group
        assert self._trace is not None
        last = self._last() if self._last is not None else None
        if last is not None and last.tape() is not tape:
            last = None
        record, touched = self._trace.take(), group.shape_contact
        taken = Taken(
            record,
            wp.clone(group.changed),
            wp.clone(group.held_rotation),
            director,
            *poses,
            [] if touched is None else [wp.clone(array) for array in touched.yielding],
            group.duration,
            last,
            weakref.ref(tape),
            meetings=group.body_contact.kept(record.most) if group.body_contact else None,
        )
        self._last = weakref.ref(taken)
        return taken

    def _prepare(self) -> StepAdjoint:
        group = self.group
        if self._adjoint is None:
            layout, device = group.layout, group.device
            compile_steps(device, *(f"gradients of {name}" for name in ("steps", *group.more)))
            moved = group.batch.free.numpy() == 0
            air = layout.node_values("air_damping")
            touched = group.shape_contact
            per_mass = None if touched is None else touched.per_mass()
            law = group.pair_law
            self._adjoint = StepAdjoint(group.dynamics, moved, air, per_mass, law)
            self._anchor = wp.zeros_like(self._adjoint.held)
            one = np.ones(layout.ghost.shape)
            share = of_free_part(layout.free_share, twisting_stiffness=one, natural_twist=one)
            self._shares = [
                wp.array(share[name], dtype=wp.float64, device=device)
                for name in ("twisting_stiffness", "natural_twist")
            ]
            worlds = np.where(group.worlds < 0, len(group.model.gravity) - 1, group.worlds)
            worlds = np.minimum(worlds, len(group.model.gravity) - 1)
            self._rod = wp.array(layout.rod, dtype=wp.int32, device=device)
            self._edge = wp.array(layout.edges, dtype=wp.int32, device=device)
            self._shapes = self._carried = None
            if touched is not None:
                self._shapes = wp.array(touched.indices(), dtype=wp.int32, device=device)
                if touched.others_move:
                    self._carried = CarriedGradients(touched, self._adjoint)
            self._meetings = None
            if group.body_contact is not None:
                by_friction = group.model.shape_material_mu.grad
                self._meetings = MeetingGradients(self._adjoint, by_friction)
            self._world = wp.array(worlds, dtype=wp.int32, device=device)
            self._is_held = bool((group.hold.numpy()["body"] >= 0).any())
        return self._adjoint

    def read(self, taken: Taken, ends: StepEnd) -> None:
        """Take up what is wanted of the arrays that the step wrote."""
        group, adjoint, record = self.group, self._prepare(), taken.record
        adjoint.clear()
        self._anchor.zero_()
        if taken.wanted is not None:
            for level, wanted in zip(adjoint.levels, taken.wanted, strict=False):
                level.assign(wanted)
            taken.wanted = None
        body_q = ends.body_q
        retained = body_q is not None and body_q.retain_grad
        by_poses = None if body_q is None else body_q.grad
        by_poses = wp.clone(by_poses) if retained and by_poses is not None else by_poses
        capsules = group.capsules if by_poses is not None else wp.full_like(group.capsules, -1)
        group.batch.launch(
            kernels.want_written,
            group.place.shape,
            [group.place, capsules, record.count, *record.end, *ends.gradients()],
            [numbers_of(by_poses, 7, group.device), adjoint.now],
        )
        if record.unsound is not None:
            level = adjoint.levels[0]
            level.launch(spoil, [record.unsound[0]], [level.part])
        if adjoint.bodies is not None:
            adjoint.recall(record, 0)
            body, speeds = adjoint.bodies.bodies.body, ends.own[1]
            by_speeds = gradient_of(speeds, 6, group.device)
            if speeds is not None and speeds.retain_grad:
                by_speeds = wp.clone(by_speeds)
            group.batch.launch(
                body_kernels.want_bodies_written,
                body.shape,
                [body, record.count, adjoint.bodies.end],
                [numbers_of(by_poses, 7, group.device), by_speeds, adjoint.bodies.now],
            )

    def go_back(self, taken: Taken, ends: StepEnd) -> None:
        """Add what is wanted of the arrays that the step read."""
        group, adjoint = self.group, self._prepare()
        by_poses = gradient_of(ends.body_q, 7, group.device)
        hold, bodies, carried = group.hold, adjoint.bodies, self._carried
        parts = [part for part in (carried, self._meetings) if part is not None]
        if by_poses.shape[0] == 0 and (parts or self._is_held):
            raise RodError("the bodies of the model have no gradients: body_q requires none")
        by_before = None
        if parts:
            by_before = wp.zeros_like(by_poses)
            if taken.wanted_of_poses is not None:
                group.batch.launch(
                    carrying_kernels.add_poses, by_poses.shape, [taken.wanted_of_poses], [by_poses]
                )

        def held(step: Any) -> None:
            group.batch.launch(
                kernels.want_poses,
                hold.shape,
                [hold, group.place, wp.float64(taken.duration), step, taken.changed, taken.poses]
                + [taken.rotation, adjoint.held],
                [self._anchor, adjoint.model.rest_length, by_poses],
            )
            if bodies is not None:
                group.batch.launch(
                    body_kernels.want_reach,
                    hold.shape,
                    [hold, group.place, step, adjoint.gradient, bodies.pose, bodies.multiplier]
                    + [adjoint.held],
                    [adjoint.model.rest_length],
                )
            if carried is not None:
                carried.want(step)

        def place(step: Any) -> None:
            for part in parts:
                part.place(step)

        for part in parts:
            part.begin(taken, [by_before, by_poses])
        adjoint.go_back(taken.record, held, place)
        for part in parts:
            part.end(gradient_of(ends.own[0], 7, group.device))
        adjoint.settle(taken.changed)
        if bodies is not None:
            self._want_bodies(bodies, taken, ends)
        by_q, by_qd, by_director, by_spin = ends.gradients()
        batch, now, step = group.batch, adjoint.now, adjoint.step
        shape = group.place.shape
        batch.launch(kernels.want_anchored, self._anchor.shape, [self._anchor], [now])
        batch.launch(
            kernels.want_frames_read,
            (shape[0], shape[1] - 1),
            [group.place, taken.changed, step, taken.director],
            [now, by_director, by_spin],
        )
        batch.launch(
            kernels.want_ghosts_read,
            shape,
            [group.place, batch.rest_length, taken.changed, step],
            [now, adjoint.model.rest_length],
        )
        batch.launch(kernels.want_nodes_read, shape, [group.place], [now, by_q, by_qd])
        for level in adjoint.levels[:2]:
            level.launch(drop, [taken.changed], [level.part])
        if taken.previous is not None:
            taken.previous.wanted = [level.clone() for level in adjoint.levels[:2]]
            taken.previous.wanted_of_poses = by_before
        self._want_properties(adjoint)

    def _want_bodies(self, bodies: BodyAdjoint, taken: Taken, ends: StepEnd) -> None:
        """Of the bodies that move with the rods, to the arrays that the step read."""
        batch, adjoint, body = self.group.batch, self._prepare(), bodies.bodies.body
        batch.launch(
            body_kernels.want_held_read,
            body.shape,
            [body, self.group.hold, self.group.place, taken.changed, adjoint.step, bodies.step],
            [adjoint.now, bodies.now, adjoint.model.rest_length],
        )
        device = self.group.device
        by_q, by_qd, by_f = (
            gradient_of(a, n, device) for a, n in zip(ends.own, (7, 6, 6), strict=True)
        )
        batch.launch(
            body_kernels.want_bodies_read,
            body.shape,
            [body, taken.changed, int(taken.previous is not None), bodies.step]
            + [bodies.force, bodies.torque],
            [bodies.now, by_q, by_qd, by_f],
        )

    def _gradient(self, name: str) -> wp.array:
        """Of a property; without numbers if it has none."""
        none = wp.zeros(0, dtype=wp.float64, device=self.group.device)
        grad = getattr(self.group.model.der, name).grad
        return none if grad is None else grad

    def _want_properties(self, adjoint: StepAdjoint) -> None:
        group, model = self.group, self.group.model
        outputs, of_rods = (
            [self._gradient(name) for name in names] for names in (_OF_NODES, _OF_RODS)
        )
        group.batch.launch(
            kernels.want_properties,
            group.place.shape,
            [group.place, self._world, *self._shares, adjoint.model],
            [*outputs, numbers_of(model.gravity.grad, 3, group.device)],
        )
        group.batch.launch(
            kernels.want_of_rods,
            self._rod.shape,
            [self._rod, self._edge, model.der.rod_radius, adjoint.model],
            of_rods,
        )
        if self._shapes is not None:
            group.batch.launch(
                kernels.want_friction,
                self._shapes.shape,
                [self._shapes, adjoint.by_friction],
                [model.shape_material_mu.grad],
            )


class Gradients:
    """Puts the steps of a solver on tapes.

    Attributes:
        listened: whether any has been put on one.
    """

    def __init__(self, model: newton.Model, groups: list[RodGroup]):
        self.model, self.listened = model, False
        self._groups = [GroupGradients(group) for group in groups]

    def listen(
        self, tape: wp.Tape | None, parts: int, state_in, state_out, moved
    ) -> Callable[[wp.array, wp.array], None] | None:
        """What puts the step that comes now on the tape, if there is one, given the bodies' poses
        at its start and at its end; without one nothing is kept.

        Raises:
            RodError: the step has no adjoint, or a state no gradients. What is returned raises it,
                too, if the step has touched something.
        """
        if tape is None or not self.model.requires_grad:
            for group in self._groups:
                group.rest()
            return None
        before, after = StepEnd.of(state_in, moved), StepEnd.of(state_out)
        self.listened = True
        for group in self._groups:
            group.listen(parts)
        director = wp.clone(state_in.der.edge_director, requires_grad=False)

        def put(*poses: wp.array) -> None:
            kept = tuple(wp.clone(p) for p in poses)
            self._put(tape, before, after, [g.take(tape, director, kept) for g in self._groups])

        return put

    def _put(self, tape: wp.Tape, before: StepEnd, after: StepEnd, taken: list[Taken]) -> None:
        steps = list(zip(self._groups, taken, strict=True))

        def backward() -> None:
            with off_tape():
                for group, step in steps:
                    group.read(step, after)
                for array in after.rods:
                    if not array.retain_grad:
                        array.grad.zero_()
                for group, step in steps:
                    group.go_back(step, before)

        properties = [getattr(self.model.der, name) for name in PROPERTIES]
        arrays = [*before.arrays(), *after.arrays(), self.model.gravity]
        if self.model.shape_count:
            arrays.append(self.model.shape_material_mu)
        tape.record_func(backward, [*arrays, *(a for a in properties if a.grad is not None)])
