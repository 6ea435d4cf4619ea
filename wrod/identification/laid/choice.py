"""Which worlds explain the photographs of a rod, judged on photographs that no choice has seen.

Every picture is another trial: another grip, another excess, another free end. One best world would
follow the accidents of the pictures that it was chosen by, so worlds are averaged instead, each
with a weight that falls by e for every millimetre by which it is farther from the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wrod.errors import DataError
from wrod.identification.laid.world import LaidRod, World

# A picture that a world misses by more than this says no more against it [m]: it may have been
# laid with another excess, and the other pictures are to be heard too.
_CAP = 6e-3
# Mean distance over the pictures by which a world's weight falls by e [m].
_SOFT = 1e-3
_POINTS = 600


@dataclass(frozen=True)
class Choice:
    """What a table of distances says.

    Attributes:
        weights: (world,) of every world by all pictures, summing to 1.
        left_out: (picture, world) the same without each picture.
    """

    weights: np.ndarray
    left_out: np.ndarray


def choose(distances: np.ndarray) -> Choice:
    """Weigh worlds by all pictures of a rod, and without each picture in turn.

    Args:
        distances: (world, picture) mean distances [m]; infinite where a simulation diverged.

    Raises:
        DataError: fewer than two pictures.
    """
    heard = np.minimum(np.asarray(distances, dtype=float), _CAP)
    pictures = heard.shape[1]
    if pictures < 2:
        raise DataError("one photograph of a rod; leaving one out takes two or more")
    without = (heard.sum(axis=1, keepdims=True) - heard) / (pictures - 1)
    return Choice(_weights(heard.mean(axis=1)), np.array([_weights(w) for w in without.T]))


def _weights(mean: np.ndarray) -> np.ndarray:
    weights = np.exp(-(mean - mean.min()) / _SOFT)
    return weights / weights.sum()


def average(rods: Sequence[LaidRod], worlds: Sequence[World], weights: np.ndarray) -> LaidRod:
    """The mean of one rod in many worlds, at equal distance from the grip.

    Those whose simulation did not get there are left out.

    Raises:
        DataError: none did.
    """
    kept = [k for k, one in enumerate(rods) if one.reached]
    if not kept:
        raise DataError("no world's simulation reached the end of the pattern")
    share = np.asarray(weights, dtype=float)[kept]
    share = share / share.sum()
    longest = min(rods[k].arc_length[-1] - worlds[k].excess for k in kept)
    s = np.linspace(0.0, longest, _POINTS)
    nodes = np.zeros((_POINTS, 3))
    for k, part in zip(kept, share, strict=True):
        # The excess is beyond the pattern's start: what lies there is told apart from the grip.
        at = s + worlds[k].excess
        nodes += part * np.column_stack(
            [np.interp(at, rods[k].arc_length, c) for c in rods[k].nodes.T]
        )
    return LaidRod(s, nodes, True)
