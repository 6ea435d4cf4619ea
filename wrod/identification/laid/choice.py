"""Which scenarios explain the photographs of a rod, and how far to trust what they say of others.

Every picture is another trial: another grip, another excess, another free end. One best scenario
would follow the accidents of the pictures that it was chosen by, so they are averaged instead:
weighted by all pictures together, as if these had been laid in one scenario, or as a mixture in
which every picture has its own. Their mean replaces the model with nothing fitted only where
pictures that it has not seen gain.
"""

from collections.abc import Sequence

import numpy as np

from wrod.errors import DataError
from wrod.identification.laid.placement import normals
from wrod.identification.laid.scenario import LaidRod, Scenario

# A picture that a scenario misses by more than this says no more against it [m]: it may have been
# laid with another excess, and the other pictures are to be heard too; more where the place counts
# as well, which an overlay tells within millimetres.
_CAP, _CAP_OF_PLACE = 6e-3, 20e-3
# A gain counts from so many of its standard errors on: the best of twelve ways is ahead by one by
# luck alone in two fifths of all cases, by two in a ninth (tests/test_photographs.py).
_ERRORS = 2.0
# Mean distance by which a scenario's weight falls by e [m].
_SOFT = 1e-3
_POINTS = 600


def weigh(
    distances: np.ndarray, soft: float = _SOFT, *, mixture: bool = False, placed: bool = False
) -> np.ndarray:
    """(scenario,) weights, summing to 1.

    Args:
        distances: (scenario, picture) mean distances [m]; infinite where a simulation diverged.
        soft: by which a weight falls by e [m]: what the model itself misses.
        mixture: weigh for each picture and take the mean of the weights, instead of weighing by
            the mean over the pictures.
        placed: distances are those before any rigid motion.

    Raises:
        DataError: no picture.
    """
    off = heard(distances, _CAP_OF_PLACE if placed else _CAP)
    if off.ndim != 2 or off.shape[1] < 1:
        raise DataError("no photograph to weigh scenarios by; leaving one out takes two or more")
    if not mixture:
        off = off.mean(axis=1, keepdims=True)
    weights = np.exp(-(off - off.min(axis=0)) / soft)
    return (weights / weights.sum(axis=0)).mean(axis=1)


def heard(distances: np.ndarray, most: float = _CAP) -> np.ndarray:
    """Distances [m] of pictures, cut where they say no more [m]."""
    return np.minimum(np.asarray(distances, dtype=float), most)


def simplest(costs: np.ndarray) -> int:
    """Which way of predicting to take, the simplest being the first column.

    The first whose cost is within two standard errors of the difference from the least cost, over
    patterns: the pictures of one pattern are laid along one path, and gain or lose together.

    Args:
        costs: (pattern, way) mean distances [m] of unseen pictures.
    """
    if len(costs) < 2:
        return 0
    more = costs - costs[:, [costs.mean(axis=0).argmin()]]
    error = more.std(axis=0, ddof=1) / np.sqrt(len(costs))
    return int(np.argmax(more.mean(axis=0) <= _ERRORS * error))


def average(rods: Sequence[LaidRod], scenarios: Sequence[Scenario], weights: np.ndarray) -> LaidRod:
    """The mean of one rod in many scenarios, at equal distance from the grip.

    Those whose simulation did not get there are left out.

    Raises:
        DataError: none did.
    """
    s, lines, share = aligned(rods, scenarios, weights)
    return LaidRod(s, np.einsum("k,knc->nc", share, lines), True)


def aligned(
    rods: Sequence[LaidRod], scenarios: Sequence[Scenario], weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arc length (n,) [m], nodes (k, n, 3) [m] of one rod in those scenarios whose simulation got
    there, at equal distance from the grip, and their weights (k,).

    Raises:
        DataError: none did.
    """
    share = np.asarray(weights, dtype=float)
    kept = [k for k, one in enumerate(rods) if one.reached and share[k] > 1e-6 * share.max()]
    if not kept:
        raise DataError("no scenario's simulation reached the end of the pattern")
    longest = min(rods[k].arc_length[-1] - scenarios[k].excess for k in kept)
    s = np.linspace(0.0, longest, _POINTS)
    # The excess is beyond the pattern's start: what lies there is told apart from the grip.
    lines = np.stack([rods[k].at(s + scenarios[k].excess) for k in kept])
    return s, lines, share[kept] / share[kept].sum()


def spread(lines: np.ndarray, weights: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """(n,) RMS distance [m] of curves from a predicted one across it, each moved by the rigid
    motion in the plane, to first order, that brings it nearest.

    Args:
        lines: (k, n, 2) [m]; weights: (k,), summing to 1; predicted: (n, 2) [m].
    """
    normal = normals(predicted)
    off = ((lines - predicted) * normal).sum(axis=2)
    arm = predicted - predicted.mean(axis=0)
    turn = arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]
    motions = np.column_stack([normal, turn / np.abs(arm).max()])
    # A straight line slides along itself, so that one of the motions may tell nothing.
    off = off - (motions @ np.linalg.lstsq(motions, off.T)[0]).T
    return np.sqrt(weights @ off**2)
