"""Rods that are bent or twisted at rest."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter, unknowns

_STATIONS = 10


class NaturalCurvature(Effect):
    """A rod that is bent at rest, as one off a spool."""

    name = "natural_curvature"
    title = "uniform natural curvature in the material frame"
    reference = "dt/ds = curvature_1 m1 + curvature_2 m2 at rest, t the tangent"
    kinds = ("clamped", "motion")
    adds = "natural_curvature"
    polar = "curvature", "direction", "1/m"
    parameters = unknowns("1/m", 20.0, "curvature_1", "curvature_2")


class NaturalCurvatureProfile(Effect):
    """A rod with bends and kinks of its own, as a cable that was folded in its package."""

    name = "natural_curvature_profile"
    title = "natural curvature that changes along the rod"
    reference = (
        "curvature vector dt/ds at rest along (m1, m2), linear between ten stations from grip to "
        "grip"
    )
    kinds = ("motion",)
    parameters = unknowns(
        "1/m", 4.0, *(f"curvature_{axis}_at_{k}" for k in range(_STATIONS) for axis in (1, 2))
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


class NaturalHelix(Effect):
    """A rod that is coiled at rest: its natural curvature turns along the rod."""

    name = "natural_helix"
    title = "natural curvature whose direction turns uniformly in the material frame"
    reference = (
        "as natural_curvature, its dt/ds turned about the tangent by turn_rate times arc length"
    )
    polar = "curvature", "direction_at_clamp", "1/m"
    parameters = (
        *NaturalCurvature.parameters,
        Parameter("turn_rate", "rad/m", 40.0, anywhere=True),
    )

    def starts(self, measurements):
        # Half turns over the length separate the optima in the turn rate.
        rates = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0]) * np.pi / measurements.material.length
        return [np.array([0.0, 0.0, rate]) for rate in rates]

    def apply(self, setup, values):
        angle = values[2] * setup.arc_length
        c, s = np.cos(angle), np.sin(angle)
        first, second = c * values[0] - s * values[1], s * values[0] + c * values[1]
        setup.natural_curvature = setup.natural_curvature + np.stack([first, second], axis=1)


class NaturalTwist(Effect):
    """A rod that is twisted at rest, or was mounted with a turn between its ends."""

    name = "natural_twist"
    title = "uniform twist at rest (also: one end mounted with a roll)"
    reference = "Bergou et al. 2010, Discrete Viscous Threads, Sec. 3"
    kinds = ("clamped", "motion")
    adds = "natural_twist"
    parameters = (Parameter("twist", "rad/m", 5.0),)
