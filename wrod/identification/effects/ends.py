"""Ends that are not where, not as, or not as long as they are said to be."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import Effect, Estimate, Parameter, unknowns


class ClampLength(Effect):
    """Grips that do not hold the rod rigidly from their edge on."""

    name = "clamp_length"
    title = "length of rod that bends inside each grip, beyond its inner marker"
    reference = "Voronoi length of the grip's node: half the free edge and this length"
    kinds = ("motion",)
    adds = "clamp_length"
    parameters = unknowns("m", 0.02, "at_first", "at_last", lower=-0.015)


class ClampOffset(Effect):
    """A rod whose end is not where clamp A is reported."""

    name = "clamp_offset"
    title = "rod displaced in clamp A, the same way in every trial"
    reference = "displacement in the reported frame (m1, m2, tangent)"
    parameters = unknowns("m", 0.01, "offset_1", "offset_2", "offset_tangent")

    def apply(self, setup, values):
        setup.clamp_position = setup.clamp_position + setup.clamp_rotation @ np.asarray(values)


class ClampRotation(Effect):
    """A rod that does not leave clamp A along the reported axes."""

    name = "clamp_rotation"
    title = "rod turned in clamp A, the same way in every trial"
    reference = "R -> R exp(rotation vector), in the reported frame (m1, m2, tangent)"
    parameters = (*unknowns("rad", 0.2, "rotation_1", "rotation_2"), Parameter("roll", "rad", 0.7))

    def apply(self, setup, values):
        setup.clamp_rotation = setup.clamp_rotation @ rotation_of(np.asarray(values))

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        size = float(np.linalg.norm(values))
        along = values / max(size, 1e-300)
        error = float(np.sqrt(along @ covariance @ along))
        return {"angle": Estimate(np.degrees(size).item(), np.degrees(error).item(), "deg"), **own}


class ClampSlip(Effect):
    """A rod that slipped in clamp A: more of it, or less, hangs free."""

    name = "clamp_slip"
    title = "free length changed at clamp A"
    reference = "free length L + slip, markers moved along with the rod"
    parameters = (Parameter("slip", "m", 0.03),)
    stage = 0

    def apply(self, setup, values):
        setup.length = setup.length + values[0]
        setup.marker_arc_length = setup.marker_arc_length + values[0]


class GripDirection(Effect):
    """Rods that leave a grip in another direction than its two markers say."""

    name = "grip_direction"
    title = "rod turned in the grips against the line through their markers"
    reference = "rotation of the held edge about the grip's (m1, m2)"
    kinds = ("motion",)
    adds = "held_turn"
    parameters = unknowns("rad", 0.1, "first_1", "first_2", "last_1", "last_2")


class GripOffset(ClampOffset):
    """A rod whose end is not where the gripper is reported."""

    name = "grip_offset"
    title = "rod displaced in the gripper, the same way in every trial"

    def apply(self, setup, values):
        setup.grip_position = setup.grip_position + setup.grip_rotation @ np.asarray(values)


class GripRoll(Effect):
    """Grips that hold the rod turned about its own axis."""

    name = "grip_roll"
    title = "twist between the grips"
    reference = "roll of the last grip against the first; markers on the axis do not show it"
    kinds = ("motion",)
    parameters = (Parameter("roll", "rad", 1.0),)

    def apply(self, setup, values):
        setup.roll = setup.roll + 0.5 * np.array([-values[0], values[0]])


class GripRotation(ClampRotation):
    """A rod that does not leave the gripper along the reported axes."""

    name = "grip_rotation"
    title = "rod turned in the gripper, the same way in every trial"

    def apply(self, setup, values):
        setup.grip_rotation = setup.grip_rotation @ rotation_of(np.asarray(values))


class GripSlip(Effect):
    """A rod that slipped in the gripper: more of it, or less, hangs free."""

    name = "grip_slip"
    title = "free length changed at the gripper"
    reference = "free length L + slip, markers counted from clamp A"
    parameters = (Parameter("slip", "m", 0.03),)
    adds = "length"
    stage = 0


class RodLength(Effect):
    """A rod that is longer between its markers than the curve through them."""

    name = "rod_length"
    title = "length between the markers"
    reference = "every rest length times 1 + e"
    kinds = ("motion",)
    parameters = (Parameter("relative_change", "", 0.01),)

    def apply(self, setup, values):
        setup.mean_length = setup.mean_length * (1.0 + values[0])
