"""Shapes that rods touch: the table and fixtures on it, with Coulomb friction."""

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.contact import energies, linearised
from wrod.kernels.contact import planes as kernels
from wrod.kernels.contact import rolling as rolls
from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.contact.shapes import NOTHING, Shape
from wrod.rods.batch import RodBatch
from wrod.rods.device import OnDevice
from wrod.rods.discretisation import cells
from wrod.solvers.carried_shapes import CarriedShapes
from wrod.solvers.edge_contact import Bristles, EdgeContact
from wrod.solvers.friction import Friction, FrictionField, contact_damping
from wrod.solvers.solids import Plane, shape_record

_IS_FRICTION = arguments.like("a wrod.Friction", "static", "kinetic")
_IS_SHAPE = arguments.like("a Plane or a solid", "_describe")
# One or a list of them.
_FRICTIONS = arguments.either(_IS_FRICTION, arguments.several(_IS_FRICTION, least=0))
_SHAPES = arguments.either(_IS_SHAPE, arguments.several(_IS_SHAPE, least=0))
# Normal forces rise over this part of the radius: thin against the penetration that is allowed.
_SKIN = 0.01
# Radius that keeps a node apart from everything, negative [length].
_FAR = 1e100


@dataclass
class Contact(OnDevice):
    """Contact of every rod of a batch with shapes; arrays live on the batch's device.

    A rod's nodes touch planes, its edges solids, wherever between their nodes these stand
    (`wrod.kernels.contact.edges`). A step of `Dynamics` in which a centreline could have
    met a fixture on the way is refused and halved, so that nothing tunnels however thin it is. What
    begins inside a solid by more than half a radius is let out slowly.

    Args:
        batch: the rods.
        radius: (rod,) radius of the section, or (rod, node) in a batch whose rows hold several
            rods [length].
        stiffness: (rod,) or (rod, node) normal and tangential stiffness of the contact per length
            of rod [force/length^2]: under its weight w per length a rod sinks in by about
            w / stiffness.
        friction: one for all rods, one per rod, or for every rod a list of one per shape.
        shapes: planes and solids (`wrod.solvers.solids`) that every rod touches, or for every rod a
            list of its own; default: the table z = 0.
        restitution: (rod,) speed after an impact over that before, of a rod that lands flat, below
            1; 0 is as little as a viscous contact leaves, a hundredth.
        friction_field: how the friction of planes varies over x and y; default: it does not.
        keeps_roll: (rod,) whether what touches a shape keeps its roll, unless its friction says
            that it rolls. That counts for naturally curved rods, whose roll says where they bend.
        passive: (rod, node) nodes that touch nothing, as nothing does of the edges beside them;
            default: none.

    Attributes:
        time_step: (rod,) duration of the present step, for what depends on rates; a `Dynamics` says
            it, without one rates are 0.
        iteration: (rod,) number of the present one of Newton's method; a `Dynamics` says it. By
            default `ended`, -1 all: the matrix is that of a state where none follows.
        model: what nodes touch, and how: `wrod.kernels.contact.law.Touchable`.
        bristles: what friction remembers of nodes.
        force: (rod, node) force on each node at the end of the last step.
        slip: (rod, node) distance that each node has slid in all [length].
        holds_roll: whether the roll of any rod is kept.

    Raises:
        RodError: radius or stiffness is not positive and finite, a shape has no size, or friction
            and shapes do not match.
    """

    batch: RodBatch
    radius: np.ndarray
    stiffness: np.ndarray
    friction: Friction | list[Friction] | list[list[Friction]]
    shapes: tuple | list[list] = (Plane(),)
    restitution: np.ndarray | float = 0.0
    friction_field: FrictionField | None = None
    keeps_roll: np.ndarray | bool = False
    passive: np.ndarray | None = None
    force: wp.array = field(init=False)
    burdened: np.ndarray | bool = field(default=False, init=False)
    slip: wp.array = field(init=False)

    def __post_init__(self) -> None:
        self._check()
        batch, device = self.batch, self.batch.device
        rods, nodes = batch.rod_count, batch.node_count
        radius = _per_node("radius", self.radius, (rods, nodes))
        stiffness = _per_node("stiffness", self.stiffness, (rods, nodes))

        floats = batch.array
        shapes, static, kinetic, rolling, roll = self._table()
        idle = np.zeros((rods, nodes), dtype=bool)
        if self.passive is not None:
            if arguments.truths(self.passive) or np.shape(self.passive) != (rods, nodes):
                raise RodError(f"Contact: passive must be truths of shape {(rods, nodes)}")
            idle = np.asarray(self.passive)
        damping = contact_damping(np.broadcast_to(self.restitution, (rods,)))
        firm = stiffness * cells(batch.rest_length.numpy())
        ratio = batch.node_mass.numpy() / firm
        field = self.friction_field
        self.model = model = Touchable()
        model.shapes, model.rest_length = shapes, batch.rest_length
        model.static_friction, model.kinetic_friction = floats(static), floats(kinetic)
        model.roll_friction, model.rolling = floats(self._kept(roll, rolling)), floats(rolling)
        model.radius = floats(np.where(idle, -_FAR, radius))
        model.stiffness = floats(firm)
        model.skin = floats(_SKIN * radius)
        model.relaxation = floats(damping[:, None] * np.sqrt(ratio))
        everywhere = np.ones((1, 1)), (0.0, 0.0, 1.0, 1.0)
        factor, place = everywhere if field is None else (field.factor, field._place())
        model.field = floats(factor)
        model.place = wp.vec4d(*map(float, place))
        self.time_step = floats(np.full(rods, np.inf))
        self._edges = EdgeContact(
            batch, np.where(idle, np.nan, radius), stiffness, _SKIN, model, damping
        )
        self._note_fixtures()
        self.bristles = Bristles(batch, shapes.shape[1], nodes)
        self.ended = self.iteration = wp.full(rods, -1, dtype=wp.int32, device=device)
        self.slip = batch.zeros(nodes)
        self.force = batch.zeros(nodes, dtype=wp.vec3d)
        if self._has_fixtures:
            self._edges.restart(batch.every_rod, batch.state.dof)

    def _check(self) -> None:
        """Kinds of the arguments; their sizes where they are used."""
        arguments.check_fields(
            self,
            RodError,
            batch=arguments.like("a wrod.RodBatch", "rod_count", "node_count", "state"),
            radius=arguments.numbers_of_any_shape,
            stiffness=arguments.numbers_of_any_shape,
            friction=arguments.either(_IS_FRICTION, arguments.several(_FRICTIONS)),
            shapes=arguments.several(_SHAPES, least=0),
            restitution=arguments.numbers_of_any_shape,
            friction_field=arguments.optional(
                arguments.like("a FrictionField", "factor", "x", "y")
            ),
            keeps_roll=arguments.truths,
        )
        rods = self.batch.rod_count
        for name in ("restitution", "keeps_roll"):
            if np.shape(getattr(self, name)) not in ((), (1,), (rods,)):
                raise RodError(f"Contact: {name} must have shape ({rods},)")

    def _note_fixtures(self) -> None:
        rows = self.shapes if isinstance(self.shapes, list) else [self.shapes]
        rows = rows if all(isinstance(row, (list, tuple)) for row in rows) else [rows]
        self._has_fixtures = any(not isinstance(s, Plane) for row in rows for s in row)

    def _table(self):
        """Shapes (rod, shape), static and kinetic coefficients (rod, shape), rolling (rod,), those
        of keeping the roll (rod, shape)."""
        rods = self.batch.rod_count
        shapes, friction = self.shapes, self.friction
        if not (isinstance(shapes, list) and all(isinstance(s, (list, tuple)) for s in shapes)):
            shapes = [list(shapes)] * rods
        friction = [friction] * rods if isinstance(friction, Friction) else friction
        if len(shapes) != rods or len(friction) != rods:
            raise RodError(
                f"contact of {rods} rods has shapes for {len(shapes)} and friction for "
                f"{len(friction)}; give one for all or one for every rod"
            )
        width = max(len(row) for row in shapes)
        nothing = Shape()
        nothing.kind = int(NOTHING)
        table = []
        static, kinetic = np.zeros((2, rods, width))
        rolling, roll = np.zeros(rods), np.zeros((rods, width))
        described = {}
        for r, (row, laws) in enumerate(zip(shapes, friction, strict=True)):
            laws = [laws] * len(row) if isinstance(laws, Friction) else laws
            if len(laws) != len(row) or len({law.rolling for law in laws}) > 1:
                raise RodError(
                    f"contact of rod {r} has {len(row)} shapes and {len(laws)} frictions; give "
                    "one for every shape, all rolling or none"
                )
            for shape in row:
                if id(shape) not in described:
                    described[id(shape)] = shape_record(shape)
            table += [described[id(s)] for s in row] + [nothing] * (width - len(row))
            static[r, : len(row)] = [law.static for law in laws]
            kinetic[r, : len(row)] = [
                law.static if law.kinetic is None else law.kinetic for law in laws
            ]
            roll[r, : len(row)] = [law.static if law.roll is None else law.roll for law in laws]
            rolling[r] = any(law.rolling for law in laws)
        shaped = wp.empty((rods, width), dtype=Shape, device=self.batch.device)
        if table:
            wp.copy(shaped.flatten(), wp.array(table, dtype=Shape, device="cpu"))
        return shaped, static, kinetic, rolling, roll

    def _kept(self, roll: np.ndarray, rolling: np.ndarray) -> np.ndarray:
        """(rod, shape) coefficients that keep the roll; -1 of rods that roll."""
        kept = np.broadcast_to(self.keeps_roll, rolling.shape) & (rolling == 0)
        self.holds_roll = bool(kept.any())
        return np.where(kept[:, None], roll, -1.0)

    @property
    def table(self) -> wp.array:
        """(rod, shape) `wrod.kernels.contact.shapes.Shape`, for kernels that move them."""
        return self.model.shapes

    def step_of(
        self, of: "Contact | EdgeContact", active: wp.array, dof: wp.array, dof_before: wp.array
    ) -> ContactStep:
        """The present step of the rods that are not 0 in `active`, of nodes or of edges."""
        span, iteration = self.time_step, self.iteration
        return of.bristles.step(
            active=active, span=span, dof=dof, dof_before=dof_before, iteration=iteration
        )

    @property
    def solids(self) -> EdgeContact | None:
        """Contact of edges, where there is any."""
        return self._edges if self._has_fixtures else None

    @property
    def pushes(self) -> tuple[wp.array, wp.array]:
        """(rod, shape) force on each solid at the end of the last step, and its moment about the
        origin."""
        return self._edges.push, self._edges.moment

    @arguments.checked(
        RodError,
        shapes=arguments.several(_SHAPES, least=0),
        friction=arguments.either(_IS_FRICTION, arguments.several(_FRICTIONS)),
    )
    def set_shapes(self, shapes, friction) -> None:
        """Move shapes, or change their friction; as many for every rod as before.

        Raises:
            RodError: the most shapes that a rod touches is not what it was, or as above.
        """
        before = self.shapes, self.friction
        self.shapes, self.friction = shapes, friction
        table, static, kinetic, rolling, roll = self._table()
        if table.shape != self.table.shape:
            self.shapes, self.friction = before
            raise RodError("the number of shapes changed; make a new Contact")
        wp.copy(self.table, table)
        self.model.static_friction.assign(static)
        self.model.kinetic_friction.assign(kinetic)
        self.model.rolling.assign(rolling)
        self.model.roll_friction.assign(self._kept(roll, rolling))
        self._note_fixtures()

    def carry(self, carried: CarriedShapes, apart: np.ndarray) -> None:
        """Let solids move with bodies: `apart` (rod, shape, edge) is what does not touch."""
        self._edges.carry(carried, apart)

    def bear(self, burden: np.ndarray) -> None:
        """Let shapes press: `burden` (rod, shape) is the weight that one edge bears sunk in by a
        fortieth of the radius [force]; what has none bears the heaviest by a `burdened` rod."""
        heaviest = burden.max(axis=1, keepdims=True)
        self._edges.bear(np.maximum(burden, np.where(burden > 0, 0, heaviest)))
        model = self.model
        given = model.stiffness.numpy()
        firm = np.maximum(given, 0.5 * heaviest / model.skin.numpy())
        self.burdened = firm > given
        model.stiffness.assign(firm)  # who lies on what others press comes to rest no sooner

    def add(self, active: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Add forces and stiffness at `dof` to the batch's gradient and Hessian."""
        out = [self.batch.derivatives.gradient, self.batch.derivatives.hessian]
        inputs = [self.model, self.step_of(self, active, dof, dof_before)]
        self.batch.launch_nodes(kernels.contact, inputs, out)
        if self._has_fixtures:
            self._edges.add(self.step_of(self._edges, active, dof, dof_before))
        if self.holds_roll:
            self.batch.launch_nodes(rolls.hold_roll, inputs, out)

    def linearise(
        self, accepted: wp.array, dof: wp.array, dof_before: wp.array, outputs: list[wp.array]
    ) -> None:
        """Derivatives of the first shape's contact at the end of accepted steps; before `settle`.

        Args:
            accepted: (rod,) whose steps are.
            dof, dof_before: (rod, dof) at the end and at the start of the steps.
            outputs: (rod, node) each: see `wrod.kernels.contact.linearised.linearise_contact`.
        """
        inputs = [self.model, self.step_of(self, accepted, dof, dof_before)]
        self.batch.launch_nodes(linearised.linearise_contact, inputs, outputs)

    def bearing(self) -> np.ndarray:
        """(rod, shape) stiffness that an edge has for what it is to bear [force/length]."""
        return self._edges.bearing()

    @property
    def tangent_stiffness(self) -> wp.array:
        """(rod, node) stiffness of each node's bristle [force/length]."""
        return self.model.stiffness

    def restart(self, chosen: wp.array) -> None:
        """Let the rods that are not 0 in `chosen` (rod,) touch everything for the first time."""
        for bristles in (self.bristles, self._edges.bristles):
            shape = bristles.arrays["bristle"].shape
            self.batch.launch(kernels.forget_friction, shape, [chosen], [bristles.step()])
        if self._has_fixtures:
            self._edges.restart(chosen, self.batch.state.dof)

    def refuse(
        self, converged: wp.array, active: wp.array, dof: wp.array, dof_before: wp.array
    ) -> None:
        """Take back the convergence of steps that are too large for nothing to tunnel."""
        if self._has_fixtures:
            self._edges.refuse(converged, dof, dof_before)

    def find_touching(
        self, chosen: wp.array, dof: wp.array, dof_before: wp.array, touching: wp.array
    ) -> None:
        """Raise `touching` (rod,) of the chosen rods to 1 where they touch, to 2 in an impact."""
        inputs = [self.model, self.step_of(self, chosen, dof, dof_before)]
        self.batch.launch_nodes(kernels.find_touching, inputs, [touching])
        if self._has_fixtures:
            self._edges.find_touching(self.step_of(self._edges, chosen, dof, dof_before), touching)

    def settle(self, accepted: wp.array, dof: wp.array, dof_before: wp.array) -> None:
        """Carry the friction of accepted steps over to the next."""
        step = self.step_of(self, accepted, dof, dof_before)
        outputs = [step, self.slip, self.force]
        self.batch.launch_nodes(kernels.settle_friction, [self.model], outputs)
        if self.holds_roll:
            self.batch.launch_nodes(rolls.settle_roll, [self.model], [step])
        if self._has_fixtures:
            step = self.step_of(self._edges, accepted, dof, dof_before)
            self._edges.settle(step, self.slip, self.force)

    def energy(self) -> np.ndarray:
        """(rod,) elastic energy of what touches now, with that of its friction."""
        batch = self.batch
        energy = wp.zeros(batch.rod_count, dtype=wp.float64, device=batch.device)
        here = batch.every_rod, batch.state.dof, batch.state.dof
        inputs = [self.model, self.step_of(self, *here)]
        batch.launch_nodes(energies.add_node_energy, inputs, [energy])
        if self._has_fixtures:
            self._edges.add_energy(self.step_of(self._edges, *here), energy)
        return energy.numpy()

    def penetration(self) -> np.ndarray:
        """(rod,) how deep each rod is in any solid now [length]."""
        if not self._has_fixtures:
            return np.zeros(self.batch.rod_count)
        return self._edges.penetration(self.batch.state.dof)


def _per_node(name: str, values, shape: tuple[int, int]) -> np.ndarray:
    """(rod, node) of what is given for all, per rod or per node."""
    values = np.asarray(values, dtype=float)
    if values.ndim < 2:
        values = arguments.spread(values, shape[:1], f"contact {name}", RodError)[:, None]
    if not (np.isfinite(values) & (values > 0)).all():
        raise RodError(f"contact {name} must be positive and finite")
    return arguments.spread(values, shape, f"contact {name}", RodError)
