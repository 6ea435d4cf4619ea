"""Optimised plans at scale: random smooth patterns, the corrections of the grip's path that lay
them on tables of all sorts, one small file a plan, split over ranks."""

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from wrod.training.dataset import Rank

from wrod.deployment.corrections import Corrections
from wrod.deployment.expectation import TOLERANCE, misplacement
from wrod.deployment.optimise import Task, course, sample_of
from wrod.deployment.plan import plan
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.spread import Spread
from wrod.deployment.together import Course, follow
from wrod.errors import DataError, WrodError, WrodWarning
from wrod.files import read_fields, read_json, schemas, write_json, write_npz, write_text
from wrod.patterns.pattern import Pattern
from wrod.planning.remainder import prepare
from wrod.rods.device import resolve_device
from wrod.rods.material import TABLE_2, RodMaterial

_FORMAT = "wrod-plans-3"
# Least and largest friction coefficient of the tables, and length of the patterns [L_gb].
FRICTION = (0.15, 0.8)
_LENGTH = (9.0, 24.0)
# Largest curvature that patterns reach, smallest and largest [1/L_gb].
_SHARPEST = (0.25, 1.6)
# What a pattern leaves of its rod [L_gb].
_SPARE = 3.0
_NODES, _SPACING, _HOLD = 600, 0.005, 0.05
# One rod a plan: a network gains more from many patterns than from rods that differ by little.
_SAMPLES = 1
# Plans that a GPU optimises together.
_TOGETHER = 64

_ARRAYS = ("laid", "curvature", "values")
# Kept in half precision, which no training notices: a plan takes 10 kB.
_HALVED, _BOWLS = ("basis",), ("around", "near_static")
# Models of the error with larger entries than this are those of rods that sprang off.
_LARGEST = 1e3


@dataclass(frozen=True)
class Bowl:
    """Gauss and Newton's model of the mean squared error of what lies [L_gb^2], for coefficients
    that differ by d (3 n,): `value` + 2 `slope` . d + d . `matrix` d.

    Attributes:
        value: [L_gb^2].
        slope: (3 n,) [L_gb].
        matrix: (3 n, 3 n) [-].
    """

    value: float
    slope: np.ndarray
    matrix: np.ndarray

    @property
    def is_usable(self) -> bool:
        """Whether it is that of a rod that was laid."""
        parts = (np.atleast_1d(self.value), self.slope, self.matrix)
        return all(bool((np.abs(part) < _LARGEST).all()) for part in parts)


@dataclass(frozen=True)
class Sample:
    """One optimised plan, dimensionless.

    Attributes:
        laid: (T,) laid length [L_gb].
        curvature: (T,) signed, of the pattern at the contacts [1/L_gb].
        basis: (T, n) cubic splines over the laid length [-].
        values: (n, 3) coefficients of the correction of the grip's position (forward, left, up) in
            the contact's frame [L_gb].
        length: of the rod [L_gb].
        stretch_ratio: k_s [-].
        friction: of the table [-].
        static, optimised: mean error of the plan without and with the corrections, of the rod
            that was optimised for [L_gb].
        around: the mean squared error of this rod near the corrections.
        near_static: the same near none.
    """

    laid: np.ndarray
    curvature: np.ndarray
    basis: np.ndarray
    values: np.ndarray
    length: float
    stretch_ratio: float
    friction: float
    static: float
    optimised: float
    around: Bowl
    near_static: Bowl

    @property
    def correction(self) -> np.ndarray:
        """(T, 3) of the grip's position [L_gb]."""
        return self.basis @ self.values


def random_pattern(rng: np.random.Generator, held: RodMaterial) -> Pattern:
    """A smooth pattern that leaves 3 L_gb of the rod: straights and bends as letters have, or
    curvature that wanders."""
    lgb = held.gravito_bending_length
    most = min(_LENGTH[1], held.length / lgb - _SPARE)
    length = rng.uniform(min(_LENGTH[0], 0.7 * most), most)
    s = np.linspace(0.0, length, _NODES)
    cell = s[1] - s[0]
    if rng.random() < 0.5:
        curvature = np.zeros(_NODES)
        at = rng.uniform(1.0, 5.0)
        while at < length:
            width = rng.uniform(1.0, 6.0)
            inside = (s > at) & (s < at + width)
            curvature[inside] += rng.uniform(-2.5, 2.5) / width
            at += width + rng.exponential(2.0)
        curvature = gaussian_filter1d(curvature, rng.uniform(0.3, 0.9) / cell, mode="nearest")
    else:
        width = rng.uniform(0.7, 2.5)
        curvature = gaussian_filter1d(rng.standard_normal(_NODES), width / cell, mode="reflect")
        if rng.random() < 0.7:  # others begin in a bend, and get a remainder
            curvature *= 1.0 - np.exp(-((s / rng.uniform(1.5, 4.0)) ** 2))
    largest = np.exp(rng.uniform(*np.log(_SHARPEST)))
    curvature *= largest / max(np.abs(curvature).max(), 1e-9)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * cell * (curvature[1:] + curvature[:-1]))])
    course = PPoly.from_spline(make_interp_spline(lgb * s, heading, 5))
    # Knots that coincide at the ends leave pieces of no length.
    kept = np.diff(course.x) > 0.0
    course = PPoly(course.c[:, kept], np.append(course.x[:-1][kept], course.x[-1]))
    return Pattern(course, np.zeros(2), name="random")


def solve(index: int, seed: int) -> Course[Sample | None]:
    """What is laid for the sample of that index, and the sample: a rod, a pattern, a table, and
    the plan that is optimised for it; None where the pattern cannot be laid."""
    rng = np.random.default_rng([seed, index])
    rods = list(TABLE_2.values())
    held = rods[rng.integers(len(rods))]
    held = replace(held, length=held.length * rng.uniform(0.8, 1.2))
    pattern = random_pattern(rng, held)
    friction = float(np.exp(rng.uniform(*np.log(FRICTION))))
    lgb = held.gravito_bending_length
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", WrodWarning)
            led = prepare(pattern, held, None)
            start = plan(led, held, spacing=_SPACING, remainder=False, device="cpu")
    except WrodError:
        return None
    task = Task(led, held, start, friction)
    best = yield from course(task, judge=False, samples=_SAMPLES, hold=_HOLD)
    corrections = Corrections(led, start, lgb, _HOLD)
    moved = np.einsum("tij,ti->tj", corrections.frame, best.position - start.position)
    values = np.linalg.lstsq(corrections.basis, moved / lgb, rcond=None)[0]
    around = static = yield from _bowl(task, corrections, np.zeros_like(values))
    if moved.any():
        around = yield from _bowl(task, corrections, values)
    errors = best.optimised["errors"]
    if not (np.isfinite(errors).all() and around.is_usable and static.is_usable):
        return None
    return Sample(
        start.arc_length / lgb,
        led.sample(start.pattern_arc_length)[2] * lgb,
        corrections.basis,
        values,
        held.length / lgb,
        held.stretch_ratio,
        friction,
        errors[0] / lgb,
        (min(errors) if moved.any() else errors[0]) / lgb,
        around,
        static,
    )


def _bowl(task: Task, corrections: Corrections, values: np.ndarray) -> Course[Bowl]:
    """Of what `optimise` lays."""
    spread = Spread.of(task.friction)
    laid = yield sample_of(task, corrections, spread, values.ravel(), _SAMPLES)
    parts = [misplacement(task.pattern, one) for one in laid]
    scale = 1.0 / (len(parts) * METRIC_POINTS * corrections.lgb**2)
    return Bowl(
        scale * sum(float(e @ e) for e, _ in parts),
        scale * sum(rates.T @ e for e, rates in parts),
        scale * sum(rates.T @ rates for _, rates in parts),
    )


def generate(
    folder: str | os.PathLike[str],
    size: int,
    *,
    seed: int = 0,
    rank: Rank | None = None,
    device: str | None = "cpu",
    progress: Callable[[], object] | None = None,
) -> tuple[int, int]:
    """Optimise the first `size` plans of a random sequence into `folder`.

    What is there already is kept, so a killed call goes on where it was. Every rank takes every
    rank.count-th plan. A GPU optimises 64 at a time.

    Args:
        folder: made if missing.
        size: number of plans.
        seed: of the sequence.
        rank: this process's part; by default read from the environment.
        device: where rods are laid: "cpu", "cuda:0" or "auto".
        progress: called after each plan.

    Returns:
        Plans that this rank has, and those of its part that could not be laid.

    Raises:
        DataError: the folder holds plans of another seed.
    """
    if size < 1:
        raise DataError(f"size is {size}; give a positive number of plans")
    folder, device = Path(folder), resolve_device(device)
    rank = rank or Rank.from_environment()
    _claim(folder, seed)
    paths = {
        index: folder / f"plan-{index:06d}.npz" for index in range(rank.index, size, rank.count)
    }
    missing = [index for index, path in paths.items() if not path.exists()]
    together = 1 if device == "cpu" else _TOGETHER
    told = progress or (lambda: None)
    for _ in range(len(paths) - len(missing)):
        told()
    for first in range(0, len(missing), together):
        chosen = missing[first : first + together]
        courses = [solve(index, seed) for index in chosen]
        solved = follow(courses, hold=_HOLD, tolerance=TOLERANCE, device=device)
        for index, one in zip(chosen, solved, strict=True):
            _store(paths[index], one)
            told()
    good = sum(path.stat().st_size > 0 for path in paths.values())
    return good, len(paths) - good


def load(folder: str | os.PathLike[str]) -> list[Sample]:
    """All plans of a folder, by index.

    Raises:
        DataError: there are none, or one is damaged.
    """
    out = []
    for path in sorted(Path(folder).glob("plan-*.npz")):
        if not path.stat().st_size:
            continue
        found = read_fields(path, "OptimisedPlan")
        count = found["values"].size
        if len(found["around"]) != 1 + count + count * (count + 1) // 2:
            raise DataError(f"{path}: around and values do not fit together; delete the file")
        bowls = [_unpacked(found[name]) for name in _BOWLS]
        figures = map(float, found["figures"])
        laid, curvature, values, basis = (found[name] for name in (*_ARRAYS, *_HALVED))
        out.append(Sample(laid, curvature, basis, values, *figures, *bowls))
    if not out:
        raise DataError(f"{folder}: holds no optimised plan; let `wrod distil` make some")
    return out


def _claim(folder: Path, seed: int) -> None:
    path = folder / "plans.json"
    folder.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        write_json(path, {"format": _FORMAT, "seed": seed})
    if read_json(path, schemas.Plans, "the label of optimised plans").seed != seed:
        raise DataError(f"{folder}: holds plans of another seed; choose another --out")


def _store(path: Path, one: Sample | None) -> None:
    """Write a plan, or an empty file where the pattern cannot be laid."""
    if one is None:
        write_text(path, "")
        return
    arrays = {name: getattr(one, name).astype(np.float32) for name in _ARRAYS}
    halves = {name: getattr(one, name) for name in _HALVED}
    halves |= {name: _packed(getattr(one, name)) for name in _BOWLS}
    arrays |= {name: values.astype(np.float16) for name, values in halves.items()}
    figures = [
        one.length, one.stretch_ratio, one.friction, one.static, one.optimised,
    ]  # fmt: skip
    write_npz(path, **arrays, figures=figures)


def _packed(bowl: Bowl) -> np.ndarray:
    """Value, slope and the matrix's upper triangle in a row."""
    upper = bowl.matrix[np.triu_indices(len(bowl.slope))]
    return np.concatenate([[bowl.value], bowl.slope, upper])


def _unpacked(row: np.ndarray) -> Bowl:
    n = int(np.sqrt(2.0 * len(row) + 0.25) - 1.5)
    matrix = np.zeros((n, n))
    matrix[np.triu_indices(n)] = row[1 + n :]
    matrix = matrix + np.triu(matrix, 1).T
    return Bowl(float(row[0]), row[1 : 1 + n], matrix)
