"""The rods of one node count: a batch, its dynamics, and the way to a Newton state and back."""

from __future__ import annotations

import numpy as np
import warp as wp
from newton import Model, State

from wrod.batch import RodBatch, RodState
from wrod.dynamics import Dynamics, Progress
from wrod.kernels import carrying, exchange
from wrod.newton_solver.attributes import CLAMPED, FREE
from wrod.newton_solver.shapes import ModelShapes
from wrod.substrate import Contact

# Under its own weight a rod on a shape sinks in by this fraction of its radius.
_SINKING = 1.0 / 600.0
_STANDARD_GRAVITY = 9.81


class RodGroup:
    """Rods that share a batch (a `wrod.dynamics.Motion`: it carries their held ends).

    Args:
        model: the Newton model.
        rods: indices of the rods into the model's.
        shapes: what they touch.
        holds: (rod, 2) records of what holds their ends; see `find_holds`.
        contact_stiffness: normal and tangential stiffness per length of rod [N/m^2], or None.
        options: of `Dynamics`.
    """

    def __init__(
        self,
        model: Model,
        rods: np.ndarray,
        shapes: ModelShapes,
        holds: np.ndarray,
        contact_stiffness: float | None,
        options: dict,
    ):
        self.model, self.rods, self.shapes = model, rods, shapes
        self.device, der = str(model.device), model.der
        self.worlds = der.rod_world.numpy()[rods]
        self.count = int(der.rod_node_count.numpy()[rods[0]])
        clamped = holds["kind"] == CLAMPED
        self.lead = clamped[:, 0].astype(int)
        nodes = self.count + int(clamped[0].sum())
        self.first_node = der.rod_first_node.numpy()[rods]
        self.first_edge = der.rod_first_edge.numpy()[rods]
        body = np.where(der.rod_visible.numpy()[rods] != 0, der.rod_body.numpy()[rods], -1)

        # Rows of the model's nodes and edges for those of the batch; a clamp repeats the last.
        at = np.arange(nodes) - self.lead[:, None]
        self._node_rows = self.first_node[:, None] + np.clip(at, 0, self.count - 1)
        self._edge_rows = self.first_edge[:, None] + np.clip(at[:, :-1], 0, self.count - 2)
        beyond = (at < 0) | (at >= self.count)
        inner = np.zeros_like(beyond)
        inner[:, 1:] |= beyond[:, :-1]
        inner[:, :-1] |= beyond[:, 1:]
        self._at_clamp = inner & ~beyond

        device = self.device
        self.span = wp.array(
            np.array(
                [
                    (n, e, self.count, lead)
                    for n, e, lead in zip(self.first_node, self.first_edge, self.lead, strict=True)
                ],
                dtype=exchange.Span.numpy_dtype(),
            ),
            dtype=exchange.Span,
            device=device,
        )
        self.body = wp.array(body, dtype=wp.int32, device=device)
        self.hold = wp.array(holds, dtype=carrying.Hold, device=device)
        self.batch = self._make_batch(nodes)
        self._hold_ends(holds)
        self.contact = self._make_contact(contact_stiffness) if len(shapes.rows) else None
        self.dynamics = Dynamics(
            self.batch,
            radius=der.rod_radius.numpy()[rods],
            air_damping=der.rod_air_damping.numpy()[rods],
            internal_damping=der.rod_internal_damping.numpy()[rods],
            contact=self.contact,
            motion=self,
            **options,
        )
        count = len(rods)
        self.changed = wp.zeros(count, dtype=wp.int32, device=device)
        self.until = wp.zeros(count, dtype=wp.float64, device=device)
        edges = (count, nodes - 1)
        self.written_director = wp.zeros(edges, dtype=wp.vec3d, device=device)
        self.no_force = wp.zeros((count, nodes), dtype=wp.vec3d, device=device)
        ends = (count, 2)
        self.end_position = wp.zeros(ends, dtype=wp.vec3d, device=device)
        self.end_rotation = wp.zeros(ends, dtype=wp.quatd, device=device)
        self.duration, self.body_before, self.body_q = 1.0, None, None

    def _make_batch(self, nodes: int) -> RodBatch:
        der = self.model.der
        # A clamp holds from the first node on: only the half of that node's length which is free
        # bends and twists, so it is twice as stiff.
        stiffer = np.where(self._at_clamp, 2.0, 1.0)
        n, e = self._node_rows, self._edge_rows
        position = der.node_q.numpy()[n]
        rest = der.edge_rest_length.numpy()[e]
        for row, lead in enumerate(self.lead):
            if lead:
                position[row, 0] -= position[row, 2] - position[row, 1]
            if nodes - lead > self.count:
                position[row, -1] += position[row, -2] - position[row, -3]
        return RodBatch(
            position,
            rest_length=rest,
            stretching_stiffness=der.edge_stretching_stiffness.numpy()[e],
            bending_stiffness=der.node_bending_stiffness.numpy()[n] * stiffer[:, :, None],
            twisting_stiffness=der.node_twisting_stiffness.numpy()[n] * stiffer,
            natural_curvature=der.node_natural_curvature.numpy()[n],
            natural_twist=der.node_natural_twist.numpy()[n],
            node_mass=der.node_mass.numpy()[n],
            gravity=self._gravity(),
            director=der.edge_director.numpy()[e],
            device=self.device,
        )

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

    def _hold_ends(self, holds: np.ndarray) -> None:
        free = np.ones((len(self.rods), self.batch.dof_count), dtype=bool)
        for row in range(len(self.rods)):
            first, last = self.lead[row], self.lead[row] + self.count - 1
            for side, end in ((0, first), (1, last)):
                kind = holds["kind"][row, side]
                if kind == FREE:
                    continue
                free[row, 4 * end : 4 * end + 3] = False
                if kind == CLAMPED:
                    beyond, edge = (end - 1, end - 1) if side == 0 else (end + 1, end)
                    free[row, 4 * beyond : 4 * beyond + 3] = False
                    free[row, 4 * edge + 3] = False
        self.batch.set_free(free)

    def refresh_gravity(self) -> None:
        self.batch.gravity.assign(self._gravity())

    def refresh_shapes(self) -> None:
        if self.contact is not None:
            self.contact.set_shapes(*self.shapes.of(self.worlds))
            _, place, turn = self.shapes.carriers(self.worlds)
            self.shape_place.assign(place)
            self.shape_turn.assign(turn)

    def step(self, state_in: State, duration: float, step: float, body_before) -> Progress:
        """Take up what changed in `state_in`, and move on by `duration` [s].

        Bodies that carry shapes come from the poses `body_before`.
        """
        batch, dynamics, der = self.batch, self.dynamics, state_in.der
        rods, nodes = len(self.rods), batch.node_count
        now = dynamics.time.numpy() + duration
        self.until.assign(now)
        self.duration, self.body_before, self.body_q = duration, body_before, state_in.body_q
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
            first = self.first_node if name.startswith("node") else self.first_edge
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
                self.no_force if self.contact is None else self.contact.force,
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
