"""Results of the campaign, told as CSV, Markdown and a picture."""

from collections import defaultdict
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from wrod import files, telling
from wrod.bench.table3_paper import METHODS, PATTERNS, RODS, SUBSTRATES, friction, measured
from wrod.files import write_figure

SHORT = {"intuitive": "INT", "numeric": "OPT"}
KEYS = ("rod", "substrate", "pattern", "method", "trial")


@dataclass(frozen=True)
class Cell:
    """Means over the trials of one cell that did not diverge [cm]: of error and deviation along the
    pattern, with the grip holding and let go; and how many trials there were."""

    held: tuple[float, float]
    released: tuple[float, float]
    trials: int
    diverged: int

    @property
    def lost(self) -> str:
        """A remark on trials that diverged."""
        return f" ({self.diverged} diverged)" if self.diverged else ""


def cells(rows: list[dict]) -> dict[tuple, Cell]:
    """(rod, substrate, pattern, method) -> cell."""
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in KEYS[:4])].append(row)
    return {key: _cell(group) for key, group in groups.items()}


def _cell(group: list[dict]) -> Cell:
    good = [row for row in group if not row["diverged"]]

    def mean(name: str) -> float:
        return float(np.mean([row[name] for row in good])) if good else np.nan

    held = mean("error_mean"), mean("error_std")
    released = mean("released_error_mean"), mean("released_error_std")
    return Cell(held, released, len(group), len(group) - len(good))


def write_csv(path: Path, table: dict) -> Path:
    paper, lines = measured(), []
    for rod, substrate, name, method in sorted(table, key=_order):
        cell = table[rod, substrate, name, method]
        lines.append(
            [rod, substrate, friction(rod, substrate), SHORT[method], name]
            + [f"{x:.4f}" for x in (*cell.held, *cell.released)]
            + [f"{x:.2f}" for x in paper[rod, substrate, name, method]]
            + [cell.trials, cell.diverged]
        )
    head = ["rod", "substrate", "friction", "method", "pattern", "e_mean [cm]", "sigma [cm]"]
    head += ["released e_mean [cm]", "released sigma [cm]", "paper e_mean [cm]"]
    return files.write_csv(path, [*head, "paper sigma [cm]", "trials", "diverged"], lines)


def _order(key) -> tuple[int, ...]:
    rod, substrate, name, method = key
    return (
        RODS.index(rod),
        SUBSTRATES.index(substrate),
        METHODS.index(method),
        PATTERNS.index(name),
    )


def markdown(table: dict, head: str) -> str:
    """Simulated over measured in every cell, with what the comparison comes to below."""
    paper = measured()
    rows = []
    for rod, substrate, method in product(RODS, SUBSTRATES, METHODS):
        if not any((rod, substrate, name, method) in table for name in PATTERNS):
            continue
        rows.append([rod, f"{substrate}, {friction(rod, substrate):g}", SHORT[method]])
        for name in PATTERNS:
            cell = table.get((rod, substrate, name, method))
            there = paper[rod, substrate, name, method]
            rows[-1].append(
                f"**{cell.held[0]:.2f} ± {cell.held[1]:.2f}**{cell.lost}<br>"
                f"let go {cell.released[0]:.2f} ± {cell.released[1]:.2f}<br>"
                f"paper {there[0]:.2f} ± {there[1]:.2f}"
                if cell
                else ""
            )
    lines = telling.table(["rod", "substrate, mu", "", *PATTERNS], rows)
    return "\n".join([head, "", *lines, "", *summary(table), ""])


def summary(table: dict) -> list[str]:
    """Where the optimal controller wins, and where it is at or below the paper's error."""
    paper = measured()
    both = [k for k in table if k[3] == "numeric" and (*k[:3], "intuitive") in table]
    wins = [k for k in both if table[k].held[0] < table[*k[:3], "intuitive"].held[0]]
    close = [k for k in both if table[k].held[0] <= paper[k][0]]
    lines = [
        f"OPT lays better than INT in {len(wins)} of {len(both)} cells, and at or below the "
        f"paper's error in {len(close)}."
    ]
    for text, good in (("INT lays better", wins), ("OPT above the paper", close)):
        worse = [k for k in both if k not in good]
        if worse:
            names = [
                f"{k[0]} {k[1]} {k[2]} ({table[k].held[0]:.2f} cm)"
                for k in sorted(worse, key=_order)
            ]
            lines.append(f"{text}: " + ", ".join(names) + ".")
    lost, trials = (sum(getattr(c, n) for c in table.values()) for n in ("diverged", "trials"))
    return [*lines, f"{lost} of {trials} trials diverged."]


def draw(path: Path, rows: list[dict], patterns: dict) -> Path:
    """Every laid curve of every trial, one panel a pattern and rod (like the paper's figure).

    Args:
        path: of the picture.
        rows: of the ledger.
        patterns: name -> pattern; those that lack leave their panels empty.
    """
    colors = {"intuitive": "#c2533c", "numeric": "#2f8f5b"}
    figure = Figure(figsize=(14.0, 6.6), facecolor="white")
    axes = figure.subplots(len(RODS), len(PATTERNS))
    for i, rod in enumerate(RODS):
        for j, name in enumerate(PATTERNS):
            panel = axes[i, j]
            panel.set_axis_off()
            if name not in patterns:
                continue
            target = patterns[name].sample(np.linspace(0.0, patterns[name].length, 300))[0]
            panel.plot(target[:, 0], target[:, 1], color="#0b5fa5", lw=4.0, alpha=0.35)
            own = [row for row in rows if (row["rod"], row["pattern"]) == (rod, name)]
            for row in sorted(own, key=lambda row: METHODS.index(row["method"])):
                curve = np.array(row["curve"])
                panel.plot(*curve.T, color=colors[row["method"]], lw=0.7, alpha=0.6)
            panel.set_aspect("equal", adjustable="datalim")
            panel.margins(0.12)
            if i == 0:
                panel.set_title(name, fontsize=11, color="#22262b")
        figure.text(0.012, 0.77 - 0.29 * i, rod, fontsize=11, color="#22262b", rotation=90)
    figure.subplots_adjust(0.03, 0.02, 0.995, 0.87, 0.05, 0.05)
    figure.legend(
        handles=[
            Line2D([], [], color="#0b5fa5", lw=4, alpha=0.35, label="pattern"),
            Line2D([], [], color=colors["intuitive"], lw=1.5, label="INT"),
            Line2D([], [], color=colors["numeric"], lw=1.5, label="OPT"),
        ],
        loc="upper right", ncol=3, fontsize=10, frameon=False,
    )  # fmt: skip
    figure.text(
        0.03, 0.955, "Laid curves of all trials on all substrates, the grip still holding",
        fontsize=14, weight="bold", color="#22262b",
    )  # fmt: skip

    return write_figure(path, figure, 90)
