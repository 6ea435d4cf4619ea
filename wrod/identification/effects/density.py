"""A rod that is heavier or lighter than its density says, its stiffness being as given."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class Density(Effect):
    name = "density"
    title = "wrong weight per length (stiffness as given)"
    reference = "uniform line mass"
    parameters = (Parameter("log_density_ratio", "", 0.7),)

    def apply(self, setup, values):
        setup.line_mass = setup.line_mass * np.exp(values[0])

    def describe(self, values, covariance, measurements):
        ratio = float(np.exp(values[0]))
        error = ratio * float(np.sqrt(covariance[0, 0]))
        rho = measurements.material.density
        return {
            "density": Estimate(rho * ratio, rho * error, "kg/m^3"),
            "density_ratio": Estimate(ratio, error, ""),
        }
