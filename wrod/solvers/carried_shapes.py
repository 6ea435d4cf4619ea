"""Shapes that rods touch on bodies that move with the rods."""

import numpy as np
import warp as wp

from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.stepping import body_shapes as kernels
from wrod.solvers.bodies import Bodies


class CarriedShapes:
    """Where shapes are that free bodies carry, and what rods do to these bodies, in their steps.

    Args:
        bodies: of the same batch as the contact.
        slot: (row, shape) the place in its row of the body that carries a shape; -1: of none.
        place, turn: (row, shape, 3) and (row, shape, 4) where it is in the body's frame, as a
            quaternion xyzw.
    """

    def __init__(self, bodies: Bodies, slot: np.ndarray, place: np.ndarray, turn: np.ndarray):
        self.bodies, self.batch = bodies, bodies.batch
        array = self.batch.array
        self.places = carried = kernels.Carried()
        carried.slot = array(slot, dtype=wp.int32)
        carried.place, carried.turn = array(place, dtype=wp.vec3d), array(turn, dtype=wp.quatd)
        bodies.meet_rods()

    def move(self, place: np.ndarray, turn: np.ndarray) -> None:
        """Put shapes elsewhere on their bodies."""
        self.places.place.assign(place)
        self.places.turn.assign(turn)

    def place(self, shapes: wp.array, chosen: wp.array, at_end: bool = False) -> None:
        """Put the shapes of the chosen rows to where Newton's method has their bodies, or, where
        forces are of the middle of a step, to where they are `at_end`."""
        bodies = self.bodies
        self.batch.launch(
            kernels.place_shapes,
            shapes.shape,
            [bodies.body, self.places, chosen, bodies.now, bodies.before, *bodies.spans]
            + [int(at_end)],
            [shapes],
        )

    def push(self, model: Touchable, step: ContactStep) -> None:
        """Add forces and stiffness."""
        bodies = self.bodies
        self.batch.launch_edges(
            kernels.push_carriers,
            [model, self.places, step, bodies.now],
            [bodies.push, bodies.press, bodies.touch],
        )

    def overlaps(self, shapes: wp.array, radius: np.ndarray) -> np.ndarray:
        """(row, shape, edge) how deep edges of these radii (row, edge) are in carried shapes now,
        over the radius."""
        batch = self.batch
        depth = batch.zeros(shapes.shape[1], radius.shape[1])
        inputs = [shapes, self.places, batch.array(radius), batch.state.dof]
        batch.launch(kernels.measure_overlaps, depth.shape, inputs, [depth])
        return depth.numpy()
