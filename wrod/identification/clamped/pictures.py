"""Pictures of an identification, as PNG bytes."""

import textwrap

import numpy as np

from wrod.files.pictures import (
    AFTER,
    BEFORE,
    FAINT,
    INK,
    MEASURED,
    MUTED,
    add_scale,
    as_png,
    draw_bands,
    dress,
    dress_map,
    new_figure,
)
from wrod.identification.clamped.trace import SEEN


def shapes(report, count: int = 4) -> bytes:
    """Measured markers and predictions before and after, for a few test trials."""
    m = report.measurements
    trials = m.test[:count]
    figure = new_figure(11.0, 3.4)
    for k, trial in enumerate(trials):
        axes = figure.add_subplot(1, len(trials), k + 1)
        start = m.clamp_position[trial]
        along = m.grip_position[trial] - start
        along = np.array([along[0], along[1], 0.0])
        size = np.linalg.norm(along)
        along = along / size if size > 1e-9 else np.array([1.0, 0.0, 0.0])

        def plane(points, along=along, start=start):
            return 1e2 * (points - start) @ along, 1e2 * (points - start)[:, 2]

        axes.plot(*plane(report.predicted_before[trial]), color=BEFORE, lw=1.4, label="before")
        axes.plot(*plane(report.predicted_after[trial]), color=AFTER, lw=1.4, label="after")
        axes.plot(
            *plane(m.centerline[trial]), "o", ms=2.6, color=MEASURED, label="measured", zorder=3
        )
        axes.set_aspect("equal", adjustable="datalim")
        dress(axes, f"trial {trial}", "along [cm]", "" if k else "up [cm]", legend=k == 0)
    return as_png(figure)


def residuals(report) -> bytes:
    """Trial by marker maps of the distance, before and after, on one scale."""
    m = report.measurements
    maps = [
        1e3 * np.linalg.norm(predicted - m.centerline, axis=2)
        for predicted in (report.predicted_before, report.predicted_after)
    ]
    figure = new_figure(11.0, 3.6)
    top = max(float(np.nanpercentile(maps[0], 99)), 2e3 * m.noise_floor)
    for k, (values, title) in enumerate(zip(maps, ("before", "after"), strict=True)):
        axes = figure.add_subplot(1, 2, k + 1)
        image = axes.imshow(values, aspect="auto", cmap="viridis", vmin=0.0, vmax=top)
        axes.set_xlabel("marker", fontsize=8.5)
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_ylabel("trial (test trials marked)" if k == 0 else "", fontsize=8.5)
        axes.plot(np.full(len(m.test), -1.0), m.test, ">", ms=4, color=AFTER, clip_on=False)
        axes.set_xlim(-0.5, values.shape[1] - 0.5)
        dress_map(axes, title)
        # The marks of test trials stand between the map and the numbers.
        axes.tick_params(axis="y", pad=14)
    add_scale(figure, image, figure.axes, "distance [mm]")
    return as_png(figure)


def force_print(report) -> bytes:
    """The likeliest print and the evidence of all of them."""
    figure = new_figure(11.0, 3.6)
    axes = figure.add_subplot(1, 2, 1)
    best = report.prints[0]
    if best.arc_length is None:
        place = np.arange(len(best.value))
        # Metres beside radians: in mm, degrees and per cent all of them can be seen.
        units = [_end_unit(name) for name in best.components]
        factor = np.array([f for f, _ in units])
        axes.bar(
            place,
            factor * best.value,
            yerr=2 * factor * best.stderr,
            color=AFTER if best.seen else FAINT,
            width=0.6,
            ecolor=INK,
        )
        labels = [f"{name}\n[{u}]" for name, (_, u) in zip(best.components, units, strict=True)]
        axes.set_xticks(place, labels, fontsize=8)
    else:
        draw_bands(axes, best.arc_length, best.value, best.stderr, best.components)
        y = f"[{best.unit}]" if best.unit else "relative change"
        dress(axes, x="arc length [m]", y=y, legend=True, ncol=3)
    title = textwrap.fill(f"{best.title} (± 2 standard errors)", 64)
    dress(axes, title if best.seen else f"no print is seen; the likeliest of them:\n{title}")
    axes = figure.add_subplot(1, 2, 2)
    names = [p.name.replace("_", " ") for p in report.prints][::-1]
    values = [max(p.evidence, 0.0) for p in report.prints][::-1]
    axes.barh(
        names,
        values,
        color=[FAINT] * (len(names) - 1) + [AFTER if best.seen else FAINT],
        height=0.62,
    )
    excess = any(p.share > 0.0 for p in report.prints)
    for y, p in enumerate(report.prints[::-1] if excess else ()):
        axes.text(
            max(p.evidence, 0.0), y, f"  {100 * max(p.share, 0.0):.0f} %",
            va="center", fontsize=8, color=MUTED,
        )  # fmt: skip
    # What is no evidence is not drawn as if it were.
    axes.set_xlim(0.0, 1.15 * max(*values, 2.0 * SEEN))
    axes.axvline(SEEN, color=MUTED, lw=0.8, ls=":")
    said = ", and share of the excess" if excess else "; no excess to take a share of"
    dress(axes, f"log evidence (seen from the dotted line){said}")
    return as_png(figure)


def _end_unit(component: str) -> tuple[float, str]:
    """Factor and unit to show a component of an end's or the cameras' print in."""
    if component.startswith(("turn", "roll")):
        return 180.0 / np.pi, "deg"
    return (100.0, "%") if component == "scale" else (1e3, "mm")


def ranking(report) -> bytes | None:
    """Test error of every effect alone, beside the base model's, the final one and the floor."""
    scored = [c for c in report.candidates if c["test_mm"] is not None]
    if not scored:
        return None
    scored.sort(key=lambda c: c["test_mm"])
    figure = new_figure(11.0, 0.8 + 0.2 * len(scored))
    axes = figure.add_subplot()
    chosen = {e.name for e in report.effects}
    names = [c["name"].replace("_", " ") for c in scored][::-1]
    colors = [AFTER if c["name"] in chosen else FAINT for c in scored][::-1]
    axes.barh(names, [c["test_mm"] for c in scored][::-1], color=colors, height=0.66)
    lines = (
        ("base model", report.before, BEFORE),
        *[("chosen model", report.after, AFTER)] * bool(report.effects),
        ("noise floor", report.noise_floor, INK),
    )
    for label, value, color in lines:
        axes.axvline(1e3 * value, color=color, lw=1.3, label=f"{label} {1e3 * value:.2f} mm")
    axes.set_xlabel("test error [mm]", fontsize=8.5)
    # Bars end anywhere inside; above them there is room.
    figure.legend(*axes.get_legend_handles_labels(), fontsize=8, frameon=False, ncol=3,
                  loc="outside upper right")  # fmt: skip
    dress(axes)
    axes.tick_params(axis="y", labelsize=7.5)
    return as_png(figure)
