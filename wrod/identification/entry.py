"""`wrod.identify`: one question for rods between clamps, in motion and laid on a table."""

import os
from typing import Any, overload

from threadpoolctl import threadpool_limits

from wrod import cost
from wrod.errors import DataError
from wrod.identification.clamped.loading import load_measurements
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.identification.clamped.report import IdentificationReport, identify_clamped
from wrod.identification.laid.fit import LaidFit, fit_laid
from wrod.identification.laid.measurements import LaidMeasurements
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.loading import is_motion, load_motion
from wrod.identification.motion.report import MotionReport, identify_motion

Measurements = ClampedMeasurements | MotionMeasurements | LaidMeasurements


@overload
def identify(measurements: ClampedMeasurements, **options: Any) -> IdentificationReport: ...
@overload
def identify(measurements: LaidMeasurements, **options: Any) -> LaidFit: ...
@overload
def identify(
    measurements: MotionMeasurements | str | os.PathLike[str], **options: Any
) -> IdentificationReport | MotionReport: ...
# BLAS's threads wait for each other by spinning, for longer than these small matrices take.
@threadpool_limits.wrap(limits=1, user_api="blas")
def identify(
    measurements: Measurements | str | os.PathLike[str], **options: Any
) -> IdentificationReport | MotionReport | LaidFit:
    """Find what the model of a rod lacks, and prove it on data that were not fitted.

    Args:
        measurements: of a rod between two clamps or in motion, or a file of either, which is
            recognised by its fields; or rods that lie on a table.
        options: of `identify_clamped` and `identify_motion`: `test`, `candidates`, `device`,
            `progress`, and `steps` of the latter; for laid rods those of `fit_laid`, of which `rod`
            and `trajectory` must be given.

    Raises:
        DataError: the data cannot be right, or an option is missing.
    """
    if isinstance(measurements, LaidMeasurements):
        missing = [name for name in ("rod", "trajectory") if name not in options]
        if missing:
            raise DataError(
                f"laid rods are explained by simulating how they were laid; give {missing[0]}="
            )
        return fit_laid(measurements, **options)
    if isinstance(measurements, ClampedMeasurements):
        return identify_clamped(measurements, **options)
    if isinstance(measurements, MotionMeasurements) or is_motion(measurements):
        return identify_motion(measurements, **options)
    return identify_clamped(measurements, **options)


def identification_cost(data: str | os.PathLike[str]) -> cost.Cost:
    """Of finding what a model misses in one file of measurements.

    Raises:
        DataError: it holds none.
    """
    if is_motion(data):
        return cost.Cost(cost.RECORDING * load_motion(data).recording_count)
    load_measurements(data)
    return cost.Cost(cost.IDENTIFIED_SET)
