"""A twisting stiffness that does not follow from the bending stiffness and Poisson's ratio."""

from wrod.identification.effect import Effect, Parameter


class TwistStiffness(Effect):
    name = "twist_stiffness"
    title = "wrong twisting stiffness"
    reference = "k_t = k_b / (1 + nu) holds for a homogeneous round section only"
    kinds = ("clamped", "motion")
    scales = ("twisting",)
    parameters = (Parameter("log_twist_stiffness_ratio", "", 1.0),)
