"""Kill commands at random moments, run them again until they end, and compare what they leave.

    python tests/killing.py --kills 100 --only train

Each command is run once to its end, then again in another folder where it is killed (SIGKILL) at
random moments and started anew, as a user would. What both leave must be the same bytes, but for
times, machine and paths in JSON.
"""

from __future__ import annotations

import hashlib
import json
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click

COMMANDS = {
    "dataset": "dataset --size 1500 --shard-size 128 --no-sensitivities --device cpu --out {out}",
    "train": "train --dataset {data} --out {out} --steps 1500 --width 32 --batch 256 --test 50 "
    "--device cpu",
    "deploy": "deploy line --rod green-vps --method intuitive --trials 2 --speed 0.1 --device cpu "
    "--out {out}",
    "table3": "bench table3 --trials 1 --spacing 0.03 --step 0.05 --speed 0.2 --batch 6 "
    "--closure zero_tension --device cpu --out {out}",
    "identify": "bench identify --hidden 1 --only straight --out {out}",
    "applications": "bench applications --case U-cable --trials 1 --batch 1 --device cpu "
    "--out {out}",
}
# What differs from run to run without any kill.
_TIMES = re.compile(
    r'"(seconds|cpu_seconds|machine|command|dataset_command|resumed|rate)": *("[^"]*"|[^,}\n]*)'
)


def same(folder: Path) -> dict[str, str]:
    """Digest of every file, without times."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.name.endswith((".png", "checkpoint.pt")):
            content = path.read_bytes()
            if path.suffix == ".safetensors":
                content = _tensors(path)
            if path.suffix in (".json", ".jsonl", ".md"):
                text = _TIMES.sub("", content.decode())
                text = re.sub(r"^.*(cores|seconds| s ).*$", "", text, flags=re.M)
                content = "\n".join(sorted(text.splitlines())).encode()
            if path.name == "history.csv":
                rows = [row.split(",") for row in content.decode().splitlines()]
                content = "\n".join(",".join(row[:1] + row[2:]) for row in rows).encode()
            found[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()[:16]
    return found


def _tensors(path: Path) -> bytes:
    """A safetensors file without the times in its label."""
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    label = json.loads(content[8 : 8 + size])
    text = label.pop("__metadata__", {}).get("wrod", "{}")
    return json.dumps(label).encode() + _TIMES.sub("", text).encode() + content[8 + size :]


def start(words: str) -> subprocess.Popen:
    call = [sys.executable, "-m", "wrod", *words.split()]
    return subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def killed(name: str, words: str, folder: Path, kills: int, draw: random.Random) -> bool:
    """Whether a run with that many kills ends as one without."""
    whole, parts = folder / f"{name}-whole", folder / f"{name}-parts"
    data = folder / "dataset-whole"
    begin = time.monotonic()
    run = start(words.format(out=whole, data=data))
    _, said = run.communicate()
    if run.returncode != 0:
        raise click.ClickException(f"{name} ended with {run.returncode}: {said[-500:]}")
    took, done = time.monotonic() - begin, 0
    for _ in range(kills):
        run = start(words.format(out=parts, data=data))
        try:
            run.wait(draw.uniform(0.05, 1.0) * took)
            break  # it was faster than the kill
        except subprocess.TimeoutExpired:
            run.send_signal(signal.SIGKILL)
            run.communicate()
            done += 1
    run = start(words.format(out=parts, data=data))
    _, said = run.communicate()
    a, b = same(whole), same(parts)
    differ = sorted(k for k in a.keys() | b.keys() if a.get(k) != b.get(k))
    good = run.returncode == 0 and not differ
    click.echo(
        f"{name}: {took:.0f} s whole, {done} kills, "
        + ("same bytes" if good else f"exit {run.returncode}, differ: {differ} {said[-300:]}")
    )
    return good


@click.command()
@click.option("--kills", default=100, show_default=True, help="In all.")
@click.option("--seed", default=0, show_default=True)
@click.option("--only", multiple=True, type=click.Choice(list(COMMANDS)))
def main(kills: int, seed: int, only: tuple[str, ...]) -> None:
    """Kill, resume, compare."""
    names = only or tuple(COMMANDS)
    if "train" in names and "dataset" not in names:
        names = ("dataset", *names)
    draw = random.Random(seed)
    each = -(-kills // len(names))
    with tempfile.TemporaryDirectory() as folder:
        good = [killed(n, COMMANDS[n], Path(folder), each, draw) for n in names]
    sys.exit(not all(good))


if __name__ == "__main__":
    main()
