"""Kill commands at random moments, run them again until they end, and compare what they leave.

    python tests/killing.py --kills 100 --workers 30

Each command is run once to its end, then again in other folders where it is killed (SIGKILL, or
with --interrupt SIGINT) at random moments and started anew, as a user would. What both leave must
be the same bytes, but for times, machine and paths in JSON. An interrupted command has to say so
in one line and end with 130.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

import click

from wrod.identification.template import write_template

COMMANDS = {
    "dataset": "dataset --size 1500 --shard-size 128 --no-sensitivities --device cpu --out {out}",
    "train": "train --dataset {data} --out {out} --steps 2000 --width 32 --batch 256 --test 50 "
    "--device cpu",
    "deploy": "deploy line --rod green-vps --method intuitive --trials 2 --speed 0.2 --device cpu "
    "--out {out}",
    "table3": "bench table3 --rod green-vps --substrate steel --pattern letter-U --trials 6 "
    "--spacing 0.02 --step 0.05 --speed 0.1 --batch 1 --closure zero_tension --device cpu "
    "--out {out}",
    "identify": "bench identify --hidden 1 --only none --out {out}",
    "motion": "identify {folder}/motion.npz --effect quadratic_drag --out {out}",
    "applications": "bench applications --case trefoil --trials 1 --batch 1 --device cpu "
    "--out {out}",
}
# What differs from run to run without any kill.
_TIMES = re.compile(
    r'"(seconds|cpu_seconds|digest|machine|command|dataset_command|resumed|rate)"'
    r': *("[^"]*"|[^,}\n]*)'
)


def same(folder: Path) -> dict[str, str]:
    """Digest of every file, without times; pictures and checkpoints hold them."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.name.endswith((".png", "checkpoint.pt")):
            content = path.read_bytes()
            if path.suffix == ".safetensors":
                content = _tensors(path)
            if path.suffix == ".csv":
                content = _TIMES.sub("", content.decode()).encode()
            if path.suffix in (".json", ".jsonl", ".md"):
                text = _TIMES.sub("", content.decode())
                text = _without_seconds(text)
                text = re.sub(r"^.*(cores|seconds| s ).*$", "", text, flags=re.M)
                content = "\n".join(sorted(text.splitlines())).encode()
            if path.name == "history.csv":
                rows = [row.split(",") for row in content.decode().splitlines()]
                content = "\n".join(",".join(row[:1] + row[2:]) for row in rows).encode()
            found[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()[:16]
    return found


def _without_seconds(text: str) -> str:
    """Markdown without the columns of its tables that tell seconds."""
    lines, drop = [], None
    for line in text.splitlines():
        cells = line.split(" | ")
        if not line.startswith("|"):
            drop = None
        elif drop is None and any("CPU s" in cell for cell in cells):
            drop = next(k for k, cell in enumerate(cells) if "CPU s" in cell)
        if drop is not None and drop < len(cells):
            del cells[drop]
        lines.append(" | ".join(cells))
    return "\n".join(lines)


def _tensors(path: Path) -> bytes:
    """A safetensors file without the times in its label."""
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    label = json.loads(content[8 : 8 + size])
    text = label.pop("__metadata__", {}).get("wrod", "{}")
    return json.dumps(label).encode() + _TIMES.sub("", text).encode() + content[8 + size :]


def start(words: str) -> subprocess.Popen:
    call = [sys.executable, "-m", "wrod", *words.split()]
    single = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    return subprocess.Popen(
        call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env=os.environ | single, preexec_fn=_hear_interruptions,
    )  # fmt: skip


def _hear_interruptions() -> None:
    """What runs in the background of a shell inherits that SIGINT is ignored, and keeps to it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def whole(name: str, folder: Path) -> float:
    """Seconds that the command takes where nothing ends it."""
    begin = time.monotonic()
    run = start(words(name, folder, folder / f"{name}-whole"))
    _, said = run.communicate()
    if run.returncode != 0:
        click.echo(f"{name} ended with {run.returncode}: {said[-500:]}")
    return time.monotonic() - begin


def words(name: str, folder: Path, out: Path) -> str:
    return COMMANDS[name].format(out=out, data=folder / "dataset-whole", folder=folder)


def series(
    name: str,
    number: int,
    folder: Path,
    times: dict[str, float],
    kills: int,
    seed: int,
    interrupt: bool,
    end: float,
) -> tuple[int, list[str]]:
    """Kills that were done in one folder, and what is wrong with what is left in the end."""
    draw = random.Random(f"{seed} {name} {number}")
    parts, done, wrong = folder / f"{name}-{number}", 0, []
    call = words(name, folder, parts)
    for _ in range(kills):
        if time.monotonic() > end:
            break
        begun, run = time.monotonic(), start(call)
        try:
            run.wait(draw.uniform(0.05, 1.0) * times[name])
            if not done:  # the first run of a machine compiles kernels, and is slower
                times[name] = min(times[name], time.monotonic() - begun)
            break
        except subprocess.TimeoutExpired:
            run.send_signal(signal.SIGINT if interrupt else signal.SIGKILL)
            _, said = run.communicate()
            if run.returncode == 0:
                break  # it had ended, and was winding up
            done += 1
        last = said.replace("\r", "\n").strip().splitlines()[-1:]
        if interrupt and (run.returncode != 130 or "Traceback" in said or "inter" not in str(last)):
            wrong.append(f"interrupted, it ended with {run.returncode}: {said[-300:]}")
    if not done:
        return 0, wrong
    run = start(call)
    _, said = run.communicate()
    if run.returncode != 0:
        wrong.append(f"exit {run.returncode}: {said[-300:]}")
    a, b = same(folder / f"{name}-whole"), same(parts)
    differ = sorted(k for k in a.keys() | b.keys() if a.get(k) != b.get(k))
    return done, wrong + ([f"differ: {differ}"] if differ else [])


@dataclass
class Tally:
    """What one command came to."""

    seconds: float
    kills: int = 0
    folders: int = 0
    wrong: list[str] = field(default_factory=list)


@click.command()
@click.option("--kills", default=100, show_default=True, help="In all.")
@click.option("--each", default=3, show_default=True, help="Most kills in one folder.")
@click.option("--seed", default=0, show_default=True)
@click.option("--workers", default=1, show_default=True, help="Commands side by side.")
@click.option("--minutes", default=60.0, show_default=True, help="Begin no folder after that.")
@click.option("--interrupt", is_flag=True, help="SIGINT instead of SIGKILL.")
@click.option("--only", multiple=True, type=click.Choice(list(COMMANDS)))
def main(
    kills: int,
    each: int,
    seed: int,
    workers: int,
    minutes: float,
    interrupt: bool,
    only: tuple[str, ...],
) -> None:
    """Kill, resume, compare."""
    names, end = list(only or COMMANDS), time.monotonic() + 60 * minutes
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(workers) as pool:
        folder, tallies = Path(place), {}
        write_template("motion", folder / "motion.npz")
        if {"train", "dataset"} & set(names):  # training reads it
            tallies["dataset"] = Tally(whole("dataset", folder))
        others = [name for name in names if name not in tallies]
        for name, took in zip(others, pool.map(lambda n: whole(n, folder), others), strict=True):
            tallies[name] = Tally(took)
        tallies = {name: tallies[name] for name in names}
        click.echo("whole: " + ", ".join(f"{n} {t.seconds:.0f} s" for n, t in tallies.items()))
        wanted, times = -(-kills // len(names)), {n: t.seconds for n, t in tallies.items()}
        # The slowest begin first; a folder whose command was faster than its kill asks for another.
        slowest = sorted(names, key=lambda name: -tallies[name].seconds)
        jobs: dict[Future, str] = {}

        def begin(name: str, count: int) -> None:
            tally = tallies[name]
            for _ in range(count):
                number, tally.folders = tally.folders, tally.folders + 1
                arguments = (name, number, folder, times, each, seed, interrupt, end)
                jobs[pool.submit(series, *arguments)] = name

        for name in slowest:
            begin(name, -(-wanted // each))
        while jobs:
            for job in wait(jobs, return_when=FIRST_COMPLETED).done:
                name, (done, said) = jobs.pop(job), job.result()
                tally = tallies[name]
                tally.kills, tally.wrong = tally.kills + done, tally.wrong + said
                at_work = sum(other == name for other in jobs.values())
                click.echo(f"{name}: {tally.kills} kills, {at_work} folders at work", err=True)
                if not at_work and tally.kills < wanted and time.monotonic() < end:
                    begin(name, -(-(wanted - tally.kills) // each))
    click.echo(f"{'command':14} {'whole s':>8} {'kills':>6} {'folders':>8}  same bytes")
    for name, tally in tallies.items():
        verdict = "no: " + "; ".join(sorted(set(tally.wrong)))[:3000] if tally.wrong else "yes"
        click.echo(f"{name:14} {tally.seconds:8.0f} {tally.kills:6} {tally.folders:8}  {verdict}")
    click.echo(f"{sum(tally.kills for tally in tallies.values())} kills")
    sys.exit(any(tally.wrong for tally in tallies.values()))


if __name__ == "__main__":
    main()
