"""Cameras whose frame is displaced against the robot's."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class CameraOffset(Effect):
    name = "camera_offset"
    title = "camera frame displaced against the robot frame"
    reference = "x -> x + offset"
    parameters = (
        Parameter("offset_x", "m", 0.02),
        Parameter("offset_y", "m", 0.02),
        Parameter("offset_z", "m", 0.02),
    )

    def measure(self, position, frame, values, setup):
        return position + np.asarray(values)
