"""The comparison of cantilevers, told as Markdown and as a picture."""

import os
from pathlib import Path

from wrod.files import write_figure
from wrod.files.pictures import INK, MUTED, dress

_COLORS = {"SolverDER": "#d1495b", "newton SolverVBD": "#0b5fa5", "PyElastica": "#3a8f5c"}
_MARKERS = ("s", "D", "^", "v", "P", "X")


def markdown(figures: dict) -> str:
    """Tables of accuracy and speed."""
    problem = figures["problem"]
    lines = [
        figures["machine"],
        "",
        f"{problem['length']:g} m of {problem['rod']} enlarged {problem['scale']:g} times, clamped "
        "level: at rest under its weight, and swinging without it (period "
        f"{problem['period']:.3f} s); errors against the continuum",
        "",
        "| solver | edges | effort | step [ms] | error at rest [% of L] | still moving [% of L/s] "
        "| frequency error [%] | amplitude kept [%] | time per step [ms] | time per simulated s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in figures["rows"]:
        rest, swing = row["rest"], row["swing"]
        lines.append(
            f"| {row['solver']} | {row['edges']} | {row['effort']} | {1e3 * row['step']:.3g} "
            f"| {100 * rest['error']:.2g} | {100 * rest['drift']:.1g} "
            f"| {_percent(swing['frequency'], '+.2f')} | {_percent(swing['amplitude'], '.0f')} "
            f"| {rest['step_ms']:.3g} | {rest['cpu_per_second']:.3g} s |"
        )
    lines += [
        "",
        "| solver | rods | edges | effort | rod steps per s | simulated rod seconds per s "
        "| error at rest [% of L] |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in figures["speed"]:
        lines.append(
            f"| {row['solver']} | {row['rods']} | {row['edges']} | {row['effort']} "
            f"| {row['rod_steps_per_second']:.0f} | {row['simulated_per_second']:.3g} "
            f"| {100 * row['error']:.2g} |"
        )
    return "\n".join(lines)


def _percent(value: float | None, form: str) -> str:
    return "–" if value is None else format(100 * value, form)


def draw(path: str | os.PathLike[str], figures: dict) -> Path:
    """Write a PNG: error against computing time, at rest and swinging, one line for each solver."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    figure = Figure(figsize=(9.6, 4.3), dpi=130, facecolor="white")
    panels = (
        ("rest", "error", "at rest: error of the tip [% of length]"),
        ("swing", "frequency", "swinging: error of the frequency [%]"),
    )
    efforts = list(dict.fromkeys((row["solver"], row["effort"]) for row in figures["rows"]))
    cables = [effort for solver, effort in efforts if solver == "newton SolverVBD"]
    handles = []
    for j, (part, key, title) in enumerate(panels):
        axes = figure.add_axes((0.065 + 0.485 * j, 0.225, 0.43, 0.66))
        for solver, effort in efforts:
            rows = [
                r for r in figures["rows"]
                if (r["solver"], r["effort"]) == (solver, effort) and r[part][key] is not None
            ]  # fmt: skip
            cost = [r[part]["cpu_per_second"] for r in rows]
            error = [abs(100 * r[part][key]) for r in rows]
            shade, marker = 1.0, "o"
            if effort in cables:
                shade = 0.3 + 0.7 * (cables.index(effort) + 1) / len(cables)
                marker = _MARKERS[cables.index(effort) % len(_MARKERS)]
            (line,) = axes.loglog(
                cost, error, color=_COLORS[solver], alpha=shade, marker=marker, ms=5.5, lw=1.6,
                label=f"{solver}, {effort}",
            )  # fmt: skip
            for x, y, row in zip(cost, error, rows, strict=True):
                axes.annotate(
                    str(row["edges"]), (x, y), (5, 4), textcoords="offset points",
                    fontsize=7, color=MUTED,
                )  # fmt: skip
            if j == 0:
                handles.append(line)
        axes.xaxis.set_minor_formatter(NullFormatter())
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        dress(axes, title, "computing time per simulated second [s]")
    figure.text(0.065, 0.955, "A heavy cantilever against the continuum", fontsize=11.5, color=INK)
    figure.text(0.935, 0.957, "numbers at the marks: edges", fontsize=8, color=MUTED, ha="right")
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.05, 0.0), ncol=3, fontsize=8,
        frameon=False, labelcolor=MUTED,
    )  # fmt: skip
    return write_figure(path, figure, 100, metadata={"Software": None})
