"""The adjoint of what rods and shapes on bodies that move with them do to each other."""

from typing import Any

import warp as wp

from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.stepping import body_shapes_adjoint as kernels
from wrod.kernels.stepping.body_shapes import place_shapes
from wrod.solvers.bodies import motion_of
from wrod.solvers.carried_shapes import CarriedShapes


class CarriedAdjoint:
    """Goes back through touches, with `wrod.solvers.body_adjoint.BodyAdjoint`.

    Args:
        carried: the shapes.
        model, touched: how edges touch them, and in the step gone through.
        steps: `wrod.kernels.stepping.body_adjoint.BodySteps` of the step gone through.
        borne: `wrod.kernels.contact.shapes.Borne`, to be filled.
        by_shape: `wrod.kernels.contact.edge_adjoint.WantedShapes`, to be used up.
    """

    def __init__(
        self, carried: CarriedShapes, model: Touchable, touched: ContactStep, steps: Any,
        borne: Any, by_shape: Any,
    ):  # fmt: skip
        self._carried, self._model, self._touched = carried, model, touched
        self._borne, self._by_shape = borne, by_shape
        self._batch = carried.batch
        rest = [steps.momentum] * 2  # is not asked for
        self._now = motion_of(steps.place, steps.turn, *rest)
        self._before = motion_of(steps.place_before, steps.turn_before, *rest)

    def place(self, at: Any) -> None:
        """Put shapes to where they were in a step of rods."""
        self._batch.launch(
            place_shapes,
            self._model.shapes.shape,
            [self._carried.bodies.body, self._carried.places, at.active]
            + [self._now, self._before, at.span, at.whole, 0],
            [self._model.shapes],
        )

    def weigh(self, at: Any, wanted: Any, system: list, rods: list) -> None:
        """Add to the bodies' system and to the rods' right-hand sides."""
        batch = self._batch
        batch.launch_edges(
            kernels.weigh_touches,
            [self._model, self._carried.places, self._touched, wanted, self._now],
            system,
        )
        on_bodies = system[2]
        batch.launch(kernels.add_touches, on_bodies.shape, [batch.free, at.active, on_bodies], rods)

    def bear(self, at: Any, on_bodies: wp.array, multiplier: wp.array, wanted: wp.array) -> None:
        """From the bodies' multipliers: what is wanted of what is not free, and how shapes would
        be moved by them."""
        batch = self._batch
        inputs = [batch.free, at.active, on_bodies, multiplier]
        batch.launch_dofs(kernels.want_held, inputs, [wanted])
        inputs = [self._carried.places, at.active, self._now, multiplier]
        batch.launch(kernels.bear, self._model.shapes.shape, inputs, [self._borne])

    def want_before(self, at: Any, before: Any) -> None:
        """From shapes at the start of the step to their bodies (`WantedBodies`)."""
        inputs = [self._carried.places, self._model.shapes, at.active, self._before]
        shape = self._model.shapes.shape
        self._batch.launch(kernels.want_carriers_before, shape, inputs, [self._by_shape, before])
