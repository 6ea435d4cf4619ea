"""A drag in proportion to the velocity, as thick air would exert."""

from wrod.identification.effect import Effect, Parameter


class AirDamping(Effect):
    name = "air_damping"
    title = "drag in proportion to the velocity"
    reference = "f = -c rho A v per length, c the drag per mass"
    kinds = ("motion",)
    adds = "linear_drag"
    parameters = (Parameter("drag_per_mass", "1/s", 3.0, lower=0.0),)
