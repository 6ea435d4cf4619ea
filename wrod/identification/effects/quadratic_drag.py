"""The drag of thin air on a fast rod."""

from wrod.identification.effect import Effect, Parameter


class QuadraticDrag(Effect):
    name = "quadratic_drag"
    title = "drag in proportion to the velocity squared"
    reference = (
        "f = -d rho A |v| v per length; d = rho_air C_d radius / (rho A) for a round section"
    )
    kinds = ("motion",)
    adds = "quadratic_drag"
    parameters = (Parameter("drag_per_mass", "1/m", 1.0, lower=0.0),)
