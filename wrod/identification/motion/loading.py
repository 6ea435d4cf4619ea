"""Recordings of held rods in motion read from files and checked on the way in; exchanged markers
and lost frames are found and put right."""

import os
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

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

# A grip's step over this many times its neighbours' mean is checked for lost frames, and is one
# where multiplying the time explains it to this share of the step.
_LOST_RATIO = 1.6
_LOST_MISFIT = 0.35
_LOST_LEAST = 2e-3
_MOST_LOST = 24
# Part of a frame by which time stamps may be off, and of the rate by which their mean may be.
_UNEVEN, _DRIFT = 0.3, 0.01
# Frames of one marker that are filled from so many seen ones on either side.
_SHORT_GAP, _AROUND = 6, 6


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


def sorted_grips(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions with each grip's inner marker inside, and the (R,) frames put right.

    A rod that is clamped by both markers cannot fold back inside its grip, so the marker that is
    nearer to the first free one in most frames is the inner one; from frame to frame each stays
    nearer to itself than to the other. A free marker may swing past its grip meanwhile.
    """
    x = x.copy()
    wrong = np.zeros(x.shape[:2], dtype=bool)
    for outer, inner, free in ((0, 1, 2), (-1, -2, -3)):
        a, b = (np.linalg.norm(x[:, :, free] - x[:, :, m], axis=2) for m in (outer, inner))
        ends = x[:, :, [outer, inner]]
        stays, changes = (
            np.sum((ends[:, 1:] - before[:, :-1]) ** 2, axis=(2, 3))
            for before in (ends, ends[:, :, ::-1])
        )
        turned = np.cumsum(np.pad(changes < stays, ((0, 0), (1, 0))), axis=1) % 2 == 1
        swap = turned ^ (2 * np.sum(turned ^ (a < b), axis=1, keepdims=True) > x.shape[1])
        x[:, :, [outer, inner]] = np.where(
            swap[:, :, None, None], x[:, :, [inner, outer]], x[:, :, [outer, inner]]
        )
        wrong |= swap
    return x, wrong.sum(axis=1)


def gaps_filled(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Recordings (R, T, M, 3) with short gaps of single markers filled from their own paths, and
    (R,) how many places those were. Longer gaps, and such at the ends, stay."""
    lost = ~np.isfinite(x).all(axis=3)
    count = np.zeros(len(x), dtype=int)
    if not lost.any():
        return x, count
    x, frames = x.copy(), np.arange(x.shape[1])
    for r, m in np.argwhere(lost.any(axis=1)):
        edges = np.flatnonzero(np.diff(np.pad(lost[r, :, m].astype(int), 1)))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            near = np.arange(max(a - _AROUND, 0), min(b + _AROUND, len(frames)))
            near = near[~lost[r, near, m]]
            if b - a <= _SHORT_GAP and (near < a).sum() >= 2 and (near >= b).sum() >= 2:
                path = CubicSpline(near, x[r, near, m])
                x[r, a:b, m] = path(frames[a:b])
                count[r] += b - a
    return x, count


def told_gaps(time: np.ndarray, rate: float, names, where: str) -> np.ndarray:
    """(R, T - 1) frame durations between recorded frames, from (R, T) time stamps [s].

    Raises:
        DataError: a time is before the last one, not at a whole frame, or long after it; or they
            have another rate.
    """
    step = np.diff(time, axis=1) * rate
    usual = np.median(step)
    if usual > _MOST_LOST:
        raise DataError(
            f"{where}: by its time a frame takes {usual / rate:.3g} s, {usual:.3g} frames of "
            f"rate_hz, {rate:g}; give time in seconds, or the rate of these frames"
        )
    gap = np.rint(step).astype(int)
    bad = np.argwhere((gap < 1) | (gap > _MOST_LOST) | (np.abs(step - gap) > _UNEVEN))
    if len(bad):
        r, f = bad[0]
        remedy = "bring the frames to even times, or check rate_hz"
        if step[r, f] > _MOST_LOST:
            remedy = "make two recordings of it"
        elif step[r, f] <= 0.0:
            remedy = "give the frames in their order"
        raise DataError(
            f"{where}: time of recording {names[r]} goes from {time[r, f]:g} s in frame {f} to "
            f"{time[r, f + 1]:g} s in the next, {step[r, f]:.3g} frames of rate_hz ({len(bad)} "
            f"such steps in all); {remedy}"
        )
    stamped = float(np.median(gap.sum(axis=1) / (time[:, -1] - time[:, 0])))
    if abs(stamped / rate - 1.0) > _DRIFT:
        raise DataError(
            f"{where}: rate_hz is {rate:.4g}, but by its time there are {stamped:.4g} frames a "
            f"second; give that (a difference of stamps that were rounded is no rate)"
        )
    return gap


def frame_gaps(held: np.ndarray) -> np.ndarray:
    """(T - 1,) frame durations between recorded frames, from (T, 4, 3) held markers.

    Where frames are lost, both grips go several times as far in one frame as before and after it,
    in the same direction.
    """
    v = np.diff(held, axis=0).reshape(len(held) - 1, -1)
    gap = np.ones(len(v), dtype=int)
    size = np.linalg.norm(v, axis=1)
    for f in range(len(v)):
        around = [g for g in (f - 2, f - 1, f + 1, f + 2) if 0 <= g < len(v) and gap[g] == 1]
        if not around or size[f] < max(_LOST_LEAST, _LOST_RATIO * np.median(size[around])):
            continue
        if f - 1 in around and size[f - 1] >= size[f]:  # it slows down
            continue
        mean = np.median(v[around], axis=0)
        if len(around) > 1 and (around[0] > f or around[-1] < f):
            # At an end a step goes on as the next ones change.
            near, far = (around[0], around[1]) if around[0] > f else (around[-1], around[-2])
            mean = 2.0 * v[near] - v[far]
        square = mean @ mean
        if square == 0.0:
            continue
        times = int(np.rint(v[f] @ mean / square))
        if not 2 <= times <= _MOST_LOST:
            continue
        if np.linalg.norm(v[f] - times * mean) < _LOST_MISFIT * size[f]:
            gap[f] = times
    return gap
