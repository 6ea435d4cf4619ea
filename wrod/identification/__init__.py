"""What measurements of a rod say that its model misses."""

from __future__ import annotations

from wrod.identification.effect import Effect, Parameter
from wrod.identification.measurements import ClampedMeasurements, load_measurements
from wrod.identification.report import IdentificationReport, identify

__all__ = [
    "ClampedMeasurements",
    "Effect",
    "IdentificationReport",
    "Parameter",
    "identify",
    "load_measurements",
]
