"""What `wrod bench loop` found, as CSV, Markdown and a picture."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from wrod.files import write_atomically

TITLES = {
    "natural_curvature": "rod with natural curvature",
    "stiffness": "rod with a wrong L_gb",
    "none": "rod without the effect",
}
# Share of a pattern that may ask for more friction than there is before it is worth a word.
_MUCH = 0.2
_COLUMNS = {
    "error_mean": "e_mean [cm]",
    "error_std": "sigma [cm]",
    "released_error_mean": "released e_mean [cm]",
    "released_error_std": "released sigma [cm]",
    "slip": "largest slip [cm]",
    "lacking_friction": "share of the pattern that asks for more friction [-]",
}


def write_csv(path: Path, rows: list[dict]) -> Path:
    """One deployment a line."""

    def write(file):
        writer = csv.writer(file)
        writer.writerow(["effect", "pattern", "plan", "method", *_COLUMNS.values(), "diverged"])
        for row in rows:
            figures = [f"{row[name]:.4f}" for name in _COLUMNS]
            names = [row[name] for name in ("effect", "pattern", "plan", "method")]
            writer.writerow([*names, *figures, int(row["diverged"])])

    return write_atomically(path, write)


def markdown(rows: list[dict], found: dict, head: str) -> str:
    """What was identified, and the errors before and after beside those without the effect."""
    patterns = list(dict.fromkeys(row["pattern"] for row in rows))
    cell = {(row["effect"], row["pattern"], row["plan"]): row for row in rows}
    lines = [head, ""]
    for effect, told in found.items():
        lines += [f"{TITLES[effect]}: {_told(told)}", ""]
    lines.append("| rod | plan | " + " | ".join(patterns) + " |")
    lines.append("|" + " --- |" * (2 + len(patterns)))
    kinds = [("none", "old", TITLES["none"], "old")]
    for effect in found:
        kinds += [(effect, plan, TITLES[effect], f"**{plan}**") for plan in ("old", "new")]
    for effect, plan, title, shown in kinds:
        texts = [_cell(cell[effect, name, plan]) for name in patterns]
        lines.append(f"| {title} | {shown} | " + " | ".join(texts) + " |")
    return "\n".join([*lines, "", *summary(rows), ""])


def _cell(row: dict) -> str:
    lost = " (diverged)" if row["diverged"] else ""
    return f"{row['error_mean']:.3f} ± {row['error_std']:.3f}{lost}"


def _told(told: dict) -> str:
    names = ", ".join(told["effects"]) or "nothing"
    true, model = told["true"], told["model"]
    curved, found = (np.hypot(*m["natural_curvature"]) for m in (true, model))
    return (
        f"{told['verdict']}, found {names}; clamped shapes off by {told['before_mm']:.2f} mm "
        f"before, {told['after_mm']:.2f} mm after, noise {told['noise_floor_mm']:.2f} mm; "
        f"natural curvature {found:.2f} (true {curved:.2f}) 1/m, L_gb "
        f"{100 * model['gravito_bending_length']:.2f} "
        f"(true {100 * true['gravito_bending_length']:.2f}) cm"
    )


def summary(rows: list[dict]) -> list[str]:
    """Mean error over the patterns with the old and the new plan."""
    lines = []
    by_effect = {
        effect: _means(rows, effect) for effect in dict.fromkeys(r["effect"] for r in rows)
    }
    ideal = by_effect.pop("none")["old"]
    for effect, means in by_effect.items():
        lines.append(
            f"{TITLES[effect]}: mean e_mean {means['old']:.3f} cm with the old plan, "
            f"{means['new']:.3f} cm with the new one ({means['old'] / means['new']:.1f} times "
            f"less); {ideal:.3f} cm without the effect."
        )
    short = {
        f"{row['pattern']} ({row['lacking_friction']:.0%} of it, {TITLES[row['effect']]})": None
        for row in rows
        if row["lacking_friction"] > _MUCH
    }
    if short:
        lines.append(
            "Asking for more friction than there is, which no plan makes up for: "
            f"{', '.join(short)}."
        )
    lost = sum(row["diverged"] for row in rows)
    if lost:
        lines.append(f"{lost} of {len(rows)} deployments diverged.")
    return lines


def _means(rows: list[dict], effect: str) -> dict[str, float]:
    mine = [row for row in rows if row["effect"] == effect]
    plans = dict.fromkeys(row["plan"] for row in mine)
    return {
        plan: float(np.mean([row["error_mean"] for row in mine if row["plan"] == plan]))
        for plan in plans
    }


def draw(path: Path, rows: list[dict], patterns: dict) -> Path:
    """Laid curves before and after for every effect and pattern, and the errors as bars."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    colors = {"old": "#c2533c", "new": "#2f8f5b"}
    effects = [e for e in dict.fromkeys(row["effect"] for row in rows) if e != "none"]
    ideal = {row["pattern"]: row["error_mean"] for row in rows if row["effect"] == "none"}
    cell = {(row["effect"], row["pattern"], row["plan"]): row for row in rows}
    count = len(patterns)
    figure = Figure(figsize=(2.0 * max(count, 3), 3.6 * len(effects) + 0.6), facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        2 * len(effects), count, height_ratios=[1.0, 0.75] * len(effects),
        left=0.06, right=0.99, top=1 - 0.62 / figure.get_figheight(), bottom=0.03,
        hspace=0.12, wspace=0.12,
    )  # fmt: skip
    for k, effect in enumerate(effects):
        highest = max(row["error_mean"] for row in rows if row["effect"] == effect)
        for j, (name, curve) in enumerate(patterns.items()):
            panel = figure.add_subplot(grid[2 * k, j])
            target = curve.sample(np.linspace(0.0, curve.length, 300))[0]
            panel.plot(target[:, 0], target[:, 1], color="#0b5fa5", lw=4.0, alpha=0.35)
            for plan, color in colors.items():
                laid = np.array(cell[effect, name, plan]["curve"])
                panel.plot(*laid.T, color=color, lw=1.3)
            panel.set_aspect("equal", adjustable="datalim")
            panel.margins(0.12)
            panel.set_axis_off()
            if k == 0:
                panel.set_title(name, fontsize=11, color="#22262b")
            bars = figure.add_subplot(grid[2 * k + 1, j])
            for x, (plan, color) in enumerate(colors.items()):
                error = cell[effect, name, plan]["error_mean"]
                bars.bar(x, 10 * error, width=0.7, color=color)
                bars.text(
                    x, 10 * error, f"{10 * error:.1f}", ha="center", va="bottom", fontsize=9,
                    color="#22262b",
                )  # fmt: skip
            bars.axhline(10 * ideal[name], color="#59616b", lw=1.0, ls=":")
            bars.set(xlim=(-0.7, 1.7), ylim=(0, 12.5 * highest), xticks=[])
            bars.spines[["top", "right"]].set_visible(False)
            bars.spines[["left", "bottom"]].set_color("#b9bfc6")
            bars.tick_params(labelsize=8, colors="#59616b")
            if j == 0:
                bars.set_ylabel("e_mean [mm]", fontsize=9, color="#59616b")
            else:
                bars.set_yticklabels([])
        height = 1 - (0.62 + (figure.get_figheight() - 0.7) * (k + 0.5) / len(effects)) / (
            figure.get_figheight()
        )
        figure.text(
            0.012, height, TITLES[effect], fontsize=11, color="#22262b", rotation=90,
            ha="center", va="center",
        )  # fmt: skip
    figure.legend(
        handles=[
            Line2D([], [], color="#0b5fa5", lw=4, alpha=0.35, label="pattern"),
            Line2D([], [], color=colors["old"], lw=1.5, label="old plan"),
            Line2D([], [], color=colors["new"], lw=1.5, label="plan with the identified model"),
            Line2D([], [], color="#59616b", lw=1.0, ls=":", label="without the effect"),
        ],
        loc="upper right", ncol=4, fontsize=9, frameon=False,
    )  # fmt: skip

    def write(file):
        figure.savefig(file, format="png", dpi=90)

    return write_atomically(path, write, "wb")
