"""Rods that leave a grip in another direction than its two markers say."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class GripDirection(Effect):
    name = "grip_direction"
    title = "rod turned in the grips against the line through their markers"
    reference = "rotation of the held edge about the grip's (m1, m2)"
    kinds = ("motion",)
    parameters = (
        Parameter("first_1", "rad", 0.1),
        Parameter("first_2", "rad", 0.1),
        Parameter("last_1", "rad", 0.1),
        Parameter("last_2", "rad", 0.1),
    )

    def apply(self, setup, values):
        setup.held_turn = setup.held_turn + np.asarray(values).reshape(2, 2)
