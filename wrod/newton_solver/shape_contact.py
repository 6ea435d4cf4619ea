"""Contact of a group's rods with the shapes of a Newton model."""

import numpy as np
import warp as wp

from wrod.kernels.stepping import carrying
from wrod.newton_solver.layout import Layout
from wrod.newton_solver.shapes import Carriers, ModelShapes, RodPlaces
from wrod.rods.batch import RodBatch
from wrod.solvers.bodies import Bodies
from wrod.solvers.carried_shapes import CarriedShapes
from wrod.solvers.contact import Contact

# Under its own weight a rod on a shape sinks in by this fraction of its radius.
_SINKING = 1.0 / 600.0
_STANDARD_GRAVITY = 9.81
# Rods are at most this stiff to a body that others move, over m / dt^2 of it: it gets their load a
# step late, and firmer ones would throw it off.
_FIRMEST = 0.6
# Longest step over sqrt(m / k), k by which one edge is to bear it: in longer ones all together are
# not firm enough.
_LONGEST = 0.9


class ShapeContact:
    """What rods touch, wherever its bodies are.

    Args:
        shapes: those of the model.
        rods: the worlds of the rows, and which bodies move with them.
        layout: of the rods in the batch.
        batch: the rods.
        bodies: those that move with them, or None.
        holds: (row, hold) records of what holds the rods.
        stiffness: normal and tangential stiffness per length of rod [N/m^2], or None.

    Attributes:
        contact: of the rods with these shapes.
        others_move: whether others move bodies of some.
    """

    def __init__(
        self,
        shapes: ModelShapes,
        rods: RodPlaces,
        layout: Layout,
        batch: RodBatch,
        bodies: Bodies | None,
        holds: np.ndarray,
        stiffness: float | None,
    ):
        self._shapes, self._rods, self._device = shapes, rods, batch.device
        self._layout, self._stiffens_by_mass = layout, stiffness is None
        radius = layout.node_values("radius")
        firm = np.asarray(stiffness, dtype=float)
        if stiffness is None:
            firm = layout.line_density() * _STANDARD_GRAVITY / (_SINKING * radius)
        table, friction = shapes.of(rods)
        curved = (batch.natural_curvature.numpy() != 0).any(axis=(1, 2))
        self.contact = Contact(
            batch, radius, firm, friction, table, keeps_roll=curved, passive=layout.ghost
        )
        carriers = shapes.carriers(rods)
        self._body = wp.array(carriers.body, dtype=wp.int32, device=self._device)
        self._place = wp.array(carriers.place, dtype=wp.vec3d, device=self._device)
        self._turn = wp.array(carriers.turn, dtype=wp.quatd, device=self._device)
        self.others_move = bool((carriers.body >= 0).any())
        self._mass = carriers.mass
        self._carried: CarriedShapes | None = None
        # What is given holds for what others move.
        burden = np.where((carriers.slot < 0) & (stiffness is not None), 0.0, carriers.burden)
        if burden.any():
            self.contact.bear(burden)
        bears = self.contact.bearing()
        pressed = (carriers.mass > 0) & (burden > 0)
        self._longest = np.full(bears.shape, np.inf)
        self._longest[pressed] = _LONGEST * np.sqrt(carriers.mass[pressed] / bears[pressed])
        if bodies is not None and (carriers.slot >= 0).any():
            self._carry(bodies, carriers, layout, holds, radius)

    def _carry(
        self, bodies: Bodies, carriers: Carriers, layout: Layout, holds, radius: np.ndarray
    ) -> None:
        """Let shapes move with the bodies that move with the rods."""
        self._carried = carried = CarriedShapes(
            bodies, carriers.slot, carriers.place, carriers.turn
        )
        radius = 0.5 * (radius[:, 1:] + radius[:, :-1])
        deep = carried.overlaps(self.contact.table, radius)
        apart = layout.beside_holds(holds, carriers.slot, deep, radius)
        self.contact.carry(carried, apart)

    def pace(self, duration: float) -> None:
        """Steps of this duration come."""
        if (self._mass > 0).any() and self.contact.solids is not None:
            firmest = _FIRMEST * self._mass / duration**2
            self.contact.solids.yield_to(self._body.numpy(), firmest)

    def count_near(self, dof: wp.array) -> None:
        """Find out how many edges are near bodies that others move."""
        if self.contact.solids is not None:
            self.contact.solids.count_near(dof)

    @property
    def yielding(self) -> list[wp.array]:
        """See `EdgeContact.yielding`."""
        return [] if self.contact.solids is None else self.contact.solids.yielding

    def shaken(self, duration: float) -> dict[int, float]:
        """Bodies that others move, which rods touch, and which steps of that duration shake: their
        longest steps. Waits for the device."""
        short = (self._longest < duration) & (self._body.numpy() >= 0)
        if not short.any():
            return {}
        short &= self.contact.pushes[0].numpy().any(axis=2)
        return dict(zip(self._body.numpy()[short].tolist(), self._longest[short], strict=True))

    def per_mass(self) -> np.ndarray | None:
        """(row, node) stiffness of contact per mass of each node's rod, if it goes with it."""
        if not self._stiffens_by_mass:
            return None
        return self.contact.model.stiffness.numpy() / self._layout.rod_mass()

    def indices(self) -> np.ndarray:
        """(row, shape) of the shapes in the model, -1 where a row has fewer than others."""
        return self._shapes.indices(self._rods)

    def refresh(self) -> None:
        """Take up shapes that were changed."""
        self.contact.set_shapes(*self._shapes.of(self._rods))
        carriers = self._shapes.carriers(self._rods)
        self._place.assign(carriers.place)
        self._turn.assign(carriers.turn)
        if self._carried is not None:
            self._carried.move(carriers.place, carriers.turn)

    @property
    def carriers(self) -> tuple[wp.array, wp.array]:
        """(row, shape) bodies that others move, -1 for none, and the shapes' places on them."""
        return self._body, self._place

    def follow(self, duration: float, times: list, poses: list) -> None:
        """Put shapes to where others have moved their bodies: arguments of `carry_shapes`."""
        if self.others_move:
            where = [self._body, self._place, self._turn, wp.float64(duration)]
            wp.launch(
                carrying.carry_shapes,
                dim=self._body.shape,
                inputs=[*where, *times, *poses],
                outputs=[self.contact.table],
                device=self._device,
            )

    def add_loads(
        self, body_com: wp.array, body_q: wp.array, force: wp.array, torque: wp.array
    ) -> None:
        """Add what rods did at the end of the last step to bodies that others move."""
        if self.others_move:
            wp.launch(
                carrying.measure_pushes,
                dim=self._body.shape,
                inputs=[self._body, body_com, *self.contact.pushes, body_q],
                outputs=[force, torque],
                device=self._device,
            )
