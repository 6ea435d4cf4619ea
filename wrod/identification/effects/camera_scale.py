"""Cameras with a wrong scale."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class CameraScale(Effect):
    name = "camera_scale"
    title = "scale error of the cameras about some point"
    reference = "x -> (1 + scale) x + offset; the point that stays is -offset / scale"
    parameters = (
        Parameter("scale", "", 0.1),
        *(Parameter(f"offset_{axis}", "m", 0.05) for axis in "xyz"),
    )

    def measure(self, position, frame, values, setup):
        return position * (1.0 + values[0]) + np.asarray(values[1:])

    def describe(self, values, covariance, measurements):
        factor = Estimate(1.0 + float(values[0]), float(np.sqrt(covariance[0, 0])), "")
        return {"factor": factor, **super().describe(values, covariance, measurements)}
