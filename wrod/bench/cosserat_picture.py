"""Errors against time of `wrod bench cosserat`, a panel for each experiment."""

import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from wrod.files import write_figure

_LOOKS = {
    "wrod": ("#d1495b", "o"), "pyelastica": ("#3a8f5c", "s"), "newton-vbd": ("#0b5fa5", "D"),
    "mujoco": ("#c98a1b", "^"), "dismech": ("#6b4c9a", "v"),
    "dismech-newton": ("#8a5a44", "P"),
}  # fmt: skip
_INK, _MUTED, _FAINT = "#22262b", "#59616b", "#e6e9ee"


def draw(path: str | os.PathLike[str], rows: list[dict], metrics: dict, machine: str) -> Path:
    """Write a PNG: lower left is better; who has no row, and why, stands in the panel.

    Args:
        path: of the picture.
        rows: of the command.
        metrics: (experiment: name of its error).
        machine: what they were measured on.
    """
    names = list(dict.fromkeys(row["experiment"] for row in rows))
    across = min(3, len(names))
    figure = Figure(figsize=(4.6 * across, 3.9 * -(-len(names) // across)), layout="constrained")
    for k, name in enumerate(names):
        axes = figure.add_subplot(-(-len(names) // across), across, k + 1)
        absent = _panel(axes, [row for row in rows if row["experiment"] == name], metrics[name])
        axes.set_title(f"{name}: {metrics[name].replace('_', ' ')}", fontsize=10, color=_INK)
        label = "\n".join(["processor time per simulated second [s]", *absent])
        axes.set_xlabel(label, fontsize=7.5, color=_MUTED)
        axes.tick_params(labelsize=8, colors=_MUTED)
        axes.grid(True, which="major", color=_FAINT)
        axes.set_axisbelow(True)
    figure.suptitle(machine, fontsize=8, color=_MUTED)
    return write_figure(path, figure, 110, metadata={"Software": None})


def _panel(axes, rows: list[dict], metric: str) -> list[str]:
    """Draw a line for each solver; a sentence for each that has none."""
    absent = []
    for solver, (color, marker) in _LOOKS.items():
        mine = [row for row in rows if row["solver"] == solver]
        done = [row for row in mine if (row.get("metrics") or {}).get(metric) is not None]
        if done:
            cost = [row["seconds"] / row["simulated"] for row in done]
            error = [max(abs(row["metrics"][metric]), 1e-7) for row in done]
            axes.plot(cost, error, color=color, marker=marker, lw=1.5, ms=5, label=solver)
            for x, y, row in zip(cost, error, done, strict=True):
                axes.annotate(row["elements"], (x, y), xytext=(4, 3), textcoords="offset points",
                              fontsize=6.5, color=_MUTED)  # fmt: skip
        elif mine:
            said = mine[0]["said"][:60].replace("$", r"\$")  # it would be mathematics
            absent.append(f"{solver}: {said}")
    for scale, axis in ((axes.set_xscale, axes.xaxis), (axes.set_yscale, axes.yaxis)):
        scale("log")
        # Labels within a decade run into each other: whole decades, and no others.
        axis.set_minor_formatter("")
        low, high = axis.get_data_interval()
        if low < high:
            ends = 10.0 ** np.array([np.floor(np.log10(low)), np.ceil(np.log10(high))])
            axis.set_view_interval(*ends, ignore=True)
    if axes.has_data():
        axes.legend(fontsize=7, frameon=False)
    return absent
