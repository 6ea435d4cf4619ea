"""Grasps of rods that cannot hang wherever they are asked to.

Where a rod bends down more than its weight bends it up, beyond the contact it would dip under the
table: with the contact there it rests on the table further on, and no grasp exists. The closest rod
that can hang there has a share of its natural curvature only; its grasp takes the missing one's
place, and says so.
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np

from wrod.grasps.rod_grasps import RodGrasps, solve_rod_grasps
from wrod.rods.model import RodModel

# The share is found to a 64th.
_HALVINGS = 6
# It changes over so much of the rod [L_gb], so that the grip moves on smoothly.
_REACH = 0.5
# What a smooth share that still is too large loses at a time, and how often.
_LESS, _ATTEMPTS = 0.9, 6


def solve_relaxed(
    model: RodModel, arc_length: np.ndarray, curvature: np.ndarray, *, held_roll, **options: Any
) -> tuple[RodGrasps, np.ndarray]:
    """Grasps at contacts in the order in which they are laid, and the share of its natural
    curvature that the rod has in each, (n,): 1 where its own grasp exists.

    Args:
        model, arc_length, curvature, held_roll, options: see `solve_rod_grasps`.
    """
    held = np.broadcast_to(np.asarray(held_roll, dtype=np.float64), arc_length.shape)

    def solve(share: np.ndarray, rows: np.ndarray) -> RodGrasps:
        # Of a rod that remembers, those between the rows count as well.
        given = rows if model.law.at_rest is not None else every
        found = solve_rod_grasps(
            model, arc_length[given], curvature[given],
            held_roll=held[given], natural_share=np.minimum(share[given], 1.0), **options,
        )  # fmt: skip
        return found if given is rows else _rows(found, rows)

    share, every = np.ones(len(arc_length)), np.arange(len(arc_length))
    grasps = solve(share, every)
    lacking = every[~grasps.converged]
    if len(lacking) == 0 or model.is_straight:
        return grasps, share
    share[lacking] = 0.0
    for step in 0.5 ** np.arange(1, _HALVINGS + 1):
        tried = share + step
        good = lacking[solve(tried, lacking).converged]
        share[good] = tried[good]
    share = _smooth_below(share, arc_length, _REACH * model.gravito_bending_length)
    relaxed = every[share < 1.0]
    for _ in range(_ATTEMPTS):
        grasps = _joined(grasps, solve(share, relaxed), relaxed)
        relaxed = every[~grasps.converged]
        if len(relaxed) == 0:
            break
        share[relaxed] *= _LESS
    return grasps, share


def _smooth_below(bound: np.ndarray, at: np.ndarray, reach: float) -> np.ndarray:
    """(n,) a smooth curve below the bounds at places (n,): the mean within `reach` of the least
    within `reach`."""
    near = np.abs(at[:, None] - at) <= reach
    least = np.where(near, bound, np.inf).min(axis=1)
    return near @ least / near.sum(axis=1)


def _rows(grasps: RodGrasps, rows: np.ndarray) -> RodGrasps:
    arrays = {n: value[rows] for n, value in vars(grasps).items() if isinstance(value, np.ndarray)}
    return replace(grasps, **arrays)


def _joined(grasps: RodGrasps, others: RodGrasps, rows: np.ndarray) -> RodGrasps:
    """The grasps with those of some rows replaced."""
    values: dict[str, Any] = {}
    for f in fields(RodGrasps):
        value = getattr(grasps, f.name)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value[rows] = getattr(others, f.name)
        values[f.name] = value
    return RodGrasps(**values)
