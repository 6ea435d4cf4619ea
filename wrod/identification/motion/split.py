"""Which recordings are fitted, which choose the effects, and which are only scored on."""

from dataclasses import replace

import numpy as np

from wrod.identification.motion.data import MotionMeasurements

_TEST, _VALIDATION = 7, 3


def split_evenly(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Recordings to fit, to choose effects by, and to score on.

    Every seventh recording is scored on, and every third of the others chooses effects: so each
    session is seen in each part. With less than eight, the last third is both.
    """
    index = np.arange(count)
    if count < _TEST + 1:
        held = max(1, count // 3)
        return index[:-held], index[-held:], index[-held:]
    return _around(count, index[_TEST // 2 :: _TEST])


def folds(count: int, number: int, *, contiguous: bool = False) -> list[np.ndarray]:
    """Recordings in parts that are scored on one after the other: every recording in one of them.

    Args:
        count: recordings.
        number: parts.
        contiguous: blocks of neighbours, whose sessions the other parts hardly know; default: every
            `number`-th recording.
    """
    index = np.arange(count)
    if contiguous:
        return np.array_split(index, number)
    return [index[k::number] for k in range(number)]


def with_test(measurements: MotionMeasurements, test: np.ndarray) -> MotionMeasurements:
    """The same recordings, of which `test` are scored on and every third other chooses effects."""
    fit, validation, test = _around(measurements.recording_count, test)
    return replace(measurements, fit=fit, validation=validation, test=test)


def _around(count: int, test: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rest = np.setdiff1d(np.arange(count), test)
    validation = rest[_VALIDATION // 2 :: _VALIDATION]
    return np.setdiff1d(rest, validation), validation, np.asarray(test)
