"""Pictures of the comparison of closures."""

from pathlib import Path

import numpy as np

from wrod.bench.closures_report import CLOSURES, LABELS, METHODS, PUT_DOWN, best, places
from wrod.files import write_figure
from wrod.files.pictures import GRID, INK, MUTED

COLORS = {
    "intuitive": "#c2533c",
    "zero_tension": "#2f8f5b",
    "min_force": "#d9a521",
    "min_friction": "#3a6fb5",
    PUT_DOWN: "#9aa1aa",
}


def draw(path: Path, table: dict) -> Path:
    """Maps of the best closure over friction and curvature, and errors over friction."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    rods = list(dict.fromkeys(key[0] for key in table))
    arcs = [rod for rod in rods if any(k[0] == rod and k[1].startswith("arc ") for k in table)]
    drawn = [rod for rod in rods if rod not in arcs]
    figure = Figure(figsize=(13.0, 8.2), facecolor="white")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.08, 1.0])[:, 0]
    if arcs:
        grid = above.subplots(1, len(arcs), squeeze=False)[0]
        above.subplots_adjust(0.06, 0.13, 0.985, 0.76, 0.13)
        for axes, rod in zip(grid, arcs, strict=True):
            _draw_map(axes, table, rod)
        grid[0].set_ylabel("friction coefficient", fontsize=9)
    count = len(drawn) + any(key[1] == "line" for key in table)
    if count:
        grid = below.subplots(1, count, squeeze=False)[0]
        below.subplots_adjust(0.06, 0.14, 0.985, 0.88, 0.22)
        for axes, rod in zip(grid, drawn, strict=False):
            _draw_errors(axes, table, rod)
        grid[0].set_ylabel("e_mean [cm], mean of the patterns", fontsize=9)
        if count > len(drawn):
            _draw_line(grid[-1], table, drawn)
    figure.text(
        0.02, 0.963, "Which closure lays the rod most accurately?",
        fontsize=15, weight="bold", color=INK,
    )  # fmt: skip
    figure.text(
        0.02, 0.934,
        "Above: arcs of constant curvature; the best closure, its error [cm] and, below, that of "
        "zero tension. Grey: all within 0.02 cm. Below: the drawn patterns.",
        fontsize=9.5, color=MUTED,
    )  # fmt: skip
    figure.legend(
        handles=[
            Line2D([], [], color=COLORS[name], lw=3, label=LABELS[name])
            for name in (*METHODS, PUT_DOWN)
        ],
        loc="upper right", ncol=5, fontsize=9.5, frameon=False, bbox_to_anchor=(0.99, 0.992),
    )  # fmt: skip

    return write_figure(path, figure, 90)


def _draw_map(axes, table: dict, rod: str) -> None:
    from matplotlib.patches import Rectangle

    where = [p for p in places(table) if p[0] == rod and p[1].startswith("arc ")]
    kappas = sorted({float(p[1].split()[1]) for p in where})
    frictions = sorted({p[2] for p in where})
    for place in where:
        x, y = kappas.index(float(place[1].split()[1])), frictions.index(place[2])
        winners = best(table, place)
        errors = {name: table[*place, name].error for name in CLOSURES}
        name = min(errors, key=errors.get)
        color = COLORS[name] if len(winners) == 1 else "#dfe3e8"
        if len(winners) == 2:
            color = _blend(COLORS[winners[0]], COLORS[winners[1]])
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, color=color, alpha=0.75, lw=0))
        axes.text(
            x, y, f"{errors[name]:.2f}\n{errors['zero_tension']:.2f}",
            ha="center", va="center", fontsize=7.5, color=INK, linespacing=1.15,
        )  # fmt: skip
    axes.set_xticks(range(len(kappas)), [f"{k:g}" for k in kappas])
    axes.set_yticks(range(len(frictions)), [f"{m:g}" for m in frictions])
    axes.set_xlim(-0.5, len(kappas) - 0.5)
    axes.set_ylim(-0.5, len(frictions) - 0.5)
    axes.set_xlabel("curvature [1/L_gb]", fontsize=9)
    axes.set_title(rod, fontsize=10.5, color=INK)
    _dress(axes)


def _blend(one: str, two: str) -> tuple[float, ...]:
    """A pale mixture: both closures are as good."""
    from matplotlib.colors import to_rgb

    return tuple(0.25 * a + 0.25 * b + 0.5 for a, b in zip(to_rgb(one), to_rgb(two), strict=True))


def _draw_errors(axes, table: dict, rod: str) -> None:
    """Mean over the patterns, and the range that they span."""
    axes.set_yscale("log")
    for method in (*METHODS, PUT_DOWN):
        keys = [k for k in table if k[0] == rod and k[3] == method]
        frictions = sorted({k[2] for k in keys})
        groups = [[table[k].error for k in keys if k[2] == mu] for mu in frictions]
        if not groups:
            continue
        style = {"ls": (0, (4, 2))} if method == PUT_DOWN else {}
        x = range(len(frictions))
        means = [np.mean(group) for group in groups]
        axes.plot(x, means, color=COLORS[method], lw=1.8, marker="o", ms=3, **style)
        axes.set_xticks(x, [f"{mu:g}" for mu in frictions])
    axes.set_ylim(bottom=5e-3)
    axes.set_xlabel("friction coefficient", fontsize=9)
    axes.set_title(rod, fontsize=10.5, color=INK)
    axes.grid(color=GRID, lw=0.7)
    _dress(axes)


def _draw_line(axes, table: dict, rods: list[str]) -> None:
    styles = ("-", (0, (5, 2)), (0, (1.5, 1.5)))
    axes.set_yscale("log")
    for rod, style in zip(rods, styles * len(rods), strict=False):
        for method in ("intuitive", "zero_tension"):
            keys = sorted(k for k in table if k[0] == rod and k[1] == "line" and k[3] == method)
            x = range(len(keys))
            axes.plot(x, [table[k].error for k in keys], color=COLORS[method], lw=1.6, ls=style)
            axes.set_xticks(x, [f"{k[2]:g}" for k in keys])
        axes.plot([], [], color=MUTED, lw=1.4, ls=style, label=rod)
    axes.set_ylim(bottom=1e-3)
    axes.set_xlabel("friction coefficient", fontsize=9)
    axes.set_ylabel("e_mean [cm]", fontsize=9)
    axes.set_title("the straight line", fontsize=10.5, color=INK)
    axes.grid(color=GRID, lw=0.7)
    axes.legend(fontsize=8, frameon=False)
    _dress(axes)


def draw_friction(path: Path, table: dict) -> Path:
    """Errors over the friction that there is per friction that the plan asks for at the contact."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.6), facecolor="white")
    left, right = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(0.075, 0.13, 0.985, 0.78, 0.06)
    for axes in (left, right):  # before there are points: on tables without friction there are none
        axes.set(xscale="log", yscale="log")
    points = [
        (key, cell)
        for key, cell in table.items()
        if key[3] in CLOSURES and key[2] > 0.0 and cell.contact_friction and cell.error > 0.0
    ]
    for name in CLOSURES:
        mine = [(k, c) for k, c in points if k[3] == name and not k[1].startswith("arc ")]
        error = [cell.error for _, cell in mine]
        style = {"s": 13, "color": COLORS[name], "alpha": 0.75, "lw": 0, "label": LABELS[name]}
        left.scatter([key[2] for key, _ in mine], error, **style)
        right.scatter([key[2] / cell.contact_friction for key, cell in mine], error, **style)
    right.axvline(1.0, color=MUTED, lw=0.8, ls=(0, (4, 3)))
    left.set_ylabel("e_mean [cm]", fontsize=9)
    left.set_xlabel("friction coefficient", fontsize=9)
    right.set_xlabel("friction coefficient over what the plan asks for at the contact", fontsize=9)
    right.set_xlim(0.02, 30.0)
    for axes in (left, right):
        axes.grid(color=GRID, lw=0.7)
        _dress(axes)
    right.legend(fontsize=8.5, frameon=False)
    figure.text(
        0.02, 0.93, "What decides is the friction asked for where the rod touches down",
        fontsize=14, weight="bold", color=INK,
    )  # fmt: skip
    figure.text(
        0.02, 0.875,
        "Every drawn pattern, rod and closure. Asked for: the largest ratio of tangential to "
        "normal force of its grasps.",
        fontsize=9.5, color=MUTED,
    )  # fmt: skip

    return write_figure(path, figure, 90)


def _dress(axes) -> None:
    axes.tick_params(labelsize=8, colors=MUTED, length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
