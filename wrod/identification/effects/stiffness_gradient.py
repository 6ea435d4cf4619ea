"""A rod that is stiffer towards one end."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class StiffnessGradient(Effect):
    name = "stiffness_gradient"
    title = "stiffness that changes linearly along the rod"
    reference = "linear profile of every stiffness, given by its relative change at both ends"
    parameters = (
        Parameter("change_at_clamp", "", 0.7, lower=-0.95),
        Parameter("change_at_grip", "", 0.7, lower=-0.95),
    )

    def apply(self, setup, values):
        def profile(fraction):
            return 1.0 + values[0] * (1.0 - fraction) + values[1] * fraction

        nodes = profile(setup.fraction)
        setup.bending = setup.bending * nodes[:, None]
        setup.twisting = setup.twisting * nodes
        setup.stretching = setup.stretching * profile(setup.edge_fraction)

    def describe(self, values, covariance, measurements):
        a, b = values
        middle = 1.0 + 0.5 * (a + b)
        slope = (b - a) / middle
        by = np.array([-1.0 - 0.5 * slope, 1.0 - 0.5 * slope]) / middle
        half = np.array([0.5, 0.5])
        own = super().describe(values, covariance, measurements)
        return own | {
            "relative_gradient": Estimate(float(slope), float(np.sqrt(by @ covariance @ by)), ""),
            "middle_ratio": Estimate(float(middle), float(np.sqrt(half @ covariance @ half)), ""),
        }
