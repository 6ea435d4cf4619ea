"""Rods that are not there yet: they wait beside the patterns, and are brought to the hand."""

import numpy as np

from wrod.patterns.curve import smoothstep

_BRINGING = 3.0  # [s]


def with_waiting(
    rod: np.ndarray, time: np.ndarray, ground: np.ndarray, radius: float
) -> np.ndarray:
    """Frames without gaps: before it hangs from a hand, a rod waits straight on the table, and is
    brought there in the last seconds; nothing is simulated of that.

    Args:
        rod: (F, node, 3) [m], NaN before it is there.
        time: (F,) [s].
        ground: (n, 3) points; the rod waits along x below the least y.
        radius: of the rod [m].
    """
    out = np.array(rod, dtype=float)
    absent = np.isnan(out).any(axis=(1, 2))
    if not absent.any():
        return out
    first = out[~absent][0]
    edges = np.diff(first, axis=0)
    length = np.linalg.norm(edges, axis=1)
    waiting = waiting_line(length.sum(), ground, radius)
    begin = max(time[absent][-1] - _BRINGING, time[0])
    for k in np.flatnonzero(absent):
        share = smoothstep((time[k] - begin) / max(time[absent][-1] - begin, 1e-9))
        # Edges turn from one direction into the other, so that the rod keeps its length.
        tangent = turned(np.array([1.0, 0.0, 0.0]), edges / length[:, None], share)
        tip = waiting[-1] + share * (first[-1] - waiting[-1])
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(tangent * length[:, None], axis=0)])
        places += tip - places[-1]
        places[:, 2] += max(0.0, min(radius, first[:, 2].min()) - places[:, 2].min())
        out[k] = places
    return out


def waiting_line(length: float, ground: np.ndarray, radius: float) -> np.ndarray:
    """(n, 3) points of a rod that waits [m], from end to end."""
    middle = (ground[:, 0].min() + ground[:, 0].max()) / 2
    x = np.linspace(-0.5, 0.5, 20) * length + middle
    return np.column_stack([x, np.full_like(x, ground[:, 1].min()), np.full_like(x, radius)])


def turned(start: np.ndarray, end: np.ndarray, share: float) -> np.ndarray:
    """(n, 3) directions on the way from `start` (3,) to `end` (n, 3), along great circles."""
    cosine = np.clip(end @ start, -1.0, 1.0)
    angle = np.arccos(cosine)[:, None]
    side = end - cosine[:, None] * start
    size = np.linalg.norm(side, axis=1, keepdims=True)
    side = np.where(size > 1e-9, side / np.maximum(size, 1e-9), [0.0, 0.0, 1.0])
    return np.cos(share * angle) * start + np.sin(share * angle) * side
