"""The paper's test of stability: nudge the grip sideways and see whether the rod snaps.

Each rod is followed twice. Newton's method walks along the branch of equilibria, stable or not; a
second rod is nudged with it and falls to a minimum of its energy after every step, as a real rod
does. Where the two part, the rod has snapped. Dimensionless.
"""

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.grasps.held_rods import HeldRods
from wrod.rods.device import resolve_device

OFFSETS = np.concatenate([[0.0, 1e-3, 5e-3], np.linspace(0.01, 0.5, 50)])
# Nodes of a rod that has snapped are further than this from the branch [L_gb].
PARTED = 0.02


@dataclass(frozen=True)
class Nudges:
    """n rods under k sideways offsets of their grips.

    Attributes:
        offset: (k,) offsets along y [L_gb].
        force: (n, k, 3) force of the table on the rod at the contact [k_b/L_gb^2].
        deflection: (n, k) largest |y| of the rod [L_gb].
        shape: (n, k, node, 3) where the rod comes to rest [L_gb].
        snaps_at: (n,) smallest offset after which the rod has left its branch; infinite where it
            never does [L_gb].
    """

    offset: np.ndarray
    force: np.ndarray
    deflection: np.ndarray
    shape: np.ndarray
    snaps_at: np.ndarray


def nudge(
    shape: np.ndarray,
    suspended_length,
    stretch_ratio,
    offset=OFFSETS,
    *,
    device: arguments.DeviceLike = None,
) -> Nudges:
    """Nudge the grips of rods in equilibrium sideways, step by step.

    Args:
        shape: (n, node, 3) equilibria, from contact to grip [L_gb].
        suspended_length, stretch_ratio: broadcast to (n,).
        offset: (k,) growing offsets along y [L_gb].
    """
    device = resolve_device(device)
    n, nodes, _ = shape.shape
    ls = np.broadcast_to(np.asarray(suspended_length, dtype=np.float64), (n,))
    ks = np.broadcast_to(np.asarray(stretch_ratio, dtype=np.float64), (n,))
    branch, real = (HeldRods(ls, ks, shape, device=device) for _ in range(2))
    grip = branch.grip_position()
    on_branch = branch.continue_to(grip)
    real.continue_to(grip)
    force = np.zeros((n, len(offset), 3))
    shapes = np.zeros((n, len(offset), nodes, 3))
    snaps_at = np.full(n, np.inf)
    for k, distance in enumerate(offset):
        if distance != 0.0:
            target = grip + distance * np.array([0.0, 1.0, 0.0])
            on_branch &= branch.continue_to(target, on_branch)
            real.settle(target)
        force[:, k], shapes[:, k] = real.force(), real.shape()
        left = ~on_branch | (parting(shapes[:, k], branch.shape()) > PARTED)
        snaps_at[left] = np.minimum(snaps_at[left], distance)
    deflection = np.abs(shapes[..., 1]).max(axis=2)
    return Nudges(np.asarray(offset), force, deflection, shapes, snaps_at)


def parting(shape: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) largest distance between the nodes of (n, node, 3) shapes."""
    return np.linalg.norm(shape - other, axis=2).max(axis=1)
