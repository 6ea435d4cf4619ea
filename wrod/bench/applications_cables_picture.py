"""Pictures of cables: how they are laid from above, and how they come to a gate."""

from pathlib import Path

import numpy as np

from wrod.bench.applications_trials import METHODS, SHORT
from wrod.files import write_figure

_INK, _MUTED, _POST = "#22262b", "#59616b", "#c9ced6"
_PATTERN, _COLORS = "#0b5fa5", {"intuitive": "#d0416b", "neural": "#2c8f4e"}


def draw_cables(path: Path, rows: list[dict]) -> Path | None:
    """Write a PNG: the first trial of INT and OPT over time, from above, and the ways of all trials
    to the first gate that INT misses, across it. None if there are no cables."""
    from matplotlib.figure import Figure

    rows = [row for row in rows if row.get("ways")]
    cases = list(dict.fromkeys(row["case"] for row in rows))
    if not cases:
        return None
    figure = Figure(figsize=(13.0, 4.4 * len(cases)), facecolor="white")
    grid = figure.subplots(len(cases), 3, squeeze=False)
    for line, case in zip(grid, cases, strict=True):
        mine = {
            method: sorted(
                (r for r in rows if (r["case"], r["method"]) == (case, method)),
                key=lambda row: row["trial"],
            )
            for method in METHODS
        }
        gate = _first_missed(mine["intuitive"])
        for axes, method in zip(line, METHODS, strict=False):
            _above(axes, case, method, mine[method][:1], gate)
        _across(line[2], case, mine, gate)
    figure.subplots_adjust(0.02, 0.07, 0.98, 0.92, 0.10, 0.22)

    return write_figure(path, figure, 100)


def _first_missed(rows: list[dict]) -> int:
    """Gate (from 0) that comes first among those that a trial is not in; 0 if there are none."""
    missed = [
        int(name) - 1
        for row in rows
        if row["why"].startswith("not in gate ")
        for name in row["why"].removeprefix("not in gate ").split(",")
    ]
    return min(missed) if missed else 0


def _title(axes, title: str, note: str) -> None:
    axes.set_title(title, fontsize=10.5, color=_INK, loc="left", pad=16)
    axes.text(0.0, 1.015, note, transform=axes.transAxes, fontsize=8, color=_MUTED, va="bottom")


def _above(axes, case: str, method: str, rows: list[dict], gate: int) -> None:
    from wrod.bench.applications_trials import cable_scene
    from wrod.deployment.picture import draw_fixtures

    pattern, fixtures = cable_scene(case)
    target = pattern.sample(np.linspace(0.0, pattern.length, 300))[0]
    draw_fixtures(axes, fixtures)
    axes.plot(*target[:, :2].T, color=_PATTERN, lw=4, alpha=0.3)
    for row in rows:
        film = [np.array(curve) for curve in row["curves"]["film"]]
        for k, curve in enumerate(film):
            fade = 0.25 + 0.6 * k / len(film)
            axes.plot(*curve[:, :2].T, color=_COLORS[method], lw=1.0, alpha=fade)
        end = np.array(row["curves"]["end"][0])
        axes.plot(*end[:, :2].T, color=_INK, lw=1.6)
    by_name = {item.name: item.shape.center for item in fixtures.items}
    middle = np.mean([by_name[name][:2] for name in fixtures.gates[gate]], axis=0)
    axes.plot(*middle, "o", ms=26, mfc="none", mec=_MUTED, lw=1.0)
    axes.set_axis_off()
    span = target[:, :2].max(axis=0) - target[:, :2].min(axis=0)
    center = (target[:, :2].max(axis=0) + target[:, :2].min(axis=0)) / 2
    half = 0.62 * span.max()
    axes.set_xlim(center[0] - 1.2 * half, center[0] + 1.2 * half)
    axes.set_ylim(center[1] - half, center[1] + half)
    axes.set_aspect("equal")
    why = rows[0]["why"] if rows else ""
    why = why if len(why) < 46 else why[:44] + " ..."
    _title(axes, f"{case}, {SHORT[method]}, first trial", f"from above, over time; {why}")


def _across(axes, case: str, mine: dict, gate: int) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    from wrod.bench.applications_trials import cable_scene

    _, fixtures = cable_scene(case)
    by_name = {item.name: item for item in fixtures.items}
    left, right = (by_name[name] for name in fixtures.gates[gate])
    apart = 1e3 * np.linalg.norm(np.subtract(left.shape.center, right.shape.center)[:2])
    for item, sign in ((left, 1.0), (right, -1.0)):
        r = 1e3 * item.shape.radius
        corner = (sign * apart / 2 - r, 0.0)
        axes.add_patch(Rectangle(corner, 2 * r, 1e3 * item.top, fc=_POST, ec=_MUTED, lw=0.8))
    for method, rows in mine.items():
        for row in rows:
            # Heights of the underside, which has to pass over the posts.
            way = np.array(row["ways"][gate]).reshape(-1, 2)
            axes.plot(*way.T, color=_COLORS[method], lw=0.9, alpha=0.7)
            if len(way):
                axes.plot(*way[-1], "o", color=_COLORS[method], ms=4)
    axes.axhline(0.0, color=_MUTED, lw=0.8)
    axes.set_xlim(-38, 26)
    axes.set_ylim(-1.0, 26.0)
    axes.set_xlabel("across the gate, left to the right [mm]", fontsize=8)
    axes.invert_xaxis()
    axes.tick_params(labelsize=8, colors=_MUTED, length=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "left")
        spine.set_color(_POST)
    entries = [Line2D([], [], color=_COLORS[m], lw=1.4, label=SHORT[m]) for m in METHODS]
    axes.legend(handles=entries, fontsize=8, frameon=False, loc="upper left")
    _title(
        axes,
        f"{case}: how the cable comes to gate {gate + 1}",
        "its underside [mm] in the plane of the gate, all trials; dots: at the end",
    )
