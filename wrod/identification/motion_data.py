"""Recordings of held rods in motion, checked on the way in."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from wrod.errors import DataError
from wrod.identification.motion_setup import START_L_GB

_FIELDS = ("positions", "rate_hz", "held", "gravity")
# A grip's step over this many times its neighbours' mean is checked for lost frames, and is one
# where multiplying the time explains it to this share of the step.
_LOST_RATIO = 1.6
_LOST_MISFIT = 0.35
_LOST_LEAST = 2e-3
_MOST_LOST = 24
_FAR = 10.0
_FAST = 15.0
_SHORTEST = 12
# Pieces between two markers of a curve whose length is wanted.
_FINE = 8


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

    def edge_length(self, pieces: int) -> np.ndarray:
        """(n,) mean distance between neighbours of the nodes that cut the curves through the
        markers into `pieces` between neighbouring free ones [m].

        The edges of a rod that is never straight are chords: taken for arcs they would be
        compressed, by (curvature length)^2 / 24.
        """
        nodes = through_markers(self.positions[self.fit][:, ::10], pieces)
        return np.linalg.norm(np.diff(nodes, axis=2), axis=3).mean(axis=(0, 1))

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
        )


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
    x, repaired = _sorted_grips(x)
    gap = np.stack([_gaps(recording[:, [0, 1, -2, -1]]) for recording in x])
    fit, validation, test = split_by_neighbours(recordings)
    return MotionMeasurements(name, x, rate, gravity, names, gap, repaired, fit, validation, test)


def split_by_neighbours(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Recordings to fit, to choose effects by, and to score on: contiguous blocks.

    Neighbouring recordings come from one session, so single ones would not be held out; half of
    the validation and of the test lies in the middle of the list, half at its end.
    """
    index = np.arange(count)
    if count < 8:
        held = max(1, count // 3)
        return index[:-held], index[-held:], index[-held:]
    seven = max(1, count // 7)
    middle = count // 2
    out = index[middle - seven // 2 : middle - seven // 2 + seven], index[count - seven :]
    validation = np.concatenate([b[: (len(b) + 1) // 2] for b in out])
    test = np.setdiff1d(np.concatenate(out), validation)
    if len(test) == 0:
        test = validation
    return np.setdiff1d(index, np.concatenate(out)), validation, test


def spline_lengths(position: np.ndarray) -> np.ndarray:
    """(..., M - 1) arc lengths between markers of the curves through (..., M, 3)."""
    return _lengths(through_markers(position, _FINE))


def _lengths(nodes: np.ndarray) -> np.ndarray:
    """(..., M - 1) lengths between markers of curves of `_FINE` pieces."""
    pieces = np.linalg.norm(np.diff(nodes, axis=-2), axis=-1)
    inner = pieces[..., 1:-1]
    inner = inner.reshape(*inner.shape[:-1], -1, _FINE).sum(axis=-1)
    return np.concatenate([pieces[..., :1], inner, pieces[..., -1:]], axis=-1)


def _running(lengths: np.ndarray) -> np.ndarray:
    """(M,) arc lengths out of (..., M - 1) pieces, their mean."""
    mean = lengths.reshape(-1, lengths.shape[-1]).mean(axis=0)
    return np.concatenate([[0.0], np.cumsum(mean)])


def through_markers(position: np.ndarray, fine: int, s: np.ndarray | None = None) -> np.ndarray:
    """Curves through markers: cubic splines that leave the grips along the lines through their
    markers, `fine` pieces of equal parameter between neighbours; inside the grips straight.

    Args:
        position: (..., M, 3), complex where they carry a derivative.
        s: (M,) arc lengths of the markers; default: the mean chords.

    Returns:
        (..., (M - 3) fine + 3, 3) points.
    """
    from scipy.interpolate import CubicSpline

    x = np.asarray(position)
    if s is None:
        # By its chords a strongly bent curve would run too fast where its direction is given.
        s = _running(np.linalg.norm(np.diff(x, axis=-2), axis=-1))
        s = _running(_lengths(through_markers(x, _FINE, s)))
    ends = [x[..., 1, :] - x[..., 0, :], x[..., -1, :] - x[..., -2, :]]
    first, last = (e / np.sqrt(np.sum(e * e, axis=-1, keepdims=True)) for e in ends)
    inner = s[1:-1]
    u = np.interp(np.arange((len(inner) - 1) * fine + 1) / fine, np.arange(len(inner)), inner)

    def curve(part):
        slopes = ((1, part(first)), (1, part(last)))
        return CubicSpline(inner, part(x)[..., 1:-1, :], axis=x.ndim - 2, bc_type=slopes)(u)

    between = curve(np.real) + (1j * curve(np.imag) if np.iscomplexobj(x) else 0.0)
    return np.concatenate([x[..., :1, :], between, x[..., -1:, :]], axis=-2)


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


def _sorted_grips(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions with each grip's inner marker inside, and the (R,) frames put right.

    A rod that is clamped by both markers cannot fold back inside its grip, so the marker that is
    nearer to the first free one is the inner one.
    """
    x = x.copy()
    wrong = np.zeros(x.shape[:2], dtype=bool)
    for outer, inner, free in ((0, 1, 2), (-1, -2, -3)):
        a, b = (np.linalg.norm(x[:, :, free] - x[:, :, m], axis=2) for m in (outer, inner))
        swap = a < b
        x[:, :, [outer, inner]] = np.where(
            swap[:, :, None, None], x[:, :, [inner, outer]], x[:, :, [outer, inner]]
        )
        wrong |= swap
    return x, wrong.sum(axis=1)


def _gaps(held: np.ndarray) -> np.ndarray:
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
        mean = np.median(v[around], axis=0)
        square = mean @ mean
        if square == 0.0:
            continue
        times = int(np.rint(v[f] @ mean / square))
        if not 2 <= times <= _MOST_LOST:
            continue
        if np.linalg.norm(v[f] - times * mean) < _LOST_MISFIT * size[f]:
            gap[f] = times
    return gap
