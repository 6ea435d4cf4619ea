"""Markers that sit beside the centreline, or were glued on shifted along it."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class MarkerOffset(Effect):
    name = "marker_offset"
    title = "markers displaced in the material frame, all the same way"
    reference = "x -> x + offset_1 m1 + offset_2 m2 + offset_tangent t"
    parameters = (
        Parameter("offset_1", "m", 0.005),
        Parameter("offset_2", "m", 0.005),
        Parameter("offset_tangent", "m", 0.005),
    )

    def measure(self, position, frame, values, setup):
        return position + frame @ np.asarray(values)
