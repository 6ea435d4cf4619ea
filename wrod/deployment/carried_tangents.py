"""Derivatives that are carried along with the steps of a deployment."""

import numpy as np
import warp as wp

from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.kernels.contact.linearised import LinearContact
from wrod.kernels.lanes import lanes
from wrod.kernels.linear import banded_lu
from wrod.kernels.stepping import deployment_tangents as kernels
from wrod.kernels.stepping import flow_tangents, inelastic_tangents
from wrod.rods.batch import RodBatch
from wrod.solvers.contact import Contact
from wrod.solvers.newton_steps import NewtonSteps


class LaidTangents:
    """Tangents of a batch of deployments (a `wrod.solvers.newton_steps.Follower`).

    Args:
        batch: the rods.
        contact: with the table, the only thing that they touch.
        path: (rod, column, key, 6) rates of the grip's position [m] and rotation vector [rad]; of
            one rod: the same for all.
        friction: (rod, column, node) of the coefficient where a node lies, see `Directions`.
        stiffness: (rod, column), likewise.
        natural_curvature: (rod, column, 2), towards the principal directions.
        begin: (rod, column) time before which a column is nothing [s].
    """

    def __init__(
        self,
        batch: RodBatch,
        contact: Contact,
        path: np.ndarray,
        friction: np.ndarray,
        stiffness: np.ndarray,
        natural_curvature: np.ndarray,
        begin: np.ndarray,
    ):
        self.batch, self.contact = batch, contact
        rods, nodes, dofs, device = batch.rod_count, batch.node_count, batch.dof_count, batch.device
        self.count = path.shape[1]
        # Columns that begin together share a pack, which rests until then; those that the grip's
        # path has no part in come first, and others begin at `first_late` or later [s].
        late = path.any(axis=(0, 2, 3))
        self.order = np.lexsort((late, begin.min(axis=0)))
        self.early_count = int(np.sum(~late))
        self.first_late = float(begin[:, late].min(initial=np.inf))
        size = kernels.PACK if wp.get_device(device).is_cpu else 1
        self.size, packs = size, -(-self.count // size)
        vector = kernels.vector_of(size)

        def packed(values):
            """(rod, column, ...) -> (rod, pack, ..., size)."""
            values = values[:, self.order]
            pad = [(0, 0)] * values.ndim
            pad[1] = (0, packs * size - self.count)
            values = np.pad(values, pad).reshape(len(values), packs, size, *values.shape[2:])
            return wp.array(
                np.ascontiguousarray(np.moveaxis(values, 2, -1)), dtype=vector, device=device
            )

        late = np.pad(
            begin[:, self.order], ((0, 0), (0, packs * size - self.count)), constant_values=np.inf
        )
        self.begin = wp.array(
            late.reshape(rods, packs, size).min(axis=2), dtype=wp.float64, device=device
        )
        self.path = packed(path)
        self.friction_rate, self.stiffness_rate, self.natural_rate = (
            packed(v) for v in (friction, stiffness, natural_curvature)
        )

        def zeros(size):
            return wp.zeros((rods, packs, size), dtype=vector, device=device)

        self.now, self.older, self.velocity, self.velocity_older, self.x = (
            zeros(dofs) for _ in range(5)
        )
        self.bristle = zeros(3 * nodes)

        def per_node(dtype):
            return wp.zeros((rods, nodes), dtype=dtype, device=device)

        self.linear_contact, self.coupling = per_node(LinearContact), per_node(wp.mat33d)
        self.elastic = wp.zeros((rods, dofs), dtype=wp.float64, device=device)
        self.bends = bool(natural_curvature.any())
        self.strain, self.strain_older = zeros(4 * nodes), zeros(4 * nodes)
        self.unstrained, self.strains = per_node(wp.vec4d), per_node(flow_tangents.Strains)
        self.matrix = banded_lu.NodeCoupled()
        self.matrix.hessian, self.matrix.coupling = batch.derivatives.hessian, self.coupling
        self.factor = wp.zeros((rods, dofs, banded_lu.BAND), dtype=wp.float64, device=device)
        self.turned = zeros(nodes)
        self.winding, self.turning = (
            wp.zeros((rods, nodes - 1), dtype=wp.vec3d, device=device) for _ in range(2)
        )
        self.packs = packs
        # Of bends that remember: what they remember, and their moments by it.
        self.remembers = batch.inelastic is not None
        inner = nodes - 2 if self.remembers else 0
        self.kept, self.kept_moment = (
            zeros(4 * nodes if inner else 0),
            zeros(2 * nodes if inner else 0),
        )
        self.memory = per_node(inelastic_tangents.Memory)
        if self.remembers:
            inputs = [batch.elastic_model, self.natural_rate, batch.inelastic]
            batch.launch(inelastic_tangents.begin_memory, (rods, packs, inner), inputs, [self.kept])

    @property
    def _carried(self) -> list[wp.array]:
        """(rod, pack, ...) of what is carried from step to step."""
        carried = [self.now, self.older, self.velocity, self.velocity_older]
        carried += [self.bristle, self.turned, self.strain, self.strain_older]
        return [*carried, self.kept] if self.remembers else carried

    def early(self) -> list[np.ndarray]:
        """(rod, column, ...) of all that is carried of the columns that the grip's path has no part
        in."""
        packs = -(-self.early_count // self.size)
        taken = []
        for one in self._carried:
            values = np.moveaxis(one.numpy()[:, :packs].copy(), -1, 2)
            taken.append(values.reshape(len(values), -1, values.shape[3])[:, : self.early_count])
        return taken

    def begin_with(self, taken: list[np.ndarray]) -> None:
        """Carry on what `early` of the same columns has told, the others not having begun."""
        for one, values in zip(self._carried, taken, strict=True):
            whole = np.zeros((len(values), self.packs * self.size, values.shape[2]))
            whole[:, : self.early_count] = values
            whole = whole.reshape(len(values), self.packs, self.size, -1)
            one.assign(np.ascontiguousarray(np.moveaxis(whole, 2, -1)))

    def follow(self, dynamics: NewtonSteps) -> None:
        """Carry the tangents over the accepted steps."""
        batch, accepted = self.batch, dynamics.accepted
        state, start, out = batch.state, dynamics.start, batch.derivatives
        rods, dofs = batch.rod_count, batch.dof_count

        pace, touching = dynamics.pace, [self.linear_contact, self.coupling]
        self.contact.linearise(accepted, state.dof, start.dof, touching)
        batch.launch(
            kernels.elastic_forces,
            (rods, dofs),
            [dynamics.mass, dynamics.air_damping, batch.node_mass, batch.gravity, pace]
            + [state.dof, start.dof, dynamics.dof_older]
            + [dynamics.velocity, dynamics.velocity_older, out.gradient, self.linear_contact],
            [self.elastic],
        )
        if self.contact.holds_roll:
            batch.launch(
                kernels.measure_winding,
                (rods, batch.node_count - 1),
                [pace, state.dof, start.tangent, state.tangent, self.elastic],
                [self.winding, self.turning],
            )
        batch.launch(
            banded_lu.assemble, (rods, dofs), [accepted, batch.free, self.matrix], [self.factor]
        )
        batch.launch_lanes(banded_lu.factorise, [accepted], [self.factor])
        tangents = [self.now, self.older, self.velocity, self.velocity_older]
        batch.launch(
            kernels.load_tangents,
            (rods, self.packs, batch.node_count),
            [dynamics.mass, dynamics.air_damping, self.friction_rate, self.stiffness_rate]
            + [self.begin, pace, batch.free, self.linear_contact, self.elastic]
            + [self.winding, self.turning, *tangents, self.bristle, self.turned],
            [self.x],
        )
        self._load_flow(dynamics)
        batch.launch(
            kernels.load_grip,
            (rods, self.packs),
            [batch.rest_length, wp.float64(KEY_INTERVAL), self.path, self.begin, pace]
            + [batch.free, state.tangent],
            [self.x],
        )
        self._solve([self.begin, pace, self.factor])
        self._measure_flow(dynamics)
        batch.launch(
            kernels.carry_bristles,
            (rods, self.packs, batch.node_count),
            [self.contact.tangent_stiffness, self.friction_rate, self.begin, pace]
            + [*touching, self.winding, self.x, self.now],
            [self.bristle, self.turned],
        )
        batch.launch(
            kernels.advance_tangents, (rods, self.packs, dofs), [self.begin, pace, self.x], tangents
        )

    def _load_flow(self, dynamics: NewtonSteps) -> None:
        viscosity, batch = dynamics.viscosity, self.batch
        if not (self.bends or viscosity.exists or self.remembers):
            return
        state, pace = batch.state, dynamics.pace
        past = [self.unstrained] * 2
        if viscosity.exists:
            past = [viscosity.strain, viscosity.strain_older]
        batch.launch(
            flow_tangents.linearise_flow,
            (batch.rod_count, batch.node_count - 1),
            [batch.elastic_model, viscosity.time, viscosity.relaxation, pace]
            + [state.dof, state.director, *past],
            [self.strains],
        )
        if self.remembers:
            batch.launch(
                inelastic_tangents.linearise_memory,
                (batch.rod_count, batch.node_count - 2),
                [batch.elastic_model, batch.inelastic, pace, state.dof, state.director],
                [self.strains, self.memory],
            )
            batch.launch(
                inelastic_tangents.remembered_moments,
                (batch.rod_count, self.packs, batch.node_count - 2),
                [self.begin, pace, self.memory, self.kept],
                [self.kept_moment],
            )
        batch.launch(
            flow_tangents.load_flow,
            (batch.rod_count, self.packs, batch.node_count),
            [self.begin, self.natural_rate, pace, batch.free]
            + [self.strains, self.strain, self.strain_older, self.kept_moment],
            [self.x],
        )

    def _measure_flow(self, dynamics: NewtonSteps) -> None:
        viscosity = dynamics.viscosity
        if viscosity.exists:
            self.batch.launch(
                flow_tangents.measure_strain_rates,
                (self.batch.rod_count, self.packs, self.batch.node_count - 1),
                [self.begin, viscosity.relaxation, dynamics.pace, self.strains, self.x],
                [self.strain, self.strain_older],
            )
        if self.remembers:
            self.batch.launch(
                inelastic_tangents.carry_memory,
                (self.batch.rod_count, self.packs, self.batch.node_count - 2),
                [self.begin, self.natural_rate, dynamics.pace, self.strains, self.memory, self.x],
                [self.kept],
            )

    def _solve(self, inputs: list) -> None:
        """Of the two kernels a CPU takes the first, one thread a pack, a GPU the second."""
        count = lanes(self.batch.device)
        dim: tuple[int, ...] = (self.batch.rod_count, self.packs)
        kernel = kernels.solve_tangents
        if count > 1:
            dim, kernel = (*dim, count), kernels.solve_tangents_lanes
        self.batch.launch(kernel, dim, inputs, [self.x], count)

    def values(self) -> np.ndarray:
        """(rod, column, node, 3) derivatives of the nodes now."""
        dof = self.now.numpy()
        rods, packs, dofs, size = dof.shape
        columns = np.moveaxis(dof, 3, 2).reshape(rods, packs * size, dofs)[:, : self.count]
        out = np.empty_like(columns)
        out[:, self.order] = columns
        padded = np.pad(out, ((0, 0), (0, 0), (0, 1)))
        return padded.reshape(rods, self.count, -1, 4)[..., :3]
