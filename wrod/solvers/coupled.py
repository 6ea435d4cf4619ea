"""Linear systems of rods whose contacts couple nodes far apart along them."""

import warp as wp

from wrod.kernels.contact import touching
from wrod.kernels.lanes import TEAM, lanes
from wrod.kernels.linear import coupling, skyline, skyline_ends, skyline_lanes, skyline_order
from wrod.rods.arrays import filled
from wrod.solvers.banded import BandedSystem
from wrod.solvers.rod_contact import RodContact

# Up to this many nodes a rod's factor may fill; beyond, rows of so many blocks on average. A GPU
# solves heaps otherwise (`wrod.solvers.condensed`).
_DENSE_NODES, _BLOCKS_PER_ROW, _BLOCKS_ON_CPU = 200, 100, 400
# Blocks of lanes that share a rod's pairs on a GPU, of which each has eight at a time.
_TEAMS = 6


def skyline_of(coupled: wp.array, overflow: wp.array, nodes: int) -> skyline_order.Skyline:
    """Where the blocks of rods (rod,) of so many nodes are, still to be found out."""
    out = skyline_order.Skyline()
    out.coupled, out.overflow, out.reach = coupled, overflow, wp.zeros_like(coupled)
    shape, names = (len(coupled), nodes), ("rank", "order", "first", "last", "row")
    device = coupled.device
    return filled(out, {n: wp.zeros(shape, dtype=wp.int32, device=device) for n in names})


class PairedSystem(BandedSystem):
    """What systems with the stiffness of a `RodContact` have in common: the pairs that touch.

    `negative_pivots` counts the negative eigenvalues of the whole matrix, contacts included.

    Args:
        contact: the contact between rods, evaluated (`RodContact.add`) before each `factorise`.
        right_hand_sides: how many `solve` takes.
        pairs: most pairs of a row that may touch.
    """

    def __init__(self, contact: RodContact, right_hand_sides: int, pairs: int):
        batch = contact.batch
        super().__init__(batch, right_hand_sides)
        self.contact = contact
        rods, device = batch.rod_count, batch.device
        self.banded, self.coupled, self.pair_count, self._changed = (
            wp.zeros(rods, dtype=wp.int32, device=device) for _ in range(4)
        )
        self.touching = wp.zeros((rods, pairs), dtype=wp.vec3i, device=device)

    def eliminate(self, gradient: wp.array, hessian: wp.array, active: wp.array) -> None:
        self._factorise_and_solve(gradient, hessian, active)

    def _collect(self, active: wp.array) -> None:
        """List the pairs that touch."""
        contact = self.contact
        self.batch.launch_lanes(
            touching.collect,
            [active, contact.partner_count, contact.partner, contact.depth],
            [self.pair_count, self.touching, contact.overflow]
            + [self.banded, self.coupled, self._changed],
        )

    @property
    def _pairs(self) -> list:
        """Where pairs are, and which."""
        contact = self.contact
        where = [contact.time_step, *contact.configuration, contact.rubbing]
        return [*where, self.pair_count, self.touching]

    def _together(self, kernel, inputs, outputs, blocks: int | None = None) -> None:
        """Launch a kernel whose lanes work on a rod together, or on each of its blocks."""
        batch = self.batch
        count = lanes(batch.device, TEAM)
        dim = (batch.rod_count, count) if blocks is None else (batch.rod_count, blocks, count)
        batch.launch(kernel, dim, inputs, outputs, count)

    def multiply_pairs(self, active: wp.array, vector: wp.array, product: wp.array) -> None:
        """Add the touching pairs' part of matrix times `vector` (rod, j, dof) to `product`."""
        chosen = [active, self.coupled, self.contact.overflow]
        inputs = [self.contact.pieces, *chosen, *self._pairs, vector]
        self._together(coupling.multiply_pairs, inputs, [product])

    def shorten(self, active: wp.array) -> None:
        """Shorten the first solution to what contacts allow in one iteration."""
        contact = self.contact
        self.batch.launch_lanes(
            touching.limit_motion,
            [contact.reach, contact.overflow, active],
            [self.x, self.shortened],
        )


class CoupledSystem(PairedSystem):
    """A `PairedSystem` that is factorised exactly, a row a block; rows that touch nothing are
    factorised as banded ones are.

    Args:
        contact, right_hand_sides: as of `PairedSystem`.
    """

    def __init__(self, contact: RodContact, right_hand_sides: int = 1):
        batch = contact.batch
        super().__init__(contact, right_hand_sides, 6 * batch.node_count)
        rods, nodes, device = batch.rod_count, batch.node_count, batch.device
        if nodes <= _DENSE_NODES:
            self._capacity = nodes * (nodes + 1) // 2
        else:
            blocks = _BLOCKS_ON_CPU if lanes(device) == 1 else _BLOCKS_PER_ROW
            self._capacity = min(nodes * blocks, nodes * (nodes + 1) // 2)
        self._skyline = skyline_of(self.coupled, contact.overflow, nodes)
        self._distance, self._tally = (
            wp.zeros((rods, nodes), dtype=wp.int32, device=device) for _ in range(2)
        )
        self._block = wp.zeros((rods, self._capacity), dtype=wp.mat44d, device=device)
        if lanes(device) == 1:
            self._y = wp.zeros((rods, nodes), dtype=wp.vec4d, device=device)
        else:
            self._lines = wp.array(
                ptr=self._block.ptr, shape=(rods, 4 * self._capacity), dtype=wp.vec4d, device=device
            )
            self._product, self._column, self._size, self._y = (
                wp.zeros((rods, width * nodes), dtype=wp.float64, device=device)
                for width in (skyline_lanes.STRIDE, skyline_lanes.STRIDE, 4, 4)
            )
            numbers = skyline_ends.scratch_of(nodes)
            self._factor = wp.zeros((rods, numbers), dtype=wp.float64, device=device)
            self._negative = wp.zeros((rods, 2), dtype=wp.int32, device=device)

    def eliminate(self, gradient: wp.array, hessian: wp.array, active: wp.array) -> None:
        self._collect(active)
        if not self._on_gpu:
            wp.copy(self.x[:, 0], gradient)
        BandedSystem.eliminate(self, gradient, hessian, self.banded)
        self._assemble(hessian)
        near = skyline_ends.reach_of(self.batch.node_count)
        if self._on_gpu:
            self._eliminate_near(near, gradient)
        self._factorise_coupled(near + 1)
        self._solve_coupled(1, near + 1)

    def _eliminate_near(self, reach: int, gradient: wp.array) -> None:
        """Solve rods none of whose columns reaches farther, on a GPU."""
        chosen, ends = [self._skyline, reach], 2
        inputs = [*chosen, self.batch.free, gradient, self._lines]
        outputs = [self._tally, self._y, self._factor, self._negative]
        self._together(skyline_ends.eliminate, inputs, outputs, ends)
        inputs = [*chosen, gradient, self._negative, self._factor]
        self._together(skyline_ends.go_back, inputs, [self.x, self.negative_pivots], ends)

    def factorise(self, hessian: wp.array, active: wp.array) -> None:
        self._collect(active)
        super().factorise(hessian, self.banded)
        self._assemble(hessian)
        self._factorise_coupled()

    def _assemble(self, hessian: wp.array) -> None:
        """Order the nodes, and fill the blocks of rods in contact."""
        batch, contact = self.batch, self.contact
        near = skyline_ends.reach_of(batch.node_count) if self._on_gpu else -1
        self._together(
            skyline_order.renumber,
            [self._changed, contact.pieces.kind, self.pair_count, self.touching, self._capacity]
            + [near if near > 0 else batch.node_count, self._distance, self._tally],
            [self._skyline],
        )
        sharing = 5 if self._on_gpu else 1
        batch.launch(
            coupling.fill_band,
            (batch.rod_count, batch.node_count, sharing),
            [self._skyline, batch.free, hessian, self.shift, sharing],
            [self._block],
            lanes(batch.device, TEAM),
        )
        teams = _TEAMS if self._on_gpu else 1
        inputs = [contact.pieces, self._skyline, batch.free, *self._pairs, teams]
        self._together(coupling.add_pairs, inputs, [self._block], teams)

    def _factorise_coupled(self, least_reach: int = 0) -> None:
        """On a GPU only of rods of which some column reaches so far."""
        if not self._on_gpu:
            outputs = [self._block, self.negative_pivots]
            self._together(skyline.factorise, [self._skyline], outputs)
            return
        inputs = [self._skyline, least_reach, self._size, self._product, self._column]
        self._together(skyline_lanes.factorise, inputs, [self._lines, self.negative_pivots])

    def solve(self, active: wp.array, columns: int | None = None) -> None:
        """Overwrite the first (default: all) right-hand sides in `x` with their solutions."""
        super().solve(self.banded, columns)
        self._solve_coupled(columns or self.x.shape[1])

    def _solve_coupled(self, columns: int, least_reach: int = 0) -> None:
        free, kernel = self.batch.free, skyline.solve
        if self._on_gpu:
            kernel = skyline_lanes.solve
            inputs = [self._skyline, least_reach, free, self._lines, self._y]
        else:
            inputs = [self._skyline, free, self._block, self._y]
        for j in range(columns):
            self._together(kernel, inputs, [self.x[:, j : j + 1]])
