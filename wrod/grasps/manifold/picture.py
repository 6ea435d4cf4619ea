"""Pictures of the manifold of grasps: its forces, its sideways softness, and its optima nudged."""

import os
from pathlib import Path

import numpy as np

from wrod.files import write_figure
from wrod.files.pictures import FAINT, INK, MUTED, dress, dress_space
from wrod.grasps.manifold.map import ForceMap

# Optima in order of their force; a third would be rare.
_OPTIMA = ("#d1495b", "#0b5fa5", "#3a8f5c", "#8a5fb0")
_SOFT = "#e2711d"
_FORCES, _SOFTNESS = "viridis_r", "magma_r"


def draw_map(path: str | os.PathLike[str], manifold: ForceMap) -> Path:
    """Write a PNG of the manifold: force at the contact, and deflection under a sideways nudge.

    Beside Fig. 2Dschematic (c) and (d) of the paper.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.8, 5.2), facecolor="white")
    size = [np.linalg.norm(patch.force, axis=2) for patch in manifold.patches]
    soft = [patch.deflection for patch in manifold.patches]
    top = max(float(field.max()) for field in soft)
    panels = (
        (
            size,
            _FORCES,
            LogNorm(*np.quantile(np.concatenate([f.ravel() for f in size]), [0.02, 0.9])),
            "force at the contact  ‖F‖ [k_b / L_gb²]",
        ),
        (
            soft,
            _SOFTNESS,
            LogNorm(manifold.offset, max(1.2 * top, 2.0 * manifold.offset)),
            f"largest sideways deflection at Δy = {manifold.offset:g} [L_gb]",
        ),
    )
    for j, (fields, colors, norm, label) in enumerate(panels):
        left = 0.045 + 0.5 * j
        axes = figure.add_axes((left, 0.21, 0.445, 0.62))
        for patch, field in zip(manifold.patches, fields, strict=True):
            # Gouraud shading lets neighbouring patches meet without a seam.
            mesh = axes.pcolormesh(
                patch.position[..., 0],
                patch.position[..., 1],
                np.clip(field, norm.vmin, norm.vmax),
                cmap=colors,
                norm=norm,
                shading="gouraud",
                rasterized=True,
            )
        _draw_outline(axes, manifold)
        _draw_optima(axes, manifold)
        _dress(axes)
        reach = 1.08 * manifold.suspended_length
        axes.set(xlim=(-reach, reach), ylim=(-0.05 * reach, 1.05 * reach), aspect="equal")
        axes.set_title(label, loc="left", fontsize=10, color=MUTED, pad=6)
        bar = figure.colorbar(
            mesh,
            cax=figure.add_axes((left + 0.04, 0.075, 0.365, 0.022)),
            orientation="horizontal",
            extend="both" if j == 0 else "neither",
        )
        ticks = np.outer(10.0 ** np.arange(-4, 5), [1.0, 2.0, 5.0]).ravel()
        if j == 1:
            ticks = np.append(ticks, manifold.offset)
        shown = ticks[(ticks >= norm.vmin) & (ticks <= norm.vmax)].tolist()
        bar.set_ticks(shown, labels=[f"{t:g}" for t in shown], minor=False)
        bar.ax.minorticks_off()
        bar.ax.tick_params(labelsize=8, colors=MUTED, length=0)
        bar.outline.set_visible(False)
    figure.text(0.03, 0.93, _title(manifold), fontsize=13, color=INK, weight="bold")
    _name_optima(figure, manifold)
    return write_figure(path, figure, 110)


def draw_nudges(path: str | os.PathLike[str], manifold: ForceMap) -> Path:
    """Write a PNG of the optima under sideways nudges: force against offset, and configurations.

    Beside Fig. stability of the paper.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.8, 5.2), facecolor="white")
    width = 0.94 / len(manifold.optima)
    for j, optimum in enumerate(manifold.optima):
        left = 0.06 + j * width
        _draw_forces(figure.add_axes((left, 0.13, 0.4 * width, 0.6)), manifold, j)
        box = (left + 0.43 * width, 0.0, 0.53 * width, 0.86)
        _draw_shapes(figure, box, manifold, j)
        word = "stable" if optimum.stable else "unstable"
        figure.text(
            left, 0.83, f"optimum {j + 1}: {word}",
            fontsize=11, color=_OPTIMA[j % len(_OPTIMA)], weight="bold",
        )  # fmt: skip
        figure.text(
            left, 0.78, f"softest motion λ = {optimum.eigenvalue:+.3f} k_b / L_gb⁴",
            fontsize=9, color=MUTED,
        )  # fmt: skip
    figure.text(0.03, 0.93, _title(manifold), fontsize=13, color=INK, weight="bold")
    return write_figure(path, figure, 110)


def _draw_forces(axes, manifold: ForceMap, j: int) -> None:
    nudges, snaps_at = manifold.nudges, manifold.optima[j].snaps_at
    force = np.abs(nudges.force[j, :, 1])
    top = max(float(force.max()), 1e-3)
    axes.plot(nudges.offset, force, color=_OPTIMA[j % len(_OPTIMA)], lw=1.8)
    axes.set_xlabel("sideways nudge Δy [L_gb]", fontsize=9, color=MUTED)
    axes.set_ylabel("|F_y| at the contact [k_b / L_gb²]", fontsize=9, color=MUTED)
    axes.set_ylim(0.0, 1.2 * top)
    axes.set_xlim(-0.02 * nudges.offset[-1], nudges.offset[-1])
    if np.isfinite(snaps_at):
        axes.annotate(
            f"snaps at Δy ≤ {snaps_at:.3g}", (snaps_at, 0.5 * top),
            xytext=(snaps_at + 0.12 * nudges.offset[-1], 0.5 * top), va="center",
            arrowprops={"arrowstyle": "->", "color": INK, "lw": 0.9}, fontsize=9, color=INK,
        )  # fmt: skip
    _dress(axes)


def _title(manifold: ForceMap) -> str:
    return (
        f"Grasps of a straight pattern · suspended length {manifold.suspended_length:g} L_gb, "
        f"stretch ratio {manifold.stretch_ratio:g}"
    )


def _draw_outline(axes, manifold: ForceMap) -> None:
    """The table, where motions turn soft, and the edge of the manifold."""
    axes.axhline(0.0, color=FAINT, lw=3.0, zorder=0)
    for number, patch in enumerate(manifold.patches):
        x, z = patch.position[..., 0], patch.position[..., 1]
        if (patch.eigenvalue < 0.0).any() and (patch.eigenvalue > 0.0).any():
            axes.contour(x, z, patch.eigenvalue, levels=[0.0], colors=_SOFT, linewidths=1.4,
                         linestyles="--")  # fmt: skip
        low = patch.position[:, -1]
        if number == 0 and len(manifold.patches) > 1:
            # No line across the fold, where neighbouring rays end far apart.
            fold = int(np.argmax(np.linalg.norm(np.diff(low, axis=0), axis=1)))
            low = np.insert(low, fold + 1, np.nan, axis=0)
        other = patch.position[:, 0] if number == 0 else patch.position[0]
        for edge in (low, other):
            axes.plot(edge[:, 0], edge[:, 1], color=INK, lw=0.8)
    values = np.concatenate([patch.eigenvalue.ravel() for patch in manifold.patches])
    if (values < 0.0).any():
        axes.plot([], [], color=_SOFT, lw=1.4, ls="--", label="stability changes")
        axes.legend(loc="upper left", fontsize=8.5, frameon=False, labelcolor=MUTED)


def _draw_optima(axes, manifold: ForceMap) -> None:
    for j, optimum in enumerate(manifold.optima):
        color = _OPTIMA[j % len(_OPTIMA)]
        axes.plot(optimum.shape[:, 0], optimum.shape[:, 2], color=color, lw=1.6, alpha=0.85)
        x, _, z = optimum.position
        axes.plot(
            x, z, "o" if optimum.stable else "X", ms=9, mfc=color, mec="white", mew=1.2, zorder=6,
        )  # fmt: skip
        axes.annotate(
            str(j + 1), (x, z), xytext=(9, -11), textcoords="offset points", fontsize=10,
            color=color, weight="bold", zorder=7,
        )  # fmt: skip
    axes.plot(0.0, 0.0, "o", ms=5, mfc="white", mec=INK, mew=1.2, zorder=6)


def _name_optima(figure, manifold: ForceMap) -> None:
    for j, optimum in enumerate(manifold.optima):
        x, _, z = optimum.position
        word = "stable" if optimum.stable else "unstable"
        figure.text(
            0.985, 0.945 - 0.042 * j,
            f"optimum {j + 1}, {word}:  grip ({x:.2f}, {z:.2f}),  ‖F‖ = "
            f"{np.linalg.norm(optimum.force):.2f}",
            ha="right", fontsize=9.5, color=_OPTIMA[j % len(_OPTIMA)],
        )  # fmt: skip


def _draw_shapes(figure, box, manifold: ForceMap, j: int) -> None:
    """The lower part of the rod, where it bends, at a few offsets."""
    from matplotlib import colormaps
    from matplotlib.ticker import MaxNLocator

    axes = figure.add_axes(box, projection="3d", proj_type="ortho")
    nudges, optimum = manifold.nudges, manifold.optima[j]
    height = min(5.0, float(optimum.position[2]))
    chosen = np.unique(np.linspace(0, len(nudges.offset) - 1, 6).round().astype(int))
    shapes = []
    for k in chosen:
        shape = nudges.shape[j, k]
        # From the contact to where the rod first leaves the box.
        above = np.flatnonzero(shape[:, 2] > height)
        shapes.append(shape[: above[0] if above.size else None])
    for k, shape in zip(chosen, shapes, strict=True):
        share = nudges.offset[k] / nudges.offset[-1]
        color = INK if k == 0 else colormaps["plasma"](0.85 * share)
        axes.plot(*shape.T, color=color, lw=1.8, label=f"Δy = {nudges.offset[k]:.2g}")
    points = np.concatenate(shapes)
    low, high = points.min(axis=0), points.max(axis=0)
    low[2], high[2] = 0.0, height
    grow = np.maximum(0.45 * (high - low).max() - (high - low), 0.0) / 2.0
    low, high = low - grow, high + grow
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.85)
    axes.view_init(elev=22, azim=-62)
    dress_space(axes, lambda: MaxNLocator(3), "L_gb", 8.5)
    axes.legend(loc="upper left", fontsize=8, frameon=False, labelcolor=MUTED, handlelength=1.2)


def _dress(axes) -> None:
    if axes.get_xlabel() == "":
        axes.set_xlabel("x [L_gb]", fontsize=9, color=MUTED)
        axes.set_ylabel("z [L_gb]", fontsize=9, color=MUTED)
    dress(axes)
