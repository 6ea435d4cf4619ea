"""Cameras whose frame is displaced against the robot's."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class CameraOffset(Effect):
    name = "camera_offset"
    title = "camera frame displaced against the robot frame"
    reference = "x -> x + offset"
    parameters = tuple(Parameter(f"offset_{axis}", "m", 0.02) for axis in "xyz")

    def measure(self, position, frame, values, setup):
        return position + np.asarray(values)
