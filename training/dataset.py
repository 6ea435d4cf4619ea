"""Datasets of optimal grasps at scale: solved in batches, stored in shards, split over ranks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from wrod.training import store
from wrod.training.sampling import MAX_INDEX, RodInputs, sample

from wrod import __version__, arguments
from wrod.controller.curved import untwisted
from wrod.errors import DataError
from wrod.files import schemas
from wrod.grasps.inputs import CLOSURES
from wrod.grasps.levels import compile_kernels
from wrod.grasps.optimal import EDGE_COUNT, solve_grasps
from wrod.grasps.results import Grasps
from wrod.machine import usable_cores
from wrod.rods.material import RodMaterial

SHARD_SIZE = 2048
# Samples solved at once on a GPU, as far as whole shards go; a CPU takes one shard at a time.
_CUDA_BATCH = 65536


@dataclass(frozen=True)
class Rank:
    """Which part of the work is this process's, as `torchrun` says in the environment."""

    index: int = 0
    count: int = 1
    local_index: int = 0
    local_count: int = 1

    @classmethod
    def from_environment(cls) -> Rank:
        """RANK, WORLD_SIZE, LOCAL_RANK and LOCAL_WORLD_SIZE; one process without them.

        Raises:
            DataError: they contradict each other.
        """
        names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")
        default = (0, 1, 0, 1)
        try:
            values = [int(os.environ.get(n, d)) for n, d in zip(names, default, strict=True)]
        except ValueError:
            raise DataError(
                f"{', '.join(names)} in the environment must be whole numbers"
            ) from None
        if not (0 <= values[0] < values[1] and 0 <= values[2] < values[3]):
            raise DataError(f"RANK {values[0]} of WORLD_SIZE {values[1]} in the environment")
        return cls(*values)

    def device(self, wanted: str) -> str:
        """Device of this rank: with several to a machine, "auto" gives each a GPU of its own."""
        from wrod.rods.device import resolve_device

        device = resolve_device(None if wanted == "auto" else wanted)
        if wanted == "auto" and device != "cpu":
            import warp as wp

            return f"cuda:{self.local_index % wp.get_cuda_device_count()}"
        return device


@dataclass(frozen=True)
class Generated:
    """What a call of `generate` did, and the honest count of what its shards hold.

    Attributes:
        samples: in all shards of this rank.
        solved: of these, in this call; the others were there.
        unconverged, unstable: among `samples`, by number; readers leave them out.
        seconds: spent in this call.
        first: of these, those until the first samples were solved, which every rank needs.
    """

    samples: int
    solved: int
    unconverged: int
    unstable: int
    seconds: float
    first: float = 0.0


def generate(
    folder: str | os.PathLike[str],
    size: int,
    *,
    seed: int = 0,
    closure: str = "zero_tension",
    sensitivities: bool = True,
    shard_size: int = SHARD_SIZE,
    edge_count: int = EDGE_COUNT,
    rod: RodMaterial | None = None,
    roll: float | str = "plane",
    device: arguments.DeviceLike = "auto",
    rank: Rank | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Generated:
    """Solve the first `size` grasps of a sampling sequence into `folder`.

    What is there already is kept, so a killed call goes on where it was, to the same bytes; the
    work in hand, one shard on a CPU, is lost. Every rank solves every rank.count-th shard. Memory
    does not grow with `size`.

    Args:
        folder: of the dataset; made if missing.
        size: number of samples.
        seed: of the sequence.
        closure: see `wrod.solve_grasps`.
        sensitivities: store the derivatives by the inputs ("zero_tension" only).
        shard_size: samples per file.
        edge_count: resolution of the solver.
        rod: solve grasps of this rod alone; by default those of all rods.
        roll: that the rod is laid at: its natural curvature in the "plane" to the left, "up", or
            an angle [rad]; see `wrod.plan`.
        device: "auto", "cpu" or "cuda:0".
        rank: this process's part; by default read from the environment.
        progress: called with the samples done since the last call and those of this rank.

    Raises:
        DataError: the folder holds something else, or a shard in it is damaged.
        GraspError: unknown closure.
    """
    start = time.perf_counter()
    _check_size(size, shard_size)
    folder = Path(folder)
    rank = rank or Rank.from_environment()
    if closure not in CLOSURES:
        solve_grasps([5.0], [0.0], [1e3], closure=closure)  # raises with the names
    device = rank.device(device)
    one = None if rod is None else RodInputs.of(rod, roll)
    curved = one is not None and not one.is_straight
    manifest = store.Manifest(
        format=store.FORMAT,
        size=size,
        shard_size=shard_size,
        seed=seed,
        closure=closure,
        edge_count=edge_count,
        sensitivities=sensitivities and closure == "zero_tension" and not curved,
        solver=__version__,
        rod=None if one is None else schemas.RodInputs(**asdict(one)),
    )
    store.create(folder, manifest)
    mine = range(rank.index, manifest.shard_count, rank.count)
    store.sweep(folder, mine)
    tally = _Tally(sum(manifest.rows(shard)[1] for shard in mine), progress)

    there = {shard for shard in mine if store.is_solved(folder, manifest, shard)}
    for shard in sorted(there):
        tally.add(store.read_shard(folder, manifest, shard), solved=False)
    waiting = [shard for shard in mine if shard not in there]
    group_size = 1 if device == "cpu" else max(1, _CUDA_BATCH // shard_size)
    threads = max(1, usable_cores() // rank.local_count)
    groups = [waiting[k : k + group_size] for k in range(0, len(waiting), group_size)]
    first: list[float] = []
    for parts in _solved(manifest, groups, one, device, threads, folder, first):
        for part in parts:
            tally.add(part, solved=True)
    return Generated(
        tally.samples, tally.solved, tally.unconverged, tally.unstable,
        time.perf_counter() - start, first[0] - start if first else 0.0,
    )  # fmt: skip


def _check_size(size: int, shard_size: int) -> None:
    if size < 1 or shard_size < 1:
        raise DataError(f"size is {size} and shard size {shard_size}; give positive numbers")
    if size > MAX_INDEX:
        raise DataError(f"size is {size}; the sampling sequence ends at {MAX_INDEX}")


@dataclass
class _Tally:
    """Counts what the shards of a rank hold."""

    samples: int
    progress: Callable[[int, int], object] | None
    solved: int = 0
    unconverged: int = 0
    unstable: int = 0

    def add(self, columns: dict, *, solved: bool) -> None:
        converged, stable = columns["converged"], columns["stable"]
        self.solved += len(converged) * solved
        self.unconverged += int(np.sum(~converged))
        self.unstable += int(np.sum(converged & ~stable))
        if self.progress is not None:
            self.progress(len(converged), self.samples)


def _solved(
    manifest: store.Manifest,
    groups: list[list[int]],
    one: RodInputs | None,
    device: str,
    threads: int,
    folder: Path,
    solved: list[float],
) -> Iterator[list[dict]]:
    """Columns of groups of shards, as they have been written. While one is solved, the one before
    is written and the one after sampled, and while the first is sampled kernels are loaded: all
    would keep a GPU waiting. `solved` gets the times when a group was."""

    def inputs(group: list[int]) -> np.ndarray:
        return np.concatenate([sample(*manifest.rows(k), manifest.seed, one) for k in group])

    def write(parts: list[tuple[int, dict]]) -> list[dict]:
        for shard, part in parts:
            store.write_shard(folder, manifest, shard, part)
        return [part for _, part in parts]

    with ThreadPoolExecutor(1) as sampler, ThreadPoolExecutor(1) as writer:
        sampled = [sampler.submit(inputs, group) for group in groups[:1]]
        if groups and (one is None or one.is_straight):
            compile_kernels(device, manifest.sensitivities)
        written: list[Future] = []
        for k, group in enumerate(groups):
            values = sampled.pop().result()
            sampled += [sampler.submit(inputs, after) for after in groups[k + 1 : k + 2]]
            parts = _solve(manifest, group, values, one, device, threads)
            solved.append(time.perf_counter())
            if written:
                yield written.pop().result()
            written.append(writer.submit(write, parts))
        if written:
            yield written.pop().result()


def _solve(
    manifest: store.Manifest,
    shards: list[int],
    inputs: np.ndarray,
    one: RodInputs | None,
    device: str,
    threads: int,
) -> list[tuple[int, dict]]:
    """Shards solved at once, of their inputs, and the columns of each."""
    curved = one is not None and not one.is_straight
    own = {"natural_curvature": one.natural_curvature, "poisson": one.poisson} if curved else {}
    grasps = solve_grasps(
        *inputs.T,
        closure=manifest.closure,
        device=device,
        sensitivities=manifest.sensitivities,
        shapes=False,
        edge_count=manifest.edge_count,
        **own,
        threads=threads,
    )
    columns, begin, parts = _columns(inputs, grasps, manifest), 0, []
    for shard in shards:
        rows = manifest.rows(shard)[1]
        part = {name: column[begin : begin + rows] for name, column in columns.items()}
        parts.append((shard, part))
        begin += rows
    return parts


def _columns(inputs: np.ndarray, grasps: Grasps, manifest: store.Manifest) -> dict:
    names = [name for name in manifest.columns if name != "inputs"]
    return {"inputs": inputs, **{name: getattr(grasps, name) for name in names}}


@dataclass
class GraspTable:
    """Grasps to learn from, float64 NumPy: inputs (n, 3), outputs (n, 9): position, rotation vector
    and force, and their derivatives by the inputs (n, 9, 3) in that order, or None.

    Outputs of a naturally curved rod are (n, 10): its rotation vectors are those without the twist
    between contact and grip, and the twist is the last [rad].
    """

    inputs: np.ndarray
    outputs: np.ndarray
    sensitivity: np.ndarray | None

    def __len__(self) -> int:
        return len(self.inputs)

    @classmethod
    def of(cls, columns: dict) -> GraspTable:
        """Those rows of a shard that are results."""
        good = columns["converged"] & columns["stable"]
        names = ("position", "rotation", "force")
        parts = {name: columns[name][good] for name in names}
        if "twist" in columns:
            twist = columns["twist"][good]
            parts["rotation"] = untwisted(parts["rotation"], twist)
            parts["twist"] = twist[:, None]
        outputs = np.concatenate(list(parts.values()), axis=1)
        sensitivity = None
        if "position_sensitivity" in columns:
            parts = [columns[f"{name}_sensitivity"][good] for name in names]
            sensitivity = np.concatenate(parts, axis=1)
        return cls(columns["inputs"][good], outputs, sensitivity)

    @classmethod
    def solve(cls, inputs: np.ndarray, device: str = "auto", sensitivities: bool = True):
        """Grasps solved here and now, of (n, 3) inputs."""
        grasps = solve_grasps(*inputs.T, device=device, sensitivities=sensitivities, shapes=False)
        names = [*store.COLUMNS, *(store.SENSITIVITIES if sensitivities else ())]
        rows = {name: getattr(grasps, name) for name in names if name != "inputs"}
        return cls.of({"inputs": inputs, **rows})

    @classmethod
    def join(cls, parts: list[GraspTable]) -> GraspTable:
        """All rows of several tables."""
        sensitivity = None
        if all(part.sensitivity is not None for part in parts):
            sensitivity = np.concatenate([part.sensitivity for part in parts])
        return cls(
            np.concatenate([part.inputs for part in parts]),
            np.concatenate([part.outputs for part in parts]),
            sensitivity,
        )

    def take(self, rows) -> GraspTable:
        sensitivity = None if self.sensitivity is None else self.sensitivity[rows]
        return GraspTable(self.inputs[rows], self.outputs[rows], sensitivity)


def largest_curvature(folder: str | os.PathLike[str], most: float) -> float:
    """Largest |kappa| [1/L_gb], at most `most`, below which every sample of a dataset is usable."""
    for columns in store.shards(Path(folder)):
        lost = ~(columns["converged"] & columns["stable"])
        most = min(most, *np.abs(columns["inputs"][lost, 1]), np.inf)
    return most


def load(folder: str | os.PathLike[str], most: int | None = None) -> GraspTable:
    """Usable rows of a dataset; at most the first `most`, so that memory has a bound.

    Raises:
        DataError: the dataset is incomplete, damaged or foreign.
    """
    parts, rows = [], 0
    for columns in store.shards(Path(folder)):
        part = GraspTable.of(columns)
        for values in (part.inputs, part.outputs, part.sensitivity):
            if values is not None and not np.isfinite(values).all():
                path = store.shard_path(Path(folder), len(parts))
                raise DataError(f"{path}: holds grasps that are not numbers; delete the file")
        parts.append(part)
        rows += len(part)
        if most is not None and rows >= most:
            break
    if not rows:
        raise DataError(f"{folder}: holds no usable grasp")
    return GraspTable.join(parts).take(slice(most))
