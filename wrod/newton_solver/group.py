"""The rods of one node count: a batch, its dynamics, and the way to a Newton state and back."""

from __future__ import annotations

import numpy as np
import warp as wp
from newton import Model, State

from wrod.kernels.stepping import carrying, exchange
from wrod.newton_solver.layout import Layout
from wrod.newton_solver.shapes import ModelShapes
from wrod.rods.batch import RodState
from wrod.solvers.contact import Contact, Friction
from wrod.solvers.dynamics import Dynamics, Progress
from wrod.solvers.rod_contact import RodContact

# Under its own weight a rod on a shape sinks in by this fraction of its radius.
_SINKING = 1.0 / 600.0
_STANDARD_GRAVITY = 9.81


class RodGroup:
    """Rods that share a batch (a `wrod.solvers.dynamics.Motion`: it carries their held ends).

    Args:
        model: the Newton model.
        rods: indices of the rods into the model's.
        shapes: what they touch.
        bodies: arrays of the bodies' poses at the start and at the end of a step.
        holds: (rod, 2) records of what holds their ends; see `find_holds`.
        contact_stiffness: normal and tangential stiffness per length of rod [N/m^2], or None.
        self_contact: friction coefficient of a rod with itself, or None.
        options: of `Dynamics`.
    """

    def __init__(
        self,
        model: Model,
        rods: np.ndarray,
        shapes: ModelShapes,
        bodies: tuple[wp.array, wp.array],
        holds: np.ndarray,
        contact_stiffness: float | None,
        self_contact: float | None,
        options: dict,
    ):
        self.model, self.rods, self.shapes = model, rods, shapes
        self.device, der = str(model.device), model.der
        self.worlds = der.rod_world.numpy()[rods]
        self.layout = layout = Layout(model, rods, holds["kind"])
        self.count = layout.count
        body = np.where(der.rod_visible.numpy()[rods] != 0, der.rod_body.numpy()[rods], -1)

        device = self.device
        self.span = wp.array(layout.spans(), dtype=exchange.Span, device=device)
        self.body = wp.array(body, dtype=wp.int32, device=device)
        self.hold = wp.array(holds, dtype=carrying.Hold, device=device)
        self.batch = layout.make_batch(self._gravity())
        self.contact = self._make_contact(contact_stiffness) if len(shapes.rows) else None
        radius = der.rod_radius.numpy()[rods]
        self.self_contact = None
        if self_contact is not None:
            self.self_contact = RodContact(self.batch, radius, Friction(self_contact))
        contacts = [c for c in (self.contact, self.self_contact) if c is not None]
        self.dynamics = Dynamics(
            self.batch,
            radius=radius,
            air_damping=der.rod_air_damping.numpy()[rods],
            internal_damping=der.rod_internal_damping.numpy()[rods],
            contact=contacts,
            motion=self,
            keeps_recording=True,
            **options,
        )
        count, nodes = len(rods), self.batch.node_count
        self.changed = wp.zeros(count, dtype=wp.int32, device=device)
        self.until = wp.zeros(count, dtype=wp.float64, device=device)
        edges = (count, nodes - 1)
        self.written_director = wp.zeros(edges, dtype=wp.vec3d, device=device)
        self.no_force = wp.zeros((count, nodes), dtype=wp.vec3d, device=device)
        ends = (count, 2)
        self.end_position = wp.zeros(ends, dtype=wp.vec3d, device=device)
        self.end_rotation = wp.zeros(ends, dtype=wp.quatd, device=device)
        self.duration, self.body_before, self.body_q = 1.0, *bodies

    def _gravity(self) -> np.ndarray:
        gravity = self.model.gravity.numpy().astype(float)
        return gravity[np.clip(self.worlds, -1, len(gravity) - 1)]

    def _make_contact(self, stiffness: float | None) -> Contact:
        der, batch = self.model.der, self.batch
        radius = der.rod_radius.numpy()[self.rods]
        density = batch.node_mass.numpy().sum(axis=1) / batch.rest_length.numpy().sum(axis=1)
        if stiffness is None:
            stiffness = density * _STANDARD_GRAVITY / (_SINKING * radius)
        shapes, friction = self.shapes.of(self.worlds)
        carrier, place, turn = self.shapes.carriers(self.worlds)
        self.carrier = wp.array(carrier, dtype=wp.int32, device=self.device)
        self.shape_place = wp.array(place, dtype=wp.vec3d, device=self.device)
        self.shape_turn = wp.array(turn, dtype=wp.quatd, device=self.device)
        self._shapes_move = bool((carrier >= 0).any())
        curved = (batch.natural_curvature.numpy() != 0).any(axis=(1, 2))
        return Contact(batch, radius, stiffness, friction, shapes, keeps_roll=curved)

    def refresh_gravity(self) -> None:
        self.batch.gravity.assign(self._gravity())

    def refresh_shapes(self) -> None:
        if self.contact is not None:
            self.contact.set_shapes(*self.shapes.of(self.worlds))
            _, place, turn = self.shapes.carriers(self.worlds)
            self.shape_place.assign(place)
            self.shape_turn.assign(turn)

    def step(self, state_in: State, duration: float, step: float) -> Progress:
        """Take up what changed in `state_in`, and move on by `duration` [s]."""
        batch, dynamics, der = self.batch, self.dynamics, state_in.der
        rods, nodes = len(self.rods), batch.node_count
        now = dynamics.time.numpy() + duration
        self.until.assign(now)
        if duration != self.duration:
            self.duration = duration
            dynamics.forget_recording()
        self.changed.zero_()
        wp.launch(
            exchange.find_changes,
            dim=(rods, self.count),
            inputs=[
                self.span,
                der.node_q,
                der.node_qd,
                der.edge_director,
                der.edge_spin,
                batch.state.dof,
                dynamics.velocity,
                self.written_director,
            ],
            outputs=[self.changed],
            device=self.device,
        )
        state = batch.state
        wp.launch(
            exchange.read_state,
            dim=(rods, nodes),
            inputs=[
                self.span,
                batch.rest_length,
                self.changed,
                der.node_q,
                der.node_qd,
                der.edge_director,
                der.edge_spin,
            ],
            outputs=[
                state.dof,
                dynamics.velocity,
                state.tangent,
                state.director,
                state.reference_twist,
            ],
            device=self.device,
        )
        batch.find_reference_twist(self.changed)
        dynamics.restart(self.changed)
        wp.launch(
            carrying.note_ends,
            dim=(rods, 2),
            inputs=[self.hold, self.span, state.dof, state.tangent, state.director],
            outputs=[self.end_position, self.end_rotation],
            device=self.device,
        )
        return dynamics.advance(now, step)

    def reset(self, state: State, initial: dict[str, wp.array], chosen: np.ndarray) -> None:
        """Put the chosen rods (rod,) of a state back to `initial`, arrays of all rods' nodes and
        edges by name."""
        for name, source in initial.items():
            first = self.layout.first_node if name.startswith("node") else self.layout.first_edge
            count = self.count - (not name.startswith("node"))
            for row in np.flatnonzero(chosen):
                at = int(first[row])
                wp.copy(getattr(state.der, name), source, at, at, count)
        self.dynamics.restart(wp.array(chosen, dtype=wp.int32, device=self.device))

    def write(self, state_out: State) -> None:
        """Give out what the rods do now, and put their capsules there."""
        batch, dynamics, der = self.batch, self.dynamics, state_out.der
        rods, state = len(self.rods), batch.state
        wp.launch(
            exchange.write_state,
            dim=(rods, self.count),
            inputs=[
                self.span,
                state.dof,
                dynamics.velocity,
                state.tangent,
                state.director,
                *(
                    self.no_force if contact is None else contact.force
                    for contact in (self.contact, self.self_contact)
                ),
            ],
            outputs=[
                der.node_q,
                der.node_qd,
                der.node_contact_f,
                der.edge_director,
                der.edge_spin,
                self.written_director,
            ],
            device=self.device,
        )
        wp.launch(
            exchange.place_capsules,
            dim=(rods, self.count - 1),
            inputs=[self.span, self.body, der.node_q, der.edge_director],
            outputs=[state_out.body_q],
            device=self.device,
        )

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState):
        """Carry held ends and shapes to where their bodies are at the end of the step."""
        batch = self.batch
        wp.launch(
            carrying.carry_ends,
            dim=(len(self.rods), 2),
            inputs=[
                self.hold,
                self.span,
                batch.rest_length,
                wp.float64(self.duration),
                running,
                self.changed,
                self.until,
                time,
                step,
                self.body_q,
                self.end_position,
                self.end_rotation,
                start.tangent,
                start.director,
            ],
            outputs=[batch.state.dof],
            device=self.device,
        )
        if self.contact is not None and self._shapes_move:
            wp.launch(
                carrying.carry_shapes,
                dim=self.carrier.shape,
                inputs=[
                    self.carrier,
                    self.shape_place,
                    self.shape_turn,
                    wp.float64(self.duration),
                    running,
                    self.changed,
                    self.until,
                    time,
                    step,
                    self.body_before,
                    self.body_q,
                ],
                outputs=[self.contact.table],
                device=self.device,
            )
