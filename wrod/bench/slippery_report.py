"""What `wrod bench slippery` tells of its trials."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wrod import files
from wrod.files import write_figure

KEYS = ("rod", "pattern", "friction", "method", "engine", "trial")
# A rod that is put down exactly where a robot that stands elsewhere, and does not know it, has the
# pattern, and one that stays there: what no plan can be better than on average.
PUT_DOWN, MISPLACED = "put_down", "misplaced"
# The nearest curve to the pattern that can lie at rest, wherever the robot stands.
HELD = "held"
# Put down exactly, a rod that moves by less than this [cm] has nothing that springs back.
_MOVES = 0.1
# From the pattern, from where the robot, misplaced, has it, and from where trials lie on average,
# which is what no plan takes away that does not see them.
_ERRORS = ("error_mean", "error_robot", "apart")


def summary(rows: list[dict]) -> list[dict]:
    """Mean errors [cm] by method of each rod, pattern, friction and engine: from the pattern, from
    where the robot, misplaced, has it, and of two trials or more how far "apart" they lie."""
    out: dict[tuple, dict] = {}
    place = (*KEYS[:3], "engine")
    for row in rows:
        cell = out.setdefault(tuple(row[name] for name in place), {})
        cell.setdefault(row["method"], []).append(row)
    table = []
    for key, cell in out.items():
        table.append(dict(zip(place, key, strict=True)))
        for name in _ERRORS[:2]:
            table[-1][name] = {m: float(np.mean([r[name] for r in of])) for m, of in cell.items()}
        table[-1]["apart"] = {
            method: _apart(np.array([row["curve"] for row in of]))
            for method, of in cell.items()
            if len(of) > 1
        }
    return table


def _apart(curves: np.ndarray) -> float:
    """Mean distance [cm] of curves (trial, point, 2) [m] from where they would lie on average."""
    count = len(curves)
    off = np.linalg.norm(curves - curves.mean(axis=0), axis=2)
    return float(100.0 * np.sqrt(count / (count - 1.0)) * off.mean())


def means(table: list[dict], bends: Callable[[str, str], bool]) -> list[dict]:
    """Mean errors [cm] of the cells of each friction and engine, of patterns that bend and of
    others, by the methods that all of these cells have; "cells" says of how many, "better" in how
    many a method's rods lie nearer than those that were put down, and "moved" in how many of how
    many of those where these had moved from where they were put."""
    groups: dict[tuple, list[dict]] = {}
    for cell in table:
        place = bends(cell["rod"], cell["pattern"]), cell["friction"], cell["engine"]
        groups.setdefault(place, []).append(cell)
    out = []
    for place, cells in sorted(groups.items(), key=lambda one: (not one[0][0], *one[0][1:])):
        out.append(dict(zip(("bent", "friction", "engine"), place, strict=True)))
        out[-1]["cells"] = len(cells)
        for name in _ERRORS:
            common = [m for m in cells[0][name] if all(m in c[name] for c in cells)]
            out[-1][name] = {m: float(np.mean([c[name][m] for c in cells])) for m in common}
            if PUT_DOWN in common and name != _ERRORS[2]:
                out[-1].setdefault("better", {})[name] = {
                    m: sum(c[name][m] < c[name][PUT_DOWN] for c in cells)
                    for m in common
                    if m not in (PUT_DOWN, MISPLACED, HELD)
                }
        if PUT_DOWN in out[-1]["error_mean"]:
            moved = [c["error_mean"] for c in cells if c["error_robot"][PUT_DOWN] > _MOVES]
            out[-1]["moved"] = {
                m: (sum(c[m] < c[PUT_DOWN] for c in moved), len(moved))
                for m in out[-1]["better"]["error_mean"]
            }
    return out


def told(table: list[dict], groups: list[dict]) -> list[str]:
    """Lines for a reader; in brackets the other errors that `summary` knows."""

    def errors(one: dict) -> str:
        def of(method: str) -> str:
            first, *rest = [f"{one[n][method]:.3f}" for n in _ERRORS if method in one[n]]
            return f"{method} {first} ({', '.join(rest)})"

        return f"{', '.join(map(of, one['error_mean']))} cm, {one['engine']}"

    lines = [
        f"{one['rod']}, {one['pattern']}, friction {one['friction']:g}: {errors(one)}"
        for one in table
    ]
    for one in groups:
        kind = "that bend by over" if one["bent"] else "that bend by up to"
        lines.append(
            f"mean of {one['cells']} {kind} 0.4 / L_gb, friction {one['friction']:g}: {errors(one)}"
        )
        if one.get("better", {}).get(_ERRORS[0]):
            on_table, own = (one["better"][name] for name in _ERRORS[:2])
            each = ", ".join(f"{m} {on_table[m]} ({own[m]})" for m in on_table)
            lines.append(f"cells of these in which rods lie nearer than those put down: {each}")
            each = ", ".join(f"{m} {won} of {count}" for m, (won, count) in one["moved"].items())
            lines.append(f"and where those move by over {_MOVES:g} cm once put down: {each}")
    said = "from where the robot, misplaced, has the pattern; how far trials lie from their mean"
    return [*lines, f"(in brackets: {said})"]


def write_csv(path: Path, rows: list[dict]) -> Path:
    """One trial a line."""
    names = [*KEYS, *_ERRORS[:2], "error_std", "diverged"]
    head = [f"{n} [cm]" if n.startswith("error") else n for n in names]
    return files.write_csv(path, head, [[row[n] for n in names] for row in rows])


def draw(path: Path, rows: list[dict], course: Callable, methods: tuple[str, ...]) -> Path:
    """What lies, one panel for each pattern and friction, one colour for each method.

    Args:
        course: gives pattern and rod by their names.
    """
    from matplotlib.figure import Figure

    places = list(dict.fromkeys((r["rod"], r["pattern"]) for r in rows))
    mus = sorted({r["friction"] for r in rows})
    count = len(places) * len(mus)
    across = len(mus) if len(mus) > 1 else math.ceil(math.sqrt(count))
    down = -(-count // across)
    figure = Figure(figsize=(3.6 * across, 3.4 * down + 0.5), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis in axes[count:]:
        axis.set_axis_off()
    lines = {}
    for i, place in enumerate(places):
        led, _ = course(*place)
        target = 100.0 * led.sample(np.linspace(0.0, led.length, 300))[0]
        for j, mu in enumerate(mus):
            axis = axes[i * len(mus) + j]
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
            axis.set(xlabel="x [cm]", ylabel="y [cm]")
    figure.legend(
        lines.values(),
        lines.keys(),
        loc="outside lower center",
        ncols=min(6, 2 * across),
        fontsize=8,
    )
    return write_figure(path, figure, 130)
