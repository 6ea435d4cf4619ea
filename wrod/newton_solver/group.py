"""Rows of rods alike: a batch, its dynamics, and the way to a Newton state and back."""

import numpy as np
import warp as wp
from newton import Contacts, Model, State

from wrod.kernels.contact.rods import POST
from wrod.kernels.stepping import carrying, exchange
from wrod.newton_solver.body_contact import BodyContact
from wrod.newton_solver.holds import Holds
from wrod.newton_solver.layout import Layout
from wrod.newton_solver.owned import find_owned
from wrod.newton_solver.shape_contact import ShapeContact
from wrod.newton_solver.shapes import ModelShapes, RodPlaces
from wrod.newton_solver.tapes import off_tape
from wrod.rods.discretisation import cells
from wrod.rods.state import RodState
from wrod.solvers.bodies import Bodies
from wrod.solvers.compiling import compile_steps
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.inertia import rounding_of, usual_force
from wrod.solvers.kept_pairs import LawShares
from wrod.solvers.rod_contact import RodContact

# Rods against each other: at least this stiff, in EA / radius, or by so many times an edge's weight
# over the radius, for what falls on soft ones; in what part of the radius the force rises; by how
# much those harden that are pressed in deep; and how stiff what sticks is over that. As stiff from
# the start and as gently as tight knots want it, a pile needs nearly twice as many iterations, and
# as stiff along each other nearly twice as many again.
_PAIR_STIFFNESS, _PAIR_WEIGHTS, _PAIR_SKIN, _PAIR_HARDENING = 0.2, 6000.0, 1e-3, 20.0
_PAIR_TANGENTIAL = 0.1
# How far nodes may go in a step over the radius, and how many edges one may be near to: for heaps.
_WAY, _PARTNERS = 1.25, 64
_STANDARD_GRAVITY = 9.81
# Of rods: what is not taken up in place.
_FIXED = ("node_mass", "node_softening", "node_inelastic", "edge_rest_length", "rod_radius",
          "rod_touches_rods", "rod_visible")  # fmt: skip


class RodGroup:
    """Rows that share a batch (a `wrod.solvers.steps.Motion`: it carries what is held).

    Args:
        model: the Newton model.
        rows: (row, rod) indices of the rods into the model's.
        shapes: what they touch.
        poses: arrays of the bodies' poses at the start and at the end of a step.
        holds: what holds the rods.
        own: (body,) whether a body moves with the rods that it holds.
        colliding: (body,) which of those have shapes that collide.
        contact_stiffness: normal and tangential stiffness per length of rod [N/m^2], or None.
        rods: how rods touch themselves and each other: `friction` coefficient or None, `stiffness`
            of a pair of edges [N/m] or None, `smooth`.
        options: of `Dynamics`.
    """

    def __init__(
        self,
        model: Model,
        rows: np.ndarray,
        shapes: ModelShapes,
        poses: tuple[wp.array, wp.array],
        holds: Holds,
        own: np.ndarray,
        colliding: np.ndarray,
        contact_stiffness: float | None,
        rods: dict,
        options: dict,
    ):
        self.model, self.rows = model, rows
        self.device = device = str(model.device)
        more = {
            "solids": len(shapes.rows),
            "pairs": rods["friction"] is not None,
            "bodies": own.any(),
        }
        self.more = [name for name, there in more.items() if there]
        compile_steps(device, "simulator", *self.more)
        self.worlds = model.der.rod_world.numpy()[rows[:, 0]]
        self.layout = layout = Layout(model, rows, holds)
        self.place = wp.array(layout.places, dtype=exchange.OutsideNode, device=device)
        self.capsules = wp.array(layout.capsules(), dtype=wp.int32, device=device)
        self.batch = layout.make_batch(self._gravity())
        owned, slots = find_owned(model, rows, holds, own)
        records = layout.hold_records(slots)
        self.batch.set_free(layout.free(records))
        self.hold = wp.array(records, dtype=carrying.Hold, device=device)
        self.bodies = None if owned is None else Bodies(self.batch, owned, records)
        self.shape_contact = None
        if len(shapes.rows):
            self.shape_contact = ShapeContact(
                shapes, RodPlaces(self.worlds, slots), layout, self.batch, self.bodies, records,
                contact_stiffness,
            )  # fmt: skip
        self.contact = None if self.shape_contact is None else self.shape_contact.contact
        self.pair_law: LawShares | None = None
        self.rod_contact = self._make_rod_contact(records, **rods)
        self.body_contact = None
        if owned is not None and colliding[owned["index"][owned["mass"] > 0]].any():
            self.body_contact = BodyContact(model, self.bodies)
        both = self.shape_contact, self.body_contact
        self._touched = [one for one in both if one is not None]
        contacts = [c for c in (self.contact, self.rod_contact, self.body_contact) if c is not None]
        self.dynamics = Dynamics(
            self.batch,
            radius=self._edge_values("radius"),
            contact=contacts,
            motion=self,
            bodies=self.bodies,
            keeps_recording=True,
            internal_damping=self._internal_damping(),
            **options,
        )
        self._set_air_damping()
        self._made_of = self._fixed_properties()
        count, nodes = self.place.shape
        self.changed = wp.zeros(count, dtype=wp.int32, device=device)
        self._seen = self.changed.numpy() if self.place.device.is_cpu else None
        # What a device tells the host without being waited for.
        self._diverged, self._overflow = (
            wp.zeros(count, dtype=wp.int32, device="cpu", pinned=self.place.device.is_cuda)
            for _ in range(2)
        )
        self._heard, self._heard_overflow = self._diverged.numpy(), self._overflow.numpy()
        self.written_director = wp.zeros((count, nodes - 1), dtype=wp.vec3d, device=device)
        self.no_force = wp.zeros((count, nodes), dtype=wp.vec3d, device=device)
        self.held_position = wp.zeros(self.hold.shape, dtype=wp.vec3d, device=device)
        self.held_rotation = wp.zeros(self.hold.shape, dtype=wp.quatd, device=device)
        self.duration, self.body_before, self.body_q = 0.0, *poses

    def _gravity(self) -> np.ndarray:
        gravity = self.model.gravity.numpy().astype(float)
        return gravity[np.clip(self.worlds, -1, len(gravity) - 1)]

    def _edge_values(self, name: str) -> np.ndarray:
        """(row, edge) of an attribute of rods."""
        return self.layout.node_values(name)[:, :-1]

    def _set_air_damping(self) -> None:
        """What the rods of a row have in common, and the rest by nodes."""
        air = self.layout.node_values("air_damping")
        self.dynamics.air_damping.assign(common := air.min(axis=1))
        drag = np.stack([air - common[:, None], self._quadratic_drag()], axis=2)
        drag[..., 0] *= self.batch.node_mass.numpy()
        if drag.any() or self.dynamics.drag is not None:
            self.dynamics.set_drag(drag)

    def _quadratic_drag(self) -> np.ndarray:
        """(row, node) per velocity squared [kg/m]; a clamp and a cut have none."""
        ghost, length = self.layout.ghost, self.batch.rest_length.numpy().copy()
        length[ghost[:, 1:] | ghost[:, :-1]] = 0.0
        length[:, list(self.layout.cuts)] = 0.0
        return self.layout.node_values("quadratic_drag") * cells(length)

    def _internal_damping(self) -> np.ndarray:
        """As `Dynamics` takes it: by nodes where gradients ask for it even of rods without any."""
        internal = self.layout.node_values("internal_damping")
        if (internal == internal[:, :1]).all() and not self.model.requires_grad:
            return internal[:, 0]
        return np.repeat(internal[:, :, None], 4, axis=2)

    def _make_rod_contact(
        self, holds: np.ndarray, friction: float | None, stiffness: float | None, smooth: bool
    ) -> RodContact | None:
        touches = self._edge_values("touches_rods") != 0
        if friction is None or not touches.any():
            return None
        radius = self._edge_values("radius")
        passive = ~touches | self.layout.near_clamps(holds, radius)
        if stiffness is None:
            stiffness = self._pair_stiffness(radius)
        contact = RodContact(
            self.batch,
            radius,
            Friction(friction),
            stiffness=stiffness,
            tangential=_PAIR_TANGENTIAL,
            skin=_PAIR_SKIN,
            hardening=_PAIR_HARDENING,
            way=_WAY,
            partners=self._partners(np.where(touches, radius, np.nan)),
            passive=passive,
            smooth=smooth,
        )
        contact.settles_loads = self.model.requires_grad
        return contact

    def _partners(self, radius: np.ndarray) -> int:
        """How many edges one may be near to: of a post, those of a turn and a quarter of what is
        thin around it. `radius` (row, edge) is NaN where nothing is touched."""
        thick, thin = np.nanmax(radius), np.nanmin(radius)
        if thick <= float(POST) * thin:
            return _PARTNERS
        shortest = self.batch.rest_length.numpy()[np.isfinite(radius)].min()
        around = 1.25 * 2.0 * np.pi * (thick + thin) / shortest
        return int(np.clip(around, _PARTNERS, max(_PARTNERS, radius.shape[1])))

    def _pair_stiffness(self, radius: np.ndarray) -> np.ndarray:
        """(row,) of pairs of edges, that of `Layout.stiffest_edges`; notes how it follows what rods
        are made of."""
        batch, layout = self.batch, self.layout
        length, pull = batch.rest_length.numpy(), batch.stretching_stiffness.numpy()
        weight = _PAIR_WEIGHTS * _STANDARD_GRAVITY * length * layout.line_density()[:, :-1]
        found = np.maximum(_PAIR_STIFFNESS * pull, weight) / radius
        most = np.arange(len(found)), layout.stiffest_edges(found, radius)
        heavy = (weight > _PAIR_STIFFNESS * pull)[most][:, None]
        one = np.zeros_like(found)
        one[most] = 1.0
        rod = layout.rod[most][:, None]
        edges = (layout.rod[:, :-1] == rod) & (layout.places["owns"][:, :-1] != 0)
        nodes = (layout.rod == rod) & ~layout.ghost
        in_all = [m / np.where(m, v, 0.0).sum(axis=1, keepdims=True)
                  for m, v in ((edges, length), (nodes, batch.node_mass.numpy()))]  # fmt: skip
        self.pair_law = LawShares(
            ~heavy * one / pull[most][:, None],
            -one,
            heavy * (one / length[most][:, None] - in_all[0]),
            heavy * in_all[1],
        )
        return found[most]

    def _fixed_properties(self) -> list[np.ndarray]:
        """Numbers that other arrays go with, and which rods are bent at rest or damped at all."""
        batch, layout = self.batch, self.layout
        names = [*_FIXED]
        if self.pair_law is not None:  # how stiff rods are against each other goes with it
            names.append("edge_stretching_stiffness")
        air = layout.node_values("air_damping")
        bent = (batch.natural_curvature.numpy() != 0).any(axis=(1, 2))
        damped = (layout.node_values("internal_damping") != 0).any()
        dragged = (layout.node_values("quadratic_drag") != 0).any()
        kinds = [bent, damped, dragged, (air != air[:, :1]).any()]
        return [*kinds, *(getattr(self.model.der, name).numpy().copy() for name in names)]

    def refresh_elasticity(self) -> bool:
        """Take up stiffnesses, the shape at rest and damping, in place; False if the rows have to
        be made anew, since something else has changed."""
        batch, dynamics = self.batch, self.dynamics
        for name, values in self.layout.elasticity().items():
            getattr(batch, name).assign(values)
        batch.cut(self.layout.cuts)
        dynamics.viscosity.set_time(self._internal_damping())
        self._set_air_damping()
        dynamics.force_scale.assign(usual_force(batch))
        scales = dynamics.length_scale.numpy(), dynamics.force_scale.numpy()
        dynamics.rounding.assign(rounding_of(batch, *scales))
        return all(map(np.array_equal, self._made_of, self._fixed_properties()))

    def refresh_gravity(self) -> None:
        self.batch.gravity.assign(self._gravity())

    def refresh_shapes(self) -> None:
        for one in self._touched:
            one.refresh()

    def step(
        self, state_in: State, contacts: Contacts | None, duration: float, step: float
    ) -> None:
        """Take up what changed in `state_in`, and move on by `duration` [s]."""
        batch, dynamics = self.batch, self.dynamics
        if duration != self.duration:
            self.duration = duration
            if self.shape_contact is not None:
                self.shape_contact.pace(duration)
            dynamics.forget_recording()
        self._take_up(state_in)
        if self.body_contact is not None and self.body_contact.read(contacts, state_in.body_q):
            dynamics.forget_recording()
        inputs = [self.hold, batch.state.dof, batch.state.tangent, batch.state.director]
        outputs = [self.held_position, self.held_rotation]
        batch.launch(carrying.note_held, self.hold.shape, inputs, outputs)
        if self.shape_contact is not None:
            self.shape_contact.count_near(batch.state.dof)
        dynamics.advance_by(duration, step)
        wp.copy(self._diverged, dynamics.diverged)
        if self.rod_contact is not None:
            wp.copy(self._overflow, self.rod_contact.overflow)

    @property
    def diverged(self) -> np.ndarray:
        """(row,) whether rows were cut out, as far as the host has heard without waiting."""
        return self._heard != 0

    def check_capacity(self) -> None:
        """As `RodContact.check_capacity`, of what the host has heard without waiting."""
        if self.rod_contact is not None and self._heard_overflow.any():
            self.rod_contact.check_capacity()

    def _take_up(self, state_in: State) -> None:
        """Read rows of which the state is not what was written last; they start anew."""
        batch, dynamics, der = self.batch, self.dynamics, state_in.der
        state, shape = batch.state, self.place.shape
        self.changed.zero_()
        source = [der.node_q, der.node_qd, der.edge_director, der.edge_spin]
        inputs = [self.place, self.capsules, *source, state_in.body_f, state.dof]
        inputs += [dynamics.velocity, self.written_director]
        batch.launch(exchange.find_changes, shape, inputs, [batch.point_load, self.changed])
        if self.bodies is not None:
            self.bodies.find_changes(state_in.body_q, state_in.body_qd, self.changed)
        anew = self._may_have_changed()
        if anew:
            inputs = [self.place, batch.rest_length, self.changed, *source]
            batch.launch(exchange.read_state, shape, inputs, [state.dof, dynamics.velocity])
            self._read_frames(der)
        if self.bodies is not None:
            self.bodies.read(
                self.changed, state_in.body_q, state_in.body_qd, state_in.body_f, state,
                dynamics.velocity,
            )  # fmt: skip
            if anew:
                batch.transport_frames(state, state, self.changed)
        if anew and self.shape_contact is not None:
            # What rods lie in from the first is told by where shapes are, which others have moved.
            times = [self.changed, self.changed, dynamics.until, dynamics.time, dynamics.span]
            self.shape_contact.follow(self.duration, times, [self.body_before, self.body_q])
        if anew:
            dynamics.restart(self.changed)

    def _may_have_changed(self) -> bool:
        """Of any row; a CPU looks, as launches that find none would take longer."""
        return self._seen is None or self.place.device.is_capturing or bool(self._seen.any())

    def _read_frames(self, der) -> None:
        state = self.batch.state
        inputs = [self.place, self.changed, der.edge_director, state.dof]
        outputs = [state.tangent, state.director, state.reference_twist]
        self.batch.launch(exchange.read_frames, self.place.shape, inputs, outputs)
        self.batch.find_reference_twist(self.changed)

    def reset(self, state: State, initial: dict[str, wp.array], chosen: np.ndarray) -> None:
        """Put the chosen rows (row,) of a state back to `initial`, arrays of all rods' nodes and
        edges by name."""
        der = self.model.der
        counts = der.rod_node_count.numpy()
        for name, source in initial.items():
            of_nodes = name.startswith("node")
            first = (der.rod_first_node if of_nodes else der.rod_first_edge).numpy()
            for rod in self.rows[chosen].ravel():
                at = int(first[rod])
                wp.copy(getattr(state.der, name), source, at, at, int(counts[rod]) - (not of_nodes))
        if self.bodies is not None:
            records = self.bodies.body.numpy()[chosen]
            at = np.unique(records["index"][records["mass"] > 0])
            for name in ("body_q", "body_qd"):
                values = getattr(state, name).numpy().copy()
                values[at] = getattr(self.model, name).numpy()[at]
                getattr(state, name).assign(values)
        with off_tape():
            self.dynamics.restart(wp.array(chosen, dtype=wp.int32, device=self.device))

    def write(self, state_out: State) -> None:
        """Give out what rods and their bodies do now, and put the rods' capsules there."""
        batch, dynamics, der = self.batch, self.dynamics, state_out.der
        state = batch.state
        contacts = self.contact, self.rod_contact
        forces = [self.no_force if one is None else one.force for one in contacts]
        batch.launch(
            exchange.write_state,
            self.place.shape,
            [self.place, self.capsules, state.dof, dynamics.velocity, state.tangent]
            + [state.director, *forces],
            [der.node_q, der.node_qd, der.node_contact_f, der.edge_director, der.edge_spin]
            + [self.written_director, state_out.body_q],
        )
        if self.bodies is not None:
            self.bodies.write(state_out.body_q, state_out.body_qd)

    def add_loads(self, force: wp.array, torque: wp.array) -> None:
        """Add what rods do to bodies that others move: (body,) force, and torque about the centre
        of mass."""
        batch, body_com = self.batch, self.model.body_com
        inputs = [self.hold, body_com, batch.state.dof, batch.state.tangent]
        inputs += [self.dynamics.reaction, self.body_before]
        batch.launch(carrying.measure_loads, self.hold.shape, inputs, [force, torque])
        for one in self._touched:
            one.add_loads(body_com, self.body_before, force, torque)

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState):
        """Carry what is held, and shapes, to where their bodies are at the end of the step."""
        times = [running, self.changed, self.dynamics.until, time, step]
        for one in self._touched:
            one.follow(self.duration, times, [self.body_before, self.body_q])
        inputs = [self.hold, wp.float64(self.duration), *times, self.body_q]
        inputs += [self.held_position, self.held_rotation, start.tangent, start.director]
        batch = self.batch
        batch.launch(carrying.carry_held, self.hold.shape, inputs, [batch.state.dof])
