"""A rod whose end is not where clamp A is reported."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class ClampOffset(Effect):
    name = "clamp_offset"
    title = "rod displaced in clamp A, the same way in every trial"
    reference = "displacement in the reported frame (m1, m2, tangent)"
    parameters = (
        Parameter("offset_1", "m", 0.01),
        Parameter("offset_2", "m", 0.01),
        Parameter("offset_tangent", "m", 0.01),
    )

    def apply(self, setup, values):
        setup.clamp_position = setup.clamp_position + setup.clamp_rotation @ np.asarray(values)
