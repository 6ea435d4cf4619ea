"""`SolverDER`: discrete elastic rods as a solver of Newton."""

import warnings
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

import wrod.kernels  # noqa: F401  # before Newton: starts Warp quietly
from wrod import arguments
from wrod.errors import RodError, WrodWarning, needed_extras, retold_as

with needed_extras():
    import newton

from newton.solvers import SolverBase

from wrod.newton_solver import attributes, notes
from wrod.newton_solver.adding import RodBuilding
from wrod.newton_solver.body_contact import colliding_bodies
from wrod.newton_solver.group import RodGroup
from wrod.newton_solver.holds import Holds
from wrod.newton_solver.loads import Loads
from wrod.newton_solver.owned import choose_bodies
from wrod.newton_solver.rows import find_rows
from wrod.newton_solver.shapes import ModelShapes
from wrod.newton_solver.tapes import off_tape, refuse
from wrod.rods.device import OnDevice
from wrod.solvers.dynamics import SCHEMES

# Steps after which a body that does not get its rods' forces is spoken of.
_PATIENCE = 3
_PASSED_ON = ("body_q", "body_qd", "joint_q", "joint_qd", "particle_q", "particle_qd")


class SolverDER(OnDevice, RodBuilding, SolverBase):
    """Implicit discrete elastic rods, in float64, inside a Newton scene.

    Rods are no bodies of Newton's: their state is in `state.der` (`node_q` [m], `node_qd` [m/s],
    `node_contact_f` [N], `edge_director`, `edge_spin` [rad/s]), their properties in `model.der`.
    They touch the model's shapes, whatever moves these, with the friction of the shape (`mu`) and,
    if asked, themselves and each other.

    Bodies hold rods, by their ends (`add_rod`) or anywhere (`attach`):

    - A free body (mass, not kinematic, no joint but a free one) is moved by this solver, with its
      rods, in one implicit step that conserves momentum; `state_in.body_f` acts on it, and what
      `contacts` say that it touches.
    - Kinematic bodies are moved by the caller.
    - Bodies of articulations, and what `bodies` leaves out, are moved by another solver before:
      call `add_body_forces(state)` on the state that it steps from.

    The pose that `state_in` (or the state `moved`) gives a body that others move is the one that it
    has at the end of the step. A state that is not the one this solver wrote last is taken up as it
    is (the rod then starts anew from it, with one step of first order), so states may be changed,
    copied and set back at will.

    Of a model that was finalized with `requires_grad=True`, steps on a `wp.Tape` have gradients, by
    the adjoint of the steps as they are taken: by `state.der`, `body_q` of bodies that others move
    and that hold or touch rods or free ones, `body_q`, `body_qd`, `body_f` of free ones, `gravity`,
    `shape_material_mu`, and `model.der`'s stretching, bending and twisting stiffness, natural
    curvature and twist, internal and air damping, radii, and node masses and rest lengths (both not
    for "consistent" inertia). Others have no `grad`. What is refused, by name, is in
    docs/newton.md.

    Example
    -------

    .. code-block:: python

        builder = newton.ModelBuilder()
        wrod.SolverDER.register_custom_attributes(builder)
        wrod.SolverDER.add_rod(builder, points, wrod.rod("green-vps"), start="clamped")
        builder.add_ground_plane()
        model = builder.finalize()

        solver = wrod.SolverDER(model)
        for i in range(100):
            solver.step(state_in, state_out, control, contacts, dt)
            state_in, state_out = state_out, state_in

    """

    ROD_PROPERTIES = 1 << 24
    """Bit for `notify_model_changed`: `model.der` was changed."""

    load_relaxation = 1.0
    """What part of the way to `body_wrenches` the loads of `add_body_forces` go in a step: less
    than 2 / (1 + 4 m / M), by "euler" 2 / (1 + m / M), for a cable of m [kg] that what moves with
    its hand, M, would else be too light for."""

    @arguments.checked(
        RodError,
        model=arguments.like("a newton.Model", "body_q", "device"),
        max_step=arguments.optional(arguments.number()),
        tolerance=arguments.number(1e-16, 1e3),
        max_iterations=arguments.whole(1, 10_000),
        contact_stiffness=arguments.optional(arguments.number()),
        self_contact=arguments.optional(arguments.number(0.0, 1e3)),
        rod_contact=arguments.optional(arguments.number(0.0, 1e3)),
        rod_stiffness=arguments.optional(arguments.number()),
        smooth_rods=arguments.flag,
        bodies=arguments.either(arguments.text, arguments.indices),
    )
    def __init__(
        self,
        model: newton.Model,
        *,
        scheme: str = "bdf2",
        inertia: str = "lumped",
        max_step: float | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 25,
        contact_stiffness: float | None = None,
        self_contact: float | None = None,
        rod_contact: float | None = None,
        rod_stiffness: float | None = None,
        smooth_rods: bool = False,
        bodies: str | Sequence[int] = "free",
    ):
        """
        Args:
            model: The model to be simulated.
            scheme: "bdf2" (second order, hardly dissipates), "midpoint" (a quarter of its error,
                loses nothing; "bdf2" where anything is touched) or "euler" (first order,
                dissipates).
            inertia: "lumped" or "consistent"; see `Dynamics`.
            max_step: Longest time step of a rod [s]; a longer `dt` is divided. Defaults to `dt`.
            tolerance: Largest unbalanced force of a step over the rod's weight, or over
                k_b / L^2 if that is larger.
            max_iterations: Of Newton's method; a step that needs more is halved.
            contact_stiffness: Normal and tangential stiffness of shapes per length of rod [N/m^2].
                Defaults to 600 times its weight per length on Earth over its radius.
            self_contact: Friction coefficient of a rod that touches itself; None: passes through.
            rod_contact: Friction coefficient of rods that touch each other, and themselves, but
                for those added with `touches_rods=False`. All rods of a world then share their
                steps. Defaults to None: they pass through each other.
            rod_stiffness: Normal stiffness of a place where rods touch [N/m], and ten times the
                tangential one. Defaults to EA / (5 radius), or 6000 times an edge's weight on Earth
                over the radius if more. Tight knots want fifty times the first.
            smooth_rods: Rods touch without corners along them, as what crosses and slides wants;
                what winds around itself or others wants edges.
            bodies: Which bodies this solver moves: "free", all free ones that hold rods, "none", or
                some of the free ones that hold rods or have shapes that collide.

        Raises:
            RodError: The model has no rods, or an option is none.
        """
        super().__init__(model=model)
        der = attributes.require(model)
        if model.requires_grad:  # with adjoints, which take a second to load
            from wrod.newton_solver.gradients import leave_gradients

            leave_gradients(model, consistent=inertia == "consistent")
        if scheme not in SCHEMES:
            raise RodError(f"unknown scheme {scheme!r}; use one of {', '.join(SCHEMES)}")
        given = {"max_step": max_step, "contact_stiffness": contact_stiffness}
        for name, value in {**given, "rod_stiffness": rod_stiffness}.items():
            if value is not None and arguments.wrong(arguments.number(above=0.0), value):
                raise RodError(f"{name} is {arguments.shown(value)}; give a positive finite number")
        if rod_contact is not None and self_contact is not None:
            raise RodError("give rod_contact or self_contact: the first one covers the second")
        self.max_step, self._max_iterations = max_step, max_iterations
        self.rod_count = len(der.rod_node_count)
        self._options = dict(scheme=scheme, inertia=inertia, tolerance=tolerance)
        self._contact_stiffness = contact_stiffness
        friction = self_contact if rod_contact is None else rod_contact
        self._rod_options = dict(friction=friction, stiffness=rod_stiffness, smooth=smooth_rods)
        self._rods_meet = rod_contact is not None
        self._bodies = bodies
        self._holds = Holds(model)
        self._own = choose_bodies(model, self._holds, bodies)
        self._initial = {name: wp.clone(getattr(der, name)) for name in attributes.STATE}
        self._mourned = np.zeros(self.rod_count, dtype=bool)
        self._poses = tuple(wp.clone(model.body_q, requires_grad=False) for _ in range(2))
        self._loads = Loads(model)
        self._fell = self._shook = False
        self._steps = 0
        self._last_out: weakref.ref | None = None
        self._build()

    @off_tape()
    def _build(self) -> None:
        model = self.model
        shapes = ModelShapes(model, self._own)
        colliding = colliding_bodies(model, self._own)
        self._colliding = np.flatnonzero(colliding)
        bodies = self._poses, self._holds, self._own, colliding
        options = self._contact_stiffness, self._rod_options, self._options
        rows = find_rows(model, self._holds, self._own, colliding, self._rods_meet)
        self._groups = [RodGroup(model, some, shapes, *bodies, *options) for some in rows]
        for group in self._groups:
            group.dynamics.max_iterations = self._max_iterations
        self._gradients: Any = None
        if model.requires_grad:  # now, as steps may be captured, where nothing can be kept
            from wrod.newton_solver.gradients import Gradients

            self._gradients = Gradients(model, self._groups)
        held = [b for b in self._holds.bodies if not self._own[b]]
        self._is_felt = bool(held) or any(g.shape_contact or g.body_contact for g in self._groups)
        flags, mass = model.body_flags.numpy(), model.body_mass.numpy()
        dynamic = (flags & int(newton.BodyFlags.DYNAMIC) != 0) & (mass > 0)
        self._others = [b for b in held if dynamic[b]]
        self._is_shared = bool((dynamic & ~self._own).any())

    @property
    def diverged(self) -> np.ndarray:
        """(rod_count,) whether the rod was cut out because no step converged. Its state is the
        last good one; it goes on when that state is changed, or after `reset`."""
        out = np.zeros(self.rod_count, dtype=bool)
        for group in self._groups:
            out[group.rows] = group.dynamics.diverged.numpy()[:, None] != 0
        return out

    @arguments.checked(RodError, dt=arguments.number(above=0.0))
    def step(
        self,
        state_in: newton.State,
        state_out: newton.State,
        control: newton.Control | None,
        contacts: newton.Contacts | None,
        dt: float,
        *,
        observables: SolverBase.Observables | None = None,
        moved: newton.State | None = None,
    ) -> None:
        """Move the rods on by `dt`.

        Args:
            state_in: The input state: rods, and the bodies that this solver moves, as they are.
            state_out: The output state; may be the input state.
            control: Not used.
            contacts: What the bodies that this solver moves touch, from Newton's collision
                detection in `state_in` (`newton.CollisionPipeline`); rods find their own contacts.
            dt: The time step [s].
            observables: None, or a container without requests.
            moved: The state into which another solver has put the bodies that it moves, where they
                are at the end of the step; may be the output state. Defaults to `state_in`. Other
                solvers do not carry rods over into the states that they write.

        Raises:
            RodError: dt is not positive, a state was made from another model, or, on a CPU, holds
                numbers that are not finite (a GPU cuts such rods out, as `diverged` and a warning
                of the next step say), or, while a tape is recorded, the step has no gradients:
                docs/newton.md lists what has none.
        """
        with retold_as(RodError):
            self.validate_observables(observables, contacts)
        moved = state_in if moved is None else moved
        for state in (state_in, state_out):
            rods = getattr(state, "der", None)
            shapes = [getattr(getattr(rods, name, None), "shape", None) for name in self._initial]
            if shapes != [array.shape for array in self._initial.values()]:
                raise RodError("the state does not hold this model's rods; call model.state()")
        device = self.model.device
        if device.is_cpu and not device.is_capturing:
            notes.refuse_what_is_no_number(self.model, state_in, moved, bool(self._own.any()))
            if self._steps == 0:
                notes.begins_elsewhere(self.model, self._holds, state_in.der.node_q, moved.body_q)
        if state_out is not moved:
            for name in _PASSED_ON:
                source = getattr(moved, name, None)
                if source is not None and len(source):
                    wp.copy(getattr(state_out, name), source)
        if contacts is None and len(self._colliding) and not self._fell:
            self._fell = True
            notes.nothing_holds(self.model, self._colliding)
        with off_tape() as tape:
            self._advance(state_in, state_out, moved, contacts, dt, tape)
        if self._follows_old_rods(state_in, state_out):
            notes.rods_of_long_ago()
        self._steps += 1
        if self._others and self._steps == _PATIENCE and not self._loads.taken:
            notes.nobody_feels(self.model, self._others)
        if self._loads.taken and device.is_cpu and not (self._shook or device.is_capturing):
            longest = [g.shape_contact.shaken(dt) for g in self._groups if g.shape_contact]
            if any(longest):
                self._shook = True
                notes.shaken(self.model, {b: t for one in longest for b, t in one.items()}, dt)

    def _advance(self, state_in, state_out, moved, contacts, dt: float, tape) -> None:
        """`step`, of which nothing is recorded but what goes back through it."""
        parts = 1 if self.max_step is None else int(np.ceil(dt / self.max_step * (1 - 1e-9)))
        before, after = self._poses
        wp.copy(after, moved.body_q)
        device = self.model.device
        if device.is_cuda and not device.is_capturing:
            self._listen()  # What earlier steps have told by now.
        put = self._gradients and self._gradients.listen(tape, parts, state_in, state_out, moved)
        for group in self._groups:
            group.step(state_in, contacts, dt, dt / parts)
        if put is not None:
            put(before, after)
        wp.copy(before, after)
        for group in self._groups:
            group.write(state_out)
        if self._is_felt:
            self._loads.measure(self._groups, self.load_relaxation)
        if device.is_cpu and not device.is_capturing:
            self._listen()

    def _follows_old_rods(self, state_in: newton.State, state_out: newton.State) -> bool:
        """Whether, early in a loop after another solver's step, rods went on from long ago."""
        last = self._last_out() if self._last_out is not None else None
        self._last_out = weakref.ref(state_out)
        early = self._steps < _PATIENCE and not self.model.device.is_capturing
        if not early or not self._is_shared or last is None or last is state_in:
            return False
        return any(group.changed.numpy().any() for group in self._groups)

    def penetration(self) -> np.ndarray:
        """(rod_count,) how deep at most a rod, or one that shares its steps, is in another [m]; 0
        where rods do not touch each other."""
        out = np.zeros(self.rod_count)
        for group in self._groups:
            if group.rod_contact is not None:
                out[group.rows] = group.rod_contact.penetration.numpy()[:, None]
        return out

    def body_wrenches(self) -> np.ndarray:
        """(body, 6) what rods did at the end of the last step to the bodies that hold or touch them
        and that others move: force [N], and torque about the centre of mass [N m]."""
        self._loads.taken = True
        return self._loads.wrenches()

    def add_body_forces(self, state: newton.State) -> None:
        """Add `body_wrenches` to `state.body_f`, for the solver that moves these bodies next;
        followed by `load_relaxation`.

        Args:
            state: The state that the other solver steps from.

        Raises:
            RodError: A tape is recorded, on which these loads have no gradients.
        """
        refuse(self.model, "loads of rods on bodies that others move")
        self._loads.taken = True
        self._loads.add_to(state)

    def _listen(self) -> None:
        """Speak of rods that were cut out since last heard of, without waiting for the device."""
        new = []
        for group in self._groups:
            group.check_capacity()
            cut = np.broadcast_to(group.diverged[:, None], group.rows.shape)
            new += group.rows[cut & ~self._mourned[group.rows]].tolist()
            self._mourned[group.rows] = cut
        if new:
            wound = ", and smooth_rods=False where they wind around each other"
            smooth = wound if self._rod_options["smooth"] else ""
            warnings.warn(
                f"rods cut out because no time step converged: {', '.join(map(str, new))}; the "
                f"others go on. Take a shorter dt{smooth}, or "
                "reset(state) them; states and poses of what holds them must be finite",
                WrodWarning,
                stacklevel=3,
            )

    @off_tape()
    def notify_model_changed(self, flags: newton.ModelFlags | int) -> None:
        """Take up changed gravity (MODEL_PROPERTIES), shapes (SHAPE_PROPERTIES), or attributes of
        the rods (`SolverDER.ROD_PROPERTIES`): docs/newton.md says for which of them rods go on, so
        that a graph of steps may be launched again, and for which they start anew."""
        flags = int(flags)
        anew = flags & int(newton.ModelFlags.SHAPE_TYPE_AND_SOURCE) != 0
        if flags & self.ROD_PROPERTIES:
            # Steps on a tape go back through what they were taken with.
            anew |= self._gradients is not None and self._gradients.listened
            anew = anew or not all([group.refresh_elasticity() for group in self._groups])
        if anew:
            self._build()
            return
        for group in self._groups:
            if flags & int(newton.ModelFlags.MODEL_PROPERTIES):
                group.refresh_gravity()
            if flags & int(newton.ModelFlags.SHAPE_PROPERTIES):
                group.refresh_shapes()

    @arguments.checked(RodError)
    def reset(self, state: newton.State, world_mask=None, flags=None) -> None:
        """Put rods back to where they were when the solver was made, at the same velocities.

        Args:
            state: The state to reset, in place.
            world_mask: (world_count + 1,) which worlds, the last for world -1; None for all.
            flags: Not used: all of `state.der` is reset.
        """
        with retold_as(RodError):
            mask = self._normalize_reset_world_mask(world_mask)
        for group in self._groups:
            if mask is None:
                chosen = np.ones(len(group.rows), dtype=bool)
            else:
                chosen = mask.numpy()[group.worlds].astype(bool)
            group.reset(state, self._initial, chosen)
