"""A rod whose moment runs ahead of its curvature, as a chain of beads does that begin to touch."""

from wrod.identification.effect import Parameter
from wrod.identification.effects.softening import Softening


class Stiffening(Softening):
    name = "stiffening"
    title = "bending stiffness that grows with curvature, from B to r B"
    reference = "M = B k (r + (1 - r) / (1 + (k / k_c)^2)) with r > 1: softening's law, backwards"
    parameters = (
        Parameter("log_critical_curvature", "", 3.0, lower=-5.0, upper=10.0, anywhere=True),
        Parameter("gained_stiffness", "", 1.0, lower=0.0, upper=9.0),
    )
    sign, first, left = 1.0, (0.1, 1.0), "final_stiffness"
