"""Recordings of a held rod in motion, which of them are fitted, which choose the effects and which
are only scored on, and what they say of the rod before any model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np

from wrod.errors import DataError
from wrod.identification.motion.curves import spline_lengths
from wrod.identification.motion.setup import START_L_GB
from wrod.records import brief
from wrod.rods.rotation import unit

# Slow noise and the mean over a recording are told apart by iteration.
_ROUNDS, _LARGEST = 20, 0.99
# Too few frames to tell a correlation from.
_FEWEST = 20
# Every so many recordings are scored on, and of the others choose effects.
_TEST, _VALIDATION = 7, 3


@dataclass(frozen=True)
class TimeNoise:
    """Noise of a marker's coordinate in time, slow noise included.

    Noise that hangs together from frame to frame looks like motion, except in the distance of a
    grip's two markers, which are on one rigid body. What that varies by is noise: a white part, and
    one that decays from frame to frame (AR(1): of cameras whose errors change with the place).

    Attributes:
        white: standard deviation of what is new in every frame [m].
        slow: of what decays over frames [m]; correlation: of that from one frame to the next.
    """

    white: float
    slow: float
    correlation: float

    @property
    def std(self) -> float:
        """Of both [m]."""
        return float(np.hypot(self.white, self.slow))

    def to_dict(self) -> dict[str, float]:
        return {
            "white_mm": 1e3 * self.white,
            "slow_mm": 1e3 * self.slow,
            "slow_correlation": self.correlation,
        }


def noise_in_time(positions: np.ndarray) -> TimeNoise | None:
    """Noise of (recording, frame, marker, 3) positions [m] by the distances of the first two
    markers and of the last two, medians over recordings; None where there are too few frames.

    Sample covariances c_k about a recording's own mean lack the variance of that mean; with it they
    are w + s, s r, s r^2 at lags of 0, 1 and 2 frames.
    """
    frames = positions.shape[1]
    if frames < _FEWEST:
        return None
    apart = np.linalg.norm(positions[:, :, [0, -2]] - positions[:, :, [1, -1]], axis=-1)
    off = apart - apart.mean(axis=1, keepdims=True)
    seen = np.array([np.median((off[:, k:] * off[:, : frames - k]).mean(axis=1)) for k in range(3)])
    lag = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
    mean, slow, white, rho = 0.0, 0.0, seen[0], 0.0
    for _ in range(_ROUNDS):
        c = seen + mean
        rho = float(np.clip(c[2] / c[1], 0.0, _LARGEST)) if c[1] > 0.0 else 0.0
        slow = min(c[1] / rho, c[0]) if rho > 0.0 else 0.0
        white = c[0] - slow
        mean = slow * (rho**lag).mean() + white / frames
    # Two markers err.
    return TimeNoise(float(np.sqrt(0.5 * white)), float(np.sqrt(0.5 * slow)), rho)


@brief
@dataclass(frozen=True)
class MotionMeasurements:
    """R recordings of one rod whose two ends are moved by grips; SI units, z up.

    Attributes:
        name: what the data are called.
        positions: (R, T, M, 3) markers along the rod [m]; two at each end are inside a grip.
        rate: frames per second [Hz].
        gravity: [m/s^2].
        names: (R,) of the recordings.
        gap: (R, T - 1) frame durations between neighbouring recorded frames: 1, or more where
            frames were lost.
        repaired: (R,) frames in which a grip's two markers were found exchanged, and put back.
        fit, validation, test: recordings to fit on, to choose effects by, and to score on.
        filled: places of single markers that were not seen, taken from the marker's own path.
    """

    name: str
    positions: np.ndarray
    rate: float
    gravity: float
    names: tuple[str, ...]
    gap: np.ndarray
    repaired: np.ndarray
    fit: np.ndarray
    validation: np.ndarray
    test: np.ndarray
    filled: int = 0

    @property
    def recording_count(self) -> int:
        return len(self.positions)

    @property
    def frame_count(self) -> int:
        return self.positions.shape[1]

    @property
    def marker_count(self) -> int:
        return self.positions.shape[2]

    @property
    def lost_frames(self) -> int:
        """Frames lost in all recordings, as the grips' jumps tell."""
        return int((self.gap - 1).sum())

    @cached_property
    def _edges(self) -> np.ndarray:
        """(fitted recording, frame, M - 1) spline lengths, every tenth frame [m]."""
        return np.stack([spline_lengths(self.positions[r, ::10]) for r in self.fit])

    @cached_property
    def grip_paths(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """By recording what `wrod.identification.motion.windows` has found of its grips so far."""
        return {}

    @cached_property
    def marker_arc_length(self) -> np.ndarray:
        """(M,) arc length of each marker from the first [m]: of splines through the markers, the
        mean over the fitted recordings."""
        return np.concatenate([[0.0], np.cumsum(self._edges.mean(axis=(0, 1)))])

    def length_change(self, recording: np.ndarray, start: np.ndarray) -> np.ndarray:
        """(W, M - 1) what to add to the mean edges in windows, from their first two frames [m].

        Grips take the rod anew between sessions. An edge's length in one recording follows that in
        its first frames as far as edges vary from recording to recording and not within one.
        """
        edges = self._edges
        between = edges.mean(axis=1).var(axis=0)
        within = edges.var(axis=1).mean(axis=0)
        trust = between / np.maximum(between + within, 1e-18)
        first = self.positions[recording[:, None], start[:, None] + np.arange(2)]
        return trust * (spline_lengths(first).mean(axis=1) - edges.mean(axis=(0, 1)))

    @property
    def bending_axis(self) -> np.ndarray:
        """(3,) mean direction of t x dt/ds between the grips, over the fitted recordings."""
        t = unit(np.diff(self.positions[self.fit, ::10], axis=2))
        axis = np.cross(t[:, :, 1:-2], t[:, :, 2:-1]).mean(axis=(0, 1, 2))
        size = np.linalg.norm(axis)
        return axis / size if size > 1e-6 else np.array([0.0, 1.0, 0.0])

    @cached_property
    def noise(self) -> float:
        """Standard deviation of a marker coordinate [m], from the fourth differences in time.

        Motion has little of them at 100 Hz; the median is deaf to lost frames.
        """
        fourth = np.diff(self.positions[self.fit], n=4, axis=1)
        return float(np.median(np.abs(fourth)) / (0.6745 * np.sqrt(70.0)))

    @cached_property
    def time_noise(self) -> TimeNoise | None:
        """Noise with what hangs together in time, by the grips' markers; None for few frames."""
        return noise_in_time(self.positions)

    @property
    def noise_floor(self) -> float:
        """Mean |difference| of a perfect prediction from noisy markers, held ones as zero [m]."""
        free = (self.marker_count - 4) / self.marker_count
        return np.sqrt(2.0 / np.pi) * self.noise * free

    @property
    def material(self) -> SimpleNamespace:
        """What effects describe their findings against: the rod that fits start from."""
        return SimpleNamespace(gravito_bending_length=START_L_GB)

    def scored_on(self, other: MotionMeasurements) -> MotionMeasurements:
        """These measurements to fit and choose on, all of `other` to score on.

        Raises:
            DataError: `other` has another number of markers or frames, or another rate.
        """
        for what in ("marker_count", "frame_count", "rate", "gravity"):
            a, b = getattr(self, what), getattr(other, what)
            if a != b:
                word = what.replace("_", " ")
                raise DataError(f"{other.name} has {word} {b}, but {self.name} has {a}")
        mine, theirs = self.marker_arc_length, other.marker_arc_length
        if np.abs(mine - theirs).max() > 0.02 * mine[-1]:
            raise DataError(
                f"{other.name} has its markers elsewhere along the rod than {self.name}"
            )
        test = np.arange(self.recording_count, self.recording_count + other.recording_count)
        everything = np.arange(self.recording_count)
        held_out = np.union1d(self.validation, self.test)
        return replace(
            self,
            positions=np.concatenate([self.positions, other.positions]),
            gap=np.concatenate([self.gap, other.gap]),
            repaired=np.concatenate([self.repaired, other.repaired]),
            names=self.names + other.names,
            fit=np.setdiff1d(everything, held_out),
            validation=held_out,
            test=test,
            filled=self.filled + other.filled,
        )


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
