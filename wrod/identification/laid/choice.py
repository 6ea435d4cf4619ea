"""Which scenarios explain the photographs of a rod, and how far to trust what they say of others.

Every picture is another trial: another grip, another excess, another free end. One best scenario
would follow the accidents of the pictures that it was chosen by, so they are averaged instead, each
with a weight that falls by e for every millimetre by which it is farther from the pictures. And
their mean replaces the model with nothing fitted only as far as pictures that it has not seen gain.
"""

from collections.abc import Sequence

import numpy as np

from wrod.errors import DataError
from wrod.identification.laid.scenario import LaidRod, Scenario

# A picture that a scenario misses by more than this says no more against it [m]: it may have been
# laid with another excess, and the other pictures are to be heard too.
_CAP = 6e-3
# Mean distance over the pictures by which a scenario's weight falls by e [m].
_SOFT = 1e-3
_POINTS = 600


def weigh(distances: np.ndarray) -> np.ndarray:
    """(scenario,) weights, summing to 1.

    Args:
        distances: (scenario, picture) mean distances [m]; infinite where a simulation diverged.

    Raises:
        DataError: no picture.
    """
    heard = np.minimum(np.asarray(distances, dtype=float), _CAP)
    if heard.ndim != 2 or heard.shape[1] < 1:
        raise DataError("no photograph to weigh scenarios by; leaving one out takes two or more")
    mean = heard.mean(axis=1)
    weights = np.exp(-(mean - mean.min()) / _SOFT)
    return weights / weights.sum()


def shrinkage(costs: np.ndarray) -> int:
    """Which share of the fitted prediction to take, the first column being none of it.

    The least share whose cost is within one standard error, over pictures, of the least cost: what
    gains on average by the luck of a few pictures is not taken.

    Args:
        costs: (picture, share) distances [m] of unseen pictures; cut at 6 mm.
    """
    heard = np.minimum(np.asarray(costs, dtype=float), _CAP)
    if len(heard) < 2:
        return 0
    best = int(heard.mean(axis=0).argmin())
    more = heard - heard[:, best : best + 1]
    error = more.std(axis=0, ddof=1) / np.sqrt(len(heard))
    return int(np.argmax(more.mean(axis=0) <= error))


def average(rods: Sequence[LaidRod], scenarios: Sequence[Scenario], weights: np.ndarray) -> LaidRod:
    """The mean of one rod in many scenarios, at equal distance from the grip.

    Those whose simulation did not get there are left out, and those of hardly any weight.

    Raises:
        DataError: none did.
    """
    share = np.asarray(weights, dtype=float)
    kept = [k for k, one in enumerate(rods) if one.reached and share[k] > 1e-6 * share.max()]
    if not kept:
        raise DataError("no scenario's simulation reached the end of the pattern")
    share = share[kept] / share[kept].sum()
    longest = min(rods[k].arc_length[-1] - scenarios[k].excess for k in kept)
    s = np.linspace(0.0, longest, _POINTS)
    nodes = np.zeros((_POINTS, 3))
    for k, part in zip(kept, share, strict=True):
        # The excess is beyond the pattern's start: what lies there is told apart from the grip.
        at = s + scenarios[k].excess
        nodes += part * np.column_stack(
            [np.interp(at, rods[k].arc_length, c) for c in rods[k].nodes.T]
        )
    return LaidRod(s, nodes, True)
