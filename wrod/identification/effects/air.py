"""Air that damps, drags or draws."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter, magnitude_and_angle, unknowns

_AIR_DENSITY = 1.2
_DRAG_COEFFICIENT = 1.2


class AirDamping(Effect):
    """A drag in proportion to the velocity, as thick air would exert."""

    name = "air_damping"
    title = "drag in proportion to the velocity"
    reference = "f = -c rho A v per length, c the drag per mass"
    kinds = ("motion",)
    adds = "linear_drag"
    parameters = (Parameter("drag_per_mass", "1/s", 3.0, lower=0.0),)


class AirFlow(Effect):
    """A steady draught across the rod."""

    name = "air_flow"
    title = "drag of a steady flow across the rod"
    reference = (
        "cross-flow principle, f = 1/2 rho_air C_d 2h |u| u with u across the rod; "
        f"speeds are for rho_air = {_AIR_DENSITY} kg/m^3 and C_d = {_DRAG_COEFFICIENT}"
    )
    follows_shape = True
    # The drag on a rod straight across the flow: the load is nearly linear in it.
    parameters = unknowns("N/m", 0.05, "drag_x", "drag_y", "drag_z")

    def starts(self, measurements):
        rod = measurements.material
        return [1e-3 * rod.weight * np.array(d) for d in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]

    def apply(self, setup, values):
        size = np.sqrt(np.dot(values, values) + 1e-60)
        setup.wind = setup.wind + np.asarray(values) / np.sqrt(size)

    def describe(self, values, covariance, measurements):
        size = float(np.linalg.norm(values))
        along = values / max(size, 1e-300)
        factor = _AIR_DENSITY * _DRAG_COEFFICIENT * measurements.material.radius
        speed = np.sqrt(size / factor)
        error = 0.5 * speed * np.sqrt(along @ covariance @ along) / max(size, 1e-300)
        _, azimuth = magnitude_and_angle(*values[:2], covariance[:2, :2])
        return {
            "speed": Estimate(float(speed), float(error), "m/s"),
            "azimuth": Estimate(*azimuth, "deg"),
            **super().describe(values, covariance, measurements),
        }


class QuadraticDrag(Effect):
    """The drag of thin air on a fast rod."""

    name = "quadratic_drag"
    title = "drag in proportion to the velocity squared"
    reference = (
        "f = -d rho A |v| v per length; d = rho_air C_d radius / (rho A) for a round section"
    )
    kinds = ("motion",)
    adds = "quadratic_drag"
    parameters = (Parameter("drag_per_mass", "1/m", 1.0, lower=0.0),)
