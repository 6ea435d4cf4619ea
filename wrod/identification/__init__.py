"""What measurements of a rod say that its model misses."""

from __future__ import annotations

from wrod.identification.effect import Effect, Parameter
from wrod.identification.measurements import ClampedMeasurements, load_measurements
from wrod.identification.motion_data import MotionMeasurements
from wrod.identification.motion_loading import is_motion, load_motion
from wrod.identification.motion_report import MotionReport, identify_motion
from wrod.identification.report import IdentificationReport, identify

__all__ = [
    "ClampedMeasurements",
    "Effect",
    "IdentificationReport",
    "MotionMeasurements",
    "MotionReport",
    "Parameter",
    "identify",
    "identify_motion",
    "is_motion",
    "load_measurements",
    "load_motion",
]
