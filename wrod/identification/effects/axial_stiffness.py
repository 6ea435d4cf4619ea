"""An axial stiffness that does not follow from the bending stiffness and the radius."""

from wrod.identification.effect import Effect, Parameter


class AxialStiffness(Effect):
    name = "axial_stiffness"
    title = "wrong axial stiffness"
    reference = "k_s = 4 k_b / h^2 holds for a homogeneous round section only"
    kinds = ("clamped", "motion")
    scales = ("stretching",)
    parameters = (Parameter("log_axial_stiffness_ratio", "", 1.5),)
