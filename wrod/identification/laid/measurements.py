"""Measurements of rods that lie on the table: centrelines beside the pattern they were laid along.

They come from `wrod scan` (pictures), from `wrod deploy`, from files of points or as arrays. What a
laid rod misses is told at the points of the accuracy metric (Eq. metric), across and along the
pattern.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.deployment.result import METRIC_POINTS
from wrod.errors import DataError, WrodError
from wrod.files import check_arrays, read_arrays
from wrod.patterns.curve import arc_length
from wrod.patterns.files import read_points, unit_scale
from wrod.patterns.pattern import Pattern

# A rod further from its pattern than this share of its length is another pattern, unit or frame.
_FAR = 0.5
# One further than that which lies so many times nearer once it is turned, mirrored or shifted is in
# another frame: no table moves a whole rod so far.
_ASIDE, _NEARER = 0.1, 4.0
# How much of the pattern's end may be missing from a centreline, as a share of the pattern.
_MISSING = 0.1
# Steps between points that are jumps, and how much of them in sum may go astray, as shares of it.
_JUMP, _STRAY = 0.03, 0.25
# Distance of the points of a smoothed centreline [m], and of how many a local cubic is made.
_SPACING, _WINDOW = 0.001, 21


@dataclass(frozen=True, eq=False)
class LaidMeasurements:
    """T rods laid along one pattern by one trajectory; SI units, the pattern's frame.

    Attributes:
        pattern: with the remainder that the rods were laid with.
        curves: T smoothed centrelines (n, 2) [m] from the end that was laid first; n may differ.
        names: what each is called.
        noise: standard deviation of a smoothed centreline's coordinate [m], as the scatter of
            several rods about their mean shows it.
    """

    pattern: Pattern
    curves: tuple[np.ndarray, ...]
    names: tuple[str, ...]
    noise: float

    @property
    def points(self) -> np.ndarray:
        """(50,) arc length on the pattern of the points compared [m]."""
        return np.linspace(0.0, self.pattern.length, METRIC_POINTS)

    @property
    def positions(self) -> np.ndarray:
        """(T, 50, 2) the rods at those arc lengths [m]."""
        return np.stack([_at(curve, self.points, self.pattern) for curve in self.curves])

    def at_points(self, line: np.ndarray) -> np.ndarray:
        """(50, 2) another centreline (n, 2) [m] at those arc lengths, read as the rods were."""
        return _at(_smooth(line), self.points, self.pattern)

    @property
    def noise_floor(self) -> float:
        """RMS distance of a perfect prediction [m]."""
        return float(np.sqrt(2.0) * self.noise)

    def residual(self, predicted: np.ndarray | None = None) -> np.ndarray:
        """(T, 50, 2) how far each rod lies along (column 0) and to the left (1) of a prediction.

        Args:
            predicted: (50, 2) where it was to lie [m]; default: on the pattern.
        """
        place, tangent, _ = self.pattern.sample(self.points)
        off = self.positions - (place[:, :2] if predicted is None else np.asarray(predicted))
        forward, left = tangent[:, :2], np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return np.stack([(off * forward).sum(-1), (off * left).sum(-1)], axis=-1)

    def rms(self, predicted: np.ndarray | None = None) -> float:
        """RMS distance from a prediction [m]."""
        return float(np.sqrt((self.residual(predicted) ** 2).sum(axis=-1).mean()))


@arguments.checked(
    DataError,
    sources=arguments.several(
        arguments.either(arguments.path, arguments.array((None, 2), (None, 3), finite=False))
    ),
    noise=arguments.optional(arguments.number(0.0, 100.0)),
    released=arguments.flag,
)
def load_laid(
    sources: Sequence[str | os.PathLike[str] | np.ndarray],
    pattern: Pattern,
    *,
    units: str | None = None,
    noise: float | None = None,
    released: bool = True,
) -> LaidMeasurements:
    """Read laid centrelines and check them against their pattern.

    Args:
        sources: arrays (n, 2) or (n, 3) [m], or files: a scan (.npz) with a scale, a deployment
            (.npz) or the folder that `wrod deploy` wrote, of which each trial counts, or points as
            `wrod.Pattern.load` reads them.
        pattern: what they were laid along, with its remainder if it had one.
        units: of files of points that do not say theirs.
        noise: standard deviation of a coordinate of a smoothed centreline [m]; default: from the
            scatter of the rods about their mean.
        released: of a deployment, the rod after the grip let go, or with it still holding.

    Raises:
        DataError: a source is unreadable, not in metres beside the pattern, or too short; or the
            noise is neither given nor to be seen.
    """
    if len(sources) == 0:
        raise DataError("no laid rod given; give at least one centreline")
    curves, names = [], []
    for k, source in enumerate(one for given in sources for one in _each(given)):
        if isinstance(source, np.ndarray):
            name, curve = f"centreline {k}", np.asarray(source, dtype=float)
        else:
            name, curve = str(source), _read(Path(source), units, released)
        curves.append(_smooth(_checked(curve, pattern, name)))
        names.append(name)
    measured = LaidMeasurements(pattern, tuple(curves), tuple(names), 1.0)
    if noise is None:
        if len(curves) < 2:
            raise DataError(
                f"{names[0]}: one rod does not show its noise; give more rods of the same plan, or "
                "the noise of a coordinate [m]"
            )
        places = measured.positions
        scatter = ((places - places.mean(axis=0)) ** 2).sum() / (2 * (len(places) - 1))
        noise = float(np.sqrt(scatter / METRIC_POINTS))
    if not (np.isfinite(noise) and noise > 0):
        raise DataError(f"noise is {noise!r}; give a positive number of metres")
    return LaidMeasurements(pattern, tuple(curves), tuple(names), float(noise))


def _each(source) -> list:
    """The source, or of a folder every deployment in it, in the order of trials."""
    if isinstance(source, np.ndarray) or not Path(source).is_dir():
        return [source]
    found = sorted(Path(source).glob("deployment*.npz"), key=lambda p: (len(p.name), p.name))
    if not found:
        raise DataError(
            f"{source}: is a folder without a deployment (deployment.npz); give the files of scans "
            "or points in it"
        )
    return found


def _read(path: Path, units: str | None, released: bool) -> np.ndarray:
    if path.suffix.lower() == ".npz":
        found = read_arrays(path, "a scan, a deployment or points (.npz)")
        line = "released_centerline" if released else "centerline"
        line = line if line in found else "centerline"
        for key, kind in (("path_m", "Scan"), (line, "LaidRod")):
            if key in found:
                return check_arrays(found, kind, str(path))[key]
        if "paths" in found:
            raise DataError(
                f"{path}: is a scan without one metric centreline; scan it with a scale "
                "(--markers, --sheet or --scale) and a single rod in view"
            )
    try:
        raw = read_points(path)
        scale = unit_scale(units or raw.units or "m", raw.source)
    except WrodError as error:
        raise DataError(str(error)) from None
    return scale * np.asarray(raw.points, dtype=float)


def _checked(curve: np.ndarray, pattern: Pattern, name: str) -> np.ndarray:
    """(n, 2) the curve from its first-laid end."""
    if curve.ndim != 2 or curve.shape[1] not in (2, 3) or len(curve) < 3:
        raise DataError(f"{name}: has shape {curve.shape}; give (n, 2) or (n, 3) points")
    if not np.isfinite(curve).all():
        row = int(np.argwhere(~np.isfinite(curve))[0, 0])
        raise DataError(f"{name}: point {row} is not a number; leave it out")
    curve = curve[:, :2]
    wanted = pattern.length + pattern.remainder_length
    _refuse_disorder(curve, wanted, name)
    length = float(arc_length(curve)[-1])
    if length < (1.0 - _MISSING) * wanted or length > 100.0 * wanted:
        hint = " (millimetres?)" if length > 100.0 * wanted else ""
        raise DataError(
            f"{name}: is {length:.4g} m long{hint} beside {wanted:.4g} m of pattern and remainder; "
            "give the whole laid rod in metres"
        )
    target = pattern.sample(np.linspace(0.0, pattern.length, METRIC_POINTS))[0][:, :2]

    def distance(candidate):
        at = _at(candidate, np.linspace(0.0, pattern.length, METRIC_POINTS), pattern)
        return float(np.hypot(*(at - target).T).mean())

    # A picture does not tell which end was laid first.
    best = min((curve, curve[::-1]), key=distance)
    far = distance(best)
    if far > _ASIDE * wanted:
        _refuse_other_frame(best, target, pattern, name, far)
    if far > _FAR * wanted:
        raise DataError(
            f"{name}: lies {far:.3g} m from the pattern on average; give it in the "
            "pattern's frame, in metres, and the pattern with the remainder that its plan has"
        )
    return best


def _refuse_other_frame(
    curve: np.ndarray, target: np.ndarray, pattern: Pattern, name: str, far: float
) -> None:
    """Refuse a curve, `far` [m] from the points of the pattern on average, that lies near them when
    it is turned, or else mirrored, and shifted."""
    lengths = np.linspace(0.0, pattern.length, METRIC_POINTS)
    aims = target - target.mean(axis=0)
    for how, sign in (("turned", 1.0), ("mirrored (y down, or x and y exchanged?)", -1.0)):
        for candidate in (curve, curve[::-1]):
            at = _at(candidate, lengths, pattern)
            at -= at.mean(axis=0)
            left, _, right = np.linalg.svd(at.T @ aims)
            left[:, 1] *= sign * np.linalg.det(left @ right)  # Kabsch 1976
            near = float(np.hypot(*(at @ left @ right - aims).T).mean())
            if near < far / _NEARER:
                raise DataError(
                    f"{name}: lies {far:.3g} m from the pattern on average, and {near:.3g} m where "
                    f"it is {how} and shifted as a whole; give it in the pattern's frame"
                )


def _refuse_disorder(curve: np.ndarray, wanted: float, name: str) -> None:
    """Refuse points that are not in their order: where the rod jumps there and back although the
    pieces between its jumps have ends that are near each other. Where it is hidden they have not.
    """
    from scipy.sparse.csgraph import minimum_spanning_tree  # loads half of SciPy
    from scipy.spatial import cKDTree
    from scipy.spatial.distance import cdist

    step = np.hypot(*np.diff(curve, axis=0).T)
    spacing = np.median(cKDTree(curve).query(curve, k=2)[0][:, 1])
    last = np.flatnonzero(step > max(5.0 * spacing, _JUMP * wanted))
    if not len(last):
        return
    needed = 0.0
    if len(last) * _JUMP < 1.0:  # more gaps than that would leave no rod
        starts, ends = curve[[0, *(last + 1)]], curve[[*last, -1]]
        pairs = [cdist(a, b) for a in (starts, ends) for b in (starts, ends)]
        needed = minimum_spanning_tree(np.min(pairs, axis=0) + 1e-12).sum()
    if step[last].sum() - needed > _STRAY * wanted:
        raise DataError(
            f"{name}: its points are not in order along the rod (point {last[0] + 1} is "
            f"{step[last[0]]:.3g} m from the one before); sort them from one end to the other"
        )


def _smooth(curve: np.ndarray) -> np.ndarray:
    """The curve with less noise, which would lengthen it: arc length tells its points apart.

    Local cubics (Savitzky and Golay 1964) leave a bend of a rod where it is.
    """
    from scipy.signal import savgol_filter  # loads half of SciPy

    along = arc_length(curve)
    count = max(int(np.ceil(along[-1] / _SPACING)) + 1, _WINDOW)
    at = np.linspace(0.0, along[-1], count)
    even = np.column_stack([np.interp(at, along, c) for c in curve.T])
    return savgol_filter(even, _WINDOW, 3, axis=0)


def _at(curve: np.ndarray, s: np.ndarray, pattern: Pattern) -> np.ndarray:
    """(n, 2) points of a rod at arc lengths of its pattern."""
    along = arc_length(curve)
    return np.column_stack([np.interp(s + pattern.remainder_length, along, c) for c in curve.T])
