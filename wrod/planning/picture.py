"""Pictures of plans: pattern, grip path, grip frames and a few rod shapes."""

import os
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import PatternError
from wrod.files import write_figure
from wrod.files.pictures import FAINT, INK, MUTED, dress, dress_space
from wrod.patterns.pattern import Pattern
from wrod.planning.shapes import with_remainder_of
from wrod.planning.trajectory import Trajectory

_PATTERN, _REMAINDER, _ROD = "#0b5fa5", "#7fb0d8", "#d9822b"
_AXES = ("#d1495b", "#3a8f5c", "#3066be")
_PATH_COLORS = "viridis"
_FRAMES, _SHAPES = 10, 6


@arguments.checked(PatternError)
def draw_plan(path: str | os.PathLike[str], pattern: Pattern, trajectory: Trajectory) -> Path:
    """Write a PNG of a plan: 3D view, view from above, curvature and grip height along the rod.

    Args:
        path: the picture.
        pattern: what is laid.
        trajectory: how.
    """
    # Figure objects of their own: pyplot would keep state and choose a display.
    from matplotlib.figure import Figure

    shapes = trajectory.shape
    if shapes is not None:
        shapes = shapes[_spread(len(trajectory), _SHAPES)]
    figure = Figure(figsize=(12.8, 7.2), facecolor="white")
    view = figure.add_axes((0.0, 0.03, 0.53, 0.87), projection="3d", proj_type="ortho")
    above = figure.add_axes((0.57, 0.47, 0.41, 0.38))
    bends = figure.add_axes((0.57, 0.255, 0.41, 0.125))
    heights = figure.add_axes((0.57, 0.075, 0.41, 0.15), sharex=bends)
    _draw_view(view, trajectory, shapes)
    _draw_above(above, trajectory, shapes)
    _draw_profiles(bends, heights, pattern, trajectory)
    figure.text(0.03, 0.945, _title(pattern, trajectory), fontsize=14, color=INK, weight="bold")
    figure.text(0.03, 0.913, _subtitle(trajectory), fontsize=9.5, color=MUTED)
    _legend(figure, shapes is not None, trajectory)

    return write_figure(path, figure, 110)


def _title(pattern: Pattern, trajectory: Trajectory) -> str:
    return f"{pattern.name} · {trajectory.method or ''} plan"


def _subtitle(trajectory: Trajectory) -> str:
    rod = trajectory.metadata.get("rod", {})
    parts = []
    if rod:
        parts.append(
            f"rod {rod['length'] * 100:.1f} cm, radius {rod['radius'] * 1000:.2g} mm, "
            f"gravito-bending length {rod['gravito_bending_length'] * 100:.2f} cm"
        )
    parts.append(f"{len(trajectory)} contact nodes")
    if trajectory.closure:
        parts.append(f"closure {trajectory.closure.replace('_', ' ')}")
    return "   ·   ".join(parts)


def _spread(count: int, wanted: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).round().astype(int))


def _laid(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Contact points of the remainder and of the pattern itself."""
    s = trajectory.pattern_arc_length
    split = int(np.searchsorted(s, 0.0))
    return trajectory.contact[: split + 1] if split else trajectory.contact[:0], (
        trajectory.contact[max(split - 1, 0) :]
    )


def _colored_path(axes, points: np.ndarray, values: np.ndarray, **style):
    from matplotlib.collections import LineCollection
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    kind = Line3DCollection if points.shape[1] == 3 else LineCollection
    segments = np.stack([points[:-1], points[1:]], axis=1)
    lines = kind(list(segments), cmap=_PATH_COLORS, capstyle="round", **style)
    lines.set_array(values[:-1])
    axes.add_collection(lines)


def _draw_rods(axes, trajectory: Trajectory, shapes, dimensions: int, width: float) -> None:
    """The rod from some contacts to the grip, by straight lines where its shapes are not known."""
    style: dict = {"lw": width, "alpha": 0.9}
    if shapes is None:
        nodes = _spread(len(trajectory), _SHAPES)
        shapes = np.stack([trajectory.contact[nodes], trajectory.position[nodes]], axis=1)
        style = {"lw": 0.9, "alpha": 0.8, "ls": (0, (2, 2))}
    for shape in shapes:
        axes.plot(*shape.T[:dimensions], color=_ROD, **style)


def _draw_view(axes, trajectory: Trajectory, shapes: np.ndarray | None) -> None:
    from matplotlib.ticker import MultipleLocator

    remainder, drawn = _laid(trajectory)
    corners = np.concatenate([trajectory.contact, trajectory.position])
    if shapes is not None:
        corners = np.concatenate([corners, shapes.reshape(-1, 3)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.06 * np.max(high - low)
    low, high = low - margin * np.array([1, 1, 0]), high + margin
    # A thin wall of numbers says less than a box: no side is shorter than a third of the longest.
    short = np.maximum(np.max(high - low) / 3.0 - (high - low), 0.0)
    low, high = low - short * np.array([0.5, 0.5, 0]), high + short * np.array([0.5, 0.5, 1])
    if len(remainder):
        axes.plot(*remainder.T, color=_REMAINDER, lw=2.5)
    axes.plot(*drawn.T, color=_PATTERN, lw=2.5)
    _draw_rods(axes, trajectory, shapes, 3, 1.6)
    _colored_path(axes, trajectory.position, trajectory.arc_length, linewidths=2.2)
    size = 0.075 * np.max(high - low)
    for node in _spread(len(trajectory), _FRAMES):
        origin = trajectory.position[node]
        for column, color in enumerate(_AXES):
            tip = origin + size * trajectory.rotation[node][:, column]
            axes.plot(*np.stack([origin, tip]).T, color=color, lw=1.4)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=0.9)
    axes.view_init(elev=22, azim=-58)
    longest = np.max(high - low)
    step = next(d for d in (0.05, 0.1, 0.2, 0.5, 1.0, 5.0, 20.0, 1e3) if longest / d <= 6)
    dress_space(axes, lambda: MultipleLocator(step), "m", 9)


def _draw_above(axes, trajectory: Trajectory, shapes: np.ndarray | None) -> None:
    remainder, drawn = _laid(trajectory)
    _draw_rods(axes, trajectory, shapes, 2, 1.3)
    if len(remainder):
        axes.plot(remainder[:, 0], remainder[:, 1], color=_REMAINDER, lw=3.0)
    axes.plot(drawn[:, 0], drawn[:, 1], color=_PATTERN, lw=3.0)
    _colored_path(axes, trajectory.position[:, :2], trajectory.arc_length, linewidths=1.6)
    start = trajectory.contact[0]
    axes.plot(start[0], start[1], "o", ms=6, mfc="white", mec=_PATTERN, mew=1.6, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set_title("from above", loc="left", pad=4, fontsize=9.5, color=MUTED)
    dress(axes, x="x [m]", y="y [m]")


def _draw_profiles(bends, heights, pattern: Pattern, trajectory: Trajectory) -> None:
    remainder = trajectory.remainder_length
    s = trajectory.arc_length
    curvature = with_remainder_of(pattern, trajectory).sample(trajectory.pattern_arc_length)[2]
    bends.axhline(0.0, color=FAINT, lw=0.8)
    bends.plot(s, curvature, color=_PATTERN, lw=1.6)
    bends.set_ylabel("curvature [1/m]", fontsize=8.5)
    span = max(float(np.max(np.abs(curvature))), 1.0)
    low, high = min(float(curvature.min()), 0.0), max(float(curvature.max()), 0.0)
    bends.set_ylim(low - 0.12 * span, high + 0.12 * span)
    heights.plot(s, trajectory.position[:, 2] - trajectory.contact[:, 2], color=INK, lw=1.6)
    heights.set_ylabel("grip height [m]", fontsize=8.5)
    heights.set_ylim(bottom=0.0)
    heights.set_xlabel("laid length [m]", fontsize=8.5)
    for axes in (bends, heights):
        if remainder:
            axes.axvspan(0.0, remainder, color=_REMAINDER, alpha=0.22, lw=0)
        axes.set_xlim(0.0, s[-1])
        dress(axes)
    bends.tick_params(labelbottom=False)


def _legend(figure, has_shapes: bool, trajectory: Trajectory) -> None:
    from matplotlib import colormaps
    from matplotlib.lines import Line2D

    entries = [Line2D([], [], color=_PATTERN, lw=3, label="pattern")]
    if trajectory.remainder_length:
        entries.append(Line2D([], [], color=_REMAINDER, lw=3, label="remainder"))
    entries.append(Line2D([], [], color=colormaps[_PATH_COLORS](0.45), lw=2.2, label="grip path"))
    if has_shapes:
        entries.append(Line2D([], [], color=_ROD, lw=1.6, label="rod"))
    else:
        entries.append(Line2D([], [], color=_ROD, lw=1, ls=":", label="contact to grip"))
    entries += [
        Line2D([], [], color=color, lw=1.4, label=f"grip {axis}")
        for axis, color in zip("xyz", _AXES, strict=True)
    ]
    figure.legend(
        handles=entries, loc="upper right", bbox_to_anchor=(0.985, 0.975), ncol=4,
        fontsize=8.5, frameon=False, handlelength=1.3, columnspacing=1.6, labelcolor=MUTED,
    )  # fmt: skip
