"""Rigid bodies that hold rods and move with them, in one implicit step."""

import numpy as np
import warp as wp

from wrod.kernels.stepping import bodies as kernels
from wrod.kernels.stepping import body_exchange, body_shapes, body_system
from wrod.rods.arrays import filled
from wrod.rods.batch import RodBatch
from wrod.rods.state import RodState
from wrod.solvers.banded import multiply_banded
from wrod.solvers.steps import Steps


def motion_of(place: wp.array, turn: wp.array, *moves: wp.array) -> kernels.BodyMotion:
    """Bodies at one time: (row, slot) arrays in the order of `BodyMotion`."""
    arrays = zip(kernels.BodyMotion.vars, (place, turn, *moves), strict=True)
    return filled(kernels.BodyMotion(), dict(arrays))


class Bodies:
    """Free rigid bodies of every row of a batch, and what they hold of its rods.

    Rods are eliminated from the Newton step of rods and bodies together: see
    `wrod.kernels.stepping.body_system`. A step of `Dynamics` with them conserves momentum to
    rounding, whatever the ratio of masses.

    Args:
        batch: the rods; what is held is not free in it.
        body: (row, slot) records of `wrod.kernels.stepping.bodies.Body`.
        hold: (row, hold) records of `wrod.kernels.stepping.bodies.Hold`; those whose `slot` is
            negative are left to others.

    Attributes:
        place, turn: (row, slot) centres of mass [length] and rotations.
        now, before, older: bodies as Newton's method has them, at the start of the step, and a step
            earlier.
        velocity, momentum: (row, slot) velocity of the centre of mass, angular momentum about it.
        force, torque: (row, slot) forces on the bodies from elsewhere, constant in a step.
        carried: (row, dof) whether a degree of freedom moves: it is free, or held by a body.
        push, press: (row, slot, 7) and (row, motion, motion) what contact adds to the residual of
            each body, with how hard it is pressed, and its derivative by the motions of all.
        touch: (row, motion, dof) derivative of the rods' residual by the motions of bodies whose
            shapes they touch, or None where they touch none (`meet_rods`).
    """

    def __init__(self, batch: RodBatch, body: np.ndarray, hold: np.ndarray):
        self.batch, device = batch, batch.device
        self.body = batch.array(body, dtype=kernels.Body)
        self.hold = batch.array(hold, dtype=kernels.Hold)
        shape = self.body.shape
        motions, dofs = 6 * shape[1], batch.dof_count
        self.columns = motions

        def vectors():
            return batch.zeros(shape[1], dtype=wp.vec3d)

        def motion():
            turn = wp.full(shape, wp.quatd(0.0, 0.0, 0.0, 1.0), dtype=wp.quatd, device=device)
            return motion_of(vectors(), turn, vectors(), vectors())

        floats = batch.zeros
        self.now, self.before, self.older = motion(), motion(), motion()
        self.place, self.turn = self.now.place, self.now.turn
        self.velocity, self.momentum = self.before.velocity, self.before.momentum
        self.force, self.torque = vectors(), vectors()
        self._motion, self._column = floats(motions, dofs), floats(motions, dofs)
        self._residual, self._matrix = floats(shape[1], 6), floats(shape[1], 36)
        self.push, self.press = floats(shape[1], 7), floats(motions, motions)
        self.touch: wp.array | None = None
        # Time to where forces are, and of the whole step: what takes the steps says it.
        self.spans: tuple[wp.array | None, wp.array | None] = (None, None)
        self._small, self._step = floats(motions, motions + 1), floats(motions)
        self._fraction = wp.ones(shape[0], dtype=wp.float64, device=device)
        self.carried = batch.array(self._carried(hold), dtype=wp.int32)
        self._written_q = batch.zeros(shape[1], dtype=wp.transform)
        self._written_qd = batch.zeros(shape[1], dtype=wp.spatial_vector)

    def _carried(self, hold: np.ndarray) -> np.ndarray:
        out = self.batch.free.numpy().copy()
        for row, holds in enumerate(hold):
            for h in holds:
                if h["kind"] > 0 and h["slot"] >= 0:
                    nodes = [h["node"], h["other"]][: h["kind"]]
                    for i in nodes:
                        out[row, 4 * i : 4 * i + 3] = 1
                    if h["kind"] == 2:
                        out[row, 4 * h["edge"] + 3] = 1
        return out

    def _each_body(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        self.batch.launch(kernel, self.body.shape, inputs, outputs)

    def _each_hold(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        self.batch.launch(kernel, self.hold.shape, inputs, outputs)

    def meet_rods(self) -> None:
        """Make room for rods that touch shapes of these bodies."""
        self.touch = wp.zeros_like(self._column)

    def clear_contact(self) -> None:
        """Nothing touches: before contacts add what they do."""
        for array in (self.push, self.press, self.touch):
            if array is not None:
                array.zero_()

    def begin(self, steps: Steps) -> None:
        """Predict where bodies are at the end of a step, and put there what they hold."""
        self.spans = steps.span, steps.step
        self._each_body(kernels.predict_bodies, [self.body, steps.pace, self.before], [self.now])
        self.put(steps.starting, steps.start)

    def put(self, chosen: wp.array, start: RodState) -> None:
        """Put what the bodies of the chosen rows hold to where they are."""
        self._each_hold(
            kernels.place_held,
            [self.body, self.hold, chosen, self.now, start.tangent, start.director],
            [self.batch.state.dof],
        )

    def balance(self, steps: Steps) -> None:
        """Residuals of the bodies, which take back the convergence of rows they are large in."""
        self._each_body(
            kernels.body_balance,
            [self.body, self.hold, self.batch.gravity, self.force, self.torque, steps.pace]
            + [self.batch.state.dof, self.batch.derivatives.gradient]
            + [self.before, self.older, self.push],
            [self.now, self._residual, self._matrix],
        )
        self.batch.launch(
            kernels.refuse_unbalanced,
            self.batch.rod_count,
            [self.body, self.batch.gravity, steps.force_scale, steps.length_scale]
            + [self._residual, self.push],
            [steps.pace],
        )

    def load(self, steps: Steps) -> None:
        """Right-hand sides of the rods' system: the residual, and one for each motion."""
        out, active, x = self.batch.derivatives, steps.active, steps.system.x
        self._each_hold(
            body_system.spread_motion,
            [self.hold, active, self.now, self.batch.state.dof],
            [self._motion],
        )
        multiply_banded(self.batch, active, out.hessian, self._motion, self._column)
        if steps.rod_contact is not None:
            steps.system.multiply_pairs(active, self._motion, self._column)
        if self.touch is not None:
            inputs = [active, self.touch]
            self.batch.launch(body_shapes.add_touch, self.touch.shape, inputs, [self._column])
        self.batch.launch(
            body_system.load_bodies, x.shape, [active, out.gradient, self._column], [x]
        )

    def solve(self, steps: Steps) -> None:
        """The bodies' part of the Newton step out of the solutions of `load`; the rods' then."""
        active, free, x = steps.active, self.batch.free, steps.system.x
        self.batch.launch(
            body_system.condense,
            self._small.shape,
            [active, free, self._motion, self._column, x, self._residual, self._matrix]
            + [self.press, self.touch],
            [self._small],
        )
        self.batch.launch(
            body_system.solve_bodies,
            self.batch.rod_count,
            [self.body, active],
            [self._small, self._step, self._fraction],
        )
        self.batch.launch_dofs(
            body_system.combine, [active, free, self._motion, self._step, self._fraction], [x]
        )

    def move(self, steps: Steps) -> None:
        """Take the step that the rods have taken."""
        self._each_body(
            body_system.move_bodies,
            [self.body, steps.active, self._step, self._fraction]
            + [steps.system.shortened, steps.taken],
            [self.now],
        )
        self.put(steps.active, steps.start)

    def finish(self, steps: Steps) -> None:
        """Carry accepted steps over to the next, and take rejected ones back."""
        self._each_body(
            kernels.finish_bodies,
            [steps.pace],
            [self.now, self.before, self.older],
        )

    def find_changes(self, body_q: wp.array, body_qd: wp.array, changed: wp.array) -> None:
        """Raise `changed` (row,) where a simulator's bodies are not as `write` left them."""
        self._each_body(
            body_exchange.find_moved_bodies,
            [self.body, body_q, body_qd, self._written_q, self._written_qd],
            [changed],
        )

    def read(self, chosen: wp.array, body_q, body_qd, body_f, start: RodState, velocity) -> None:
        """Take a simulator's bodies up in the chosen rows, what they hold with them, and the
        forces on all."""
        self._each_body(
            body_exchange.read_bodies,
            [self.body, chosen, body_q, body_qd, body_f],
            [self.now, self.before, self.force, self.torque],
        )
        self.put(chosen, start)
        self._each_hold(
            body_exchange.carry_velocity,
            [self.body, self.hold, chosen, self.before, self.batch.state.dof],
            [velocity],
        )

    def write(self, body_q: wp.array, body_qd: wp.array) -> None:
        """Give a simulator its bodies back, in its precision."""
        self._each_body(
            body_exchange.write_bodies,
            [self.body, self.now, self.before],
            [body_q, body_qd, self._written_q, self._written_qd],
        )
