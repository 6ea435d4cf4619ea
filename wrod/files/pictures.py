"""What pictures have in common: their colours, their axes, and how they become bytes."""

import io

INK, FAINT, MUTED, GRID = "#22262b", "#c9ced6", "#59616b", "#e6e9ee"
MEASURED, BEFORE, AFTER = "#22262b", "#d9822b", "#0b5fa5"
SERIES = ("#0b5fa5", "#d9822b", "#3a8f5c")


def new_figure(width: float, height: float):
    """A figure of that size [inch]."""
    # Figure objects of their own: pyplot would keep state and choose a display.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), facecolor="white", layout="constrained")


def as_png(figure, dpi: int = 120, **how) -> bytes:
    """The figure as the bytes of a PNG file; `how` are arguments of `print_png`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    # What draws it lays it out; `savefig` draws all of it once more for that.
    buffer = io.BytesIO()
    figure.set_dpi(dpi)
    FigureCanvasAgg(figure).print_png(buffer, **how)
    return buffer.getvalue()


def dress(axes, title: str = "", x: str = "", y: str = "", *, legend: bool = False, **how) -> None:
    """A light grid, no frame but the axes, and what they say; `how` the legend looks."""
    if title:
        axes.set_title(title, loc="left", fontsize=9, color=MUTED)
    if x:
        axes.set_xlabel(x, fontsize=8.5)
    if y:
        axes.set_ylabel(y, fontsize=8.5)
    if legend:
        axes.legend(**{"fontsize": 8, "frameon": False, **how})
    axes.grid(color=GRID, lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=MUTED, which="both", length=0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[:].set_color(FAINT)


def dress_space(axes, ticks, unit: str, size: float) -> None:
    """Three axes: faint walls, `ticks` where a locator of matplotlib has them, names in a unit."""
    for axis, label in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_major_locator(ticks())
        axis.set_pane_color((0.965, 0.97, 0.978, 1.0))
        axis._axinfo["grid"].update(color="#dde1e7", linewidth=0.6)
        axis.set_tick_params(labelsize=7.5, colors=MUTED, pad=0)
        axis.set_label_text(f"{label} [{unit}]", fontsize=size)
        axis.label.set_color(MUTED)


def draw_bands(axes, place, value, error, labels) -> None:
    """Lines of (place, column) values in bands of two standard errors, and where zero is."""
    for column, label in enumerate(labels):
        color, v, e = SERIES[column % len(SERIES)], value[:, column], 2 * error[:, column]
        axes.plot(place, v, color=color, lw=1.6, label=label)
        axes.fill_between(place, v - e, v + e, color=color, alpha=0.15, lw=0)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=0)


def dress_map(axes, title: str) -> None:
    """Of a map: a title, and no frame."""
    axes.set_title(title, loc="left", fontsize=9, color=MUTED)
    axes.tick_params(labelsize=8, colors=MUTED, length=0)
    axes.spines[:].set_visible(False)


def add_scale(figure, image, axes, label: str) -> None:
    """The bar that says what the colours of a map are."""
    bar = figure.colorbar(image, ax=axes, pad=0.01)
    bar.set_label(label, fontsize=8.5)
    bar.ax.tick_params(labelsize=8, colors=MUTED)
    bar.outline.set_visible(False)
