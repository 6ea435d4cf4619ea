"""What the base model leaves, seen in the laboratory and in the rod's own frame."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wrod.identification.motion.windows import Windows


@dataclass(frozen=True)
class Residual:
    """Measured minus predicted, over the test recordings.

    A force fixed in space leaves a mean in the laboratory frame; a bend of the rod's own or an
    offset of a marker leaves one in the frame that moves with the rod; damping leaves neither, but
    a part in proportion to the velocity; and what is not the same everywhere leaves scatter.

    Attributes:
        laboratory: (M, 3) mean along x, y, z [m].
        local: (M, 3) mean along the rod's tangent, towards the inside of its bend and across both.
        per_velocity: (M,) slope of the residual on the marker's velocity [s]: negative where the
            prediction runs ahead.
        explained: share of the mean square that each of the three takes away, by name.
        by_marker_before, by_marker_after: (M, B) mean |residual| [m] in B stretches of time.
    """

    laboratory: np.ndarray
    local: np.ndarray
    per_velocity: np.ndarray
    explained: dict[str, float]
    by_marker_before: np.ndarray
    by_marker_after: np.ndarray

    def to_dict(self) -> dict:
        return {
            "laboratory_mean_mm": (1e3 * self.laboratory).tolist(),
            "local_mean_mm": (1e3 * self.local).tolist(),
            "per_velocity_ms": (1e3 * self.per_velocity).tolist(),
            "explained_share": self.explained,
        }


def residual_of(laboratory, windows: Windows, before: np.ndarray, after: np.ndarray) -> Residual:
    """Residual of (W, F, M, 3) predictions before and after."""
    x = windows.markers
    seen = windows.seen.copy()
    seen[:, :2] = False
    difference = x - before
    frame = _frames(x)
    local = np.einsum("wfmka,wfma->wfmk", frame, difference)
    rate = laboratory.measurements.rate
    velocity = np.gradient(x, axis=1) * rate
    d, v = difference[seen], velocity[seen]
    slope = np.sum(d * v, axis=(0, 2)) / np.maximum(np.sum(v * v, axis=(0, 2)), 1e-30)
    total = np.sum(d**2)
    mean, own = d.mean(axis=0), local[seen].mean(axis=0)
    left = {
        "fixed in the laboratory": np.sum((d - mean) ** 2),
        "fixed to the rod": np.sum((local[seen] - own) ** 2),
        "in proportion to the velocity": np.sum((d - slope[:, None] * v) ** 2),
    }
    explained = {k: float(1.0 - v / total) if total > 0 else 0.0 for k, v in left.items()}
    return Residual(
        mean,
        own,
        slope,
        explained,
        _in_time(np.abs(difference), seen),
        _in_time(np.abs(x - after), seen),
    )


def _frames(x: np.ndarray) -> np.ndarray:
    """(W, F, M, 3, 3) rows: tangent, towards the inside of the bend, across both."""
    t = np.gradient(x, axis=2)
    t /= np.linalg.norm(t, axis=-1, keepdims=True)
    bend = np.gradient(t, axis=2)
    bend -= np.sum(bend * t, axis=-1, keepdims=True) * t
    bend /= np.maximum(np.linalg.norm(bend, axis=-1, keepdims=True), 1e-12)
    return np.stack([t, bend, np.cross(t, bend)], axis=3)


def _in_time(size: np.ndarray, seen: np.ndarray) -> np.ndarray:
    frames = size.shape[1]
    edges = np.unique(np.linspace(2, frames, min(25, frames - 2) + 1).astype(int))
    out = []
    for a, b in pairwise(edges):
        part = size[:, a:b][seen[:, a:b]]
        out.append(part.mean(axis=(0, 2)) if len(part) else np.zeros(size.shape[2]))
    return np.stack(out, axis=1)
