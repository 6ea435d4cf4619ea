"""The drag of thin air on a fast rod."""

from wrod.identification.effect import Effect, Parameter


class QuadraticDrag(Effect):
    name = "quadratic_drag"
    title = "drag in proportion to the velocity squared"
    reference = (
        "f = -d rho A |v| v per length; d = rho_air C_d radius / (rho A) for a round section"
    )
    kinds = ("motion",)
    parameters = (Parameter("drag_per_mass", "1/m", 1.0, lower=0.0),)

    def apply(self, setup, values):
        setup.quadratic_drag = setup.quadratic_drag + values[0]
