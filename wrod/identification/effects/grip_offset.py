"""A rod whose end is not where the gripper is reported."""

import numpy as np

from wrod.identification.effects.clamp_offset import ClampOffset


class GripOffset(ClampOffset):
    name = "grip_offset"
    title = "rod displaced in the gripper, the same way in every trial"

    def apply(self, setup, values):
        setup.grip_position = setup.grip_position + setup.grip_rotation @ np.asarray(values)
