"""What measurements of a rod say that its model misses."""

from wrod.identification.clamped.loading import load_measurements
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.clamped.report import IdentificationReport, identify_clamped
from wrod.identification.effect import Effect, Parameter
from wrod.identification.entry import identify
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.loading import is_motion, load_motion
from wrod.identification.motion.report import MotionReport, identify_motion

__all__ = [
    "ClampedMeasurements",
    "Effect",
    "IdentificationReport",
    "MotionMeasurements",
    "MotionReport",
    "Parameter",
    "identify",
    "identify_clamped",
    "identify_motion",
    "is_motion",
    "load_measurements",
    "load_motion",
]
