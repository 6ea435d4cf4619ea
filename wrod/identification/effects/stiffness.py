"""A gravito-bending length that was measured wrong: every stiffness is off by one factor."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class Stiffness(Effect):
    name = "stiffness"
    title = "wrong gravito-bending length (every stiffness scales)"
    reference = "L_gb = (k_b / (2 pi h^2 rho g))^(1/3), paper Eq. nondimensionl_mapping"
    kinds = ("clamped", "motion")
    parameters = (Parameter("log_stiffness_ratio", "", 1.0),)

    def apply(self, setup, values):
        factor = np.exp(values[0])
        setup.bending = setup.bending * factor
        setup.twisting = setup.twisting * factor
        setup.stretching = setup.stretching * factor

    def describe(self, values, covariance, measurements):
        ratio, error = float(np.exp(values[0])), float(np.sqrt(covariance[0, 0]))
        lgb = measurements.material.gravito_bending_length * ratio ** (1 / 3)
        return {
            "L_gb": Estimate(lgb, lgb * error / 3, "m"),
            "stiffness_ratio": Estimate(ratio, ratio * error, ""),
        }
