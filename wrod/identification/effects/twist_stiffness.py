"""A twisting stiffness that does not follow from the bending stiffness and Poisson's ratio."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class TwistStiffness(Effect):
    name = "twist_stiffness"
    title = "wrong twisting stiffness"
    reference = "k_t = k_b / (1 + nu) holds for a homogeneous round section only"
    kinds = ("clamped", "motion")
    parameters = (Parameter("log_twist_stiffness_ratio", "", 1.0),)

    def apply(self, setup, values):
        setup.twisting = setup.twisting * np.exp(values[0])

    def describe(self, values, covariance, measurements):
        ratio = float(np.exp(values[0]))
        error = ratio * float(np.sqrt(covariance[0, 0]))
        return {"twist_stiffness_ratio": Estimate(ratio, error, "")}
