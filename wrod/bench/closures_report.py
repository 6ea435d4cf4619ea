"""Results of the comparison of closures, told as CSV, Markdown and a picture."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod.files import write_atomically

KEYS = ("rod", "course", "friction", "method", "trial")
CLOSURES = ("zero_tension", "min_force", "min_friction")
METHODS = ("intuitive", *CLOSURES)
PUT_DOWN = "put down"
# Errors closer than this [cm] are no difference: it is what the steps and meshes leave.
_TIE = 0.02
_INK, _MUTED = "#22262b", "#59616b"
COLORS = {
    "intuitive": "#c2533c",
    "zero_tension": "#2f8f5b",
    "min_force": "#d9a521",
    "min_friction": "#3a6fb5",
    PUT_DOWN: "#9aa1aa",
}
LABELS = {"intuitive": "INT", PUT_DOWN: "put down exactly"} | {
    name: name.replace("_", " ") for name in CLOSURES
}


@dataclass(frozen=True)
class Cell:
    """Means over the trials of one cell that did not diverge: errors [cm], the error of each fifth
    of the pattern [cm]; and how many trials there were."""

    held: tuple[float, float]
    released: tuple[float, float]
    fifths: tuple[float, ...]
    trials: int
    diverged: int

    @property
    def error(self) -> float:
        return self.held[0]


def cells(rows: list[dict]) -> dict[tuple[str, str, float, str], Cell]:
    """(rod, course, friction, method) -> cell, in the order of the rows."""
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in KEYS[:4])].append(row)
    out = {}
    for key, group in groups.items():
        good = [row for row in group if not row["diverged"]]

        def mean(name, good=good):
            return np.mean([row[name] for row in good], axis=0) if good else np.nan

        out[key] = Cell(
            (float(mean("error_mean")), float(mean("error_std"))),
            (float(mean("released_error_mean")), float(mean("released_error_std"))),
            tuple(np.broadcast_to(mean("error_fifths"), 5).tolist()),
            len(group),
            len(group) - len(good),
        )
    return out


def write_csv(path: Path, table: dict) -> Path:
    def write(file):
        writer = csv.writer(file)
        writer.writerow(
            ["rod", "course", "friction", "method", "e_mean [cm]", "sigma [cm]"]
            + ["released e_mean [cm]", "released sigma [cm]"]
            + [f"error of fifth {k} [cm]" for k in range(1, 6)]
            + ["trials", "diverged"]
        )
        for key, cell in table.items():
            values = (*cell.held, *cell.released, *cell.fifths)
            writer.writerow([*key, *(f"{x:.4f}" for x in values), cell.trials, cell.diverged])

    return write_atomically(path, write)


def places(table: dict) -> list[tuple[str, str, float]]:
    """(rod, course, friction) of every cell that all closures could plan and none diverged in."""

    def complete(place):
        laid = [table.get((*place, name)) for name in CLOSURES]
        return all(cell is not None and np.isfinite(cell.error) for cell in laid)

    return [place for place in {key[:3]: None for key in table} if complete(place)]


def best(table: dict, place: tuple) -> list[str]:
    """The closures that lay best there: the best one, and those that are no worse by a tie."""
    errors = {name: table[*place, name].error for name in CLOSURES}
    least = min(errors.values())
    return [name for name in CLOSURES if errors[name] <= least + _TIE]


def summary(table: dict) -> list[str]:
    """What the comparison comes to."""
    where = places(table)
    if not where:
        return ["No place was laid by all closures."]
    lines = []
    wins = {name: [p for p in where if best(table, p) == [name]] for name in CLOSURES}
    among = {name: sum(name in best(table, p) for p in where) for name in CLOSURES}
    for name in CLOSURES:
        lines.append(
            f"{LABELS[name]}: alone the best of the closures in {len(wins[name])} of {len(where)} "
            f"places, within {_TIE:g} cm of the best in {among[name]}."
        )
    for low, high in ((0.0, 0.0), (0.01, 0.2), (0.21, 0.45), (0.46, 0.8), (0.81, 10.0)):
        band = [p for p in where if low <= p[2] <= high]
        if not band:
            continue
        used = sorted({p[2] for p in band})
        means = [
            f"{LABELS[name]} {np.mean([table[*p, name].error for p in band]):.3f}"
            for name in CLOSURES
        ]
        lines.append(
            f"Mean error [cm] at friction {', '.join(f'{mu:g}' for mu in used)}: "
            + ", ".join(means)
            + "."
        )
    rivals = [p for p in where if (*p, "intuitive") in table]
    for name in CLOSURES:
        worse = [p for p in rivals if table[*p, name].error > table[*p, "intuitive"].error]
        text = f"{LABELS[name]} lays better than INT in {len(rivals) - len(worse)} of {len(rivals)}"
        if worse:
            text += ", not in " + ", ".join(f"{p[0]} {p[1]} at {p[2]:g}" for p in worse[:12])
            text += ", ..." if len(worse) > 12 else ""
        lines.append(text + ".")
    lost = sum(cell.diverged for cell in table.values())
    lines.append(f"{lost} of {sum(cell.trials for cell in table.values())} trials diverged.")
    return lines


def markdown(table: dict, head: str, words: list[str]) -> str:
    """One table a rod: courses and methods down, friction across; the best closures in bold."""
    lines = [head, "", *(f"- {line}" for line in words), ""]
    for rod in dict.fromkeys(key[0] for key in table):
        frictions = sorted({key[2] for key in table if key[0] == rod})
        lines += [f"## {rod}", "", "| | | " + " | ".join(f"mu {m:g}" for m in frictions) + " |"]
        lines.append("|" + " --- |" * (2 + len(frictions)))
        for course in dict.fromkeys(key[1] for key in table if key[0] == rod):
            for method in (*METHODS, PUT_DOWN):
                row = [course, LABELS[method]]
                for mu in frictions:
                    place = (rod, course, mu)
                    cell = table.get((*place, method))
                    if cell is None:
                        row.append("")
                        continue
                    complete = all((*place, name) in table for name in CLOSURES)
                    bold = "**" if complete and method in best(table, place) else ""
                    lost = f" ({cell.diverged} diverged)" if cell.diverged else ""
                    row.append(f"{bold}{cell.error:.2f}{bold}{lost}")
                lines.append("| " + " | ".join(row) + " |")
        lines.append("")
    return "\n".join(lines)


def draw(path: Path, table: dict) -> Path:
    """Maps of the best closure over friction and curvature, and errors over friction."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    rods = list(dict.fromkeys(key[0] for key in table))
    arcs = [rod for rod in rods if any(k[0] == rod and k[1].startswith("arc ") for k in table)]
    drawn = [rod for rod in rods if rod not in arcs]
    figure = Figure(figsize=(13.0, 8.2), facecolor="white")
    FigureCanvasAgg(figure)
    above, below = figure.subfigures(2, 1, height_ratios=[1.08, 1.0])
    if arcs:
        grid = above.subplots(1, len(arcs), squeeze=False)[0]
        above.subplots_adjust(0.06, 0.13, 0.985, 0.76, 0.13)
        for axes, rod in zip(grid, arcs, strict=True):
            _draw_map(axes, table, rod)
    count = len(drawn) + any(key[1] == "line" for key in table)
    if count:
        grid = below.subplots(1, count, squeeze=False)[0]
        below.subplots_adjust(0.06, 0.14, 0.985, 0.88, 0.22)
        for axes, rod in zip(grid, drawn, strict=False):
            _draw_errors(axes, table, rod)
        if count > len(drawn):
            _draw_line(grid[-1], table, drawn)
    figure.text(
        0.02, 0.963, "Which closure lays the rod most accurately?",
        fontsize=15, weight="bold", color=_INK,
    )  # fmt: skip
    figure.text(
        0.02, 0.934,
        "Above: arcs of constant curvature; the best closure, its error [cm] and, below, that of "
        "zero tension. Grey: all within 0.02 cm. Below: the drawn patterns.",
        fontsize=9.5, color=_MUTED,
    )  # fmt: skip
    figure.legend(
        handles=[
            Line2D([], [], color=COLORS[name], lw=3, label=LABELS[name])
            for name in (*METHODS, PUT_DOWN)
        ],
        loc="upper right", ncol=5, fontsize=9.5, frameon=False, bbox_to_anchor=(0.99, 0.992),
    )  # fmt: skip

    def write(file):
        figure.savefig(file, format="png", dpi=90)

    return write_atomically(path, write, "wb")


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
            ha="center", va="center", fontsize=7.5, color=_INK, linespacing=1.15,
        )  # fmt: skip
    axes.set_xticks(range(len(kappas)), [f"{k:g}" for k in kappas])
    axes.set_yticks(range(len(frictions)), [f"{m:g}" for m in frictions])
    axes.set_xlim(-0.5, len(kappas) - 0.5)
    axes.set_ylim(-0.5, len(frictions) - 0.5)
    axes.set_xlabel("curvature [1/L_gb]", fontsize=9)
    axes.set_ylabel("friction coefficient", fontsize=9)
    axes.set_title(rod, fontsize=10.5, color=_INK)
    _dress(axes)


def _blend(one: str, two: str) -> tuple[float, ...]:
    """A pale mixture: both closures are as good."""
    from matplotlib.colors import to_rgb

    return tuple(0.25 * a + 0.25 * b + 0.5 for a, b in zip(to_rgb(one), to_rgb(two), strict=True))


def _draw_errors(axes, table: dict, rod: str) -> None:
    """Mean over the patterns, and the range that they span."""
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
    axes.set_yscale("log")
    axes.set_ylim(bottom=5e-3)
    axes.set_xlabel("friction coefficient", fontsize=9)
    axes.set_ylabel("e_mean [cm], mean of patterns", fontsize=9)
    axes.set_title(rod, fontsize=10.5, color=_INK)
    axes.grid(color="#e6e9ee", lw=0.7)
    _dress(axes)


def _draw_line(axes, table: dict, rods: list[str]) -> None:
    styles = ("-", (0, (5, 2)), (0, (1.5, 1.5)))
    for rod, style in zip(rods, styles * len(rods), strict=False):
        for method in ("intuitive", "zero_tension"):
            keys = sorted(k for k in table if k[0] == rod and k[1] == "line" and k[3] == method)
            x = range(len(keys))
            axes.plot(x, [table[k].error for k in keys], color=COLORS[method], lw=1.6, ls=style)
            axes.set_xticks(x, [f"{k[2]:g}" for k in keys])
        axes.plot([], [], color=_MUTED, lw=1.4, ls=style, label=rod)
    axes.set_yscale("log")
    axes.set_ylim(bottom=1e-3)
    axes.set_xlabel("friction coefficient", fontsize=9)
    axes.set_ylabel("e_mean [cm]", fontsize=9)
    axes.set_title("the straight line", fontsize=10.5, color=_INK)
    axes.grid(color="#e6e9ee", lw=0.7)
    axes.legend(fontsize=8, frameon=False)
    _dress(axes)


def _dress(axes) -> None:
    axes.tick_params(labelsize=8, colors=_MUTED, length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
