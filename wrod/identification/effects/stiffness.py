"""A gravito-bending length that was measured wrong: every stiffness is off by one factor."""

from wrod.identification.effect import Effect, Estimate, Parameter


class Stiffness(Effect):
    name = "stiffness"
    title = "wrong gravito-bending length (every stiffness scales)"
    reference = "L_gb = (k_b / (2 pi h^2 rho g))^(1/3), paper Eq. nondimensionl_mapping"
    kinds = ("clamped", "motion")
    scales = ("bending", "twisting", "stretching")
    parameters = (Parameter("log_stiffness_ratio", "", 1.0),)

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        ratio = own["stiffness_ratio"]
        lgb = measurements.material.gravito_bending_length * ratio.value ** (1 / 3)
        return {"L_gb": Estimate(lgb, lgb * ratio.stderr / ratio.value / 3, "m")} | own
