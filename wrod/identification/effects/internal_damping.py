"""A material whose moments also depend on how fast it is bent and twisted."""

from wrod.identification.effect import Effect, Parameter


class InternalDamping(Effect):
    name = "internal_damping"
    title = "strain-rate damping inside the rod (Kelvin-Voigt)"
    reference = (
        "M = B (k + eta dk/dt), bending and twisting alike; Bergou et al. 2010, Discrete Viscous "
        "Threads, Sec. 4"
    )
    kinds = ("motion",)
    adds = "viscous_time"
    parameters = (Parameter("viscous_time", "s", 0.1, lower=0.0),)
