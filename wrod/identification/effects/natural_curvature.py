"""A rod that is bent at rest, as one off a spool."""

from wrod.identification.effect import Effect, Estimate, Parameter, magnitude_and_angle


class NaturalCurvature(Effect):
    name = "natural_curvature"
    title = "uniform natural curvature in the material frame"
    reference = "dt/ds = curvature_1 m1 + curvature_2 m2 at rest, t the tangent"
    kinds = ("clamped", "motion")
    adds = "natural_curvature"
    parameters = (Parameter("curvature_1", "1/m", 20.0), Parameter("curvature_2", "1/m", 20.0))

    def describe(self, values, covariance, measurements):
        size, angle = magnitude_and_angle(*values, covariance)
        return {
            "curvature": Estimate(*size, "1/m"),
            "direction": Estimate(*angle, "deg"),
            **super().describe(values, covariance, measurements),
        }
