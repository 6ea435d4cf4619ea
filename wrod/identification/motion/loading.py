"""Recordings of held rods in motion read from files, checked on the way in."""

import os
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import DataError
from wrod.files import check_arrays, read_arrays, read_fields
from wrod.identification.motion.checks import (
    check_positions,
    doubt_gravity,
    doubt_rate,
    doubt_slow_motion,
)
from wrod.identification.motion.data import MotionMeasurements, split_evenly
from wrod.identification.motion.repair import (
    frame_gaps,
    gaps_filled,
    sorted_grips,
    told_gaps,
)


def is_motion(path: str | os.PathLike[str]) -> bool:
    """Whether an .npz file holds recordings of motion, by its fields."""
    try:
        return {"rate_hz"} == set(read_arrays(path, only=["rate_hz"]))
    except DataError:  # whatever is wrong with the file, its loader says it
        return False


@arguments.checked(DataError)
def load_motion(path: str | os.PathLike[str]) -> MotionMeasurements:
    """Read recordings of a rod in motion (.npz) and check them.

    The fields are `positions` (R, T, M, 3) [m], `rate_hz`, `held` (the four markers inside the
    grips: the first two and the last two), `gravity` [m/s^2] and optionally `file_ids` (R,) and
    `time` (R, T) [s]. Frames that were lost are told by the grips' jumps where there is no `time`.

    Raises:
        DataError: the file is unreadable or lacks a field, or a value cannot be right; the
            sentence names the field, the recording, the frame and the marker.
    """
    path = Path(path)
    return _checked(read_fields(path, "MotionMeasurements"), path.stem, str(path))


def motion_from_arrays(
    data: dict[str, np.ndarray], *, name: str = "recordings"
) -> MotionMeasurements:
    """The same from a dictionary of arrays; `name` starts the sentences of errors."""
    return _checked(check_arrays(data, "MotionMeasurements", name), name, name)


def _checked(data: dict, name: str, where: str) -> MotionMeasurements:
    x, rate = data["positions"], data["rate_hz"]
    recordings, _, markers = x.shape[:3]
    if data["held"].tolist() != [0, 1, markers - 2, markers - 1]:
        raise DataError(
            f"{where}: held is {data['held'].tolist()}; the grips hold the first two and the last "
            f"two markers, [0, 1, {markers - 2}, {markers - 1}]"
        )
    names = data.get("file_ids", tuple(map(str, range(recordings))))
    x, filled = gaps_filled(x)
    check_positions(x, names, rate, where)
    x, repaired = sorted_grips(x)
    doubt_slow_motion(x, rate, data["gravity"], where)
    doubt_gravity(x, names, where)
    coarse = doubt_rate(x, rate, where)
    if "time" in data:
        gap = told_gaps(data["time"], rate, names, where)
    elif coarse:
        gap = np.ones((recordings, x.shape[1] - 1), dtype=int)
    else:
        gap = np.stack([frame_gaps(recording[:, [0, 1, -2, -1]]) for recording in x])
    fit, validation, test = split_evenly(recordings)
    return MotionMeasurements(
        name,
        x,
        rate,
        data["gravity"],
        names,
        gap,
        repaired,
        fit,
        validation,
        test,
        int(filled.sum()),
    )
