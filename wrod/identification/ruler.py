"""A rod's gravito-bending length with a ruler: how far an overhanging end falls.

The rod is clamped level at a table's edge, and a length of it hangs over. (The folded loop is
`RodMaterial.from_loop_height`, the photograph of a hanging loop `hanging_loop`.)
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from wrod import arguments
from wrod.errors import DataError
from wrod.grasps.mesh import WEIGHT
from wrod.rods.batch import RodBatch
from wrod.rods.model import RodModel
from wrod.solvers.statics import EquilibriumSolver, prescribe

_EDGES = 80
# Overhangs [L_gb] of the first look: from a fall of 2 % to an end that hangs straight down.
_LENGTHS = np.geomspace(0.7, 8.0, 24)
# Where the fall tells little of the stiffness: ends that hardly fall, and ends that hang.
_RATIOS = (0.03, 0.93)
_STRETCH_RATIO = 1e5


@dataclass(frozen=True)
class MeasuredLength:
    """A gravito-bending length and its standard error [m], and a warning or None."""

    gravito_bending_length: float
    error: float
    warning: str | None = None


def fall_ratio(lengths: np.ndarray) -> np.ndarray:
    """Fall of the end over the overhang, for overhangs (n,) [L_gb] of a rod that is clamped level.

    Two meshes are extrapolated.

    Raises:
        DataError: an equilibrium was not found.
    """
    coarse, fine = (_falls(np.asarray(lengths, float), n) for n in (_EDGES // 2, _EDGES))
    return (4.0 * fine - coarse) / 3.0


def _falls(lengths: np.ndarray, edges: int) -> np.ndarray:
    share = np.arange(-1, edges + 1) / edges
    rods = [
        RodModel(
            length=float(length), bending_stiffness=1.0, twisting_stiffness=2.0 / 3.0,
            stretching_stiffness=_STRETCH_RATIO, line_mass=WEIGHT, radius=1.0, gravity=1.0,
        )
        for length in lengths
    ]  # fmt: skip
    s = lengths[:, None] * share
    # As the parabola of a stiff rod begins, no steeper than 45 degrees.
    drop = np.minimum(lengths**3 / 16.0, 0.7)[:, None] * np.maximum(s, 0.0) * np.maximum(share, 0.0)
    position = np.stack([s, 0 * s, -drop], axis=2)
    position[:, 0] = np.column_stack([s[:, 0], 0 * lengths, 0 * lengths])
    batch = RodBatch.of(
        rods, s + lengths[:, None] / edges, position, clamped=(True, False),
        director=(0.0, 1.0, 0.0),
    )  # fmt: skip
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    if not EquilibriumSolver(batch).solve(ramp_loads=True).converged.all():
        raise DataError("an overhanging rod found no equilibrium; measure a shorter overhang")
    return -batch.positions()[:, -1, 2] / lengths


@arguments.checked(
    DataError, **dict.fromkeys(("overhang", "fall", "reading"), arguments.number(0.0, 1e3, above=0))
)
def measure_overhang(overhang: float, fall: float, reading: float = 1e-3) -> MeasuredLength:
    """The gravito-bending length of a rod whose end falls, overhanging a table.

    Args:
        overhang: length of rod from the table's edge to its end, along the rod [m].
        fall: of the end below the clamped part, centreline to centreline [m].
        reading: standard error of either reading [m].

    Raises:
        DataError: the readings are not positive, or the end would fall further than it is long.
    """
    if fall >= 0.999 * overhang:
        raise DataError(
            f"an end cannot fall {fall:g} m over an overhang of {overhang:g} m; measure the "
            "overhang along the rod"
        )
    ratio = fall / overhang
    low, high = _RATIOS
    warning = None
    if not low <= ratio <= high:
        way = "shorter" if ratio > high else "longer"
        warning = (
            f"an end that falls {100 * ratio:.0f} % of its overhang says little of the stiffness; "
            f"measure a {way} overhang, best one that falls by half of it"
        )
    grid = fall_ratio(_LENGTHS)
    if not grid[0] < ratio < grid[-1]:
        raise DataError(
            f"a fall of {100 * ratio:.1f} % of the overhang is none that a stiffness follows from; "
            "measure an overhang whose end falls by about half of it"
        )
    length = float(PchipInterpolator(grid, _LENGTHS)(ratio))
    slope = 0.0
    for _ in range(3):
        at = fall_ratio(np.array([length, 1.001 * length]))
        slope = float((at[1] - at[0]) / (0.001 * length))
        length += (ratio - at[0]) / slope
    found = overhang / length
    if not reading < fall:
        raise DataError(
            f"a ruler that is off by {reading:g} m shows no fall of {fall:g} m; check the numbers"
        )
    # found = overhang / length(fall / overhang)
    to_fall = found / length / slope / overhang
    to_overhang = 1.0 / length + found / length / slope * ratio / overhang
    return MeasuredLength(float(found), float(reading * np.hypot(to_fall, to_overhang)), warning)
