"""Pictures of a motion's identification, and of what its residual looks like as mechanics, as PNG
bytes."""

import numpy as np

from wrod.files.pictures import (
    AFTER,
    BEFORE,
    FAINT,
    INK,
    MEASURED,
    MUTED,
    SERIES,
    add_scale,
    as_png,
    draw_bands,
    dress,
    dress_map,
    new_figure,
)
from wrod.identification.motion.trace import MotionTrace

# What an effect's error on the recordings that choose it is called in a report.
_VALIDATION = "validation_mm_with_this_effect"
_ALONG = "arc length from the first grip [m]"


def shapes(report, count: int = 6) -> bytes:
    """Measured markers and predictions in six frames of the test recording in the middle."""
    w = report.windows
    error = w.errors(report.predicted_after).mean(axis=1)
    r = int(np.argsort(error)[len(error) // 2])
    last = int(w.seen[r].sum()) - 1
    frames = np.linspace(last // count, last, count).astype(int)
    figure = new_figure(11.0, 3.0)
    line = w.markers[r, :, -2] - w.markers[r, :, 1]
    along = np.array([*line.mean(axis=0)[:2], 0.0])
    along /= max(np.linalg.norm(along), 1e-12)
    for k, f in enumerate(frames):
        axes = figure.add_subplot(1, count, k + 1)
        origin = w.markers[r, f, 1]

        def plane(points, origin=origin):
            return 1e2 * (points - origin) @ along, 1e2 * (points - origin)[:, 2]

        axes.plot(*plane(report.predicted_before[r, f]), color=BEFORE, lw=1.4, label="before")
        axes.plot(*plane(report.predicted_after[r, f]), color=AFTER, lw=1.4, label="after")
        axes.plot(*plane(w.markers[r, f]), "o", ms=2.6, color=MEASURED, label="measured", zorder=3)
        axes.set_aspect("equal", adjustable="datalim")
        title, y = f"{f / report.measurements.rate:.1f} s", "" if k else "up [cm]"
        dress(axes, title, "along [cm]", y, legend=k == 0, loc="lower left")
    return as_png(figure)


def errors(report) -> bytes:
    """Error over time and of every test recording."""
    w, rate = report.windows, report.measurements.rate
    figure = new_figure(11.0, 3.0)
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.5, 1.0]})
    series = (("before", report.predicted_before, BEFORE), ("after", report.predicted_after, AFTER))
    for k, (label, predicted, color) in enumerate(series):
        error = np.where(w.seen, 1e3 * w.errors(predicted), np.nan)
        time = np.arange(error.shape[1]) / rate
        left.plot(time, np.nanmean(error, axis=0), color=color, lw=1.4, label=label)
        place = np.arange(len(error)) + 0.4 * k - 0.2
        right.bar(place, np.nanmean(error, axis=1), width=0.38, color=color)
    right.set_xticks(
        range(len(w.recording)), [report.measurements.names[r] for r in w.recording], fontsize=8
    )
    dress(left, x="time [s]", y="mean |difference| [mm]", legend=True)
    dress(right, x="test recording")
    for axes in (left, right):
        axes.set_ylim(bottom=0.0)
    return as_png(figure)


def residual(report) -> bytes:
    """Residual maps before and after, and the mean residual in two frames."""
    r = report.residual
    figure = new_figure(11.0, 3.2)
    axes = figure.subplots(1, 4, gridspec_kw={"width_ratios": [1.2, 1.2, 1.0, 1.0]})
    top = 1e3 * r.by_marker_before.max()
    free = slice(2, -2)
    markers = len(r.by_marker_before)
    seconds = report.predicted_before.shape[1] / report.measurements.rate
    for k, (title, value) in enumerate(
        (("before", r.by_marker_before), ("after", r.by_marker_after))
    ):
        shown = axes[k].imshow(
            1e3 * value[free], aspect="auto", origin="lower", cmap="viridis", vmin=0.0, vmax=top,
            extent=(0.0, seconds, 1.5, markers - 2.5),
        )  # fmt: skip
        axes[k].set_xlabel("time [s]", fontsize=8.5)
        axes[k].set_ylabel("free marker" if k == 0 else "", fontsize=8.5)
        axes[k].yaxis.get_major_locator().set_params(integer=True)
        dress_map(axes[k], title)
    add_scale(figure, shown, axes[:2], "mean |difference| [mm]")
    parts = (
        ("fixed in the laboratory", r.laboratory, ("x", "y", "z")),
        ("fixed to the rod", r.local, ("tangent", "inside of bend", "across")),
    )
    for panel, (title, value, labels) in zip(axes[2:], parts, strict=True):
        for c, color in enumerate(SERIES):
            panel.plot(1e3 * value[:, c], color=color, lw=1.4, label=labels[c])
        panel.axhline(0.0, color=MUTED, lw=0.6)
        low, high = panel.get_ylim()
        panel.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
        share = 100 * r.explained[title]
        panel.xaxis.get_major_locator().set_params(integer=True)
        dress(panel, f"{title}: {share:.0f} %", "marker", legend=True, fontsize=7)
    axes[2].set_ylabel("mean residual before [mm]", fontsize=8.5)
    return as_png(figure)


def ladder(report) -> bytes | None:
    """Errors on validation and test recordings after each effect."""
    added = [e for e in report.effects if e.name not in report.base]
    if not added:
        return None
    names = ["base model", *(e.name.replace("_", " ") for e in added), "last fit"]
    # The last fit has seen the validation recordings.
    validation = [
        report.selection.validation_before,
        *(e.others[_VALIDATION] for e in added),
        np.nan,
    ]
    test = [report.before, *(e.after for e in added), report.after]
    figure = new_figure(11.0, 0.9 + 0.32 * len(names))
    axes = figure.add_subplot()
    place = np.arange(len(names))
    axes.barh(place - 0.19, 1e3 * np.array(validation), 0.36, color="#c9ced6", label="validation")
    axes.barh(place + 0.19, 1e3 * np.array(test), 0.36, color=AFTER, label="test")
    for y, value in zip(place, test, strict=True):
        axes.text(1e3 * value, y + 0.19, f" {1e3 * value:.2f}", fontsize=8, va="center", color=INK)
    axes.set_yticks(place, names, fontsize=9)
    axes.invert_yaxis()
    dress(axes, x="mean |difference| [mm]", legend=True)
    axes.tick_params(axis="y", labelsize=9)
    return as_png(figure)


def correlation(report) -> bytes:
    """Largest correlations between combinations of two effects' parameters."""
    s = report.selection
    chosen = len(s.model.effects)
    value = s.correlation[:chosen]
    figure = new_figure(11.0, 1.8 + 0.27 * chosen)
    axes = figure.add_subplot()
    shown = axes.imshow(value, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(
        range(len(s.correlated)),
        [n.replace("_", " ") for n in s.correlated],
        rotation=35,
        ha="right",
        fontsize=8,
    )
    axes.set_yticks(range(chosen), [n.replace("_", " ") for n in s.correlated[:chosen]], fontsize=8)
    for i in range(chosen):
        for j in range(len(s.correlated)):
            if i != j and value[i, j] > 0:
                axes.text(
                    j, i, f"{value[i, j]:.2f}", ha="center", va="center", fontsize=7,
                    color="white" if value[i, j] > 0.6 else INK,
                )  # fmt: skip
    axes.axvline(chosen - 0.5, color=INK, lw=0.8)
    axes.tick_params(colors=MUTED, length=0)
    figure.colorbar(shown, ax=axes, shrink=0.9).ax.tick_params(labelsize=7, colors=MUTED)
    return as_png(figure)


def missing_force(trace: MotionTrace, rate: float, name: str) -> bytes:
    """The missing force of one recording over time, and its mean over all, in two frames."""
    f = trace.shown
    figure = new_figure(11.0, 5.6)
    top, bottom = figure.subfigures(2, 1)
    axes = top.subplots(1, 3, sharey=True)
    maps = (
        ("upwards", f.laboratory[..., 2]),
        ("along m1, in the material", f.material[..., 0]),
        ("along m2, in the material", f.material[..., 1]),
    )
    limit = max(float(np.percentile(np.abs(np.stack([m for _, m in maps])), 98)), 1e-6)
    edges = _edges(f.arc_length)
    time = _edges(f.frame / rate)
    for panel, (title, values) in zip(axes, maps, strict=True):
        shown = panel.pcolormesh(
            time, edges, values.T, cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True
        )
        panel.set_xlabel("time [s]", fontsize=8.5)
        dress_map(panel, title)
    axes[0].set_ylabel(f"recording {name}\narc length [m]", fontsize=8.5)
    add_scale(top, shown, axes, "missing force / weight")
    axes = bottom.subplots(1, 2, sharey=True)
    frames = (("laboratory", ("x", "y", "z")), ("material", ("m1", "m2", "tangent")))
    for panel, (frame, labels) in zip(axes, frames, strict=True):
        value, error = trace.force.mean(frame)
        draw_bands(panel, trace.force.arc_length, value, error, labels)
        title = f"mean in the {frame} frame, all recordings (± 2 standard errors)"
        dress(panel, title, _ALONG, legend=True, ncol=3)
    axes[0].set_ylabel("missing force / weight", fontsize=8.5)
    return as_png(figure)


def prints(trace: MotionTrace) -> bytes:
    """The likeliest print and the share of the missing force that each takes away."""
    figure = new_figure(11.0, 4.0)
    left, right = figure.subplots(1, 2)
    best = trace.prints[0]
    if best.arc_length is None:
        place = np.arange(len(best.value))
        left.bar(place, best.value, yerr=2 * best.stderr, color=AFTER, width=0.6, ecolor=INK)
        left.set_xticks(place, [c.replace(" ", "\n", 1) for c in best.components], fontsize=8)
    else:
        draw_bands(left, best.arc_length, best.value, best.stderr, best.components)
        dress(left, x=_ALONG, legend=True, ncol=3)
    y = f"[{best.unit}]" if best.unit else "relative"
    dress(left, f"{best.title} (± 2 standard errors)", y=y)
    shown = trace.prints[::-1]
    place = np.arange(len(shown))
    first = trace.steps[0][0][0] if trace.steps else None
    share = 100 * np.array([max(p.share, 0.0) for p in shown])
    later = 100 * np.array([max(trace.remaining.get(p.name, 0.0), 0.0) for p in shown])
    colors = [AFTER if p.name == first else FAINT for p in shown]
    right.barh(place + 0.18, share, 0.34, color=colors)
    right.barh(place - 0.2, later, 0.34, color=SERIES[1], alpha=0.75)
    for y, p, a, b in zip(place, shown, share, later, strict=True):
        right.text(a, y + 0.18, f"  {a:.0f} %", va="center", fontsize=7.5, color=MUTED)
        if p.name in trace.remaining:
            right.text(b, y - 0.2, f"  {b:.0f} %", va="center", fontsize=7.5, color=MUTED)
    right.set_yticks(place, [p.name.replace("_", " ") for p in shown])
    right.set_xlim(0.0, 112.0)
    dress(right, "share of the missing force alone, and (orange) of what the first leaves")
    right.grid(False, axis="y")
    return as_png(figure)


def _edges(centres: np.ndarray) -> np.ndarray:
    """Cell borders around places."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])
