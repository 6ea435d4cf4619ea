"""A rod that is longer between its markers than the curve through them."""

from wrod.identification.effect import Effect, Parameter


class RodLength(Effect):
    name = "rod_length"
    title = "length between the markers"
    reference = "every rest length times 1 + e"
    kinds = ("motion",)
    parameters = (Parameter("relative_change", "", 0.01),)

    def apply(self, setup, values):
        setup.rest_length = setup.rest_length * (1.0 + values[0])
