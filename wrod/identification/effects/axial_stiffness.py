"""An axial stiffness that does not follow from the bending stiffness and the radius."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class AxialStiffness(Effect):
    name = "axial_stiffness"
    title = "wrong axial stiffness"
    reference = "k_s = 4 k_b / h^2 holds for a homogeneous round section only"
    kinds = ("clamped", "motion")
    parameters = (Parameter("log_axial_stiffness_ratio", "", 1.5),)

    def apply(self, setup, values):
        setup.stretching = setup.stretching * np.exp(values[0])

    def describe(self, values, covariance, measurements):
        ratio = float(np.exp(values[0]))
        error = ratio * float(np.sqrt(covariance[0, 0]))
        return {"axial_stiffness_ratio": Estimate(ratio, error, "")}
