"""Campaigns of simulated deployments: finished trials are kept, so that a stopped run goes on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod import cost
from wrod.deployment.bounds import check_release, refuse_long_moves
from wrod.errors import RodError
from wrod.files.ledger import Ledger
from wrod.options import FOLDER, SCHEME, SOURCE_FOLDER, option

# Points at which laid curves are kept.
_CURVE_POINTS = 60
# Trials simulated between two notes in the ledger, on a CPU.
_CPU_BATCH = 32


def run(
    ledger: Ledger,
    keys: Sequence[tuple],
    simulate: Callable[[list[tuple], Callable[[float], None]], list[dict]],
    *,
    device: str,
    batch: int | None = None,
) -> tuple[int, int]:
    """Simulate the trials that the ledger lacks, and note each batch of them when it is done.

    Args:
        ledger: of the campaign.
        keys: every trial that is wanted, in order.
        simulate: called with some of them and with what it reports its progress to (fractions
            done since the last call); returns their rows, each with "steps".
        device: where it runs.
        batch: trials at once; default: 32 on a CPU, all on a GPU.

    Returns:
        How many trials it simulated, and their time steps.
    """
    pending, steps = ledger.lacking(keys), 0
    size = _at_once(len(pending), batch, device)
    with cost.progress_bar(
        total=len(keys), initial=len(keys) - len(pending), unit="trial",
        bar_format="{desc}{percentage:3.0f}% |{bar}| {elapsed} < {remaining}",
    ) as bar:  # fmt: skip
        for first in range(0, len(pending), size):
            part = pending[first : first + size]

            def advanced(fraction: float, count: int = len(part)) -> None:
                bar.update(min(fraction * count, bar.total - bar.n))

            rows = simulate(part, advanced)
            ledger.add(rows)
            steps += sum(row["steps"] for row in rows)
    return len(pending), steps


def still_to_lay(
    ledger: Ledger, keys: Sequence[tuple], finished: bool
) -> tuple[list[tuple], list[tuple]]:
    """Which of the trials are told, and which of these the ledger lacks: all that are wanted, or
    those alone that are finished.

    Raises:
        RodError: none is.
    """
    lacking = ledger.lacking(keys)
    if not finished:
        return list(keys), lacking
    gone = set(lacking)
    done = [key for key in keys if key not in gone]
    if not done:
        raise RodError(f"{ledger.path}: none of these is finished; leave --finished out")
    return done, []


def _at_once(trials: int, batch: int | None, device: str) -> int:
    return batch or (_CPU_BATCH if device == "cpu" else max(trials, 1))


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

    out: Path = option(None, type=FOLDER, required=True)
    patterns: Path | None = option(
        "Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
        type=SOURCE_FOLDER,
    )
    release: float = option(
        "Laid length at which the free end, held for 5 cm, is let go [m].",
        default=_HOLD,
        callback=_checked_release,
    )
    speed: float = option("Speed of the contact [m/s].")
    step: float = option("Largest time step [s].")
    scheme: str = SCHEME
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
