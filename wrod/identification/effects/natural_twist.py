"""A rod that is twisted at rest, or was mounted with a turn between its ends."""

from wrod.identification.effect import Effect, Parameter


class NaturalTwist(Effect):
    name = "natural_twist"
    title = "uniform twist at rest (also: one end mounted with a roll)"
    reference = "Bergou et al. 2010, Discrete Viscous Threads, Sec. 3"
    kinds = ("clamped", "motion")
    adds = "natural_twist"
    parameters = (Parameter("twist", "rad/m", 5.0),)
