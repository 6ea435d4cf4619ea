"""What the pictures of identification's reports have in common."""

import io

INK, FAINT, MUTED = "#22262b", "#c9ced6", "#59616b"
MEASURED, BEFORE, AFTER = "#22262b", "#d9822b", "#0b5fa5"
SERIES = ("#0b5fa5", "#d9822b", "#3a8f5c")


def new_figure(width: float, height: float):
    """A figure of that size [inch], to be written by `as_png`."""
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
    axes.grid(color="#e6e9ee", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=MUTED, length=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)
