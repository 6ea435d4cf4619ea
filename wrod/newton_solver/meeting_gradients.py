"""Gradients through what free bodies touch: each other, what stands still, what others move."""

from typing import Any

import warp as wp

from wrod.kernels.stepping import meeting_adjoint as kernels
from wrod.kernels.stepping.body_meetings import carry_others
from wrod.kernels.stepping.carrying import Pose
from wrod.kernels.stepping.carrying_adjoint import find_begun
from wrod.newton_solver.taken_steps import Taken
from wrod.solvers.adjoint import StepAdjoint
from wrod.solvers.bodies import motion_of


class MeetingGradients:
    """Goes back through contacts of bodies (`wrod.solvers.body_adjoint.Meetings`).

    Args:
        adjoint: of the steps of the rods that move with them.
        by_friction: (shape,) derivatives by the coefficients of friction, or None.
    """

    def __init__(self, adjoint: StepAdjoint, by_friction: wp.array | None):
        assert adjoint.bodies is not None
        self._bodies, self._batch = adjoint.bodies, adjoint.batch
        self._device = adjoint.batch.device
        self._bodies.meet(self)
        step = self._bodies.step
        rest = [wp.zeros((0, 0), dtype=wp.vec3d, device=self._device)] * 2
        self._now = motion_of(step.place, step.turn, *rest)
        self._before = motion_of(step.place_before, step.turn_before, *rest)
        self._by_friction = by_friction
        if by_friction is None:
            self._by_friction = wp.zeros(0, dtype=wp.float32, device=self._device)
        self._begun = wp.zeros_like(adjoint.step.time)
        self._taken: Taken | None = None
        self._back = -1

    def begin(self, taken: Taken, by_poses: list[wp.array]) -> None:
        """Go back through the contacts of this step from now on, to `by_poses` (body, 7) at its
        start and at its end."""
        self._taken, self._back, self._by_poses = None, -1, by_poses
        if taken.meetings is None:
            return
        self._taken, count = taken, taken.meetings[0].shape[0]
        self._wanted, self._grip, self._grip_there = (
            wp.zeros(count, dtype=wp.vec3d, device=self._device) for _ in range(3)
        )
        self._there = [wp.zeros(count, dtype=Pose, device=self._device) for _ in range(2)]
        if taken.wanted_of_meetings is not None:
            self._wanted, taken.wanted_of_meetings = taken.wanted_of_meetings, None

    def place(self, step: Any) -> None:
        """Take up the step before of each row."""
        self._back += 1
        taken = self._taken
        if taken is None:
            return
        self._batch.launch(find_begun, self._batch.rod_count, [step], [self._begun])
        times = [step.active, taken.changed, step.until, self._begun, step.span]
        inputs = [wp.float64(taken.duration), taken.meetings[0], *times]
        self._launch(carry_others, [*inputs, taken.poses_before, taken.poses], self._there[::-1])

    def end(self, by_read: wp.array) -> None:
        """Let the start of the step be wanted for where friction held bodies since, of those that
        others move the poses that were read (`by_read`), and the step before for bristles."""
        taken = self._taken
        if taken is None:
            return
        bodies, (meeting, _, source, read) = self._bodies, taken.meetings
        inputs = [bodies.bodies.body, meeting, self._before, read, self._grip, self._grip_there]
        self._launch(kernels.want_grips, inputs, [bodies.now, by_read])
        earlier = taken.previous
        if earlier is None or earlier.meetings is None:
            return
        size = earlier.meetings[0].shape[0]
        earlier.wanted_of_meetings = wp.zeros(size, dtype=wp.vec3d, device=self._device)
        inputs = [meeting, source, taken.changed, self._wanted]
        self._launch(kernels.pass_bristles, inputs, [earlier.wanted_of_meetings])

    def weigh(self, at: Any, load: wp.array, press: wp.array) -> None:
        """See `wrod.solvers.body_adjoint.Meetings`."""
        if self._taken is not None:
            self._launch(kernels.weigh_meetings, [*self._step(at), self._wanted], [load, press])

    def want_before(self, at: Any, multiplier: wp.array, before: Any) -> None:
        """See `wrod.solvers.body_adjoint.Meetings`."""
        if self._taken is not None:
            held = [self._wanted, self._grip, self._grip_there]
            outputs = [*held, before, self._by_friction, *self._by_poses]
            taken = self._taken
            inputs = [*self._step(at), multiplier, wp.float64(taken.duration), taken.changed]
            inputs += [taken.poses_before, taken.poses]
            self._launch(kernels.want_meetings_before, inputs, outputs)

    def _step(self, at: Any) -> list:
        meeting, kept, *_ = self._taken.meetings
        count = self._taken.record.count
        body = self._bodies.bodies.body
        motion = [self._now, self._before, *self._there]
        return [body, meeting, at, *motion, kept, count, self._back]

    def _launch(self, kernel, inputs: list, outputs: list) -> None:
        size = self._taken.meetings[0].shape[0]
        wp.launch(kernel, size, inputs, outputs, device=self._device)
