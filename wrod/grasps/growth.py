"""Whether small departures of a rod that is being laid grow with the length that is laid.

A grip that goes on as planned holds a rod whose contact lies a little to the left, points another
way or is rolled. That changes curvature and twist at the contact, which is what is laid next: of
departures d = (left, direction, roll), d' = M d over the laid length, if what lies stays. M comes
from the tangents of one grasp, and its eigenvalues say whether d dies out (wrod's derivation).
"""

import numpy as np

from wrod.rods.batch import RodBatch
from wrod.solvers.banded import BandedSystem
from wrod.solvers.statics import prescribe

# The degrees of freedom of the clamp at the contact: node, angle and node.
_CLAMP = 7


def growth(batch: RodBatch) -> np.ndarray:
    """(rod,) the largest real part of the eigenvalues of `departures` [1/length]; nan where they
    are not finite."""
    rates = departures(batch)
    known = np.isfinite(rates).all(axis=(1, 2))
    out = np.full(batch.rod_count, np.nan)
    out[known] = np.linalg.eigvals(rates[known]).real.max(axis=1)
    return out


def departures(batch: RodBatch) -> np.ndarray:
    """(rod, 3, 3) M of d' = M d over the laid length [1/length], d a contact's departure (to the
    left [length], in direction and in roll [rad]).

    Departures along the rod are left out. On a straight pattern they change no curvature or twist
    at the contact to first order, nor does it that the contact moves along.

    Args:
        batch: grasps with a ghost edge before the contact, of whose cell half bends. All of the
            grip is clamped on return.
    """
    prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    # The grip is held, so that what a torque at a free one adds does not count.
    hessian = RodBatch.evaluate(batch, order=2).hessian
    behind, first = batch.rest_length.numpy()[:, :2].T
    clamp = np.zeros((batch.rod_count, 3, _CLAMP))
    clamp[:, 0, [1, 5]] = 1.0
    clamp[:, 1, 1] = -behind
    clamp[:, 2, 3] = 1.0
    system = BandedSystem(batch, right_hand_sides=3)
    system.factorise(hessian, batch.every_rod)
    x, band = system.x.numpy(), hessian.numpy()
    for i in range(_CLAMP, _CLAMP + band.shape[2] - 1):
        for j in range(max(0, i - band.shape[2] + 1), _CLAMP):
            x[:, :, i] -= band[:, i, i - j, None] * clamp[:, :, j]
    system.x.assign(x)
    system.solve(batch.every_rod)
    x = system.x.numpy()
    half = 0.5 * first[:, None]
    rates = np.zeros((batch.rod_count, 3, 3))
    rates[:, 0, 1] = 1.0
    before = (clamp[:, :, 5] - clamp[:, :, 1]) / behind[:, None]
    rates[:, 1] = ((x[:, :, 9] - clamp[:, :, 5]) / first[:, None] - before) / half
    rates[:, 2] = (x[:, :, 7] - clamp[:, :, 3]) / half
    return rates
