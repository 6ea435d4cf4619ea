"""`wrod show PATTERN`: the pattern as it is read, before anything is planned."""

from pathlib import Path

import click

from wrod.commands.options import DRAWING, PICTURE, UNITS, PatternOptions, RodOptions
from wrod.errors import PatternError
from wrod.options import FILE, gathered, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell


@click.command(name="show", short_help="Say what PATTERN is: its length, size and bends.")
@click.argument("pattern")
@gathered("rod_options", RodOptions)
@gathered("reading", PatternOptions, UNITS, DRAWING, PICTURE)
@own_options
@json_option
def command(
    pattern: str,
    rod_options: RodOptions,
    reading: PatternOptions,
    resize: float | None = option("Draw the pattern this many times as large."),
    tolerance: float = option("Of rounded corners [m].", default=0.01),
    out: Path | None = option("A picture (PNG).", type=FILE),
) -> None:
    """Say what PATTERN is: length, size, curvature, how far it leaves its points.

    With a rod also whether it is long enough and what is rounded for it; see `wrod plan`.
    """
    import numpy as np

    if out is not None and out.suffix.lower() != ".png":
        raise PatternError(f"{out}: is not a .png file name; the picture is a PNG")
    if not rod_options.given:
        refuse_idle_options("a pattern without a rod", "tolerance")
    from wrod.commands.plan_pattern import Shaping, fit, too_long

    first = reading.read(pattern)
    curve, notes = first, []
    if rod_options.given:
        rod = rod_options.read()
        fitted = fit(first, rod, Shaping(resize, tolerance, None))
        curve, notes = fitted.pattern, list(fitted.notes)
        remedy = too_long(curve, rod)
        if remedy is not None:
            notes.append(f"too long for a rod of {rod.length:g} m: {remedy}")
    elif resize is not None:
        curve = first.scaled(resize)
    position, _, curvature = curve.sample(np.linspace(0.0, curve.length, 2000))
    figures = {
        "pattern": curve.name,
        "length": curve.length,
        "size": np.ptp(position[:, :2], axis=0).tolist(),
        "largest_curvature": float(np.abs(curvature).max()),
        "departure_from_points": curve.departure()[0],
        "noise": curve.noise,
        "notes": notes,
    }
    if out is not None:
        _draw(out, curve, position, figures)
    width, height = figures["size"]
    tell(
        figures,
        f"{curve.name}: {curve.length:.3f} m long, {width:.3f} x {height:.3f} m, largest curvature "
        f"{figures['largest_curvature']:.1f} 1/m; leaves its points by "
        f"{1e3 * figures['departure_from_points']:.1f} mm at most",
        *(f"note: {note}" for note in notes),
        *[f"wrote {out}"] * (out is not None),
    )


def _draw(out: Path, curve, position, figures: dict) -> None:
    from matplotlib.figure import Figure

    from wrod.files import write_figure

    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    if curve.points is not None:
        axes.plot(curve.points[:, 0], curve.points[:, 1], "o-", color="0.7", ms=2, lw=0.8,
                  label="points given")  # fmt: skip
    axes.plot(position[:, 0], position[:, 1], color="tab:blue", lw=2, label="pattern")
    axes.plot(*position[0, :2], "o", color="tab:green", label="start")
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(f"{curve.name}: {figures['length']:.3f} m", fontsize=10)
    axes.legend(fontsize=8)
    write_figure(out, figure, 110)
