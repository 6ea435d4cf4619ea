"""What the examples have in common: pictures, and a first shape."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def panels(count: int = 1, **options):
    """A figure with `count` axes side by side."""
    figure, axes = plt.subplots(
        1, count, figsize=(6.4 * count, 4.4), layout="constrained", **options
    )
    for one in figure.axes:
        one.spines[["top", "right"]].set_visible(False)
        one.grid(color="#e4e7ec", lw=0.6)
    return figure, axes


def save(figure, out: str | Path, name: str) -> Path:
    """Write the figure as `out/name.png` and say so."""
    path = Path(out) / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(path)
    return path


def sagging(s: np.ndarray, apart: float) -> np.ndarray:
    """(node, 3) nodes at arc lengths s (node,) of a parabola between two points [m]."""
    x = np.linspace(0.0, apart, 2000)
    shallow, deep = 0.0, s[-1]
    for _ in range(60):
        depth = 0.5 * (shallow + deep)
        z = -4.0 * depth * (x / apart) * (1.0 - x / apart)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
        shallow, deep = (depth, deep) if along[-1] < s[-1] else (shallow, depth)
    return np.column_stack([np.interp(s, along, x), 0.0 * s, np.interp(s, along, z)])
