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


def as_png(figure) -> bytes:
    """The figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    return buffer.getvalue()


def dress(axes) -> None:
    """A light grid, and no frame but the axes."""
    axes.grid(color=GRID, lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=MUTED, which="both", length=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)


def dress_map(axes, title: str) -> None:
    """Of a map: a title, and no frame."""
    axes.set_title(title, loc="left", fontsize=9.5, color=MUTED)
    axes.tick_params(labelsize=8, colors=MUTED, length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def add_scale(figure, image, axes, label: str) -> None:
    """The bar that says what the colours of a map are."""
    bar = figure.colorbar(image, ax=axes, pad=0.01)
    bar.set_label(label, fontsize=8.5)
    bar.ax.tick_params(labelsize=8, colors=MUTED)
    bar.outline.set_visible(False)
