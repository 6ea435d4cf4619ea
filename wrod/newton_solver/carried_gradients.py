"""Gradients by the poses of bodies that others move and whose shapes rods touch."""

from typing import Any

import warp as wp

from wrod.kernels.stepping import carrying_adjoint as kernels
from wrod.newton_solver.shape_contact import ShapeContact
from wrod.newton_solver.taken_steps import Taken
from wrod.solvers.adjoint import StepAdjoint


class CarriedGradients:
    """Goes back through the ways of shapes in one step of a group after the other.

    Args:
        touched: the shapes.
        adjoint: of the steps of the rods that touch them.
    """

    def __init__(self, touched: ShapeContact, adjoint: StepAdjoint):
        self._touched, self._adjoint = touched, adjoint
        self._begun = wp.zeros_like(adjoint.step.time)
        self._kept: list[wp.array] = []

    def begin(self, taken: Taken, by_poses: list[wp.array]) -> None:
        """Remember how shapes are now, and let them yield as in this step; what is wanted of them
        goes to `by_poses` (body, 7) at its start and at its end."""
        self._taken, self._by_poses, arrays = taken, by_poses, self._arrays
        self._kept = [wp.clone(array) for array in arrays]
        for array, then in zip(arrays[1:], taken.yielding, strict=True):
            wp.copy(array, then)

    def end(self, _by_read: wp.array) -> None:
        """Put them back to how they were."""
        for array, kept in zip(self._arrays, self._kept, strict=True):
            wp.copy(array, kept)

    @property
    def _arrays(self) -> list[wp.array]:
        return [self._touched.contact.table, *self._touched.yielding]

    def place(self, step: Any) -> None:
        """Put shapes to where they were in a step of rods."""
        batch, taken = self._adjoint.batch, self._taken
        batch.launch(kernels.find_begun, batch.rod_count, [step], [self._begun])
        times = [step.active, taken.changed, step.until, self._begun, step.span]
        self._touched.follow(taken.duration, times, [taken.poses_before, taken.poses])

    def want(self, step: Any) -> None:
        """Let what is wanted of shapes be wanted of the poses."""
        taken, (carrier, place) = self._taken, self._touched.carriers
        self._adjoint.batch.launch(
            kernels.want_carriers,
            carrier.shape,
            [carrier, place, wp.float64(taken.duration), step, taken.changed]
            + [taken.poses_before, taken.poses, self._adjoint.by_shape],
            self._by_poses,
        )
