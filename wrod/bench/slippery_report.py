"""What `wrod bench slippery` tells of its trials."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wrod import files

KEYS = ("rod", "pattern", "friction", "method", "engine", "trial")
# From the pattern, and from where the robot, misplaced, has it.
_ERRORS = ("error_mean", "error_robot")


def summary(rows: list[dict]) -> list[dict]:
    """Mean errors [cm] by method of each rod, pattern, friction and engine: from the pattern, and
    from where the robot, misplaced, has it."""
    out: dict[tuple, dict] = {}
    place = (*KEYS[:3], "engine")
    for row in rows:
        out.setdefault(tuple(row[name] for name in place), {}).setdefault(row["method"], []).append(
            [row[name] for name in _ERRORS]
        )
    table = []
    for key, cell in out.items():
        means = {method: np.mean(values, axis=0) for method, values in cell.items()}
        table.append(dict(zip(place, key, strict=True)))
        for i, name in enumerate(_ERRORS):
            table[-1][name] = {method: float(mean[i]) for method, mean in means.items()}
    return table


def means(table: list[dict], bends: Callable[[str, str], bool]) -> list[dict]:
    """Mean errors [cm] of the cells of each friction and engine, of patterns that bend and of
    others, by the methods that all of these cells have; "cells" says of how many."""
    groups: dict[tuple, list[dict]] = {}
    for cell in table:
        place = bends(cell["rod"], cell["pattern"]), cell["friction"], cell["engine"]
        groups.setdefault(place, []).append(cell)
    out = []
    for place, cells in sorted(groups.items(), key=lambda one: (not one[0][0], *one[0][1:])):
        common = [m for m in cells[0][_ERRORS[0]] if all(m in c[_ERRORS[0]] for c in cells)]
        out.append(dict(zip(("bent", "friction", "engine"), place, strict=True)))
        out[-1]["cells"] = len(cells)
        for name in _ERRORS:
            out[-1][name] = {m: float(np.mean([c[name][m] for c in cells])) for m in common}
    return out


def told(table: list[dict], groups: list[dict]) -> list[str]:
    """Lines for a reader; in brackets errors from where the robot, misplaced, has the pattern."""

    def errors(one: dict) -> str:
        by_robot = one["error_robot"]
        return (
            ", ".join(f"{m} {e:.3f} ({by_robot[m]:.3f})" for m, e in one["error_mean"].items())
            + f" cm, {one['engine']}"
        )

    lines = [
        f"{one['rod']}, {one['pattern']}, friction {one['friction']:g}: {errors(one)}"
        for one in table
    ]
    for one in groups:
        kind = "that bend by over" if one["bent"] else "that bend by up to"
        lines.append(
            f"mean of {one['cells']} {kind} 0.4 / L_gb, friction {one['friction']:g}: {errors(one)}"
        )
    return [*lines, "(in brackets: from where the robot, misplaced, has the pattern)"]


def write_csv(path: Path, rows: list[dict]) -> Path:
    """One trial a line."""
    names = [*KEYS, *_ERRORS, "error_std", "diverged"]
    head = [f"{n} [cm]" if n.startswith("error") else n for n in names]
    return files.write_csv(path, head, [[row[n] for n in names] for row in rows])


def draw(path: Path, rows: list[dict], course: Callable, methods: tuple[str, ...]) -> Path:
    """What lies, one panel for each pattern and friction, one colour for each method.

    Args:
        course: gives pattern and rod by their names.
    """
    from matplotlib.figure import Figure

    from wrod.files import write_figure

    places = list(dict.fromkeys((r["rod"], r["pattern"]) for r in rows))
    mus = sorted({r["friction"] for r in rows})
    figure = Figure(figsize=(3.6 * len(mus), 3.4 * len(places) + 0.5), layout="constrained")
    axes = figure.subplots(len(places), len(mus), squeeze=False)
    lines = {}
    for i, place in enumerate(places):
        led, _ = course(*place)
        target = 100.0 * led.sample(np.linspace(0.0, led.length, 300))[0]
        for j, mu in enumerate(mus):
            axis = axes[i, j]
            lines["pattern"] = axis.plot(*target[:, :2].T, color="0.8", lw=4)[0]
            for row in rows:
                if ((row["rod"], row["pattern"]), row["friction"]) == (place, mu):
                    colour = f"C{methods.index(row['method'])}"
                    curve = 100.0 * np.array(row["curve"])
                    label = row["method"].replace("_", " ")
                    other = row["engine"] != "wrod"
                    label += f" ({row['engine']})" if other else ""
                    style = "--" if other else "-"
                    lines[label] = axis.plot(*curve.T, color=colour, lw=1, ls=style)[0]
            axis.set_aspect("equal")
            axis.set_title(f"{place[0]}, {place[1]}, friction {mu:g}", fontsize=9)
            axis.set_xlabel("x [cm]")
    figure.legend(
        lines.values(),
        lines.keys(),
        loc="outside lower center",
        ncols=min(6, 2 * len(mus)),
        fontsize=8,
    )
    return write_figure(path, figure, 130)
