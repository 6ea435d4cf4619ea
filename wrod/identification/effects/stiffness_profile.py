"""A rod that is stiffer here and softer there."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class StiffnessProfile(Effect):
    name = "stiffness_profile"
    title = "stiffness that changes along the rod"
    reference = (
        "bending and twisting stiffness times exp(a P1 + b P2 + c P3), Legendre polynomials from "
        "grip to grip"
    )
    kinds = ("motion",)
    parameters = (
        Parameter("linear", "", 0.5),
        Parameter("quadratic", "", 0.5),
        Parameter("cubic", "", 0.5),
    )

    def apply(self, setup, values):
        u = 2.0 * np.clip(setup.fraction, 0.0, 1.0) - 1.0
        shapes = np.stack([u, 1.5 * u**2 - 0.5, 2.5 * u**3 - 1.5 * u], axis=1)
        factor = np.exp(shapes @ np.asarray(values))
        setup.bending = setup.bending * factor[:, None]
        setup.twisting = setup.twisting * factor
