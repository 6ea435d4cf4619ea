"""A rod that slipped in the gripper: more of it, or less, hangs free."""

from wrod.identification.effect import Effect, Parameter


class GripSlip(Effect):
    name = "grip_slip"
    title = "free length changed at the gripper"
    reference = "free length L + slip, markers counted from clamp A"
    parameters = (Parameter("slip", "m", 0.03),)
    adds = "length"
    stage = 0
