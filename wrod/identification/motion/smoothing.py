"""Recorded paths between markers, smoothed in time so that they have accelerations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from wrod.identification.motion.curves import through_markers
from wrod.identification.motion.windows import windows_at

# Standard deviation of the Gaussian that paths are smoothed with, in time and at least [s, frames].
_SMOOTH, _LEAST = 0.015, 1.2


def sampled_frames(m, recordings, spacing, reach):
    """[(recording, frame)] with recorded frames in sequence all around."""
    frames = np.arange(reach, m.frame_count - reach, spacing)
    out = [
        (r, f) for r in recordings for f in frames if (m.gap[r, f - reach : f + reach] == 1).all()
    ]
    return np.array(out, dtype=int).reshape(-1, 2)


def smoothing(rate: float) -> np.ndarray:
    """(3, 2 k + 1) weights for the path, its velocity and its acceleration, from neighbours.

    A Gaussian and its derivatives: what is fast is weakened alike in all three, so that smoothed
    paths still obey the equations of motion, to first order.
    """
    width = max(_LEAST, _SMOOTH * rate)
    k = np.arange(-int(np.ceil(4 * width)), int(np.ceil(4 * width)) + 1)
    bell = np.exp(-0.5 * (k / width) ** 2)
    first = k * bell
    second = ((k / width) ** 2 - 1.0) * bell
    second -= bell * second.sum() / bell.sum()
    return np.stack(
        [bell / bell.sum(), first * rate / (first @ k), 2.0 * second * rate**2 / (second @ k**2)]
    )


def smoothed(m, setup, sampled, weights) -> SimpleNamespace:
    """Nodes with velocity and acceleration in the sampled frames, and their windows."""
    recording, frame = sampled.T
    reach = weights.shape[1] // 2
    around = frame[:, None] + np.arange(-reach, reach + 1)
    x = m.positions[recording[:, None], around]
    pieces = int(setup.marker_node[2] - setup.marker_node[1])
    position = m.positions.copy()
    position[recording, frame] = np.einsum("k,skmc->smc", weights[0], x)
    nodes = through_markers(x, pieces, m.marker_arc_length)
    return SimpleNamespace(
        windows=windows_at(replace(m, positions=position), sampled - [0, 1], 2),
        weights=weights,
        position=through_markers(position[recording, frame], pieces, m.marker_arc_length),
        velocity=np.einsum("k,sknc->snc", weights[1], nodes),
        acceleration=np.einsum("k,sknc->snc", weights[2], nodes),
    )
