"""A rod that bends more easily in one direction, as a ribbon cable."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter


class AnisotropicBending(Effect):
    name = "anisotropic_bending"
    title = "two bending stiffnesses about principal directions of the section"
    reference = "Bergou et al. 2008, Discrete Elastic Rods, Sec. 4.2 (anisotropic bending)"
    kinds = ("clamped", "motion")
    parameters = (
        Parameter("log_ratio_1", "", 0.7),
        Parameter("log_ratio_2", "", 0.7),
        Parameter("principal_angle", "rad", 2.0),
    )

    def starts(self, measurements):
        # Without anisotropy the directions mean nothing: start with some, in three directions.
        return [np.array([0.1, -0.1, angle]) for angle in (0.0, np.pi / 6, -np.pi / 6)]

    def apply(self, setup, values):
        setup.bending = setup.bending * np.exp(np.asarray(values[:2]))
        setup.principal_angle = setup.principal_angle + values[2]

    def describe(self, values, covariance, measurements):
        order = np.argsort(-values[:2])
        ratios = np.exp(values[:2])
        errors = np.sqrt(np.diag(covariance))
        # The stiffer direction first; directions repeat after half a turn.
        angle = np.degrees(values[2]) + (90.0 if order[0] == 1 else 0.0)
        angle = (angle + 90.0) % 180.0 - 90.0
        contrast = np.array([1.0, -1.0]) @ covariance[:2, :2] @ np.array([1.0, -1.0])
        ratio = float(ratios[order[0]] / ratios[order[1]])
        stiffer, softer = (
            Estimate(float(ratios[i]), float(ratios[i] * errors[i]), "") for i in order
        )
        return {
            "stiffer_ratio": stiffer,
            "softer_ratio": softer,
            "anisotropy": Estimate(ratio, float(ratio * np.sqrt(contrast)), ""),
            "stiffer_direction": Estimate(float(angle), float(np.degrees(errors[2])), "deg"),
        }
