"""The part of `Contact` that deals with solids: contact of edges."""

import numpy as np
import warp as wp

from wrod.errors import RodError
from wrod.kernels.contact import depths, energies
from wrod.kernels.contact import edges as kernels
from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.rods.arrays import filled
from wrod.rods.batch import RodBatch
from wrod.solvers.carried_shapes import CarriedShapes

_EMERGING = 0.01


class Bristles:
    """What friction remembers of nodes or edges that touch shapes.

    Attributes:
        arrays: (rod, shape, node or edge) each, by the names of
            `wrod.kernels.contact.law.ContactStep`.
    """

    def __init__(self, batch: RodBatch, shapes: int, pieces: int):
        kinds = {
            "bristle": wp.vec3d, "sliding": wp.int32, "turned": wp.float64, "stretch": wp.vec3d,
            "dual": wp.vec3d,
        }  # fmt: skip
        self.arrays = {n: batch.zeros(shapes, pieces, dtype=kind) for n, kind in kinds.items()}
        self._steps: dict[tuple, ContactStep] = {}

    def step(self, **others: wp.array) -> ContactStep:
        """A step of them, with the other arrays that it has; one for each set of these, since what
        is recorded may hold it."""
        key = tuple(array.ptr for array in others.values())
        if key not in self._steps:
            self._steps[key] = filled(ContactStep(), self.arrays | others)
        return self._steps[key]


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
        model, bristles: as of `Contact`, of edges.
        yields: whether shapes are pressed gently (`yield_to`).
    """

    def __init__(self, batch: RodBatch, radius, stiffness, skin, nodes, damping):
        self.batch = batch
        floats, edges = batch.array, batch.node_count - 1
        radius = np.nan_to_num((radius[:, 1:] + radius[:, :-1]) / 2)
        radius[:, list(batch.cut_edges)] = 0.0
        stiffness = (stiffness[:, 1:] + stiffness[:, :-1]) / 2 * batch.rest_length.numpy()
        mass = batch.node_mass.numpy()
        mass = (mass[:, 1:] + mass[:, :-1]) / 2
        self.model = model = Touchable()
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
        self._hidden = batch.zeros(edges)
        table = model.shapes.shape
        self.bristles = Bristles(batch, table[1], edges)
        self.push, self.moment = (batch.zeros(table[1], dtype=wp.vec3d) for _ in range(2))
        self.carried: CarriedShapes | None = None
        self.yields = False

    def find_unknown(self, step: ContactStep, touching: wp.array) -> None:
        """Raise `touching` (rod,) of the chosen rods that touch what has no adjoint."""
        from wrod.kernels.contact.edge_adjoint import find_unknown

        self.batch.launch_edges(find_unknown, [self.model, self._hidden, step], [touching])

    def bear(self, burden: np.ndarray) -> None:
        """Let shapes press: see `Contact.bear`."""
        self.model.burden = self.batch.array(burden)

    def yield_to(self, bearer: np.ndarray, firmest: np.ndarray) -> None:
        """Let shapes be pressed gently: `firmest` (rod, shape) is the stiffness that all edges may
        have together on the `bearer` (rod, shape) of a shape [force/length], 0 for any."""
        model, batch = self.model, self.batch
        if self.yields:
            model.firmest.assign(firmest)
            return
        self.yields = True
        model.firmest = batch.array(firmest)
        model.bearer = batch.array(bearer, dtype=wp.int32)
        model.near = wp.zeros(max(int(bearer.max()) + 1, 1), dtype=wp.int32, device=batch.device)

    def count_near(self, dof: wp.array) -> None:
        """Find out how many edges share that stiffness from now on."""
        if self.yields:
            self.model.near.zero_()
            self.batch.launch_edges(depths.count_near, [dof], [self.model])

    @property
    def yielding(self) -> list[wp.array]:
        """What decides how stiff shapes are that are pressed gently: nothing if none is."""
        return [self.model.firmest, self.model.near] if self.yields else []

    def bearing(self) -> np.ndarray:
        """See `Contact.bearing`."""
        m = self.model
        if m.burden is None or not m.burden.size:
            return np.zeros(m.shapes.shape)
        return 0.5 * m.burden.numpy() / m.skin.numpy().max(axis=1)[:, None]

    def carry(self, carried: CarriedShapes, apart: np.ndarray) -> None:
        """Let shapes move with bodies: see `Contact.carry`.

        Raises:
            RodError: rods roll by friction, of which bodies would not get the torque.
        """
        if self.model.rolling.numpy().any():
            raise RodError("rods on shapes that move with them cannot roll; use rolling=False")
        self.carried = carried
        self.model.apart = self.batch.array(apart, dtype=wp.int8)

    def add(self, step: ContactStep) -> None:
        out = self.batch.derivatives
        self._place_carried(step.active)
        self.batch.launch_edges(
            kernels.edge_contact, [self.model, step], [out.gradient, out.hessian]
        )
        if self.carried is not None:
            self.carried.push(self.model, step)

    def refuse(self, converged: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        inputs = [self.model, self._hidden, dof, dof_before]
        self.batch.launch_edges(depths.refuse_tunnelling, inputs, [converged])

    def restart(self, chosen: wp.array, dof: wp.array) -> None:
        """Hide what lies deep inside shapes; it comes out as the chosen rods move on."""
        self._place_carried(chosen)
        self.batch.launch_edges(depths.hide, [chosen, dof], [self.model, self._hidden])

    def find_touching(self, step: ContactStep, touching: wp.array) -> None:
        self._place_carried(step.active, at_end=True)
        self.batch.launch_edges(kernels.find_touching, [self.model, step], [touching])
        self._place_carried(step.active)

    def settle(self, step: ContactStep, slip: wp.array, force: wp.array) -> None:
        pushes = [self.push, self.moment]
        self.batch.launch(kernels.clear_pushes, self.push.shape, [step.active], pushes)
        self.batch.launch_edges(kernels.settle_edges, [self.model], [step, slip, force, *pushes])
        inputs = [self._speed, step.span, step.active]
        self.batch.launch_edges(depths.swell, inputs, [self.model, self._hidden])

    def _place_carried(self, chosen: wp.array | None = None, at_end: bool = False) -> None:
        """Put shapes of the chosen rods, all by default, to where their bodies are in a step, which
        may have left them halfway."""
        if self.carried is not None:
            chosen = self.batch.every_rod if chosen is None else chosen
            self.carried.place(self.model.shapes, chosen, at_end)

    def add_energy(self, step: ContactStep, energy: wp.array) -> None:
        self._place_carried()
        self.batch.launch_edges(energies.add_edge_energy, [self.model, step], [energy])

    def penetration(self, dof: wp.array) -> np.ndarray:
        """(rod,) deepest penetration into any fixture [length]."""
        self._place_carried()
        depth = self.batch.zeros()
        self.batch.launch_edges(depths.measure_depth, [self.model, self._hidden, dof], [depth])
        return depth.numpy().copy()
