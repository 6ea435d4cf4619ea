"""A rod whose moment falls behind its curvature, as a cable does whose strands begin to slip."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class Softening(Effect):
    name = "softening"
    title = "bending stiffness that falls with curvature, from B to r B"
    reference = (
        "M = B k (r + (1 - r) / (1 + (k / k_c)^2)), a smooth form of the stick-slip law of "
        "stranded cables (Papailiou 1997)"
    )
    kinds = ("clamped", "motion")
    parameters = (
        Parameter("log_critical_curvature", "", 3.0, lower=-5.0, upper=10.0, anywhere=True),
        Parameter("lost_stiffness", "", 1.0, lower=0.0, upper=1.0),
    )
    # What is lost counts against the stiffness; where fits of it start; what is left is called so.
    sign, first, left = -1.0, (0.1, 0.7), "kept_stiffness"

    def starts(self, measurements):
        return [np.array([np.log(k), change]) for k in (3.0, 30.0) for change in self.first]

    def apply(self, setup, values):
        # A rod has one law: of two, the last counts.
        own = np.array([np.exp(-2.0 * values[0]), 1.0 + self.sign * values[1]])
        setup.softening = 0.0 * setup.softening + own

    def describe(self, values, covariance, measurements):
        errors = np.sqrt(np.diag(covariance))
        critical = float(np.exp(values[0]))
        return {
            "critical_curvature": Estimate(critical, float(critical * errors[0]), "1/m"),
            self.left: Estimate(1.0 + self.sign * float(values[1]), float(errors[1]), ""),
        }
