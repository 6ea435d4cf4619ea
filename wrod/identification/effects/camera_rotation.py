"""Cameras whose frame is turned against the robot's."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import Effect, Parameter


class CameraRotation(Effect):
    name = "camera_rotation"
    title = "camera frame turned against the robot frame about some point"
    reference = "x -> exp(rotation vector) (x - a) + a + offset, a the mean place of clamp A"
    parameters = (
        *(Parameter(f"rotation_{axis}", "rad", 0.1) for axis in "xyz"),
        *(Parameter(f"offset_{axis}", "m", 0.02) for axis in "xyz"),
    )

    def measure(self, position, frame, values, setup):
        centre = np.real(setup.clamp_position).mean(axis=0)
        turned = (position - centre) @ rotation_of(np.asarray(values[:3])).T
        return turned + centre + np.asarray(values[3:])
