"""A robot frame whose z axis is not plumb."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import Effect, Estimate, Parameter, magnitude_and_angle


class GravityTilt(Effect):
    name = "gravity_tilt"
    title = "gravity turned about a horizontal axis"
    reference = "rotation of the gravity vector"
    kinds = ("clamped", "motion")
    parameters = (Parameter("tilt_x", "rad", 0.15), Parameter("tilt_y", "rad", 0.15))

    def apply(self, setup, values):
        setup.gravity = rotation_of(np.array([values[0], values[1], 0 * values[0]])) @ setup.gravity

    def describe(self, values, covariance, measurements):
        size, azimuth = magnitude_and_angle(*values, covariance)
        tilt = Estimate(np.degrees(size[0]).item(), np.degrees(size[1]).item(), "deg")
        return {
            "tilt": tilt,
            "axis_azimuth": Estimate(*azimuth, "deg"),
            **super().describe(values, covariance, measurements),
        }
