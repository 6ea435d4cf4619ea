"""Stretches of recordings in true time, with what a prediction may know of them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from wrod.identification.motion.data import MotionMeasurements
from wrod.rods.rotation import transport, unit

# Frames of the cubics that smooth the paths of grips, and what is left of their noise at most.
_WIDTHS, _AS_NOISE = (61, 41, 25, 15, 9, 5), 1.05


class Lacking:
    """What to add to predictions of windows: what mesh and time step lack.

    Args:
        make: computes it, where somebody looks at it.
        digest: its digest, if it is known beforehand.
    """

    def __init__(self, make: Callable[[], np.ndarray], digest: str | None = None):
        self._make, self._digest = make, digest

    @cached_property
    def array(self) -> np.ndarray:
        """(W, F, M, 3) [m]."""
        return self._make()

    @cached_property
    def digest(self) -> str:
        return self._digest or hashlib.sha256(self.array.tobytes()).hexdigest()

    def __getitem__(self, index: np.ndarray) -> Lacking:
        return Lacking(lambda: self.array[index])


@dataclass(frozen=True)
class Windows:
    """Stretches of recordings in true time: frames that were lost are places without markers.

    Attributes:
        recording, start: (W,) where each begins.
        time: (W, F) frame durations since the window's opening, for each recorded frame.
        seen: (W, F) whether there is such a frame.
        markers: (W, F, M, 3) what was recorded [m]; repeats the last frame where there is none.
        opening: (W, 2, M, 3) the first two frames, brought one frame duration apart where frames
            were lost between them [m].
        held: (W, K, 4, 3) held markers at every frame duration, smoothed by as much as noise goes,
            interpolated where frames are lost.
        grip_director: (W, K, 2, 3) first director of each grip: across the line through its
            markers, carried along without roll from the recording's start, where it is the axis
            about which the rod bends on average, as seen along the grip: so a rod that hangs in
            one plane starts without twist.
        arc_length: (W, M) of the markers, the same for all windows [m].
        length_change: (W, M - 1) what to add to the rod's length between markers [m].
        lacking: what to add to predictions.
    """

    recording: np.ndarray
    start: np.ndarray
    time: np.ndarray
    seen: np.ndarray
    markers: np.ndarray
    opening: np.ndarray
    held: np.ndarray
    grip_director: np.ndarray
    length_change: np.ndarray
    arc_length: np.ndarray
    lacking: Lacking

    def errors(self, predicted: np.ndarray) -> np.ndarray:
        """(W, F) mean |difference| over coordinates and all markers [m]."""
        return np.abs(predicted + self.lacking.array - self.markers).mean(axis=(2, 3))

    def part(self, index: np.ndarray) -> Windows:
        """Some of them."""
        return Windows(**{key: value[index] for key, value in vars(self).items()})


def windows_of(
    measurements: MotionMeasurements,
    recordings: Sequence[int],
    starts: Sequence[int] = (0,),
    frames: int | None = None,
) -> Windows:
    """Windows of `frames` frames (default: all) that begin at each of `starts`."""
    count = measurements.frame_count
    frames = count if frames is None else min(frames, count)
    pairs = [(r, s) for r in recordings for s in starts if s + 3 <= count]
    return windows_at(measurements, np.array(pairs), frames)


def windows_at(m: MotionMeasurements, pairs: np.ndarray, frames: int) -> Windows:
    """Windows of `frames` frames that begin at (recording, frame) `pairs`."""
    recording, start = pairs.T
    index = start[:, None] + np.arange(frames)
    seen = index < m.frame_count
    index = np.minimum(index, m.frame_count - 1)
    clock = np.pad(np.cumsum(m.gap, axis=1), ((0, 0), (1, 0)))
    time = clock[recording[:, None], index] - clock[recording, start + 1][:, None] + 1
    time[:, 0] = 0
    last = int(time.max())
    whole = m.grip_paths
    if missing := [r for r in dict.fromkeys(recording.tolist()) if r not in whole]:
        whole.update(_true_time(m, clock, missing))
    held, director = [], []
    for r, s in pairs.tolist():
        a = np.minimum(clock[r, s + 1] - 1 + np.arange(last + 1), clock[r, -1])
        held.append(whole[r][0][a])
        director.append(whole[r][1][a])
    markers = m.positions[recording[:, None], index]
    gap = m.gap[recording, start].astype(float)[:, None, None]
    opening = np.stack(
        [markers[:, 1] + (markers[:, 0] - markers[:, 1]) / gap, markers[:, 1]], axis=1
    )
    return Windows(
        recording,
        start,
        time,
        seen,
        markers,
        opening,
        np.stack(held),
        np.stack(director),
        m.length_change(recording, start),
        np.repeat(m.marker_arc_length[None], len(recording), axis=0),
        Lacking(lambda: np.zeros_like(markers)),
    )


def _smoothed(path: np.ndarray, noise: float) -> np.ndarray:
    """A grip's (K, 4, 3) path by the widest local cubics from which it departs by no more than
    `noise` leaves. Two markers 30 mm apart that err by 0.05 mm shake a stiff rod by more than its
    own markers err, and a fit takes a drag that is not there to still it."""
    from scipy.signal import savgol_filter

    for width in _WIDTHS:
        if width <= len(path):
            smooth = savgol_filter(path, width, 3, axis=0)
            if np.sqrt(np.mean((smooth - path) ** 2)) <= _AS_NOISE * noise * _left_by(width):
                return smooth
    return path


@cache
def _left_by(width: int) -> float:
    """Share of white noise that local cubics leave in what they take away."""
    from scipy.signal import savgol_coeffs

    return float(np.sqrt(1.0 - savgol_coeffs(width, 3)[width // 2]))


def _true_time(
    m: MotionMeasurements, clock: np.ndarray, recordings: Sequence[int]
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Held markers (K, 4, 3) and directors (K, 2, 3) at every frame duration of each recording."""
    held = [_held(m, r, clock[r]) for r in recordings]
    longest = max(map(len, held))
    # All of them side by side; the last frame of the shorter ones is repeated.
    x = np.stack([np.pad(h, ((0, longest - len(h)), (0, 0), (0, 0)), mode="edge") for h in held])
    tangent = unit(x[:, :, [1, 3]] - x[:, :, [0, 2]])
    director = np.empty_like(tangent)
    d, before = np.broadcast_to(m.bending_axis, tangent[:, 0].shape), tangent[:, 0]
    for k in range(longest):
        d = transport(d, before, tangent[:, k]) if k else d
        before = tangent[:, k]
        director[:, k] = d = unit(d - np.sum(d * before, axis=2, keepdims=True) * before)
    return {r: (h, d[: len(h)]) for r, h, d in zip(recordings, held, director, strict=True)}


def _held(m: MotionMeasurements, r: int, clock: np.ndarray) -> np.ndarray:
    """(K, 4, 3) held markers of a recording, smoothed, at every frame duration."""
    x = m.positions[r][:, [0, 1, -2, -1]]
    if clock[-1] > len(x) - 1:
        x = PchipInterpolator(clock, x, axis=0)(np.arange(clock[-1] + 1))
    return _smoothed(x, m.noise)
