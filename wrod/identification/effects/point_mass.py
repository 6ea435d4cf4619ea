"""Something that hangs on the rod: a connector, a tape, a marker that is not light."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class PointMass(Effect):
    name = "point_mass"
    title = "a mass at one place of the rod"
    reference = "dead load m g at arc length s"
    parameters = (
        Parameter("mass", "kg", 0.01, lower=0.0),
        Parameter("arc_length", "m", 1.0, lower=0.0, anywhere=True),
    )

    def starts(self, measurements):
        length = measurements.material.length
        return [np.array([1e-5, f * length]) for f in (0.15, 0.32, 0.5, 0.68, 0.85)]

    def apply(self, setup, values):
        setup.node_mass = setup.node_mass + values[0] * setup.weights_at(values[1])
