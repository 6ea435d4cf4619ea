"""Campaigns of simulated deployments: finished trials are kept, so that a stopped run goes on."""

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod import cost
from wrod.deployment.bounds import check_release, refuse_long_moves
from wrod.files.ledger import Ledger
from wrod.machine import machine_line
from wrod.options import option
from wrod.telling import tell

# Points at which laid curves are kept.
_CURVE_POINTS = 60
# Trials simulated between two notes in the ledger, on a CPU.
_CPU_BATCH = 32


@dataclass(frozen=True)
class Spent:
    """What a run cost: trials simulated, their time steps, and seconds."""

    trials: int
    steps: int
    seconds: float

    @property
    def rate(self) -> float | None:
        """Rod steps per second."""
        return self.steps / self.seconds if self.trials else None

    def __str__(self) -> str:
        rate = "" if self.rate is None else f", {self.rate:.0f} rod steps per second"
        return f"{self.trials} trials in {self.seconds:.1f} s{rate}"


def run(
    ledger: Ledger,
    keys: Sequence[tuple],
    simulate: Callable[[list[tuple], Callable[[float], None]], list[dict]],
    *,
    device: str,
    batch: int | None = None,
) -> Spent:
    """Simulate the trials that the ledger lacks, and note each batch of them when it is done.

    Args:
        ledger: of the campaign.
        keys: every trial that is wanted, in order.
        simulate: called with some of them and with what it reports its progress to (fractions
            done since the last call); returns their rows, each with "steps".
        device: where it runs.
        batch: trials at once; default: 32 on a CPU, all on a GPU.
    """
    pending = ledger.lacking(keys)
    size = _at_once(len(pending), batch, device)
    start, steps = time.perf_counter(), 0
    with cost.progress_bar(
        total=len(keys), initial=len(keys) - len(pending), unit="trial",
        bar_format="{desc}{percentage:3.0f}% |{bar}| {elapsed} < {remaining}",
    ) as bar:  # fmt: skip
        for first in range(0, len(pending), size):
            part = pending[first : first + size]
            rows = simulate(part, _counted(bar, len(part)))
            ledger.add(rows)
            steps += sum(row["steps"] for row in rows)
    return Spent(len(pending), steps, time.perf_counter() - start)


def _at_once(trials: int, batch: int | None, device: str) -> int:
    return batch or (_CPU_BATCH if device == "cpu" else max(trials, 1))


def _counted(bar, count: int) -> Callable[[float], None]:
    return lambda fraction: bar.update(min(fraction * count, bar.total - bar.n))


def figures_of(deployment, pattern) -> dict:
    """What is kept of a trial: figures [cm], and the laid curve at 60 points [m].

    Args:
        deployment: a `Deployment`.
        pattern: with its remainder.
    """
    names = ("error_mean", "error_std", "released_error_mean", "released_error_std")
    return {
        **{name: 100.0 * getattr(deployment, name) for name in names},
        "slip": 100.0 * float(deployment.slip.max()),
        "diverged": deployment.diverged,
        "steps": deployment.steps,
        "curve": curve_of(pattern, deployment.arc_length, deployment.centerline),
    }


def curve_of(pattern, arc_length, place) -> list[list[float]]:
    """What a rod laid of a pattern, at 60 points from above [m], to keep."""
    return np.round(points_of(pattern, arc_length, place, _CURVE_POINTS), 5).tolist()


def points_of(pattern, arc_length, place, count: int) -> np.ndarray:
    """(count, 2) points from above [m] of a rod that lies at `place`, evenly along its pattern."""
    s = np.linspace(0.0, pattern.length, count) + pattern.remainder_length
    return np.column_stack([np.interp(s, arc_length, place[:, c]) for c in range(2)])


# The first length that is laid is held [m].
_HOLD = 0.05


def _checked_release(ctx: click.Context, option: click.Parameter, release: float) -> float:
    check_release(_HOLD, release)  # before plans, that take time
    return release


@dataclass(frozen=True)
class Common:
    """Options that all campaigns have; each has its own speed, step and spacing by default."""

    out: Path = option(None, type=click.Path(file_okay=False, path_type=Path), required=True)
    patterns: Path | None = option(
        "Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
        type=click.Path(file_okay=False, exists=True, path_type=Path),
    )
    release: float = option(
        "Laid length at which the free end, held for 5 cm, is let go [m].",
        default=_HOLD,
        callback=_checked_release,
    )
    speed: float = option("Speed of the contact [m/s].")
    step: float = option("Largest time step [s].")
    scheme: str = option(
        "Of time stepping, of first and of second order.",
        type=click.Choice(["euler", "bdf2"]),
        default="bdf2",
    )
    spacing: float = option("Length of the edges [m].")
    batch: int | None = option("Trials simulated at once; default: 32, CUDA all.")
    device: str = option("cpu, cuda:0 or auto.", default="auto")

    @property
    def settings(self) -> dict[str, Any]:
        """What trials have to have in common, in the ledger's words."""
        names = ("speed", "step", "spacing", "release")
        scheme = {} if self.scheme == "euler" else {"scheme": self.scheme}
        return {name: getattr(self, name) for name in names} | scheme

    def how(self, node_count: int | None = None) -> dict[str, Any]:
        """How trials are simulated."""
        from wrod.deployment.discretisation import Discretisation

        mesh = Discretisation(self.spacing, self.step, self.scheme, node_count=node_count)
        return {"discretisation": mesh, "speed": self.speed, "release": self.release}

    @property
    def source(self) -> str:
        """Of the patterns, in a word."""
        return "built-in" if self.patterns is None else self.patterns.name


def settle(common: Common, trials: int, length: float, more: float = 0.0) -> None:
    """Say what the deployments that are missing will cost, or refuse it (`cost.settle`).

    Args:
        trials: that are missing.
        length: of the longest rod that is laid [m].
        more: what else takes time on one core [s].
    """
    from wrod.rods.device import resolve_device

    refuse_long_moves(common.speed, common.step)
    device = resolve_device(common.device)
    at_once = min(_at_once(trials, common.batch, device), trials)
    how = {"speed": common.speed, "step": common.step, "spacing": common.spacing}
    work = cost.deployments(trials, length, device=device, **how)
    cost.settle(
        replace(work, seconds=work.seconds + more, memory=work.memory * at_once / max(trials, 1)),
        f"{trials} deployments",
        "ask for fewer trials, or for a larger --spacing or --step",
    )


def say(
    spent: Spent,
    *,
    device: str,
    trials: int,
    planned: float,
    nodes: int,
    summary: list[str],
    written: Sequence[Path],
    compiled: float = 0.0,
) -> None:
    """Tell what a campaign came to.

    Args:
        spent: on the deployments.
        device: where they ran.
        trials: in all, and the number of nodes of each.
        planned: seconds that the plans took.
        summary: what the rows say, in sentences.
        written: files.
        compiled: seconds that compiling kernels for a GPU took.
    """
    before = f"plans {planned:.1f} s"
    if compiled:
        before = f"compiling {compiled:.1f} s, {before}"
    figures = {
        "machine": machine_line(device),
        "device": device,
        "trials": trials,
        "simulated_now": spent.trials,
        "compiling_seconds": compiled,
        "planning_seconds": planned,
        "simulation_seconds": spent.seconds,
        "rod_steps_per_second": spent.rate,
        "nodes": nodes,
        "summary": summary,
        "written": [str(path) for path in written],
    }
    tell(figures, f"{spent} of {nodes} nodes on {device} ({before})", *summary)


@dataclass(frozen=True)
class Cell:
    """Means over the trials of one cell that did not diverge [cm]: of error and deviation along the
    pattern, with the grip holding and let go; and how many trials there were."""

    held: tuple[float, float]
    released: tuple[float, float]
    trials: int
    diverged: int

    @property
    def error(self) -> float:
        return self.held[0]

    @property
    def lost(self) -> str:
        """A remark on trials that diverged."""
        return f" ({self.diverged} diverged)" if self.diverged else ""


def grouped(rows: Sequence[dict], keys: Sequence[str]) -> dict[tuple, list[dict]]:
    """The rows of each cell, which `keys` tell apart, in their order."""
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in keys)].append(row)
    return groups


def cell_of(group: Sequence[dict]) -> Cell:
    """What the trials of a cell come to."""
    good = [row for row in group if not row["diverged"]]

    def mean(name: str) -> float:
        return float(np.mean([row[name] for row in good])) if good else np.nan

    held = mean("error_mean"), mean("error_std")
    released = mean("released_error_mean"), mean("released_error_std")
    return Cell(held, released, len(group), len(group) - len(good))


def diverged(table: Mapping[Any, Cell]) -> str:
    """How many trials of all cells did, in a sentence."""
    lost = sum(cell.diverged for cell in table.values())
    return f"{lost} of {sum(cell.trials for cell in table.values())} trials diverged."
