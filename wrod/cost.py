"""What work will cost, said before it begins, and refused where the machine has not that much."""

import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import click

from wrod.errors import DataError
from wrod.machine import usable_cores
from wrod.telling import asked, flag

force_option = flag("force", "Begin although it needs more than this machine has.")
# Of one core of a server's processor; docs/measured.md has them.
GRASPS_PER_SECOND, SENSITIVITIES_COST = 2000.0, 3.0
# A node's part of a time step, of rods that are laid.
LAID_NODE_STEP = 4e-6
APPLICATION = {"S cable": 25.0, "U cable": 15.0, "trefoil": 6.0, "reef": 35.0}
EQUILIBRIUM, BOUNDARY = 4e-3, 0.8
IDENTIFIED_SET, TRACED_PIXEL, DRAWN_RAY = 30.0, 2e-6, 1e-6
# A plan of a random pattern, corrected for its table.
CORRECTED_PLAN = 15.0
# A recording of motion identified, a joint path with approach and retreat, a plan, a bend pulled.
RECORDING, JOINT_PATH, PLAN, BEND = 7.0, 12.0, 0.5, 50.0
# Scenes of `wrod bench newton` of bodies, six sevenths of it plectonemes, and of many worlds and of
# a pile, for each edge; what hangs in a hand, and what loops do.
NEWTON_BODIES, NEWTON_MANY, WORLD_EDGE, PILE_EDGE = 180.0, 85.0, 1e-3, 1e-3
HAND, FOLD, LOOPS, EXPERIMENT = 28.0, 60.0, 60.0, 10.0
# Kernels compiled for a CPU: what commands launch, and the others.
KERNELS, RARE_KERNELS = 80.0, 70.0
# Multiplications and additions of a core with eight float64 lanes that training keeps busy.
_OPERATIONS = 4e9
# Longer than this is a mistake more often than a wish [s].
_LONGEST = 7 * 86400.0
# Looks of a bar of shares.
SHARE = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
# What takes less is begun without a word [s, bytes].
_NOT_WORTH_SAYING = (10.0, 2.0**30, 2.0**30)


@dataclass(frozen=True)
class Cost:
    """Time [s], memory and room on the disk [bytes]."""

    seconds: float
    memory: float = 0.0
    disk: float = 0.0

    def __str__(self) -> str:
        parts = [_time(self.seconds)]
        parts += [f"{_size(self.memory)} of memory"] if self.memory > 2**20 else []
        parts += [f"{_size(self.disk)} on disk"] if self.disk > 2**20 else []
        return ", ".join(parts)


def settle(cost: Cost, what: str, remedy: str = "", *, force: bool | None = None) -> None:
    """Say what the running command's work costs, or refuse it. With --json nothing is said.

    Args:
        cost: of the work, on this machine; on the disk of the command's --out.
        what: is done: "12 trials".
        remedy: for the refusal: "ask for fewer trials".
        force: begin in any case; default: where --force was given.

    Raises:
        DataError: the machine has not so much memory or room, or it takes more than a week.
    """
    from wrod.machine import available_memory

    context = click.get_current_context(silent=True)
    out = None if context is None else context.params.get("out")
    force = asked("force") if force is None else force
    lacks = []
    free = available_memory()
    if cost.memory > free:
        lacks.append(f"{_size(free)} of memory are free")
    room = _room(out)
    if cost.disk > room:
        lacks.append(f"{_size(room)} are free on the disk of {out}")
    if cost.seconds > _LONGEST:
        lacks.append("that is more than a week")
    said = f"{what}: about {cost}"
    if lacks and not force:
        remedy += "" if force is None else ", or give --force"
        raise DataError(f"{said}; {' and '.join(lacks)}; {remedy}")
    worth = (cost.seconds, cost.memory, cost.disk)
    if not asked("json") and any(a > b for a, b in zip(worth, _NOT_WORTH_SAYING, strict=True)):
        click.echo(f"wrod: {said} on this machine", err=True)


def progress_bar(*arguments, **options):
    """A tqdm bar that shows from the start, but not with --json; where nobody watches, a line every
    ten seconds."""
    from tqdm import tqdm

    watched = sys.stderr.isatty()
    # In a log nothing stands of what is refused or done before the first line is due.
    pace, wait = (0.1, 0.0) if watched else (10.0, 10.0)
    options = {"mininterval": pace, "delay": wait, "leave": False} | options
    bar: Callable = tqdm
    _say_that_kernels_are_compiled()
    return bar(*arguments, disable=bool(asked("json")), **options)


@cache
def _say_that_kernels_are_compiled() -> None:
    """Where Warp has none of ours yet: a first run takes minutes where the next take seconds."""
    running = click.get_current_context(silent=True)
    itself = running is not None and running.info_name == "compile"
    if "wrod.kernels" not in sys.modules or itself or asked("json"):
        return
    import warp

    if any(Path(warp.config.kernel_cache_dir).glob("wp_wrod*")):
        return
    said = "wrod: kernels are compiled on the way, once on this machine, for up to two minutes"
    click.echo(f"{said} (`wrod compile` does it beforehand)", err=True)


@contextmanager
def ticking(bar) -> Iterator[None]:
    """While something is done that moves no bar, let this one show that time goes on."""
    ended, pace = threading.Event(), 1.0 if sys.stderr.isatty() else 10.0

    def tick() -> None:
        while not ended.wait(pace):
            bar.refresh()

    thread = threading.Thread(target=tick, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def share_bar(what: str) -> Iterator[Callable[[float], None]]:
    """A bar of 100 per cent, by what moves it: called with how much more of all is done."""
    with progress_bar(total=100, desc=what, bar_format=SHARE) as bar:
        yield lambda share: bar.update(min(100 * share, bar.total - bar.n))


def counting(bar) -> Callable[[int, int], None]:
    """What moves a bar: called with how many more are done, and of how many in all."""

    def progress(count: int, total: int) -> None:
        bar.total = total
        bar.update(count)

    return progress


def grasps(
    count: int, row_bytes: int, shard_size: int, *, sensitivities: bool, device: str, ranks: int
) -> Cost:
    """Of solving and storing grasps.

    Args:
        count: of grasps.
        row_bytes: what one takes on the disk.
        shard_size: grasps solved at once.
    """
    rate = GRASPS_PER_SECOND / (SENSITIVITIES_COST if sensitivities else 1.0)
    rate *= usable_cores() if device == "cpu" else 600.0
    # Meshes of 128 edges, of which a dozen arrays of the degrees of freedom live at once.
    return Cost(count / ranks / rate, 50e3 * min(shard_size, count), float(row_bytes) * count)


def manifold(count: int, lengths: int, *, device: str) -> Cost:
    """Of equilibria of held grips, and of the boundary for some suspended lengths."""
    seconds = EQUILIBRIUM * count + BOUNDARY * lengths
    return Cost(seconds / (usable_cores() if device == "cpu" else 20.0), 10e3 * count)


def training(steps: int, batch: int, width: int, depth: int, rows: int, *, device: str) -> Cost:
    """Of training a network: three passes of value and tangent, and the optimiser's products."""
    layer = 12.0 * batch * width**2 + 20.0 * width**3
    seconds = steps * (layer * (depth + 1) / _OPERATIONS + 2e-3)
    memory = width * 8.0 * (depth + 1) * (8.0 * batch + 12.0 * width) + 400.0 * rows
    return Cost(seconds if device == "cpu" else seconds / 20.0, memory, 64.0 * width**2 * depth)


def deployments(
    trials: int, length: float, *, speed: float, step: float, spacing: float, device: str = "cpu"
) -> Cost:
    """Of laying a length [m] of rods in simulation; beside it hangs a part of each."""
    nodes, steps = length / spacing + 40.0, 1.5 * length / speed / step
    seconds = trials * nodes * steps * LAID_NODE_STEP
    memory = nodes * 4096.0 * trials
    rate = usable_cores() if device == "cpu" else 100.0
    return Cost(seconds / rate, memory, 1e5 * trials)


def pictures(count: int, width: int, height: int, samples: int = 4) -> Cost:
    """Of drawing a stage."""
    rays = float(width) * height * samples
    seconds = count * (rays * DRAWN_RAY + 0.2) / usable_cores()
    return Cost(seconds, 60.0 * rays, 3.0 * count * rays / 4)


def _room(out: Path | None) -> float:
    """Free bytes on the disk where `out` is, or will be."""
    if out is None:
        return float("inf")
    whole = Path(os.path.abspath(out))
    try:
        there = next(place for place in (whole, *whole.parents) if place.exists())
        return float(shutil.disk_usage(there).free)
    except OSError:
        return float("inf")


def _time(seconds: float) -> str:
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{max(seconds, 1.0):.2g} s"


def _size(size: float) -> str:
    for unit, bytes_ in (("TiB", 2**40), ("GiB", 2**30)):
        if size >= bytes_:
            return f"{size / bytes_:.3g} {unit}"
    return f"{size / 2**20:.3g} MiB"
