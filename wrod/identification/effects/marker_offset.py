"""Markers that sit beside the centreline, or were glued on shifted along it."""

import numpy as np

from wrod.identification.effect import Effect, Parameter
from wrod.identification.motion.setup import MotionSetup


class MarkerOffset(Effect):
    name = "marker_offset"
    title = "markers displaced in the material frame, all the same way"
    reference = "x -> x + offset_1 m1 + offset_2 m2 + offset_tangent t"
    kinds = ("clamped", "motion")
    parameters = (
        Parameter("offset_1", "m", 0.005),
        Parameter("offset_2", "m", 0.005),
        Parameter("offset_tangent", "m", 0.005),
    )

    def apply(self, setup, values):
        if isinstance(setup, MotionSetup):
            setup.marker_offset = setup.marker_offset + np.asarray(values)

    def measure(self, position, frame, values, setup):
        return position + frame @ np.asarray(values)
