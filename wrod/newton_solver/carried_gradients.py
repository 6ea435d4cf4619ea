"""Gradients by the poses of bodies that others move and whose shapes rods touch."""

from typing import Any

import warp as wp

from wrod.kernels.stepping import carrying_adjoint as kernels
from wrod.newton_solver.shape_contact import ShapeContact
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

    def begin(self, taken: Any) -> None:
        """Remember how shapes are now, and let them yield as in `taken`, of
        `wrod.newton_solver.taken_steps.Taken`."""
        arrays = self._arrays
        self._kept = [wp.clone(array) for array in arrays]
        for array, then in zip(arrays[1:], taken.yielding, strict=True):
            wp.copy(array, then)

    def end(self) -> None:
        """Put them back to how they were."""
        for array, kept in zip(self._arrays, self._kept, strict=True):
            wp.copy(array, kept)

    @property
    def _arrays(self) -> list[wp.array]:
        return [self._touched.contact.table, *self._touched.yielding]

    def place(self, step: Any, taken: Any) -> None:
        """Put shapes to where they were in a step of rods."""
        batch = self._adjoint.batch
        batch.launch(kernels.find_begun, batch.rod_count, [step], [self._begun])
        times = [step.active, taken.changed, step.until, self._begun, step.span]
        self._touched.follow(taken.duration, times, [taken.poses_before, taken.poses])

    def want(self, step: Any, taken: Any, by_before: wp.array, by_poses: wp.array) -> None:
        """Let what is wanted of shapes be wanted of (body, 7) poses at the start of the simulator's
        step and at its end."""
        carrier, place = self._touched.carriers
        self._adjoint.batch.launch(
            kernels.want_carriers,
            carrier.shape,
            [carrier, place, wp.float64(taken.duration), step, taken.changed]
            + [taken.poses_before, taken.poses, self._adjoint.by_shape],
            [by_before, by_poses],
        )
