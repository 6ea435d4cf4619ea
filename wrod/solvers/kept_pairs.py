"""Pairs of edges that touch, kept for what goes back through steps."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrod.kernels.contact.pair_contact import Rubbing
from wrod.kernels.contact.pairs import keep_pairs
from wrod.rods.arrays import filled

# With how many later edges one may touch at once.
SLOTS = 8


@dataclass(frozen=True)
class LawShares:
    """How the logarithm of the stiffness of a row's pairs follows what its rods are made of: by
    stretching stiffness, logarithm of the radius and rest length (rod, edge), and mass (rod, node).
    """

    by_stretching: np.ndarray
    by_radius: np.ndarray
    by_length: np.ndarray
    by_mass: np.ndarray


class KeptPairs:
    """The pairs of edges that touch at the end of a step, as its adjoint wants them.

    Args:
        contact: the `wrod.solvers.rod_contact.RodContact`.

    Attributes:
        partner: (rod, edge, slot) later edges, 0 for none.
        rubbing: `wrod.kernels.contact.pair_contact.Rubbing` of these, as friction of the step began
            and under the loads of its end.
    """

    def __init__(self, contact: Any):
        self._contact, batch = contact, contact.batch
        shape, device = (batch.rod_count, batch.node_count - 1, SLOTS), batch.device
        self.partner = wp.zeros(shape, dtype=wp.int32, device=device)
        self.rubbing = rubbing = Rubbing()
        rubbing.load = wp.zeros(shape, dtype=wp.float64, device=device)
        rubbing.sliding = wp.zeros_like(self.partner)
        rubbing.iteration = wp.zeros(batch.rod_count, dtype=wp.int32, device=device)
        names = ("bristle", "stretch", "dual")
        filled(rubbing, {n: wp.zeros(shape, dtype=wp.vec2d, device=device) for n in names})

    def arrays(self) -> dict[str, wp.array]:
        """By the names of `wrod.kernels.stepping.trace.OneStep`."""
        kept = self.rubbing
        return {
            "pair_partner": self.partner, "pair_bristle": kept.bristle, "pair_load": kept.load,
            "pair_sliding": kept.sliding,
        }  # fmt: skip

    def keep(self, accepted: wp.array, touching: wp.array) -> None:
        """Keep those of accepted steps; raise `touching` (rod,) to 1 where there are too many."""
        contact = self._contact
        contact.batch.launch(
            keep_pairs,
            contact.partner_count.shape,
            [accepted, contact.partner_count, contact.partner, contact.depth, contact.rubbing],
            [self.partner, self.rubbing, touching],
        )
