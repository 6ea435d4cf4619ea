"""Grasps of rods that cannot hang wherever they are asked to.

Where a rod bends down more than its weight bends it up, beyond the contact it would dip under the
table: with the contact there it rests on the table further on, and no grasp exists. The closest rod
that can hang there has a share of its natural curvature only; its grasp takes the missing one's
place, and says so.
"""

from dataclasses import fields
from typing import Any

import numpy as np

from wrod.grasps.rod_grasps import RodGrasps, solve_rod_grasps
from wrod.rods.model import RodModel

# The share is found to a 64th; that of a rod that remembers to an eighth, at contacts that are so
# far from each other at most [L_gb].
_HALVINGS, _PARTS, _LOOKED = 6, 8, 0.05
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
        return solve_rod_grasps(
            model, arc_length[rows], curvature[rows],
            held_roll=held[rows], natural_share=np.minimum(share[rows], 1.0), **options,
        )  # fmt: skip

    share, every = np.ones(len(arc_length)), np.arange(len(arc_length))
    lgb, remembers = model.gravito_bending_length, model.law.at_rest is None
    looked = every
    if remembers and not model.is_straight and len(every) > 1:
        looked = _spread_out(arc_length, _LOOKED * lgb)
    grasps = solve(share, looked)
    lacking = looked[~grasps.converged]
    if model.is_straight or (len(lacking) == 0 and len(looked) == len(every)):
        return grasps, share
    if len(lacking) > 0:
        share[lacking] = 0.0
        if remembers:
            # A share that jumped from contact to contact would bend what remembers it.
            for tried in np.arange(_PARTS - 1, 0, -1) / _PARTS:
                found = looked[solve(np.full_like(share, tried), looked).converged]
                good = np.intersect1d(found, lacking)
                share[good], lacking = tried, np.setdiff1d(lacking, good)
                if len(lacking) == 0:
                    break
        else:
            for step in 0.5 ** np.arange(1, _HALVINGS + 1):
                tried = share + step
                good = lacking[solve(tried, lacking).converged]
                share[good] = tried[good]
        share = np.interp(arc_length, arc_length[looked], share[looked])
        share = _smooth_below(share, arc_length, _REACH * lgb)
    rows = every if remembers else every[share < 1.0]
    for _ in range(_ATTEMPTS):
        if len(rows) == 0:
            break
        found = solve(share, rows)
        grasps = found if len(rows) == len(every) else _joined(grasps, found, rows)
        lost = every[~grasps.converged]
        share[lost] *= _LESS
        rows = every if remembers and len(lost) > 0 else lost
    return grasps, share


def _spread_out(at: np.ndarray, distance: float) -> np.ndarray:
    """Rows of increasing places (n,), the first and the last of them, each the last one within
    `distance` of the one before."""
    rows = [0]
    while rows[-1] < len(at) - 1:
        next_one = np.searchsorted(at, at[rows[-1]] + distance, side="right") - 1
        rows.append(max(int(next_one), rows[-1] + 1))
    return np.array(rows)


def _smooth_below(bound: np.ndarray, at: np.ndarray, reach: float) -> np.ndarray:
    """(n,) a smooth curve below the bounds at places (n,): the mean within `reach` of the least
    within `reach`."""
    near = np.abs(at[:, None] - at) <= reach
    least = np.where(near, bound, np.inf).min(axis=1)
    return near @ least / near.sum(axis=1)


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
