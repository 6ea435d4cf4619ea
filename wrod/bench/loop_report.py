"""What `wrod bench loop` found, as CSV, Markdown and a picture."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from wrod import files, telling
from wrod.files import write_figure

TITLES = {
    "natural_curvature": "rod with natural curvature",
    "stiffness": "rod with a wrong L_gb",
    "varied": "anisotropic, tapering, softening rod",
    "none": "rod without the effect",
}
COLORS = {"old": "#c2533c", "new": "#2f8f5b"}


def _title(effect: str) -> str:
    """Of a recorded cable its name."""
    return TITLES.get(effect, effect)


_INK, _GREY = "#22262b", "#59616b"
_COLUMNS = {
    "error_mean": "e_mean [cm]",
    "error_std": "sigma [cm]",
    "released_error_mean": "released e_mean [cm]",
    "released_error_std": "released sigma [cm]",
    "slip": "largest slip [cm]",
    "contact_friction": "largest friction asked for by the plan [-]",
    "natural_share": "least share of the natural curvature in a grasp [-]",
}
_NAMES = ("effect", "controller", "pattern", "plan", "method", "closure")


def write_csv(path: Path, rows: list[dict]) -> Path:
    """One deployment a line."""
    lines = [
        [row[n] for n in _NAMES] + [_figure(row[n]) for n in _COLUMNS] + [int(row["diverged"])]
        for row in rows
    ]
    return files.write_csv(path, [*_NAMES, *_COLUMNS.values(), "diverged"], lines)


def _figure(value: float | None) -> str:
    """A path that was corrected for a table no longer says which friction it asks for."""
    return "" if value is None else f"{value:.4f}"


def markdown(rows: list[dict], found: dict, head: str) -> str:
    """What was identified, and the errors before and after beside those without the effect."""
    patterns, controllers = _values(rows, "pattern"), _values(rows, "controller")
    cell = _cells(rows)
    lines = [head, ""]
    for effect, told in found.items():
        lines += [f"{_title(effect)}: {_told(told)}", ""]
    kinds = [("none", controller, "old", "old") for controller in controllers]
    for effect in found:
        for controller in controllers:
            kinds += [(effect, controller, plan, f"**{plan}**") for plan in ("old", "new")]
    table = []
    for effect, controller, plan, shown in kinds:
        texts = [_cell(cell[effect, controller, name, plan]) for name in patterns]
        texts.append(f"{mean_error(rows, effect, controller, plan):.3f}")
        table.append([_title(effect), controller, shown, *texts])
    lines += telling.table(["rod", "controller", "plan", *patterns, "mean"], table)
    return "\n".join([*lines, "", *summary(rows), ""])


def _values(rows: list[dict], name: str) -> list[str]:
    return list(dict.fromkeys(row[name] for row in rows))


def _cells(rows: list[dict]) -> dict:
    return {(r["effect"], r["controller"], r["pattern"], r["plan"]): r for r in rows}


def _cell(row: dict) -> str:
    lost = " (diverged)" if row["diverged"] else ""
    return f"{row['error_mean']:.3f} ± {row['error_std']:.3f}{lost}"


def _told(told: dict) -> str:
    names = ", ".join(told["effects"]) or "nothing"
    true, model, network = told["true"], told["model"], told["network"]

    def beside(value: float) -> str:
        return "" if true is None else f" (true {value:.2f})"

    found = np.hypot(*model["natural_curvature"])
    curved = 0.0 if true is None else np.hypot(*true["natural_curvature"])
    stiff = 0.0 if true is None else 100 * true["gravito_bending_length"]
    text = (
        f"{told['verdict']}, found {names}; measured shapes off by {told['before_mm']:.2f} mm "
        f"before, {told['after_mm']:.2f} mm after, noise {told['noise_floor_mm']:.2f} mm; "
        f"natural curvature {found:.2f}{beside(curved)} 1/m, L_gb "
        f"{100 * model['gravito_bending_length']:.2f}{beside(stiff)} cm"
    )
    if told["set_aside"]:
        text += f"; of the measurement, not of the rod: {', '.join(told['set_aside'])}"
    if told["rod_has"]:
        return text + f"; planned with its {', '.join(told['rod_has'])}"
    if network is None:
        return text + "; the network that ships knows it"
    held_out = network["held_out"]
    return text + (
        f"; its own network learnt {network['samples']} grasps in {network['seconds']:.0f} s and "
        f"errs by {held_out['mean_absolute_error']:.1e} on fresh ones, position p99 "
        f"{held_out['position_error_p99']:.1e} L_gb"
    )


def summary(rows: list[dict]) -> list[str]:
    """Mean error over the patterns with the old and the new plan of every controller, and where
    the new one is worse."""
    lines = []
    for effect in _values(rows, "effect"):
        for controller in _values(rows, "controller") if effect != "none" else ():
            old, new = (mean_error(rows, effect, controller, plan) for plan in ("old", "new"))
            ideal = mean_error(rows, "none", controller, "old")
            lines.append(
                f"{_title(effect)}, {controller}: mean e_mean {old:.3f} cm with the old plan, "
                f"{new:.3f} cm with the new one ({old / new:.1f} times less); {ideal:.3f} cm "
                "without the effect."
            )
    cell = _cells(rows)
    worse = [
        f"{row['pattern']} ({_title(row['effect'])}, {row['controller']}: {before:.3f} to "
        f"{row['error_mean']:.3f} cm; the new plan asks for friction "
        f"{_figure(row['contact_friction']) or 'that is not known'})"
        for (effect, controller, name, plan), row in cell.items()
        if plan == "new"
        and row["error_mean"]
        > 1.1 * (before := cell[effect, controller, name, "old"]["error_mean"]) + 0.01
    ]
    if worse:
        lines.append(f"Worse than before: {'; '.join(worse)}.")
    for row in (row for row in rows if row["rivals"]):
        said = ", ".join(f"{name} {error:.1f} cm" for name, error in row["rivals"].items())
        down = ", ".join(f"{turn} degrees {e:.1f} cm" for turn, e in row["put_down"].items())
        key = row["effect"], row["controller"], row["pattern"]
        old, new = (cell[*key, plan]["released_error_mean"] for plan in ("old", "new"))
        lines += [
            f"{_who(row)}: what the found rod was expected to be laid by, from which the new plan "
            f"was chosen: {said}.",
            f"{_who(row)}: once the grip has let go {old:.2f} cm by the old plan, {new:.2f} cm by "
            f"the new one; put down exactly on the pattern and let go, by {down}; what it "
            f"springs to, turned and shifted on the table as fits best, {row['nearest']:.1f} cm.",
        ]
    lost = [
        f"{_who(row)} by the {row['plan']} plan after {row['ended']:.2f} s (the grip lets go after "
        f"{row['let_go']:.2f} s)"
        for row in rows
        if row["diverged"]
    ]
    if lost:
        lines.append(f"{len(lost)} of {len(rows)} deployments diverged: {', '.join(lost)}.")
    return lines


def _who(row: dict) -> str:
    return f"{row['pattern']} ({_title(row['effect'])}, {row['controller']})"


def mean_error(rows: list[dict], effect: str, controller: str, plan: str) -> float:
    """Mean of e_mean over the patterns [cm]."""
    mine = [
        row["error_mean"]
        for row in rows
        if (row["effect"], row["controller"], row["plan"]) == (effect, controller, plan)
    ]
    return float(np.mean(mine))


def draw(path: Path, rows: list[dict], patterns: dict) -> Path:
    """Curves laid by the last controller before and after, for every effect and pattern, and the
    errors of all controllers as bars."""
    effects = [effect for effect in _values(rows, "effect") if effect != "none"]
    cell, count = _cells(rows), len(patterns)
    shown = _values(rows, "controller")[-1]
    # Above the panels room for a legend, in two lines where the figure is narrow.
    top, columns = (0.62, 5) if count > 5 else (0.85, 3)
    size = max(2.0 * count, 7.5), 3.6 * len(effects) + top
    figure = Figure(figsize=size, facecolor="white")
    height = figure.get_figheight()
    grid = figure.add_gridspec(
        2 * len(effects), count, height_ratios=[1.0, 0.75] * len(effects),
        left=0.45 / size[0] + 0.03, right=0.99, top=1 - top / height, bottom=0.28 / height,
        hspace=0.2, wspace=0.12,
    )  # fmt: skip
    for k, effect in enumerate(effects):
        highest = max(row["error_mean"] for row in rows if row["effect"] == effect)
        for j, (name, curve) in enumerate(patterns.items()):
            panel = figure.add_subplot(grid[2 * k, j])
            target = curve.sample(np.linspace(0.0, curve.length, 300))[0]
            panel.plot(target[:, 0], target[:, 1], color="#0b5fa5", lw=4.0, alpha=0.35)
            for plan, color in COLORS.items():
                laid = np.array(cell[effect, shown, name, plan]["curve"])
                panel.plot(*laid.T, color=color, lw=1.3)
            panel.set_aspect("equal", adjustable="datalim")
            panel.margins(0.12)
            panel.set_axis_off()
            if k == 0:
                panel.set_title(name, fontsize=11, color=_INK)
            bars = figure.add_subplot(grid[2 * k + 1, j])
            _draw_bars(bars, cell, effect, name, highest)
            if j == 0:
                bars.set_ylabel("e_mean [mm]", fontsize=9, color=_GREY)
            else:
                bars.set_yticklabels([])
        middle = 1 - (top + (height - 0.28 - top) * (k + 0.5) / len(effects)) / height
        figure.text(
            0.012, middle, _title(effect), fontsize=11, color=_INK, rotation=90, ha="center",
            va="center",
        )  # fmt: skip
    _draw_legend(figure, shown, columns)

    return write_figure(path, figure, 90)


def _draw_bars(axes, cell: dict, effect: str, name: str, highest: float) -> None:
    """Errors [mm] of one pattern: old and new of every controller, and that without the effect."""
    controllers = list(dict.fromkeys(key[1] for key in cell))
    for i, controller in enumerate(controllers):
        for side, (plan, color) in zip((-0.2, 0.2), COLORS.items(), strict=True):
            error = 10 * cell[effect, controller, name, plan]["error_mean"]
            axes.bar(i + side, error, width=0.38, color=color)
            axes.text(
                i + side, error, f"{error:.1f}", ha="center", va="bottom", fontsize=8, color=_INK
            )
        ideal = 10 * cell["none", controller, name, "old"]["error_mean"]
        axes.hlines(ideal, i - 0.45, i + 0.45, color=_GREY, lw=1.0, ls=":")
    axes.set(xlim=(-0.6, len(controllers) - 0.4), ylim=(0, 12.5 * highest))
    axes.set_xticks(range(len(controllers)), controllers, fontsize=8, color=_INK)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#b9bfc6")
    axes.tick_params(axis="x", length=0)
    axes.tick_params(axis="y", labelsize=8, colors=_GREY)


def _draw_legend(figure, shown: str, columns: int) -> None:
    figure.legend(
        handles=[
            Line2D([], [], color="#0b5fa5", lw=4, alpha=0.35, label="pattern"),
            Line2D([], [], color=COLORS["old"], lw=1.5, label="old plan"),
            Line2D([], [], color=COLORS["new"], lw=1.5, label="plan with the identified model"),
            Line2D([], [], color=_GREY, lw=1.0, ls=":", label="without the effect"),
            Line2D([], [], color="none", label=f"curves: {shown} controller"),
        ],
        loc="upper right", ncol=columns, fontsize=9, frameon=False,
    )  # fmt: skip
