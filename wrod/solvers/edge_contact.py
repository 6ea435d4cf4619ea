"""The part of `Contact` that deals with solids: contact of edges."""

import numpy as np
import warp as wp

from wrod.errors import RodError
from wrod.kernels.contact import depths, edge_adjoint, energies
from wrod.kernels.contact import edges as kernels
from wrod.kernels.contact.law import Touchable
from wrod.rods.batch import RodBatch
from wrod.solvers.carried_shapes import CarriedShapes

_EMERGING = 0.01


class EdgeContact:
    """Contact of a batch's edges with the solids of a table of shapes.

    Args:
        batch: the rods; their cut edges touch nothing.
        radius: (rod, node) of the section [length]; not a number where nothing is touched.
        stiffness: (rod, node) per length of rod [force/length^2].
        skin: thickness over which the force rises, over the radius.
        nodes: what the batch's nodes touch, and how; shapes and friction are the edges' too.
        damping: relaxation time of the contact times sqrt(stiffness / mass), (rod,).

    Attributes:
        push, moment: (rod, shape) force on each shape at the end of the last step, and its moment
            about the origin.
        carried: shapes that move with the rods, or None.
        duals: as of `Contact`, of edges.
        yields: whether shapes are pressed gently (`yield_to`).
    """

    def __init__(self, batch: RodBatch, radius, stiffness, skin, nodes, damping):
        self.batch = batch
        device, edges = batch.device, batch.node_count - 1

        def floats(values):
            return wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device)

        radius = np.nan_to_num((radius[:, 1:] + radius[:, :-1]) / 2)
        radius[:, list(batch.cut_edges)] = 0.0
        stiffness = (stiffness[:, 1:] + stiffness[:, :-1]) / 2 * batch.rest_length.numpy()
        mass = batch.node_mass.numpy()
        mass = (mass[:, 1:] + mass[:, :-1]) / 2
        self._model = model = Touchable()
        for name in ("shapes", "static_friction", "kinetic_friction", "roll_friction", "rolling"):
            setattr(model, name, getattr(nodes, name))
        model.field, model.place, model.rest_length = nodes.field, nodes.place, batch.rest_length
        model.radius, model.skin = floats(radius), floats(skin * radius)
        model.stiffness = floats(stiffness)
        model.relaxation = floats(damping[:, None] * np.sqrt(mass / stiffness))
        # What is hidden comes out at a hundredth of the speed at which contact stops within a
        # radius: faster, it loses its grip on the way. Rods without any mass have no speed.
        light = max(1e-12 * mass.max(), np.finfo(float).tiny)
        self._speed = floats(_EMERGING * radius * np.sqrt(stiffness / np.maximum(mass, light)))
        self._hidden = wp.zeros(radius.shape, dtype=wp.float64, device=device)
        table = model.shapes.shape
        shape = (batch.rod_count, table[1], edges)
        self.bristle = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self.sliding = wp.zeros(shape, dtype=wp.int32, device=device)
        self.duals = tuple(wp.zeros(shape, dtype=wp.vec3d, device=device) for _ in range(2))
        self.push = wp.zeros(table, dtype=wp.vec3d, device=device)
        self.moment = wp.zeros(table, dtype=wp.vec3d, device=device)
        self.turned = wp.zeros(shape, dtype=wp.float64, device=device)
        self.carried: CarriedShapes | None = None
        self.yields = False

    def _launch(self, kernel, inputs, outputs) -> None:
        batch = self.batch
        dim = (batch.rod_count, batch.node_count - 1)
        batch.launch(kernel, dim, inputs, outputs)

    @property
    def memory(self) -> tuple:
        """What edges touch, their bristles (rod, shape, edge), and whether those slid."""
        return self._model, self.bristle, self.sliding

    def find_unknown(self, chosen, dof, dof_before, touching: wp.array) -> None:
        """Raise `touching` (rod,) of the chosen rods that touch what has no adjoint."""
        inputs = [self._model, self._hidden, chosen, dof, dof_before]
        self._launch(edge_adjoint.find_unknown, inputs, [touching])

    def bear(self, burden: np.ndarray) -> None:
        """Let shapes press: see `Contact.bear`."""
        device = self.batch.device
        self._model.burden = wp.array(burden, dtype=wp.float64, device=device)

    def yield_to(self, bearer: np.ndarray, firmest: np.ndarray) -> None:
        """Let shapes be pressed gently: `firmest` (rod, shape) is the stiffness that all edges may
        have together on the `bearer` (rod, shape) of a shape [force/length], 0 for any."""
        model, device = self._model, self.batch.device
        if self.yields:
            model.firmest.assign(firmest)
            return
        self.yields = True
        model.firmest = wp.array(firmest, dtype=wp.float64, device=device)
        model.bearer = wp.array(bearer, dtype=wp.int32, device=device)
        model.near = wp.zeros(max(int(bearer.max()) + 1, 1), dtype=wp.int32, device=device)

    def count_near(self, dof: wp.array) -> None:
        """Find out how many edges share that stiffness from now on."""
        if self.yields:
            self._model.near.zero_()
            self._launch(depths.count_near, [dof], [self._model])

    @property
    def yielding(self) -> list[wp.array]:
        """What decides how stiff shapes are that are pressed gently: nothing if none is."""
        return [self._model.firmest, self._model.near] if self.yields else []

    def bearing(self) -> np.ndarray:
        """See `Contact.bearing`."""
        m = self._model
        if m.burden is None or not m.burden.size:
            return np.zeros(m.shapes.shape)
        return 0.5 * m.burden.numpy() / m.skin.numpy().max(axis=1)[:, None]

    def carry(self, carried: CarriedShapes, apart: np.ndarray) -> None:
        """Let shapes move with bodies: see `Contact.carry`.

        Raises:
            RodError: rods roll by friction, of which bodies would not get the torque.
        """
        if self._model.rolling.numpy().any():
            raise RodError("rods on shapes that move with them cannot roll; use rolling=False")
        self.carried = carried
        self._model.apart = wp.array(apart.astype(np.int8), dtype=wp.int8, device=self.batch.device)

    def add(self, step, active, dof, dof_before: wp.array, iteration: wp.array) -> None:
        out, old = self.batch.derivatives, [self.bristle, self.sliding, self.turned]
        if self.carried is not None:
            self.carried.place(self._model.shapes, active)
        inputs = [self._model, step, active, dof, dof_before, *old]
        outputs = [*self.duals, out.gradient, out.hessian]
        self._launch(kernels.edge_contact, [*inputs, iteration], outputs)
        if self.carried is not None:
            self.carried.push(self._model, [*inputs[1:], self.duals[1]])

    def refuse(self, converged: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        inputs = [self._model, self._hidden, dof, dof_before]
        self._launch(depths.refuse_tunnelling, inputs, [converged])

    def restart(self, chosen: wp.array, dof: wp.array) -> None:
        """Hide what lies deep inside shapes; it comes out as the chosen rods move on."""
        if self.carried is not None:
            self.carried.place(self._model.shapes, chosen)
        self._launch(depths.hide, [chosen, dof], [self._model, self._hidden])

    def find_touching(self, chosen, dof, dof_before, touching: wp.array) -> None:
        if self.carried is not None:
            self.carried.place(self._model.shapes, chosen, at_end=True)
        inputs = [self._model, chosen, dof, dof_before]
        self._launch(kernels.find_touching, inputs, [touching])
        if self.carried is not None:
            self.carried.place(self._model.shapes, chosen)

    def settle(self, step, accepted, dof, dof_before, slip: wp.array, force: wp.array) -> None:
        inputs = [self._model, step, accepted, dof, dof_before]
        pushes = [self.push, self.moment]
        self.batch.launch(kernels.clear_pushes, self.push.shape, [accepted], pushes)
        outputs = [self.bristle, self.sliding, self.turned, slip, force, *pushes]
        self._launch(kernels.settle_edges, inputs, outputs)
        self._launch(depths.swell, [self._speed, step, accepted], [self._model, self._hidden])

    def _place_carried(self) -> None:
        """Where bodies are now: a midpoint step leaves shapes halfway."""
        if self.carried is not None:
            self.carried.place(self._model.shapes, self.batch.every_rod)

    def add_energy(self, dof: wp.array, energy: wp.array) -> None:
        self._place_carried()
        inputs = [self._model, dof, self.bristle, self.turned]
        self._launch(energies.add_edge_energy, inputs, [energy])

    def penetration(self, dof: wp.array) -> np.ndarray:
        """(rod,) deepest penetration into any fixture [length]."""
        self._place_carried()
        depth = wp.zeros(self.batch.rod_count, dtype=wp.float64, device=self.batch.device)
        self._launch(depths.measure_depth, [self._model, self._hidden, dof], [depth])
        return depth.numpy().copy()
