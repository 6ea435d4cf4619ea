"""Grips that do not hold the rod rigidly from their edge on."""

from wrod.identification.effect import Effect, Parameter


class ClampLength(Effect):
    name = "clamp_length"
    title = "length of rod that bends inside each grip, beyond its inner marker"
    reference = "Voronoi length of the grip's node: half the free edge and this length"
    kinds = ("motion",)
    adds = "clamp_length"
    parameters = (
        Parameter("at_first", "m", 0.02, lower=-0.015),
        Parameter("at_last", "m", 0.02, lower=-0.015),
    )
