"""Public names, for editors, type checkers and the lazy imports of `wrod.identification`."""

from .clamped.loading import load_measurements as load_measurements
from .clamped.measurements import ClampedMeasurements as ClampedMeasurements
from .clamped.report import IdentificationReport as IdentificationReport
from .clamped.report import identify_clamped as identify_clamped
from .effect import Effect as Effect
from .effect import Parameter as Parameter
from .entry import identify as identify
from .motion.data import MotionMeasurements as MotionMeasurements
from .motion.loading import is_motion as is_motion
from .motion.loading import load_motion as load_motion
from .motion.report import MotionReport as MotionReport
from .motion.report import identify_motion as identify_motion

__all__: list[str]
