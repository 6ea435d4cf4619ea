"""How far a deployed rod lies from its pattern (Eq. metric)."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import PerceptionError
from wrod.files import write_figure
from wrod.files.pictures import AFTER, BEFORE, INK, MUTED, new_figure
from wrod.patterns.curve import arc_length
from wrod.perception.scan import read_scan


@dataclass(frozen=True)
class Measurement:
    """Deviation of a deployed rod from its pattern.

    Attributes:
        error_mean: e_mean, mean distance of corresponding points [m].
        error_std: sigma, standard deviation of these distances [m].
        errors: (N,) distances [m].
        deployed: (N, 2) points of the rod, prescribed: (N, 2) of the pattern, both at even
            arc lengths [m].
        deployed_length, prescribed_length: lengths of both [m].
    """

    error_mean: float
    error_std: float
    errors: np.ndarray
    deployed: np.ndarray
    prescribed: np.ndarray
    deployed_length: float
    prescribed_length: float

    def draw(self, path: str | os.PathLike[str]) -> Path:
        """Write a PNG: pattern, rod and their distances from above, and along the rod."""
        figure = new_figure(11, 5)
        above, along = figure.subplots(1, 2, width_ratios=(1.5, 1))
        above.plot(*(100 * self.prescribed.T), color=AFTER, lw=2, label="pattern")
        above.plot(*(100 * self.deployed.T), color=BEFORE, lw=2, label="deployed")
        for a, b in zip(self.deployed, self.prescribed, strict=True):
            above.plot(*(100 * np.array([a, b]).T), color=MUTED, lw=0.7)
        above.set(xlabel="x [cm]", ylabel="y [cm]", aspect="equal", title="From above")
        above.legend(frameon=False)
        share = np.linspace(0, 100, len(self.errors))
        along.plot(share, 1e3 * self.errors, color=INK, lw=1.5)
        along.axhline(1e3 * self.error_mean, color="#d1495b", lw=1)
        along.set(
            xlabel="along the rod [%]",
            ylabel="distance [mm]",
            ylim=(0, None),
            title=f"mean {1e3 * self.error_mean:.2f} mm, deviation {1e3 * self.error_std:.2f} mm",
        )
        for axes in (above, along):
            axes.grid(color="#e5e8ec", lw=0.6)
            axes.spines[["top", "right"]].set_visible(False)
        return write_figure(path, figure, 110)


def compare(deployed: np.ndarray, pattern, points: int = 50) -> Measurement:
    """Eq. metric between a deployed centreline and a pattern.

    Args:
        deployed: (n, 2) or (n, 3) centreline in the pattern's frame [m], from either end.
        pattern: `wrod.Pattern`, or its points (m, 2) or (m, 3) [m].
        points: N, points on either curve, evenly by arc length.

    Raises:
        PerceptionError: fewer than two points on either curve, or N < 2.
    """
    if points < 2:
        raise PerceptionError(f"points is {points}; the metric needs at least 2")
    if hasattr(pattern, "sample"):
        prescribed = pattern.sample(np.linspace(0.0, pattern.length, points))[0][:, :2]
        prescribed_length = float(pattern.length)
    else:
        prescribed, prescribed_length = _even(pattern, points, "the pattern")
    deployed, deployed_length = _even(deployed, points, "the deployed rod")

    def distances(curve):
        return np.hypot(*(curve - prescribed).T)

    # A picture does not tell which end of a rod was laid first.
    if distances(deployed[::-1]).mean() < distances(deployed).mean():
        deployed = deployed[::-1]
    errors = distances(deployed)
    return Measurement(
        float(errors.mean()),
        float(errors.std()),
        errors,
        deployed,
        prescribed,
        deployed_length,
        prescribed_length,
    )


@arguments.checked(
    PerceptionError,
    pattern=arguments.either(
        arguments.like("a wrod.Pattern", "sample", "length"), arguments.array((None, 2), (None, 3))
    ),
    points=arguments.whole(2, 100_000),
)
def measure_deployment(
    image, pattern, *, points: int = 50, picture: str | os.PathLike[str] | None = None, **reading
) -> Measurement:
    """Deviation of the rod in a picture from its pattern (Eq. metric).

    Args:
        image: picture of the deployed rod, as in `wrod.scan`.
        pattern: `wrod.Pattern` in the frame of the markers or of the scale [m].
        points: N, points compared.
        picture: where to draw the comparison (PNG), if anywhere.
        **reading: markers, sheet, scale, camera, mask, kind and color, as in `wrod.scan`.

    Raises:
        PerceptionError: as `wrod.scan`.
    """
    reading.setdefault("kind", "auto")
    result = read_scan(image, **reading)
    result.single()
    measurement = compare(result.metric_lines()[0], pattern, points)
    if picture is not None:
        measurement.draw(picture)
    return measurement


def _even(curve: np.ndarray, points: int, what: str) -> tuple[np.ndarray, float]:
    curve = np.asarray(curve, float)
    if curve.ndim != 2 or curve.shape[1] not in (2, 3) or len(curve) < 2:
        raise PerceptionError(f"{what} has shape {curve.shape}; give (n, 2) or (n, 3) points")
    if not np.isfinite(curve).all():
        raise PerceptionError(f"{what} has points that are not finite")
    curve = curve[:, :2]
    arc = arc_length(curve)
    if arc[-1] <= 0:
        raise PerceptionError(f"{what} has no length")
    at = np.linspace(0.0, arc[-1], points)
    return np.column_stack([np.interp(at, arc, curve[:, i]) for i in (0, 1)]), float(arc[-1])
