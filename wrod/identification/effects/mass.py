"""Weight that is another, lies elsewhere, or points elsewhere."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import Effect, Estimate, Parameter, unknowns


class Density(Effect):
    """A rod that is heavier or lighter than its density says, its stiffness being as given."""

    name = "density"
    title = "wrong weight per length (stiffness as given)"
    reference = "uniform line mass"
    scales = ("line_mass",)
    parameters = (Parameter("log_density_ratio", "", 0.7),)

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        ratio, rho = own["density_ratio"], measurements.material.density
        return {"density": Estimate(rho * ratio.value, rho * ratio.stderr, "kg/m^3")} | own


class DensityProfile(Effect):
    """A rod that is heavier towards one end."""

    name = "density_profile"
    title = "weight per length that changes linearly along the rod"
    reference = "linear line mass, given by its relative change at both ends"
    parameters = unknowns("", 0.7, "change_at_clamp", "change_at_grip")

    def apply(self, setup, values):
        fraction = setup.fraction
        profile = 1.0 + values[0] * (1.0 - fraction) + values[1] * fraction
        setup.line_mass = setup.line_mass * profile


class GravityTilt(Effect):
    """A robot frame whose z axis is not plumb."""

    name = "gravity_tilt"
    title = "gravity turned about a horizontal axis"
    reference = "rotation of the gravity vector"
    # Of a uniform rod, but for 1 - cos(tilt) of its weight.
    alike = (
        "a steady sideways force per length, as of wind: the tangent of the tilt times the weight"
    )
    kinds = ("clamped", "motion")
    polar = "tilt", "axis_azimuth", "deg"
    parameters = unknowns("rad", 0.15, "tilt_x", "tilt_y")

    def apply(self, setup, values):
        setup.gravity = rotation_of(np.array([values[0], values[1], 0 * values[0]])) @ setup.gravity


class MassGradient(Effect):
    """A rod that is heavier towards one end."""

    name = "mass_gradient"
    title = "mass per length that changes along the rod"
    reference = "rho A times exp(a u), u from -1 at the first grip to 1 at the last"
    kinds = ("motion",)
    parameters = (Parameter("log_ratio", "", 0.5),)

    def apply(self, setup, values):
        u = 2.0 * np.clip(setup.fraction, 0.0, 1.0) - 1.0
        setup.line_mass = setup.line_mass * np.exp(values[0] * u)


class PointMass(Effect):
    """Something that hangs on the rod: a connector, a tape, a marker that is not light."""

    name = "point_mass"
    title = "a mass at one place of the rod"
    reference = "dead load m g at arc length s"
    parameters = (
        Parameter("mass", "kg", 0.01, lower=0.0),
        Parameter("arc_length", "m", 1.0, lower=0.0, anywhere=True),
    )

    def starts(self, measurements):
        length = measurements.material.length
        return [np.array([1e-5, f * length]) for f in (0.15, 0.32, 0.5, 0.68, 0.85)]

    def apply(self, setup, values):
        setup.node_mass = setup.node_mass + values[0] * setup.weights_at(values[1])
