"""Linear systems of rows of many rods that touch, for a whole GPU."""

import numpy as np
import warp as wp

from wrod.kernels.lanes import WARP, lanes
from wrod.kernels.linear import banded, banded_lanes, condensing, dense_lanes
from wrod.solvers.coupled import CoupledSystem, PairedSystem
from wrod.solvers.rod_contact import RodContact

# Rows of so many rods and nodes are condensed on a GPU; smaller ones are factorised exactly.
_RODS, _NODES = 8, 200
# Numbers that the condensed matrices of a batch may have.
_LARGEST = 5e8
# Columns and threads that a GPU works on at a time.
_COLUMNS, _THREADS = 2048, 1 << 17


class CondensedSystem(PairedSystem):
    """A `PairedSystem` that is reduced to three unknowns a pair: rods are factorised side by side,
    and the dense rest by the whole device (`wrod.kernels.linear.condensing`).

    How the normals of pairs turn is left out of the matrix: Newton's iteration converges to the
    same, a little slower where rods lie along each other.

    Args:
        contact, right_hand_sides: as of `PairedSystem`.
    """

    def __init__(self, contact: RodContact, right_hand_sides: int = 1):
        batch = contact.batch
        rods, device = batch.rod_count, batch.device
        tile = dense_lanes.TILE
        most = np.sqrt(_LARGEST / rods)
        unknowns = tile * int(min(-(-3 * batch.node_count // tile), most // tile))
        super().__init__(contact, right_hand_sides, unknowns // 3)
        self._unknowns = unknowns
        parts = self.segment.numpy()
        owner = np.repeat(np.arange(len(parts)), -(-parts[:, 1] // 4))
        self._owner = batch.array(owner, dtype=wp.int32)
        pairs, columns = unknowns // 3, self.x.shape[1]

        self._weight = batch.zeros(18 * pairs, dtype=wp.vec4d)
        self._column = batch.zeros(6 * pairs, int(parts[:, 1].max()))
        self._matrix, self._size = batch.zeros(unknowns, unknowns), batch.zeros(unknowns)
        self._panel, self._diagonal = batch.zeros(2 * unknowns, tile), batch.zeros(unknowns, tile)
        self._t, self._push = batch.zeros(columns, unknowns), wp.zeros_like(self.x)
        self._tiles, self._arrived = (batch.zeros(dtype=wp.int32) for _ in range(2))
        self._turns = (_COLUMNS, _THREADS) if self._on_gpu else (1, 1)
        # Blocks that wait for each other must all be there at once.
        there = wp.get_device(device).sm_count if self._on_gpu else 1
        self._blocks = max(1, there // rods)

    def _spread(self, kernel, dim: tuple, inputs: list, outputs: list, block: int = 0) -> None:
        """Launch over (row, *dim), with the lanes of a block as last dimension where there are."""
        dim, count = (self.batch.rod_count, *dim), lanes(self.batch.device, block or WARP)
        if block:
            self.batch.launch(kernel, (*dim, count), inputs, outputs, count)
        else:
            self.batch.launch(kernel, dim, inputs, outputs)

    @property
    def _touched(self) -> list:
        return [self._tiles, self.pair_count, self.touching, self._weight]

    def factorise(self, hessian: wp.array, active: wp.array) -> None:
        batch, contact = self.batch, self.contact
        columns, threads = self._turns
        self._collect(active)
        super().factorise(hessian, active)
        self._spread(
            condensing.weigh_pairs,
            (self.touching.shape[1],),
            [contact.pieces, self.coupled, contact.overflow, batch.free, *self._pairs],
            [self._weight, self._tiles, self._arrived],
        )
        rods = [self.segment, self._owner]
        _, count, pairs, weight = self._touched
        self._spread(
            condensing.solve_pairs,
            (columns,),
            [*rods, self._tiles, batch.free, self.factor, count, pairs, weight, columns],
            [self._column],
            WARP,
        )
        self._spread(
            condensing.condense,
            (threads,),
            [*rods, *self._touched, self._column, threads],
            [self._matrix, self._size],
        )
        self._spread(
            dense_lanes.factorise,
            (self._blocks,),
            [self._tiles, self._size, self._blocks],
            [self._arrived, self._matrix, self._panel, self.negative_pivots, self._diagonal],
            dense_lanes.BLOCK,
        )

    def solve(self, active: wp.array, columns: int | None = None) -> None:
        """Overwrite the first (default: all) right-hand sides in `x` with their solutions."""
        super().solve(active, columns)
        count, dofs = columns or self.x.shape[1], self.x.shape[2]
        self._spread(
            condensing.gather, (count, self._unknowns), [*self._touched, self.x], [self._t]
        )
        self._spread(
            dense_lanes.solve,
            (count,),
            [self._tiles, self._matrix, self._diagonal],
            [self._t],
            dense_lanes.SOLVE_BLOCK,
        )
        self._spread(condensing.clear, (count, dofs), [self._tiles], [self._push])
        ends = 2 * self.touching.shape[1]
        self._spread(condensing.scatter, (count, ends), [*self._touched, self._t], [self._push])
        self._launch(
            (banded.solve, banded_lanes.solve),
            (self.batch.rod_count, count),
            [self.coupled, self.batch.free, self.factor],
            [self._push],
        )
        self._spread(condensing.take_off, (count, dofs), [self._tiles, self._push], [self.x])


def paired_system(contact: RodContact, right_hand_sides: int) -> PairedSystem:
    """The system for rods in contact: exact, or condensed for large rows on a GPU."""
    batch = contact.batch
    large = batch.node_count > _NODES and len(batch.cut_edges) + 1 >= _RODS
    if large and wp.get_device(batch.device).is_cuda:
        return CondensedSystem(contact, right_hand_sides)
    return CoupledSystem(contact, right_hand_sides)
