"""Grips that hold the rod turned about its own axis."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class GripRoll(Effect):
    name = "grip_roll"
    title = "twist between the grips"
    reference = "roll of the last grip against the first; markers on the axis do not show it"
    kinds = ("motion",)
    parameters = (Parameter("roll", "rad", 1.0),)

    def apply(self, setup, values):
        setup.roll = setup.roll + 0.5 * np.array([-values[0], values[0]])
