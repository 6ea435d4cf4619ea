"""A rod that does not leave clamp A along the reported axes."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import Effect, Estimate, Parameter


class ClampRotation(Effect):
    name = "clamp_rotation"
    title = "rod turned in clamp A, the same way in every trial"
    reference = "R -> R exp(rotation vector), in the reported frame (m1, m2, tangent)"
    parameters = (
        Parameter("rotation_1", "rad", 0.2),
        Parameter("rotation_2", "rad", 0.2),
        Parameter("roll", "rad", 0.7),
    )

    def apply(self, setup, values):
        setup.clamp_rotation = setup.clamp_rotation @ rotation_of(np.asarray(values))

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        size = float(np.linalg.norm(values))
        along = values / max(size, 1e-300)
        error = float(np.sqrt(along @ covariance @ along))
        return {"angle": Estimate(np.degrees(size).item(), np.degrees(error).item(), "deg"), **own}
