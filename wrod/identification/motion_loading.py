"""Recordings of held rods in motion read from files, checked on the way in."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from wrod.errors import DataError
from wrod.identification.motion_data import MotionMeasurements
from wrod.identification.motion_repair import frame_gaps, sorted_grips
from wrod.identification.motion_split import split_evenly

_FIELDS = ("positions", "rate_hz", "held", "gravity")
# A rod of this length [m], or a thousandth of it, was not given in metres; nor moves one so [m/s].
_FAR = 10.0
_FAST = 15.0
_SHORTEST = 12


def is_motion(path: str | os.PathLike[str]) -> bool:
    """Whether an .npz file holds recordings of motion, by its fields."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return "positions" in file.files and "rate_hz" in file.files
    except Exception:  # whatever is wrong with the file, its loader says it
        return False


def load_motion(path: str | os.PathLike[str]) -> MotionMeasurements:
    """Read recordings of a rod in motion (.npz) and check them.

    The fields are `positions` (R, T, M, 3) [m], `rate_hz`, `held` (the four markers inside the
    grips: the first two and the last two), `gravity` [m/s^2] and optionally `file_ids` (R,).

    Raises:
        DataError: the file is unreadable or lacks a field, or a value cannot be right; the
            sentence names the field, the recording, the frame and the marker.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {key: file[key] for key in file.files}
    except Exception as error:
        raise DataError(f"{path}: not a readable .npz file ({error})") from None
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
    _check_positions(x, names, rate, where)
    x, repaired = sorted_grips(x)
    gap = np.stack([frame_gaps(recording[:, [0, 1, -2, -1]]) for recording in x])
    fit, validation, test = split_evenly(recordings)
    return MotionMeasurements(name, x, rate, gravity, names, gap, repaired, fit, validation, test)


def _scalar(data, key: str, where: str) -> float:
    value = np.asarray(data[key], dtype=float)
    if value.ndim != 0:
        raise DataError(f"{where}: {key} has shape {value.shape}; give one number")
    if not (np.isfinite(value) and value > 0):
        raise DataError(f"{where}: {key} is {value:g}; it must be positive")
    return float(value)


def _check_positions(x: np.ndarray, names, rate: float, where: str) -> None:
    bad = np.argwhere(~np.isfinite(x).all(axis=3))
    if len(bad):
        r, f, m = bad[0]
        raise DataError(
            f"{where}: marker {m} of recording {names[r]} is not finite in frame {f} "
            f"({len(bad)} such markers in all); interpolate them or leave the recording out"
        )
    edge = np.linalg.norm(np.diff(x, axis=2), axis=3)
    mean = np.median(edge, axis=(0, 1))
    length = mean.sum()
    if length > _FAR or np.abs(x).max() > 10 * _FAR:
        raise DataError(
            f"{where}: the rod would be {length:.3g} m long; positions must be in metres"
        )
    if length < 1e-3 * _FAR:
        raise DataError(
            f"{where}: the rod would be {length:.3g} m long; positions must be in metres"
        )
    if not (mean > 0).all():
        m = int(np.argmin(mean))
        raise DataError(f"{where}: markers {m} and {m + 1} are in the same place")
    ratio = np.median(edge, axis=1) / mean
    if ratio.max() > 1.5 or ratio.min() < 0.5:
        r, m = np.unravel_index(np.argmax(np.abs(np.log(ratio))), ratio.shape)
        raise DataError(
            f"{where}: markers {m} and {m + 1} of recording {names[r]} are "
            f"{1e3 * np.median(edge[r, :, m]):.0f} mm apart, {1e3 * mean[m]:.0f} mm in the others; "
            "are its markers in another order, or is it of another rod?"
        )
    step = np.linalg.norm(np.diff(x, axis=1), axis=3)
    middle = np.median(step, axis=2)
    typical = np.median(middle)
    if typical * rate > _FAST:
        raise DataError(
            f"{where}: markers move at {typical * rate:.0f} m/s; check rate_hz and the unit"
        )
    jump = np.abs(np.diff(edge, axis=1)).max(axis=2)
    if jump.max() > 0.5 * length:
        r, f = np.unravel_index(np.argmax(jump), jump.shape)
        raise DataError(
            f"{where}: the markers of recording {names[r]} change places at frame {f + 1}; sort "
            "them or leave the recording out"
        )
