"""The success table of the applications beside the paper's, and their pictures."""

from collections import Counter
from itertools import pairwise
from operator import itemgetter
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from scipy.stats import binomtest

from wrod import telling
from wrod.bench.applications_trials import METHODS, SHORT, cable_scene, knot_plan
from wrod.deployment.picture import draw_fixtures
from wrod.files import write_figure
from wrod.files.pictures import FAINT, INK, MUTED
from wrod.knots.trials import STILL

# Tong et al., the success table: successes of ten trials.
PAPER = {
    (case, method): won
    for case, neural in (("S cable", 9), ("U cable", 9), ("trefoil", 9), ("reef", 7))
    for method, won in (("intuitive", 0), ("neural", neural))
}
_PATTERN, _COLORS = "#0b5fa5", {"intuitive": "#d0416b", "neural": "#2c8f4e"}
_STAGES = ("laid", "tied", "pulled")
RODS = {"cable": ("#2a2d33",), "trefoil": ("#d0416b",), "reef": ("#2c8f4e", "#d0416b")}


def table(rows: list[dict]) -> dict[tuple[str, str], dict]:
    """(case, method) -> successes, trials, paper's successes of ten, why others failed."""
    out = {}
    for key in PAPER:
        mine = [row for row in rows if (row["case"], row["method"]) == key]
        if not mine:
            continue
        won = sum(row["success"] for row in mine)
        out[key] = {
            "success": won,
            "trials": len(mine),
            "paper": PAPER[key],
            "failures": dict(Counter(row["why"] for row in mine if not row["success"])),
            "cpu_seconds": float(np.mean([row["cpu_seconds"] for row in mine])),
            "interval": success_interval(won, len(mine)),
        }
    return out


def success_interval(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate of success."""
    found = binomtest(int(successes), int(trials)).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)


def markdown(cells: dict) -> str:
    head = ("application", "scheme", "paper", "wrod", "95 % interval", "CPU s a trial")
    rows = []
    for (case, method), cell in cells.items():
        reasons = "; ".join(f"{n} x {why}" for why, n in cell["failures"].items())
        low, high = (100 * share for share in cell["interval"])
        won = f"{cell['paper']}/10", f"{cell['success']}/{cell['trials']}"
        interval = f"{low:.0f} to {high:.0f} %"
        rows.append((case, SHORT[method], *won, interval, f"{cell['cpu_seconds']:.0f}", reasons))
    return "\n".join(telling.table((*head, "why others failed"), rows)) + "\n"


def draw(path: Path, rows: list[dict]) -> Path:
    """Write a PNG: all cables, and knots of each method at several stages."""
    cells = table(rows)
    cases = list(dict.fromkeys(case for case, _ in cells))
    cables = [case for case in cases if case.endswith("cable")]
    knots = [case for case in cases if not case.endswith("cable")]
    height = int(bool(cables)) + len(knots)
    wide = 5 if knots else 4
    figure = Figure(figsize=(3.25 * wide, 3.5 * height), facecolor="white")
    grid = figure.subplots(height, wide, squeeze=False)
    figure.subplots_adjust(0.01, 0.01, 0.99, 1.0 - 0.16 / height, 0.04, 0.16)
    for axes in grid.flat:
        axes.set_axis_off()
    for k, (case, method) in enumerate((c, m) for c in cables for m in METHODS):
        if (case, method) in cells:
            _cables(grid[0, k], case, method, rows, cells[case, method])
    for row, case in enumerate(knots, start=int(bool(cables))):
        _knots(grid[row], case, rows, cells)

    return write_figure(path, figure, 100)


def _head(axes, title: str, note: str) -> None:
    axes.set_title(title, fontsize=10.5, color=INK, loc="left", pad=14)
    axes.text(0.0, 1.01, note, transform=axes.transAxes, fontsize=8, color=MUTED, va="bottom")


def _score(cell: dict) -> str:
    return f"{cell['success']}/{cell['trials']} (paper {cell['paper']}/10)"


def _cables(axes, case: str, method: str, rows: list[dict], cell: dict) -> None:
    pattern, fixtures = cable_scene(case)
    draw_fixtures(axes, fixtures)
    target = pattern.sample(np.linspace(0.0, pattern.length, 300))[0]
    axes.plot(*target[:, :2].T, color=_PATTERN, lw=4, alpha=0.3)
    for row in rows:
        if (row["case"], row["method"]) == (case, method):
            rod = np.array(row["curves"]["end"][0])
            axes.plot(*rod[:, :2].T, color=RODS["cable"][0], lw=1.2, alpha=0.8)
    axes.set_aspect("equal", adjustable="datalim")
    _head(axes, f"{case}, {SHORT[method]}  {_score(cell)}", "let go; all trials")


def _knots(axes, case: str, rows: list[dict], cells: dict) -> None:
    """INT as laid and at the end, an example of its commonest end; OPT laid, tied and pulled."""

    plan = knot_plan(case)
    panels = [("intuitive", "laid"), ("intuitive", "end"), *(("neural", s) for s in _STAGES)]
    for one, (method, stage) in zip(axes, panels, strict=True):
        mine = [row for row in rows if (row["case"], row["method"]) == (case, method)]
        if not mine:
            continue
        ends = [row["why"] for row in mine]
        commonest = max(map(ends.count, ends))
        usual = [row for row in mine if ends.count(row["why"]) == commonest]
        row = min(usual, key=itemgetter("trial"))
        note = row["why"]
        if stage == "end":
            # Only what was tied has been pulled.
            stage = "pulled" if row["strongest"] > 0.0 else "tied"
        else:
            note = f"{stage}: {_shown(row, stage, plan.knot)}"
        if stage != "pulled":
            for pattern, _ in plan.rods:
                target = pattern.sample(np.linspace(0.0, pattern.length, 300))[0]
                one.plot(*target[:, :2].T, color=_PATTERN, lw=3, alpha=0.22)
        rods = [np.array(rod) for rod in row["curves"][stage]]
        radii = [material.radius for _, material in plan.rods]
        close = stage == "pulled"
        woven(one, rods, radii, RODS[case], width=3000 if close else 900)
        score = f"  {_score(cells[case, method])}" if stage != "laid" else ""
        _head(one, f"{case}, {SHORT[method]}{score}", note)
        if close:
            close_up(one, tightest(rods), 0.06)


def close_up(axes, middle: np.ndarray, half: float) -> None:
    """Show what is within `half` [m] of a point to both sides, in the whole panel."""
    box = axes.get_position().transformed(axes.figure.transFigure)
    x, y = middle
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(x - half, x + half)
    axes.set_ylim(y - half * box.height / box.width, y + half * box.height / box.width)


def tightest(rods: list[np.ndarray]) -> np.ndarray:
    """(2,) where two rods are nearest to each other, or where one bends most."""
    if len(rods) == 2:
        gap = np.linalg.norm(rods[0][:, None] - rods[1][None], axis=2)
        i, j = np.unravel_index(gap.argmin(), gap.shape)
        return (rods[0][i, :2] + rods[1][j, :2]) / 2
    edges = np.diff(rods[0], axis=0)
    turning = np.linalg.norm(np.cross(edges[1:], edges[:-1]), axis=1)
    return np.average(rods[0][1:-1, :2], axis=0, weights=turning**2)


def _shown(row: dict, stage: str, wanted: str) -> str:
    """The knot at a stage; a tight one is still there if some closures show it."""
    name, _, share = row["knots"].get(stage, ["", 0.0, 0.0])
    return wanted if stage == "pulled" and share >= STILL else name


def woven(axes, rods, radii, colors, width: float = 900) -> None:
    """Rods from above, upper strands drawn over lower ones with a white edge; `width` points per
    metre of radius."""
    pieces = []
    for rod, radius, color in zip(rods, radii, colors, strict=True):
        for a, b in pairwise(rod):
            pieces.append(((a[2] + b[2]) / 2, a[:2], b[:2], radius, color))
    pieces.sort(key=lambda piece: piece[0])
    # In layers of a millimetre: within one, all edges first, so that a strand has no rungs.
    heights = np.array([piece[0] for piece in pieces])
    layers = np.floor((heights - heights.min()) / 1e-3).astype(int)
    axes.set_aspect("equal", adjustable="datalim")
    for layer in np.unique(layers):
        chosen = [piece for piece, here in zip(pieces, layers, strict=True) if here == layer]
        lines = [[a, b] for _, a, b, _, _ in chosen]
        widths = [width * radius for _, _, _, radius, _ in chosen]
        axes.add_collection(
            LineCollection(lines, colors="white", linewidths=[w + 2.2 for w in widths])
        )
        axes.add_collection(
            LineCollection(
                lines, colors=[c for *_, c in chosen], linewidths=widths, capstyle="round"
            )
        )
    axes.autoscale_view()


def draw_cables(path: Path, rows: list[dict]) -> Path | None:
    """Write a PNG: the first trial of INT and OPT over time, from above, and the ways of all trials
    to the first gate that INT misses, across it. None if there are no cables."""
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


def _above(axes, case: str, method: str, rows: list[dict], gate: int) -> None:
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
        axes.plot(*end[:, :2].T, color=INK, lw=1.6)
    by_name = {item.name: item.shape.center for item in fixtures.items}
    middle = np.mean([by_name[name][:2] for name in fixtures.gates[gate]], axis=0)
    axes.plot(*middle, "o", ms=26, mfc="none", mec=MUTED, lw=1.0)
    axes.set_axis_off()
    span = target[:, :2].max(axis=0) - target[:, :2].min(axis=0)
    center = (target[:, :2].max(axis=0) + target[:, :2].min(axis=0)) / 2
    half = 0.62 * span.max()
    axes.set_xlim(center[0] - 1.2 * half, center[0] + 1.2 * half)
    axes.set_ylim(center[1] - half, center[1] + half)
    axes.set_aspect("equal")
    why = rows[0]["why"] if rows else ""
    why = why if len(why) < 46 else why[:44] + " ..."
    _head(axes, f"{case}, {SHORT[method]}, first trial", f"from above, over time; {why}")


def _across(axes, case: str, mine: dict, gate: int) -> None:
    _, fixtures = cable_scene(case)
    by_name = {item.name: item for item in fixtures.items}
    left, right = (by_name[name] for name in fixtures.gates[gate])
    apart = 1e3 * np.linalg.norm(np.subtract(left.shape.center, right.shape.center)[:2])
    for item, sign in ((left, 1.0), (right, -1.0)):
        r = 1e3 * item.shape.radius
        corner = (sign * apart / 2 - r, 0.0)
        axes.add_patch(Rectangle(corner, 2 * r, 1e3 * item.top, fc=FAINT, ec=MUTED, lw=0.8))
    for method, rows in mine.items():
        for row in rows:
            # Heights of the underside, which has to pass over the posts.
            way = np.array(row["ways"][gate]).reshape(-1, 2)
            axes.plot(*way.T, color=_COLORS[method], lw=0.9, alpha=0.7)
            if len(way):
                axes.plot(*way[-1], "o", color=_COLORS[method], ms=4)
    axes.axhline(0.0, color=MUTED, lw=0.8)
    axes.set_xlim(-38, 26)
    axes.set_ylim(-1.0, 26.0)
    axes.set_xlabel("across the gate, left to the right [mm]", fontsize=8)
    axes.invert_xaxis()
    axes.tick_params(labelsize=8, colors=MUTED, length=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "left")
        spine.set_color(FAINT)
    entries = [Line2D([], [], color=_COLORS[m], lw=1.4, label=SHORT[m]) for m in METHODS]
    axes.legend(handles=entries, fontsize=8, frameon=False, loc="upper left")
    _head(
        axes,
        f"{case}: how the cable comes to gate {gate + 1}",
        "its underside [mm] in the plane of the gate, all trials; dots: at the end",
    )
