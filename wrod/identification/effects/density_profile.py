"""A rod that is heavier towards one end."""

from wrod.identification.effect import Effect, Parameter


class DensityProfile(Effect):
    name = "density_profile"
    title = "weight per length that changes linearly along the rod"
    reference = "linear line mass, given by its relative change at both ends"
    parameters = (Parameter("change_at_clamp", "", 0.7), Parameter("change_at_grip", "", 0.7))

    def apply(self, setup, values):
        fraction = setup.fraction
        profile = 1.0 + values[0] * (1.0 - fraction) + values[1] * fraction
        setup.line_mass = setup.line_mass * profile
