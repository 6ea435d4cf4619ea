"""Recordings of held rods in motion read from files, checked on the way in."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import DataError
from wrod.files import read_arrays
from wrod.identification.motion.checks import check_positions
from wrod.identification.motion.data import MotionMeasurements
from wrod.identification.motion.repair import frame_gaps, gaps_filled, sorted_grips
from wrod.identification.motion.split import split_evenly

_FIELDS = ("positions", "rate_hz", "held", "gravity")
_SHORTEST = 12
# Slower than any swing of a rod, and faster than any camera of markers [Hz].
_RATES = (2.0, 1e6)
# No planet to stand on pulls so [m/s^2].
_HEAVY = 30.0


def is_motion(path: str | os.PathLike[str]) -> bool:
    """Whether an .npz file holds recordings of motion, by its fields."""
    try:
        return {"rate_hz"} == set(read_arrays(path, only=["rate_hz"]))
    except DataError:  # whatever is wrong with the file, its loader says it
        return False


@arguments.checked(DataError, path=arguments.path)
def load_motion(path: str | os.PathLike[str]) -> MotionMeasurements:
    """Read recordings of a rod in motion (.npz) and check them.

    The fields are `positions` (R, T, M, 3) [m], `rate_hz`, `held` (the four markers inside the
    grips: the first two and the last two), `gravity` [m/s^2] and optionally `file_ids` (R,).

    Raises:
        DataError: the file is unreadable or lacks a field, or a value cannot be right; the
            sentence names the field, the recording, the frame and the marker.
    """
    path = Path(path)
    data = read_arrays(path, "an .npz file of recordings")
    return motion_from_arrays(data, name=path.stem, where=str(path))


def motion_from_arrays(
    data: dict[str, np.ndarray], *, name: str = "recordings", where: str | None = None
) -> MotionMeasurements:
    """The same from a dictionary of arrays; `where` starts the sentences of errors."""
    where = where or name
    for key in _FIELDS:
        if key not in data:
            raise DataError(f"{where}: lacks {key}; motion needs {', '.join(_FIELDS)}")
        if not np.issubdtype(np.asarray(data[key]).dtype, np.number):
            raise DataError(f"{where}: {key} does not hold numbers")
    x = np.asarray(data["positions"], dtype=float)
    if x.ndim != 4 or x.shape[3] != 3:
        raise DataError(f"{where}: positions has shape {x.shape}; give (recording, frame, M, 3)")
    recordings, frames, markers = x.shape[:3]
    if recordings < 2:
        raise DataError(
            f"{where}: {recordings} recording; at least two are needed, to fit on one and to score "
            "on another"
        )
    if frames < _SHORTEST or markers < 6:
        raise DataError(
            f"{where}: {frames} frames of {markers} markers; at least {_SHORTEST} frames of 6 "
            "markers are needed"
        )
    rate, gravity = (_scalar(data, key, where) for key in ("rate_hz", "gravity"))
    if not _RATES[0] <= rate <= _RATES[1]:
        raise DataError(
            f"{where}: rate_hz is {rate:g}; give frames per second, {_RATES[0]:g} to {_RATES[1]:g}"
        )
    if gravity > _HEAVY:
        raise DataError(f"{where}: gravity is {gravity:g}; it must be in m/s^2")
    held = np.asarray(data["held"]).ravel()
    if held.tolist() != [0, 1, markers - 2, markers - 1]:
        raise DataError(
            f"{where}: held is {held.tolist()}; the grips hold the first two and the last two "
            f"markers, [0, 1, {markers - 2}, {markers - 1}]"
        )
    names = data.get("file_ids", np.arange(recordings))
    if np.shape(names) != (recordings,):
        raise DataError(f"{where}: file_ids has shape {np.shape(names)}; give ({recordings},)")
    names = tuple(str(n) for n in names)
    x, filled = gaps_filled(x)
    check_positions(x, names, rate, where)
    x, repaired = sorted_grips(x)
    gap = np.stack([frame_gaps(recording[:, [0, 1, -2, -1]]) for recording in x])
    fit, validation, test = split_evenly(recordings)
    return MotionMeasurements(
        name, x, rate, gravity, names, gap, repaired, fit, validation, test, int(filled.sum())
    )


def _scalar(data, key: str, where: str) -> float:
    value = np.asarray(data[key], dtype=float)
    if value.ndim != 0:
        raise DataError(f"{where}: {key} has shape {value.shape}; give one number")
    if not (np.isfinite(value) and value > 0):
        raise DataError(f"{where}: {key} is {value:g}; it must be positive")
    return float(value)
