"""Grasps per second of another checkout beside this one's: both solve the same, turn by turn."""

import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wrod.errors import WrodError
from wrod.grasps.inputs import whole_range

CALLS = 5
# Of the table for people.
HEAD = (
    f"{'grasps':>8} {'closure':>13} {'other per s':>12} {'calls':>5} {'converged':>9} "
    f"{'this per s':>12} {'calls':>5} {'converged':>9} {'times':>6}"
)
# A first call that takes longer [s] counts with the others: kernels have been compiled, and what
# room costs is a hundredth of it.
_LONG = 20.0


class _Worker:
    """A process that solves with the wrod of one checkout."""

    def __init__(self, root: Path, inputs: Path, device: str):
        script = Path(__file__).with_name("grasp_worker.py")
        run = f"import runpy; runpy.run_path({str(script)!r}, run_name='__main__')"
        self.root = root
        self.told = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", run, str(root.resolve()), str(inputs), device],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.told,
            text=True,
            start_new_session=True,
            cwd=inputs.parent,
        )

    def call(self, count: int, closure: str) -> tuple[float, float]:
        """Seconds of one call, and the share that converged.

        Raises:
            WrodError: the process has ended.
        """
        process = self.process
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(f"{count} {closure}\n")
            process.stdin.flush()
        except BrokenPipeError:
            pass
        for line in process.stdout:
            if line.startswith("seconds "):
                _, seconds, converged = line.split()
                return float(seconds), float(converged)
        self.told.seek(0)
        why = (self.told.read().splitlines() or ["it ended"])[-1][:300]
        raise WrodError(f"{self.root}: its wrod did not solve {count} grasps ({why})")

    def end(self) -> None:
        self.told.close()
        self.process.kill()
        self.process.wait()


def compare(
    other: Path, counts: list[int], closures: tuple[str, ...], device: str, patience: float
) -> Iterator[dict]:
    """A row for every count and closure, as they are measured: grasps/s of the other checkout and
    of this one.

    Each solves once to compile and to warm up, then both in turn, `CALLS` times, or as often as
    one comes to in `patience` seconds.

    Raises:
        WrodError: the folder is no checkout, or a process ended early.
    """
    if not (other / "wrod" / "__init__.py").is_file():
        raise WrodError(f"{other}: is no checkout of wrod, which has a folder wrod; give another")
    here = Path(__file__).resolve().parents[2]
    with tempfile.TemporaryDirectory() as folder:
        inputs = Path(folder) / "inputs.npz"
        np.savez(inputs, *whole_range(max(counts)))
        workers = {"other": _Worker(other, inputs, device), "this": _Worker(here, inputs, device)}
        try:
            for closure in closures:
                for worker in workers.values():
                    worker.call(16, closure)
            for count in counts:
                for closure in closures:
                    yield _row(workers, count, closure, patience)
        finally:
            for worker in workers.values():
                worker.end()


def _row(workers: dict[str, _Worker], count: int, closure: str, patience: float) -> dict:
    warm = {name: worker.call(count, closure) for name, worker in workers.items()}
    longest = min(_LONG, patience)
    seconds = {name: [took] if took > longest else [] for name, (took, _) in warm.items()}
    for _ in range(CALLS):
        for name, worker in workers.items():
            taken, (took, _) = seconds[name], warm[name]
            if not taken or (len(taken) < CALLS and took + sum(taken) < patience):
                taken.append(worker.call(count, closure)[0])
    row: dict = {"grasps": count, "closure": closure}
    for name, taken in seconds.items():
        row[name] = {
            "per_second": count / statistics.median(taken),
            "calls": len(taken),
            "converged": warm[name][1],
        }
    return row


def line(row: dict) -> str:
    old, new = row["other"], row["this"]
    return (
        f"{row['grasps']:8d} {row['closure']:>13} {old['per_second']:12.0f} "
        f"{old['calls']:5d} {old['converged']:9.5f} {new['per_second']:12.0f} "
        f"{new['calls']:5d} {new['converged']:9.5f} {new['per_second'] / old['per_second']:6.1f}"
    )
