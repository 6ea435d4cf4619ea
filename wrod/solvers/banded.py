"""Systems of equations with the banded Hessians of a batch of rods."""

from collections.abc import Sequence

import numpy as np
import warp as wp

from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.lanes import WARP, lanes
from wrod.kernels.linear import banded, banded_ends, banded_lanes, factor_lanes, two_warps
from wrod.rods.batch import RodBatch


def multiply_banded(
    batch: RodBatch, active: wp.array, hessian: wp.array, vectors: wp.array, product: wp.array
) -> None:
    """Products (rod, vector, row) of matrices (rod, row, 11) of a batch's rods with vectors."""
    rods, columns, rows = vectors.shape
    count = lanes(batch.device, rows)
    inputs = [count, active, hessian, vectors]
    batch.launch(banded.multiply, (rods, columns, count), inputs, [product])


class BandedSystem:
    """Factorisation of the free block of a batch's Hessian, and solutions with it.

    A CPU takes a node at a time, coupled with two before it. A GPU gives each rod a warp, also of
    those that share a row; `eliminate` solves there for one right-hand side from both ends of each
    rod with two.

    Args:
        batch: the rods.
        right_hand_sides: how many `solve` takes.

    Attributes:
        factor: (rod, dof, 11) L and D of the last factorisation; see `kernels.banded`.
        shift: (rod,) multiple of the identity that `factorise` adds to the Hessian.
        negative_pivots: (rod,) negative eigenvalues of what was factorised.
        x: (rod, right-hand side, dof) right-hand sides, then solutions.
        shortened: (rod,) part of the first solution that `shorten` left.
        segment: (segment,) first degree of freedom and number of those of each rod of a row.
    """

    def __init__(self, batch: RodBatch, right_hand_sides: int = 1):
        self.batch, dofs = batch, batch.dof_count
        self.factor = batch.zeros(dofs, HALF_BANDWIDTH + 1)
        self.shift = batch.zeros()
        self.negative_pivots = batch.zeros(dtype=wp.int32)
        self.x = batch.zeros(right_hand_sides, dofs)
        self.shortened = wp.ones(batch.rod_count, dtype=wp.float64, device=batch.device)
        first = 4 * np.array([0, *(e + 1 for e in batch.cut_edges), batch.node_count])
        first[-1] = dofs
        parts = np.column_stack([first[:-1], np.diff(first)])
        self.segment = batch.array(parts, dtype=wp.vec2i)

    def shorten(self, active: wp.array) -> None:
        """Shorten the first solution to what a Newton iteration may take of it: all."""

    def eliminate(self, gradient: wp.array, hessian: wp.array, active: wp.array) -> None:
        """Factorise `hessian` and solve for `gradient` (rod, dof), into the first column of `x`.

        Nothing else can be solved after that."""
        count = lanes(self.batch.device, two_warps.ENDS)
        self._clear_pivots(active)
        inputs = [active, self.batch.free, hessian, gradient, self.shift]
        outputs = [self.factor, self.x, self.negative_pivots]
        kernel, dim = banded.eliminate, (self.batch.rod_count,)
        if self._on_gpu:
            kernel, dim = banded_ends.solve, (*dim, len(self.segment), count)
            inputs = [self.segment, *inputs]
        self.batch.launch(kernel, dim, inputs, outputs, count)

    def _factorise_and_solve(self, gradient, hessian, active) -> None:
        self.factorise(hessian, active)
        wp.copy(self.x[:, 0], gradient)
        self.solve(active, columns=1)

    def _clear_pivots(self, active: wp.array) -> None:
        """Segments of a row add theirs up."""
        if len(self.segment) > 1:
            rods, outputs = self.batch.rod_count, [self.negative_pivots]
            self.batch.launch(banded_lanes.clear_pivots, rods, [active], outputs, WARP)

    def factorise(self, hessian: wp.array, active: wp.array) -> None:
        """Factorise the free blocks of `hessian` (rod, dof, 11), which is contiguous."""
        self._clear_pivots(active)
        self._launch(
            (banded.factorise, factor_lanes.factorise),
            (self.batch.rod_count,),
            [active, self.batch.free, hessian, self.shift],
            [self.factor, self.negative_pivots],
        )

    def solve(self, active: wp.array, columns: int | None = None) -> None:
        """Overwrite the first (default: all) right-hand sides in `x` with their solutions."""
        self.solve_in(self.x, active, columns)

    def solve_in(self, x: wp.array, active: wp.array, columns: int | None = None) -> None:
        """The same in an array of one's own."""
        self._launch(
            (banded.solve, banded_lanes.solve),
            (self.batch.rod_count, columns or x.shape[1]),
            [active, self.batch.free, self.factor],
            [x],
        )

    @property
    def _on_gpu(self) -> bool:
        return lanes(self.batch.device) > 1

    def _launch(self, kernels, dim: tuple, inputs: list, outputs: list) -> None:
        """Of the two kernels the first takes a row a thread, the second a rod a warp."""
        count = lanes(self.batch.device)
        kernel = kernels[self._on_gpu]
        if self._on_gpu:
            dim, inputs = (*dim, len(self.segment), count), [self.segment, *inputs]
        self.batch.launch(kernel, dim, inputs, outputs, count)


class BorderedSystem(BandedSystem):
    """A `BandedSystem` with a border: degrees of freedom that are not free in it, for which a small
    system is to be condensed.

    Args:
        batch: the rods.
        coordinates: indices of the border's degrees of freedom, negative from the end.
    """

    def __init__(self, batch: RodBatch, coordinates: Sequence[int]):
        super().__init__(batch, right_hand_sides=1 + len(coordinates))
        indices = [a % batch.dof_count for a in coordinates]
        self.border = batch.array(indices, dtype=wp.int32)

    def load(
        self, gradient: wp.array, hessian: wp.array, active: wp.array, columns: int | None = None
    ) -> None:
        """Fill the first (default: all) right-hand sides: `gradient` (rod, dof), then the columns
        of `hessian` (rod, dof, 11) that belong to the border."""
        self.batch.launch(
            banded.load_border,
            (self.x.shape[0], columns or self.x.shape[1], self.x.shape[2]),
            [self.border, active, gradient, hessian],
            [self.x],
        )

    def eliminate(self, gradient: wp.array, hessian: wp.array, active: wp.array) -> None:
        """Factorise `hessian`, and solve for `gradient` and for all columns of the border."""
        self.factorise(hessian, active)
        self.load(gradient, hessian, active)
        self.solve(active)
