"""A rod whose moment grows less than its curvature."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class Softening(Effect):
    name = "softening"
    title = "moment that falls behind the curvature, B k / sqrt(1 + (k / k_c)^2)"
    reference = "one-parameter moment-curvature law; to second order any symmetric law is one"
    parameters = (Parameter("softening", "m^2", 1e-2, lower=0.0),)

    def starts(self, measurements):
        return [np.array([1e-5]), np.array([1e-3])]

    def apply(self, setup, values):
        setup.softening = setup.softening + values[0]

    def describe(self, values, covariance, measurements):
        c, error = float(values[0]), float(np.sqrt(covariance[0, 0]))
        own = super().describe(values, covariance, measurements)
        if c <= 0.0:
            return own
        critical = c**-0.5
        return {"critical_curvature": Estimate(critical, 0.5 * critical * error / c, "1/m"), **own}
