"""A rod with bends and kinks of its own, as a cable that was folded in its package."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter

_STATIONS = 10


class NaturalCurvatureProfile(Effect):
    name = "natural_curvature_profile"
    title = "natural curvature that changes along the rod"
    reference = (
        "curvature vector dt/ds at rest along (m1, m2), linear between ten stations from grip to "
        "grip"
    )
    kinds = ("motion",)
    parameters = tuple(
        Parameter(f"curvature_{axis}_at_{station}", "1/m", 4.0)
        for station in range(_STATIONS)
        for axis in (1, 2)
    )

    def apply(self, setup, values):
        stations = np.linspace(0.0, 1.0, _STATIONS)
        # Interpolation is linear, so it may be done as a matrix, which carries complex steps.
        weights = np.stack([np.interp(setup.fraction, stations, e) for e in np.eye(_STATIONS)], 1)
        own = weights @ np.asarray(values).reshape(_STATIONS, 2)
        setup.natural_curvature = setup.natural_curvature + own

    def describe(self, values, covariance, measurements):
        size = float(np.sqrt(np.mean(values**2) * 2))
        error = float(np.sqrt(values @ covariance @ values) * 2 / len(values) / max(size, 1e-12))
        return {
            "rms_curvature": Estimate(size, error, "1/m"),
            **super().describe(values, covariance, measurements),
        }
