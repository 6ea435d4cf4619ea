"""Pictures of what the residual of a motion looks like as mechanics, as PNG bytes."""

import numpy as np

from wrod.files.pictures import (
    AFTER,
    FAINT,
    INK,
    MUTED,
    SERIES,
    add_scale,
    as_png,
    draw_bands,
    dress,
    dress_map,
    new_figure,
)
from wrod.identification.motion.trace import MotionTrace

_ALONG = "arc length from the first grip [m]"


def missing_force(trace: MotionTrace, rate: float, name: str) -> bytes:
    """The missing force of one recording over time, and its mean over all, in two frames."""
    f = trace.shown
    figure = new_figure(11.0, 5.6)
    top, bottom = figure.subfigures(2, 1)
    axes = top.subplots(1, 3, sharey=True)
    maps = (
        ("upwards", f.laboratory[..., 2]),
        ("along m1, in the material", f.material[..., 0]),
        ("along m2, in the material", f.material[..., 1]),
    )
    limit = max(float(np.percentile(np.abs(np.stack([m for _, m in maps])), 98)), 1e-6)
    edges = _edges(f.arc_length)
    time = _edges(f.frame / rate)
    for panel, (title, values) in zip(axes, maps, strict=True):
        shown = panel.pcolormesh(
            time, edges, values.T, cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True
        )
        panel.set_xlabel("time [s]", fontsize=8.5)
        dress_map(panel, title)
    axes[0].set_ylabel(f"recording {name}\narc length [m]", fontsize=8.5)
    add_scale(top, shown, axes, "missing force / weight")
    axes = bottom.subplots(1, 2, sharey=True)
    frames = (("laboratory", ("x", "y", "z")), ("material", ("m1", "m2", "tangent")))
    for panel, (frame, labels) in zip(axes, frames, strict=True):
        value, error = trace.force.mean(frame)
        draw_bands(panel, trace.force.arc_length, value, error, labels)
        title = f"mean in the {frame} frame, all recordings (± 2 standard errors)"
        dress(panel, title, _ALONG, legend=True, ncol=3)
    axes[0].set_ylabel("missing force / weight", fontsize=8.5)
    return as_png(figure)


def prints(trace: MotionTrace) -> bytes:
    """The likeliest print and the share of the missing force that each takes away."""
    figure = new_figure(11.0, 4.0)
    left, right = figure.subplots(1, 2)
    best = trace.prints[0]
    if best.arc_length is None:
        place = np.arange(len(best.value))
        left.bar(place, best.value, yerr=2 * best.stderr, color=AFTER, width=0.6, ecolor=INK)
        left.set_xticks(place, [c.replace(" ", "\n", 1) for c in best.components], fontsize=8)
    else:
        draw_bands(left, best.arc_length, best.value, best.stderr, best.components)
        dress(left, x=_ALONG, legend=True, ncol=3)
    y = f"[{best.unit}]" if best.unit else "relative"
    dress(left, f"{best.title} (± 2 standard errors)", y=y)
    shown = trace.prints[::-1]
    place = np.arange(len(shown))
    first = trace.steps[0][0][0] if trace.steps else None
    share = 100 * np.array([max(p.share, 0.0) for p in shown])
    later = 100 * np.array([max(trace.remaining.get(p.name, 0.0), 0.0) for p in shown])
    colors = [AFTER if p.name == first else FAINT for p in shown]
    right.barh(place + 0.18, share, 0.34, color=colors)
    right.barh(place - 0.2, later, 0.34, color=SERIES[1], alpha=0.75)
    for y, p, a, b in zip(place, shown, share, later, strict=True):
        right.text(a, y + 0.18, f"  {a:.0f} %", va="center", fontsize=7.5, color=MUTED)
        if p.name in trace.remaining:
            right.text(b, y - 0.2, f"  {b:.0f} %", va="center", fontsize=7.5, color=MUTED)
    right.set_yticks(place, [p.name.replace("_", " ") for p in shown])
    right.set_xlim(0.0, 112.0)
    dress(right, "share of the missing force alone, and (orange) of what the first leaves")
    right.grid(False, axis="y")
    return as_png(figure)


def _edges(centres: np.ndarray) -> np.ndarray:
    """Cell borders around places."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])
