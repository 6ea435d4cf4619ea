"""Pictures of simulated deployments: where the rod was to lie and where it lies."""

import os
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.result import Deployment, errors_along
from wrod.errors import RodError
from wrod.files import write_figure
from wrod.files.pictures import FAINT, INK, MUTED, dress
from wrod.patterns.pattern import Pattern
from wrod.solvers.solids import Cylinder

PATTERN_COLOR, HELD_COLOR, RELEASED_COLOR = "#0b5fa5", "#d9822b", "#8a5a9e"


@arguments.checked(
    RodError,
    deployments=arguments.several(arguments.like("a wrod.Deployment", "centerline", "error_mean")),
)
def draw_deployments(
    path: str | os.PathLike[str],
    pattern: Pattern,
    deployments: list[Deployment],
    title: str,
    fixtures: Fixtures | None = None,
) -> Path:
    """Write a PNG: the laid rods from above, and their error along the pattern.

    Args:
        path: the picture.
        pattern: with its remainder.
        deployments: trials of the same pattern, one line each.
        title: the first line.
        fixtures: what stands on the table, or None.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.4), facecolor="white")
    above = figure.add_axes((0.07, 0.11, 0.52, 0.72))
    errors = figure.add_axes((0.67, 0.11, 0.30, 0.72))
    if fixtures is not None:
        draw_fixtures(above, fixtures)
    draw_above(above, pattern, deployments)
    above.set_xlabel("x [m]", fontsize=8.5)
    above.set_ylabel("y [m]", fontsize=8.5)
    for deployment in deployments:
        s, held = errors_along(pattern, deployment.arc_length, deployment.centerline)
        _, later = errors_along(pattern, deployment.arc_length, deployment.released_centerline)
        errors.plot(s, 100 * held, color=HELD_COLOR, lw=1.4)
        errors.plot(s, 100 * later, color=RELEASED_COLOR, lw=1.0, ls=(0, (4, 2)))
    errors.set_xlim(0.0, pattern.length)
    errors.set_ylim(bottom=0.0)
    errors.set_xlabel("along the pattern [m]", fontsize=8.5)
    errors.set_ylabel("error [cm]", fontsize=8.5)
    for axes in (above, errors):
        dress(axes)
    figure.text(0.03, 0.94, title, fontsize=13, color=INK, weight="bold")
    figure.text(0.03, 0.895, _subtitle(deployments), fontsize=9.5, color=MUTED)
    _legend(figure)

    return write_figure(path, figure, 110)


def draw_above(axes, pattern: Pattern, deployments: list[Deployment]) -> None:
    """The pattern from above and the laid rods on it, cut off where they leave the table."""
    s = np.linspace(-pattern.remainder_length, pattern.length, 400)
    target = pattern.sample(s)[0]
    axes.plot(target[:, 0], target[:, 1], color=PATTERN_COLOR, lw=3.9, alpha=0.35)
    for deployment in deployments:
        laid = deployment.arc_length <= pattern.length + pattern.remainder_length
        axes.plot(*deployment.released_centerline[:, :2].T, color=RELEASED_COLOR, lw=0.9)
        axes.plot(*deployment.centerline[laid, :2].T, color=HELD_COLOR, lw=1.5)
    axes.set_aspect("equal", adjustable="datalim")


def draw_fixtures(axes, fixtures: Fixtures) -> None:
    """Posts and walls from above."""
    from matplotlib.patches import Circle, Rectangle

    for item in fixtures.items:
        x, y = item.shape.center[:2]
        style = dict(facecolor=FAINT, edgecolor=MUTED, lw=0.8)
        if isinstance(item.shape, Cylinder):
            axes.add_patch(Circle((x, y), item.shape.radius, **style))
            continue
        a, b = item.shape.half_size[:2]
        turn = np.degrees(item.yaw)
        box = Rectangle((x - a, y - b), 2 * a, 2 * b, angle=turn, rotation_point="center", **style)
        axes.add_patch(box)


def _subtitle(deployments: list[Deployment]) -> str:
    good = [d for d in deployments if not d.diverged]
    if not good:
        return "diverged"
    held = np.mean([(d.error_mean, d.error_std) for d in good], axis=0) * 100
    later = np.mean([(d.released_error_mean, d.released_error_std) for d in good], axis=0) * 100
    trials = f"{len(good)} trials, " if len(deployments) > 1 else ""
    return (
        f"{trials}error {held[0]:.2f} ± {held[1]:.2f} cm with the grip holding, "
        f"{later[0]:.2f} ± {later[1]:.2f} cm after it let go"
    )


def _legend(figure) -> None:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], color=PATTERN_COLOR, lw=4, alpha=0.35, label="pattern"),
        Line2D([], [], color=HELD_COLOR, lw=1.5, label="grip holding"),
        Line2D([], [], color=RELEASED_COLOR, lw=1.0, label="let go, with its tail"),
    ]
    figure.legend(
        handles=entries, loc="upper right", bbox_to_anchor=(0.985, 0.975), ncol=3,
        fontsize=8.5, frameon=False, labelcolor=MUTED,
    )  # fmt: skip
