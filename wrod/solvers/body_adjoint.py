"""The adjoint of bodies that hold rods and move with them, beside that of the rods' steps."""

from __future__ import annotations

from typing import Any, Protocol

import warp as wp

from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping import body_adjoint as kernels
from wrod.kernels.stepping import body_system
from wrod.rods.arrays import filled
from wrod.solvers.bodies import Bodies, motion_of
from wrod.solvers.carried_adjoint import CarriedAdjoint
from wrod.solvers.pair_adjoint import PairAdjoint


def body_steps(bodies: Bodies) -> list[wp.array]:
    """What the bodies' part of the step is made of that is taken now, in the order of
    `wrod.kernels.stepping.body_adjoint.BodySteps`."""
    now, before = ([m.place, m.turn, m.momentum] for m in (bodies.now, bodies.before))
    return [*now, *before, bodies.older.turn]


class Meetings(Protocol):
    """Contact of bodies with each other and with what stands still, in the step gone through."""

    def weigh(self, at: Any, load: wp.array, press: wp.array) -> None:
        """Add to right-hand side and matrix of the bodies' system, `at` being the rods' step."""

    def want_before(self, at: Any, multiplier: wp.array, before: Any) -> None:
        """From the solution to where the bodies were before (`WantedBodies`)."""


class BodyAdjoint:
    """Goes through steps of bodies backwards, with those of `wrod.solvers.adjoint.StepAdjoint`.

    Attributes:
        now, before, older: `wrod.kernels.stepping.body_adjoint.WantedBodies` at the end of a step,
            at its start, and a step earlier.
        step, end: the step gone through last, where its forces are and where it ended,
            `wrod.kernels.stepping.body_adjoint.BodySteps`.
        pose: the one of the two of which `held` of the rods' adjoint is.
        multiplier: (row, motion) of its balance of bodies.
        force, torque: (row, slot) what is wanted of them, summed up until `clear`.
        x: (row, 1 + motion, dof) right-hand sides of the rods' system.
        pairs: of rods that touch each other, or None.
    """

    def __init__(self, bodies: Bodies):
        self.bodies, batch = bodies, bodies.batch
        self._batch = batch
        slots, motions, dofs = bodies.body.shape[1], bodies.columns, batch.dof_count

        def vectors():
            return batch.zeros(slots, dtype=wp.vec3d)

        self.now, self.before, self.older = (kernels.WantedBodies() for _ in range(3))
        for level in (self.now, self.before, self.older):
            filled(level, {name: vectors() for name in kernels.WantedBodies.vars})
        self.step, self.end = kernels.BodySteps(), kernels.BodySteps()
        for steps in (self.step, self.end):
            arrays = map(wp.zeros_like, body_steps(bodies))
            filled(steps, dict(zip(kernels.BodySteps.vars, arrays, strict=True)))
        self.pose, self.force, self.torque = self.step, vectors(), vectors()
        self._motion_at = motion_of(self.step.place, self.step.turn, *[vectors()] * 2)
        self._motion, self._column, self._line = (batch.zeros(motions, dofs) for _ in range(3))
        self._load, self._matrix = batch.zeros(slots, 6), batch.zeros(slots, 36)
        self._small, self.multiplier = batch.zeros(motions, motions + 1), batch.zeros(motions)
        self.meetings: Meetings | None = None
        self.touches: CarriedAdjoint | None = None
        self.pairs: PairAdjoint | None = None
        self._press, self._on_bodies, self._by_bodies = (batch.zeros(0, 0) for _ in range(3))
        self._whole = wp.ones(batch.rod_count, dtype=wp.float64, device=batch.device)
        self._fraction = wp.ones_like(self._whole)
        self.x = batch.zeros(1 + motions, dofs, dtype=ALONE)
        self._numbers = wp.array(
            ptr=self.x.ptr, dtype=wp.float64, shape=self.x.shape, device=batch.device
        )

    def meet(self, meetings: Meetings) -> None:
        """Go back through what these say that bodies touch, too."""
        self.meetings = meetings
        self._press = self._of_motions(self.bodies.columns)

    def touch(self, touches: CarriedAdjoint) -> None:
        """Go back through what edges of rods and these do to each other, too."""
        self.touches = touches
        self._press = self._of_motions(self.bodies.columns)
        self._on_bodies, self._by_bodies = (
            self._of_motions(self._batch.dof_count) for _ in range(2)
        )

    def _of_motions(self, size: int) -> wp.array:
        return self._batch.zeros(self.bodies.columns, size)

    def clear(self) -> None:
        """Want nothing of forces any more."""
        self.force.zero_()
        self.torque.zero_()

    def find_ends(self, at: Any) -> None:
        """Of the step that was taken up, `at` being the rods'."""
        shape = self.bodies.body.shape
        self._batch.launch(kernels.find_ends, shape, [at, self.step], [self.end])
        if self.touches is not None:
            self.touches.place(at)

    def go_to_middle(self, at: Any, held: wp.array) -> None:
        """From the ends of the steps of the midpoint rule (`at`): what is wanted of what bodies
        hold there is in `held` (row, dof)."""
        bodies, self.pose = self.bodies, self.end
        self.multiplier.zero_()
        self._batch.launch(
            kernels.want_middle,
            bodies.body.shape,
            [bodies.body, bodies.hold, at, self.step, self.end, held],
            [self.now, self.before],
        )

    def load(self, at: Any, matrix: Any, gradient: wp.array, wanted: Any) -> None:
        """Right-hand sides of the rods' system of a step: one for each motion of the bodies.

        Args:
            at: the rods' step.
            matrix: `wrod.kernels.stepping.adjoint.StepMatrix`.
            gradient: (row, dof) the rods' residual.
            wanted: `wrod.kernels.stepping.trace.Wanted` of the rods at the end of the step.
        """
        batch, hold, active = self._batch, self.bodies.hold, at.active
        batch.launch(
            body_system.spread_motion, hold.shape, [hold, active, self._motion_at, at.dof],
            [self._motion],
        )  # fmt: skip
        batch.launch(
            kernels.multiply_motions,
            self._motion.shape,
            [batch.free, active, matrix, self._motion],
            [self._column, self._line, self.x],
        )
        if self.pairs is not None:
            outputs = [self._column, self._line, self._numbers]
            self.pairs.multiply_motions(self._motion, outputs)
        batch.launch(
            kernels.balance_wanted,
            self.bodies.body.shape,
            [self.bodies.body, hold, at, gradient, self.step, self.now],
            [self._load, self._matrix],
        )
        self._press.zero_()
        if self.meetings is not None:
            self.meetings.weigh(at, self._load, self._press)
        if self.touches is not None:
            for array in (self._on_bodies, self._by_bodies):
                array.zero_()
            outputs = [self._load, self._press, self._on_bodies, self._by_bodies]
            self.touches.weigh(at, wanted, outputs, [self._column, self.x])

    def solve(self, at: Any, wanted: wp.array) -> None:
        """Multipliers of the bodies, and of all the rods' degrees of freedom, from the solutions.

        Args:
            at: the rods' step.
            wanted: (row, dof) what a loss wants of the rods.
        """
        batch, bodies, active, free = self._batch, self.bodies, at.active, self._batch.free
        self.pose = self.step
        batch.launch(
            kernels.condense_wanted,
            self._small.shape,
            [active, free, self._motion, self._column, self._line, self.x, wanted]
            + [self._load, self._matrix, self._press, self._by_bodies],
            [self._small],
        )
        batch.launch(
            body_system.solve_bodies,
            batch.rod_count,
            [bodies.body, active],
            [self._small, self.multiplier, self._fraction],
        )
        batch.launch_dofs(
            body_system.combine,
            [active, free, self._motion, self.multiplier, self._whole],
            [self._numbers],
        )
        if self.touches is not None:
            self.touches.bear(at, self._on_bodies, self.multiplier, wanted)

    def want_before(self, at: Any, by_gravity: wp.array) -> None:
        """From the end of the step to its starts, and to what acts on the bodies."""
        body = self.bodies.body
        self._batch.launch(
            kernels.want_bodies_before,
            body.shape,
            [body, at, self.step, self.multiplier, self.now],
            [self.before, self.older, by_gravity, self.force, self.torque],
        )
        if self.meetings is not None:
            self.meetings.want_before(at, self.multiplier, self.before)
        if self.touches is not None:
            self.touches.want_before(at, self.before)
