"""A rod that is heavier or lighter than its density says, its stiffness being as given."""

from wrod.identification.effect import Effect, Estimate, Parameter


class Density(Effect):
    name = "density"
    title = "wrong weight per length (stiffness as given)"
    reference = "uniform line mass"
    scales = ("line_mass",)
    parameters = (Parameter("log_density_ratio", "", 0.7),)

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        ratio, rho = own["density_ratio"], measurements.material.density
        return {"density": Estimate(rho * ratio.value, rho * ratio.stderr, "kg/m^3")} | own
