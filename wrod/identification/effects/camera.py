"""Cameras that see the rod elsewhere, and markers beside its centreline."""

import numpy as np

from wrod.identification.clamped.setup import rotation_of
from wrod.identification.effect import Effect, Estimate, Parameter, unknowns
from wrod.identification.motion.setup import MotionSetup


class CameraOffset(Effect):
    """Cameras whose frame is displaced against the robot's."""

    name = "camera_offset"
    title = "camera frame displaced against the robot frame"
    reference = "x -> x + offset"
    parameters = unknowns("m", 0.02, "offset_x", "offset_y", "offset_z")

    def measure(self, position, frame, values, setup):
        return position + np.asarray(values)


class CameraRotation(Effect):
    """Cameras whose frame is turned against the robot's."""

    name = "camera_rotation"
    title = "camera frame turned against the robot frame about some point"
    reference = "x -> exp(rotation vector) (x - a) + a + offset, a the mean place of clamp A"
    parameters = (
        *unknowns("rad", 0.1, "rotation_x", "rotation_y", "rotation_z"),
        *CameraOffset.parameters,
    )

    def measure(self, position, frame, values, setup):
        centre = np.real(setup.clamp_position).mean(axis=0)
        turned = (position - centre) @ rotation_of(np.asarray(values[:3])).T
        return turned + centre + np.asarray(values[3:])


class CameraScale(Effect):
    """Cameras with a wrong scale."""

    name = "camera_scale"
    title = "scale error of the cameras about some point"
    reference = "x -> (1 + scale) x + offset; the point that stays is -offset / scale"
    parameters = (
        Parameter("scale", "", 0.1),
        *unknowns("m", 0.05, "offset_x", "offset_y", "offset_z"),
    )

    def measure(self, position, frame, values, setup):
        return position * (1.0 + values[0]) + np.asarray(values[1:])

    def describe(self, values, covariance, measurements):
        factor = Estimate(1.0 + float(values[0]), float(np.sqrt(covariance[0, 0])), "")
        return {"factor": factor, **super().describe(values, covariance, measurements)}


class MarkerOffset(Effect):
    """Markers that sit beside the centreline, or were glued on shifted along it."""

    name = "marker_offset"
    title = "markers displaced in the material frame, all the same way"
    reference = "x -> x + offset_1 m1 + offset_2 m2 + offset_tangent t"
    kinds = ("clamped", "motion")
    parameters = unknowns("m", 0.005, "offset_1", "offset_2", "offset_tangent")

    def apply(self, setup, values):
        if isinstance(setup, MotionSetup):
            setup.marker_offset = setup.marker_offset + np.asarray(values)

    def measure(self, position, frame, values, setup):
        return position + frame @ np.asarray(values)
