"""Recordings of a held rod in motion, and what they say of it before any model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np

from wrod.errors import DataError
from wrod.identification.motion.curves import spline_lengths
from wrod.identification.motion.noise import TimeNoise, noise_in_time
from wrod.identification.motion.setup import START_L_GB
from wrod.records import brief


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
        edge = np.diff(self.positions[self.fit, ::10], axis=2)
        t = edge / np.linalg.norm(edge, axis=3, keepdims=True)
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
