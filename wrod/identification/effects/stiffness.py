"""Stiffnesses that are others, and change along the rod or across it."""

import numpy as np

from wrod.identification.effect import Effect, Estimate, Parameter, unknowns


class Stiffness(Effect):
    """A gravito-bending length that was measured wrong: every stiffness is off by one factor."""

    name = "stiffness"
    title = "wrong gravito-bending length (every stiffness scales)"
    reference = "L_gb = (k_b / (2 pi h^2 rho g))^(1/3), paper Eq. nondimensionl_mapping"
    kinds = ("clamped", "motion")
    scales = ("bending", "twisting")
    parameters = (Parameter("log_stiffness_ratio", "", 1.0),)

    def apply(self, setup, values):
        super().apply(setup, values)
        setup.stretching = setup.stretching * np.exp(setup.stretching_power * values[0])

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        ratio = own["stiffness_ratio"]
        lgb = measurements.material.gravito_bending_length * ratio.value ** (1 / 3)
        return {"L_gb": Estimate(lgb, lgb * ratio.stderr / ratio.value / 3, "m")} | own


class StiffnessGradient(Effect):
    """A rod that is stiffer towards one end."""

    name = "stiffness_gradient"
    title = "stiffness that changes linearly along the rod"
    reference = "linear profile of every stiffness, given by its relative change at both ends"
    parameters = unknowns("", 0.7, "change_at_clamp", "change_at_grip", lower=-0.95)

    def apply(self, setup, values):
        def profile(fraction):
            return 1.0 + values[0] * (1.0 - fraction) + values[1] * fraction

        nodes = profile(setup.fraction)
        setup.bending = setup.bending * nodes[:, None]
        setup.twisting = setup.twisting * nodes
        setup.stretching = setup.stretching * profile(setup.edge_fraction)

    def describe(self, values, covariance, measurements):
        a, b = values
        middle = 1.0 + 0.5 * (a + b)
        slope = (b - a) / middle
        by = np.array([-1.0 - 0.5 * slope, 1.0 - 0.5 * slope]) / middle
        own = super().describe(values, covariance, measurements)
        return own | {
            "relative_gradient": Estimate(float(slope), float(np.sqrt(by @ covariance @ by)), ""),
        }


class StiffnessProfile(Effect):
    """A rod that is stiffer here and softer there."""

    name = "stiffness_profile"
    title = "stiffness that changes along the rod"
    reference = (
        "bending and twisting stiffness times exp(a P1 + b P2 + c P3), Legendre polynomials from "
        "grip to grip"
    )
    kinds = ("motion",)
    parameters = unknowns("", 0.5, "linear", "quadratic", "cubic")

    def apply(self, setup, values):
        u = 2.0 * np.clip(setup.fraction, 0.0, 1.0) - 1.0
        shapes = np.stack([u, 1.5 * u**2 - 0.5, 2.5 * u**3 - 1.5 * u], axis=1)
        factor = np.exp(shapes @ np.asarray(values))
        setup.bending = setup.bending * factor[:, None]
        setup.twisting = setup.twisting * factor


class AnisotropicBending(Effect):
    """A rod that bends more easily in one direction, as a ribbon cable."""

    name = "anisotropic_bending"
    title = "two bending stiffnesses about principal directions of the section"
    reference = "Bergou et al. 2008, Discrete Elastic Rods, Sec. 4.2 (anisotropic bending)"
    kinds = ("clamped", "motion")
    parameters = (
        *unknowns("", 0.7, "log_ratio_1", "log_ratio_2"),
        Parameter("principal_angle", "rad", 2.0, anywhere=True),
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


class AxialStiffness(Effect):
    """An axial stiffness that does not follow from the bending stiffness and the radius."""

    name = "axial_stiffness"
    title = "wrong axial stiffness"
    reference = "k_s = 4 k_b / h^2 holds for a homogeneous round section only"
    scales: tuple[str, ...] = ("stretching",)
    parameters: tuple[Parameter, ...] = (Parameter("log_axial_stiffness_ratio", "", 1.5),)


class AxialCompliance(AxialStiffness):
    """The same of a rod in motion, by how much more it gives way: what markers show is nearly
    linear in that, and nearly nothing at the stiffness of a common cable."""

    kinds = ("motion",)
    scales = ()
    parameters = (Parameter("added_axial_compliance", "", 100.0, lower=-0.9),)

    def apply(self, setup, values):
        setup.stretching = setup.stretching / (1.0 + values[0])

    def describe(self, values, covariance, measurements):
        ratio = 1.0 / (1.0 + float(values[0]))
        error = ratio**2 * float(np.sqrt(covariance[0, 0]))
        return {"axial_stiffness_ratio": Estimate(ratio, error, "")}


class TwistStiffness(Effect):
    """A twisting stiffness that does not follow from the bending stiffness and Poisson's ratio."""

    name = "twist_stiffness"
    title = "wrong twisting stiffness"
    reference = "k_t = k_b / (1 + nu) holds for a homogeneous round section only"
    kinds = ("clamped", "motion")
    scales = ("twisting",)
    parameters = (Parameter("log_twist_stiffness_ratio", "", 1.0),)
