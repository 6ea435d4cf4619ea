"""A rod that is heavier towards one end."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class MassGradient(Effect):
    name = "mass_gradient"
    title = "mass per length that changes along the rod"
    reference = "rho A times exp(a u), u from -1 at the first grip to 1 at the last"
    kinds = ("motion",)
    parameters = (Parameter("log_ratio", "", 0.5),)

    def apply(self, setup, values):
        u = 2.0 * np.clip(setup.fraction, 0.0, 1.0) - 1.0
        setup.line_mass = setup.line_mass * np.exp(values[0] * u)
