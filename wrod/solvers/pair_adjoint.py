"""The adjoint of rods that touch each other, in the steps of `wrod.solvers.adjoint.StepAdjoint`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrod.kernels.contact import pair_adjoint as kernels
from wrod.kernels.contact import touching
from wrod.kernels.contact.pair_contact import Rubbing
from wrod.kernels.lanes import TEAM, lanes
from wrod.kernels.linear import skyline_lu, skyline_order
from wrod.kernels.stepping.adjoint import fill_coupled
from wrod.rods.arrays import filled
from wrod.solvers.coupled import skyline_of
from wrod.solvers.kept_pairs import SLOTS, KeptPairs, LawShares

if TYPE_CHECKING:
    from wrod.solvers.dynamics import Dynamics

# How many blocks a row of the factor may have on average.
_BLOCKS = 400


class PairAdjoint:
    """What pairs have in the matrix of steps, which is factorised with them where there are any.

    Args:
        dynamics: that has taken the steps.
        step: `wrod.kernels.stepping.trace.OneStep` that is gone through.
        turns: by how much frames turn by where the last nodes of their edges are, at the end of the
            step and at its start.
        shares: of the pairs' law; default: it is given.

    Attributes:
        banded: (rod,) whether the matrix of a row that is gone through is banded.
    """

    def __init__(
        self, dynamics: Dynamics, step: Any, turns: tuple[wp.array, wp.array],
        shares: LawShares | None,
    ):  # fmt: skip
        assert dynamics.rod_contact is not None
        contact, batch = dynamics.rod_contact, dynamics.batch
        self._batch, self._pieces, self._step = batch, contact.pieces, step
        self._turns = kernels.Turns()
        self._turns.by_end, self._turns.by_start = turns
        self._kept = kept = Rubbing()
        kept.bristle, kept.load, kept.sliding = (
            step.pair_bristle, step.pair_load, step.pair_sliding
        )  # fmt: skip
        own = KeptPairs(contact).rubbing
        kept.iteration, kept.stretch, kept.dual = own.iteration, own.stretch, own.dual
        rods, nodes, device = batch.rod_count, batch.node_count, batch.device
        self._shape = step.pair_partner.shape

        numbers = batch.zeros
        self._touching = numbers(*self._shape[1:])
        self._slots = wp.full((rods, nodes - 1), SLOTS, dtype=wp.int32, device=device)
        self.banded, self._count, self._changed, coupled, overflow = (
            numbers(dtype=wp.int32) for _ in range(5)
        )
        self._skyline = skyline_of(coupled, overflow, nodes)
        self._pair = numbers(6 * nodes, dtype=wp.vec3i)
        self._scratch = [numbers(nodes, dtype=wp.int32) for _ in range(2)]
        self._capacity = min(nodes * _BLOCKS, nodes * (nodes + 1) // 2)
        self._lower, self._upper = (numbers(self._capacity, dtype=wp.mat44d) for _ in range(2))
        law = {name: numbers() for name in kernels.WantedLaw.vars}
        self._law = filled(kernels.WantedLaw(), law)
        self._shares = self._law_shares(contact, shares)
        self._x: wp.array | None = None

    @classmethod
    def of(
        cls, dynamics: Dynamics, step: Any, turns: tuple[wp.array, wp.array],
        shares: LawShares | None,
    ) -> PairAdjoint | None:  # fmt: skip
        """None where rods do not touch each other."""
        return None if dynamics.rod_contact is None else cls(dynamics, step, turns, shares)

    def _law_shares(self, contact: Any, shares: LawShares | None) -> Any:
        batch = self._batch
        radius = contact.edge_radius.numpy()
        mass = batch.node_mass.numpy()
        if shares is None:
            none = np.zeros_like(radius)
            shares = LawShares(none, none, none, np.zeros_like(mass))
        own = ("by_stretching", "by_radius", "by_length", "by_mass")
        values = {name: getattr(shares, name) for name in own}
        values |= {"size_by_radius": contact.mean_share, "total_mass": mass.sum(axis=1)}
        arrays = {name: batch.array(value) for name, value in values.items()}
        return filled(kernels.LawShares(), arrays)

    def _launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        model = (
            [self._pieces] if kernel is not kernels.add_pairs else [self._pieces, self._batch.free]
        )
        inputs = [*model, self._step, self._kept, self._turns, *inputs]
        self._batch.launch(kernel, self._shape, inputs, outputs)

    def weigh(self, now: Any, gradient: wp.array, moment: wp.array) -> None:
        """Add to the residual and to moments about edges, let what is wanted of bristles at the
        step's end be wanted of the rods there, and find out which rows touch."""
        self._launch(kernels.want_pairs, [], [now, gradient, moment, self._touching])
        skyline = self._skyline
        skyline.overflow.zero_()
        self._batch.launch_lanes(
            touching.collect,
            [self._step.active, self._slots, self._step.pair_partner, self._touching],
            [self._count, self._pair, skyline.overflow, self.banded, skyline.coupled]
            + [self._changed],
        )

    def factorise(self, matrix: Any) -> None:
        """Of the rows that touch: `matrix` (`StepMatrix`) with the pairs."""
        batch, team = self._batch, lanes(self._batch.device, TEAM)
        batch.launch(
            skyline_order.renumber,
            (batch.rod_count, team),
            [self._changed, self._pieces.kind, self._count, self._pair]
            + [self._capacity, batch.node_count, *self._scratch],
            [self._skyline],
            team,
        )
        skyline, blocks = self._skyline, [self._lower, self._upper]
        batch.launch_nodes(fill_coupled, [skyline, batch.free, matrix], blocks)
        inputs = [skyline.overflow, skyline.rank, skyline.row]
        self._launch(kernels.add_pairs, inputs, blocks)
        batch.launch(skyline_lu.factorise, batch.rod_count, [skyline], blocks)

    def solve(self, x: wp.array) -> None:
        """Of the rows that touch, all right-hand sides (rod, p, dof) in place; the first is what
        the rest goes on from."""
        if self._x is not x:
            device, shape = self._batch.device, (*x.shape[:2], self._batch.node_count)
            self._x, self._y = x, wp.zeros(shape, dtype=wp.vec4d, device=device)
            self._solution = wp.array(ptr=x.ptr, dtype=wp.float64, shape=x.shape, device=device)
        inputs = [self._skyline, self._batch.free, self._lower, self._upper, self._y]
        self._batch.launch(skyline_lu.solve, x.shape[:2], inputs, [x])

    def want_held(self, held: wp.array) -> None:
        """Add to what is wanted of what is not free."""
        self._launch(kernels.want_held, [self._batch.free, self._solution], [held])

    def multiply_motions(self, motion: wp.array, products: list[wp.array]) -> None:
        """Add to products of the matrix with motions of bodies, to those from the left, and to what
        is solved for."""
        self._launch(kernels.multiply_motions, [self._batch.free, motion], products)

    def want_before(self, now: Any, before: Any, model: Any) -> None:
        """From the solution to the start of the step, and to what the pairs are made of."""
        for name in kernels.WantedLaw.vars:
            getattr(self._law, name).zero_()
        self._launch(kernels.want_pairs_before, [now, self._solution], [before, model, self._law])
        self._batch.launch_nodes(kernels.want_law, [self._shares, self._law], [model])
