"""A rod whose end is not where the gripper is reported."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class GripOffset(Effect):
    name = "grip_offset"
    title = "rod displaced in the gripper, the same way in every trial"
    reference = "displacement in the reported frame (m1, m2, tangent)"
    parameters = (
        Parameter("offset_1", "m", 0.01),
        Parameter("offset_2", "m", 0.01),
        Parameter("offset_tangent", "m", 0.01),
    )

    def apply(self, setup, values):
        setup.grip_position = setup.grip_position + setup.grip_rotation @ np.asarray(values)
