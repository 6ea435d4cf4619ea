"""Contact of the bodies that SolverDER moves, from Newton's collision detection."""

import newton
import numpy as np
import warp as wp

from wrod.kernels.stepping import body_contact as kernels
from wrod.kernels.stepping import body_meetings as meetings
from wrod.kernels.stepping.carrying import Pose
from wrod.solvers.bodies import Bodies
from wrod.solvers.friction import contact_damping

_LARGEST_RESTITUTION = 0.99


def colliding_bodies(model: newton.Model, own: np.ndarray) -> np.ndarray:
    """(body,) which bodies that move with rods have shapes that collide with other shapes."""
    out = np.zeros_like(own)
    if model.shape_count:
        collide = model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_SHAPES) != 0
        body = model.shape_body.numpy()[collide & (model.shape_collision_group.numpy() != 0)]
        out[body[body >= 0]] = True
    return out & own


class BodyContact:
    """What the bodies of a group's rows touch, with its forces in their Newton steps (a contact of
    `Dynamics`). As many contacts as Newton's buffer holds.

    Args:
        model: the Newton model.
        bodies: those that move with rods.
    """

    time_step: wp.array
    iteration: wp.array

    def __init__(self, model: newton.Model, bodies: Bodies):
        self.model, self.bodies, self._room = model, bodies, 0
        device = model.device
        row, slot = np.full((2, model.body_count), -1, dtype=np.int32)
        for (r, s), record in np.ndenumerate(bodies.body.numpy()):
            if record["mass"] > 0:
                row[record["index"]], slot[record["index"]] = r, s
        self._owned = owned = meetings.Owned()
        owned.row, owned.slot = (wp.array(a, dtype=int, device=device) for a in (row, slot))
        owned.mass = model.body_mass
        self._detected = meetings.Detected()
        self._read = wp.zeros_like(model.body_q, requires_grad=False)
        self._allocate(0)
        self.refresh()

    def refresh(self) -> None:
        """Take the shapes' numbers up."""
        model, out = self.model, self._detected
        out.shape_body, out.size = model.shape_body, model.shape_collision_radius
        out.stiffness, out.friction = model.shape_material_ke, model.shape_material_mu
        given = model.shape_material_restitution.numpy().astype(float)
        damping = contact_damping(np.clip(given, 0.0, _LARGEST_RESTITUTION))
        out.damping = wp.array(damping, dtype=wp.float64, device=model.device)

    def read(self, contacts: newton.Contacts | None, body_q: wp.array) -> bool:
        """Take up what touches at the start of a step, or nothing; whether arrays were made."""
        capacity = 0 if contacts is None else contacts.rigid_contact_max
        grows = capacity > self._size
        if grows:
            self._allocate(capacity)
        if self._size == 0:
            return False
        if contacts is None:
            self._fill_none()
            return False
        wp.copy(self._read, body_q)
        detected = self._detected
        detected.count = contacts.rigid_contact_count
        for name in ("shape0", "shape1", "point0", "point1", "normal", "margin0", "margin1"):
            setattr(detected, name, getattr(contacts, f"rigid_contact_{name}"))
        wp.copy(self._old, self._meeting)
        wp.copy(self._old_bristle, self._bristle)
        self._launch(
            meetings.read_contacts,
            [self._owned, self.bodies.body, detected, capacity, self.bodies.now, self._read]
            + [self._old, self._old_bristle],
            [self._meeting, self._bristle, self._source],
        )
        return grows

    def _allocate(self, size: int) -> None:
        device = self.model.device

        def records(kind):
            return wp.zeros(size, dtype=kind, device=device)

        self._size = size
        self._meeting, self._old = records(meetings.Meeting), records(meetings.Meeting)
        self._source = records(wp.int32)
        self._fill_none()
        self.make_room(self._room)
        self._here, self._was = records(Pose), records(Pose)
        self._bristle, self._old_bristle, self._force, self._place = (
            records(wp.vec3d) for _ in range(4)
        )

    def make_room(self, steps: int) -> None:
        """Keep what friction held at the starts of so many steps, for their adjoint."""
        self._room = steps
        shape = (steps, self._size)
        self._kept = wp.zeros(shape, dtype=wp.vec3d, device=self.model.device)

    def keep(self, accepted: wp.array, count: wp.array) -> None:
        """Keep it for the step `count` (row,) of accepted rows."""
        from wrod.kernels.stepping.meeting_adjoint import keep_bristles

        self._launch(keep_bristles, [self._meeting, accepted, count, self._bristle], [self._kept])

    def kept(self, steps: int) -> tuple[wp.array, ...] | None:
        """(meeting,) contacts of the step that was taken last, (step, meeting) what friction held,
        (meeting,) the contacts of the step before that it went on from, and (body,) the poses that
        it was told; None without any."""
        if self._size == 0:
            return None
        arrays = self._meeting, self._kept[:steps], self._source, self._read
        return tuple(wp.clone(a) for a in arrays)

    def find_unknown(self, chosen, dof, dof_before, touching: wp.array) -> None:
        """All has an adjoint."""

    def _fill_none(self) -> None:
        self._launch(meetings.clear_contacts, [], [self._meeting])

    def _launch(self, kernel, inputs: list, outputs: list) -> None:
        if self._size:
            wp.launch(kernel, self._size, inputs, outputs, device=self.model.device)

    def _motion(self) -> list:
        return [self.bodies.now, self.bodies.before, self._here, self._was]

    def follow(self, duration: float, times: list, poses: list) -> None:
        """Put bodies that others move to where they are in a step: arguments of `carry_others`."""
        inputs = [wp.float64(duration), self._meeting, *times, *poses]
        self._launch(meetings.carry_others, inputs, [self._was, self._here])

    def add(self, active: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Add forces and stiffness to those of the bodies."""
        bodies, motion = self.bodies, self._motion()
        inputs = [bodies.body, self._meeting, active, self.time_step, *motion, self._bristle]
        self._launch(kernels.push_bodies, inputs, [bodies.push, bodies.press])

    def refuse(self, converged, active, dof, dof_before) -> None:
        """Nothing is refused."""

    def find_touching(self, chosen, dof, dof_before, touching: wp.array) -> None:
        """Raise `touching` (row,) of the chosen rows to 1 where they touch, to 2 in an impact."""
        inputs = [self.bodies.body, self._meeting, chosen, *self._motion()]
        self._launch(kernels.find_meeting, inputs, [touching])

    def settle(self, accepted: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Carry the friction of accepted steps over to the next."""
        inputs = [self.bodies.body, self._meeting, accepted, self.time_step, *self._motion()]
        outputs = [self._bristle, self._force, self._place]
        self._launch(kernels.settle_meeting, inputs, outputs)

    def restart(self, chosen: wp.array) -> None:
        """Forget the friction of the chosen rows."""
        self._launch(kernels.forget_meeting, [self._meeting, chosen], [self._bristle])

    def add_loads(
        self, body_com: wp.array, body_q: wp.array, force: wp.array, torque: wp.array
    ) -> None:
        """Add what was done at the end of the last step to bodies that others move."""
        inputs = [body_com, self._meeting, self._force, self._place, body_q]
        self._launch(kernels.measure_presses, inputs, [force, torque])
