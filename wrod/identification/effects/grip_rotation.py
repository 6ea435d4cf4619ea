"""A rod that does not leave the gripper along the reported axes."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effects.clamp_rotation import ClampRotation


class GripRotation(ClampRotation):
    name = "grip_rotation"
    title = "rod turned in the gripper, the same way in every trial"

    def apply(self, setup, values):
        setup.grip_rotation = setup.grip_rotation @ rotation_of(np.asarray(values))
