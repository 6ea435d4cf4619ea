"""Optimised plans at scale: random smooth patterns, the corrections of the grip's path that lay
them on tables of all sorts, and what lies by a network's; split over ranks."""

import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from wrod.training.dataset import Rank
from wrod.training.plan_files import Bowl, Sample, claim, read, store

from wrod import arguments
from wrod.controller.corrector import Corrector, CorrectorInputs
from wrod.deployment.corrections import Corrections
from wrod.deployment.descent import Problem, TableTask
from wrod.deployment.distilled import asked
from wrod.deployment.expectation import misplacement
from wrod.deployment.optimise import course
from wrod.deployment.plan import plan
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.spread import Spread
from wrod.deployment.together import Course, follow
from wrod.errors import DataError, WrodError, WrodWarning
from wrod.patterns.pattern import Pattern
from wrod.planning.remainder import prepare
from wrod.rods.device import resolve_device
from wrod.rods.material import TABLE_2, RodMaterial

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
# Plans that a GPU works on together.
_TOGETHER = 64


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


def task_of(index: int, seed: int) -> TableTask | None:
    """The rod, the pattern and the table of that index, and the plan that does not know the table;
    None where the pattern cannot be laid."""
    rng = np.random.default_rng([seed, index])
    rods = list(TABLE_2.values())
    held = rods[rng.integers(len(rods))]
    held = replace(held, length=held.length * rng.uniform(0.8, 1.2))
    pattern = random_pattern(rng, held)
    friction = float(np.exp(rng.uniform(*np.log(FRICTION))))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", WrodWarning)
            led = prepare(pattern, held, None)
            start = plan(led, held, spacing=_SPACING, remainder=False, device="cpu")
    except WrodError:
        return None
    return TableTask(led, held, start, friction)


def solve(index: int, seed: int) -> Course[Sample | None]:
    """What is laid for the sample of that index, and the sample: its task, and the plan that is
    optimised for it; None where the pattern cannot be laid."""
    task = task_of(index, seed)
    if task is None:
        return None
    held, start = task.rod, task.trajectory
    best = yield from course(task, judge=False, samples=_SAMPLES, hold=_HOLD, straight=True)
    lgb = held.gravito_bending_length
    corrections = Corrections(task.pattern, start, lgb, _HOLD, straight=True)
    moved = (best.position - start.position) / lgb
    values = corrections.nearest(np.einsum("tij,ti->tj", corrections.frame, moved))
    anchors = np.stack([np.zeros_like(values), values])
    bowls = []
    for one in anchors:
        bowls.append((yield from _bowl(task, corrections, one)))
    if not all(bowl.is_usable for bowl in bowls):
        return None
    what = _asked(task)
    return Sample(
        what.laid,
        what.curvature,
        corrections.basis,
        anchors,
        tuple(bowls),
        what.rod_length,
        what.stretch_ratio,
        what.friction,
    )


def visit(index: int, seed: int, sample: Sample, corrector: Corrector) -> Course[Sample]:
    """What is laid by a network's corrections, and the sample with what came of it; as it was where
    the rod sprang off."""
    task = task_of(index, seed)
    if task is None:
        return sample
    lgb = task.rod.gravito_bending_length
    corrections = Corrections(task.pattern, task.trajectory, lgb, _HOLD, straight=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WrodWarning)
        values = corrections.nearest(corrector.predict(_asked(task)))
    bowl = yield from _bowl(task, corrections, values)
    return sample.laid_by(values, bowl) if bowl.is_usable else sample


def _asked(task: TableTask) -> CorrectorInputs:
    """What a network is asked about a task."""
    low, high = Spread.of(task.friction).friction
    return asked(task.pattern, task.rod, task.trajectory, 0.5 * (low + high))


def _bowl(task: TableTask, corrections: Corrections, values: np.ndarray) -> Course[Bowl]:
    """Of what `optimise` lays."""
    problem = Problem(task, corrections, Spread.of(task.friction), _SAMPLES, alone=False)
    laid = yield from problem.laid(values.ravel())
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
    device: arguments.DeviceLike = "cpu",
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
        DataError: size is not positive, or the folder holds plans of another seed.
    """
    if size < 1:
        raise DataError(f"size is {size}; give a positive number of plans")
    folder = Path(folder)
    claim(folder, seed)
    paths = _share(folder, size, rank)
    missing = [index for index, path in paths.items() if not path.exists()]
    _follow(missing, lambda index: solve(index, seed), paths, device, progress, len(paths))
    good = sum(map(_is_laid, paths.values()))
    return good, len(paths) - good


def visit_all(
    folder: str | os.PathLike[str],
    size: int,
    corrector: Corrector,
    round_: int,
    *,
    seed: int = 0,
    rank: Rank | None = None,
    device: arguments.DeviceLike = "cpu",
    progress: Callable[[], object] | None = None,
) -> None:
    """Lay the first `size` patterns by a network's corrections, and keep with the plans what came
    of it, from which the next network learns what this one did not know.

    Args:
        folder, size, seed, rank, device, progress: as for `generate`, which made the plans.
        corrector: the network.
        round_: its number, from 1 on: plans that were laid by so many networks are left.
    """
    paths = {i: p for i, p in _share(Path(folder), size, rank).items() if _is_laid(p)}
    samples = {index: read(path) for index, path in paths.items()}
    missing = [index for index, one in samples.items() if len(one.bowls) < 2 + round_]
    _follow(
        missing,
        lambda index: visit(index, seed, samples[index], corrector),
        paths, device, progress, len(paths),
    )  # fmt: skip


def _share(folder: Path, size: int, rank: Rank | None) -> dict[int, Path]:
    """The files of a rank's plans."""
    rank = rank or Rank.from_environment()
    return {
        index: folder / f"plan-{index:06d}.npz" for index in range(rank.index, size, rank.count)
    }


def _is_laid(path: Path) -> bool:
    """Whether a plan is there, and its pattern could be laid."""
    return path.exists() and path.stat().st_size > 0


def _follow(
    missing: list[int],
    make: Callable[[int], Course[Sample | None]],
    paths: dict[int, Path],
    device: arguments.DeviceLike,
    progress: Callable[[], object] | None,
    count: int,
) -> None:
    """Make the plans that are missing of `count`, and write each lot as it ends."""
    device, told = resolve_device(device), progress or (lambda: None)
    together = 1 if device == "cpu" else _TOGETHER
    for _ in range(count - len(missing)):
        told()
    for first in range(0, len(missing), together):
        chosen = missing[first : first + together]
        courses = [make(index) for index in chosen]
        solved = follow(courses, hold=_HOLD, device=device)
        for index, one in zip(chosen, solved, strict=True):
            store(paths[index], one)
            told()
