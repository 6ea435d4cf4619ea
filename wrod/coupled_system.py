"""Linear systems of rods whose contacts couple nodes far apart along them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

from wrod.banded import BandedSystem
from wrod.kernels import skyline
from wrod.kernels.lanes import WARP
from wrod.kernels.segments import SMOOTHING

if TYPE_CHECKING:
    from wrod.rod_contact import RodContact

# Up to this many nodes a rod's factor may fill; beyond, rows of so many blocks on average.
_DENSE_NODES, _BLOCKS_PER_ROW = 200, 100


class CoupledSystem(BandedSystem):
    """A `BandedSystem` with the stiffness of a `RodContact` in it; rods that touch nothing are
    factorised as banded ones are.

    `negative_pivots` counts the negative eigenvalues of the whole matrix, contacts included.

    Args:
        contact: the contact between rods, evaluated (`RodContact.add`) before each `factorise`.
    """

    def __init__(self, contact: RodContact):
        batch = contact.batch
        super().__init__(batch)
        self.contact = contact
        rods, nodes, device = batch.rod_count, batch.node_count, batch.device

        def ints(*shape):
            return wp.zeros((rods, *shape), dtype=wp.int32, device=device)

        if nodes <= _DENSE_NODES:
            self._capacity = nodes * (nodes + 1) // 2
        else:
            self._capacity = nodes * _BLOCKS_PER_ROW
        pairs = 6 * nodes
        self.banded, self.coupled, self.pair_count = ints(), ints(), ints()
        self.touching = wp.zeros((rods, pairs), dtype=wp.vec3i, device=device)
        self._head, self._link = ints(nodes), ints(2 * pairs)
        self._rank, self._order, self._first, self._row = (ints(nodes) for _ in range(4))
        self._block = wp.zeros((rods, self._capacity), dtype=wp.mat44d, device=device)
        self._y = wp.zeros((rods, nodes), dtype=wp.vec4d, device=device)

    def _per_rod(self, kernel, inputs, outputs) -> None:
        batch = self.batch
        wp.launch(
            kernel,
            batch.rod_count,
            inputs=inputs,
            outputs=outputs,
            device=batch.device,
            block_dim=WARP,
        )

    def factorise(self, hessian: wp.array, active: wp.array) -> None:
        batch, contact = self.batch, self.contact
        overflow = contact.overflow
        self._per_rod(
            skyline.collect,
            [active, contact.partner_count, contact.partner, contact.depth],
            [self.pair_count, self.touching, overflow, self.banded, self.coupled],
        )
        super().factorise(hessian, self.banded)
        profile = [self._rank, self._order, self._first, self._row]
        self._per_rod(
            skyline.renumber,
            [
                contact.cut,
                self.coupled,
                self.pair_count,
                self.touching,
                self._capacity,
                self._head,
                self._link,
            ],
            [*profile, overflow],
        )
        chosen = [self.coupled, overflow, batch.free]
        profile = [self._rank, self._first, self._row]
        wp.launch(
            skyline.fill_band,
            dim=(batch.rod_count, batch.node_count),
            inputs=[*chosen, hessian, self.shift, *profile],
            outputs=[self._block],
            device=batch.device,
        )
        self._per_rod(
            skyline.add_pairs,
            [
                contact.law,
                contact.edge_radius,
                batch.rest_length,
                SMOOTHING,
                *chosen,
                *contact.configuration,
                contact.bristle,
                contact.load,
                contact.sliding,
                contact.sticking,
                self.pair_count,
                self.touching,
                *profile,
            ],
            [self._block],
        )
        self._per_rod(
            skyline.factorise,
            [self.coupled, overflow, self._first, self._row],
            [self._block, self.negative_pivots],
        )

    def solve(self, active: wp.array, columns: int | None = None) -> None:
        """Overwrite `x` with its solution, shortened to what contacts allow in one iteration."""
        super().solve(self.banded, columns)
        contact = self.contact
        chosen = [self.coupled, contact.overflow, self.batch.free]
        profile = [self._order, self._first, self._row]
        self._per_rod(skyline.solve, [*chosen, *profile, self._block, self._y], [self.x])
        limits = [contact.reach, contact.overflow, active]
        self._per_rod(skyline.limit_motion, limits, [self.x, contact.sticking])
