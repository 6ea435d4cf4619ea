"""A rod that is coiled at rest: its natural curvature turns along the rod."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter, magnitude_and_angle


class NaturalHelix(Effect):
    name = "natural_helix"
    title = "natural curvature whose direction turns uniformly in the material frame"
    reference = (
        "as natural_curvature, its dt/ds turned about the tangent by turn_rate times arc length"
    )
    parameters = (
        Parameter("curvature_1", "1/m", 20.0),
        Parameter("curvature_2", "1/m", 20.0),
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

    def describe(self, values, covariance, measurements):
        size, angle = magnitude_and_angle(*values[:2], covariance[:2, :2])
        return {
            "curvature": Estimate(*size, "1/m"),
            "direction_at_clamp": Estimate(*angle, "deg"),
            **super().describe(values, covariance, measurements),
        }
