"""`wrod bench table3`: the paper's accuracy table, laid in simulation. Restartable."""

from __future__ import annotations

import json
import time
from itertools import product
from pathlib import Path

import click


@click.command(name="table3")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option("--trials", default=10, show_default=True, help="Trials a cell.")
@click.option(
    "--patterns",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
)
@click.option("--speed", default=0.02, show_default=True, help="Speed of the contact [m/s].")
@click.option("--step", default=0.01, show_default=True, help="Largest time step [s].")
@click.option("--spacing", default=0.005, show_default=True, help="Length of the edges [m].")
@click.option("--batch", type=int, help="Trials simulated at once; default: 32, CUDA all.")
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    out: Path,
    trials: int,
    patterns: Path | None,
    speed: float,
    step: float,
    spacing: float,
    batch: int | None,
    device: str,
    as_json: bool,
) -> None:
    """Rods 1-3 x fabric, steel, foam x seven patterns x {INT, OPT} x ten trials.

    Finished trials are kept in OUT/trials.jsonl: a run that was stopped goes on from there.
    """
    from tqdm import tqdm

    from wrod.batch import resolve_device
    from wrod.bench import machine_line
    from wrod.bench.table3_paper import METHODS, PATTERNS, RODS, SUBSTRATES, read_pattern
    from wrod.bench.table3_report import Ledger, cells, draw, markdown, summary, write_csv
    from wrod.deployment import nodes_needed, simulate_deployments
    from wrod.errors import RodError

    if trials < 1:
        raise RodError(f"trials is {trials}; give 1 or more")
    device = resolve_device(device)
    settings = {
        "speed": speed,
        "step": step,
        "spacing": spacing,
        "patterns": "built-in" if patterns is None else patterns.name,
    }
    out.mkdir(parents=True, exist_ok=True)
    ledger = Ledger(out / "trials.jsonl", settings)
    curves = {name: read_pattern(name, patterns) for name in PATTERNS}
    start = time.perf_counter()
    plans = _plans(curves, device, as_json)
    # One trial of every cell before the second of any, so that a stopped run covers the table.
    keys = [
        (rod, substrate, name, method, trial)
        for trial, rod, substrate, name, method in product(
            range(trials), RODS, SUBSTRATES, PATTERNS, METHODS
        )
    ]
    done = ledger.done()
    pending = [key for key in keys if key not in done]
    nodes = nodes_needed([_trial(key, plans) for key in keys[: len(keys) // trials]], spacing)
    size = batch or (32 if device == "cpu" else max(len(pending), 1))
    planned = time.perf_counter()
    with tqdm(
        total=len(keys), initial=len(keys) - len(pending), unit="trial", disable=as_json,
        bar_format="{desc}{percentage:3.0f}% |{bar}| {elapsed} < {remaining}",
    ) as bar:  # fmt: skip
        for first in range(0, len(pending), size):
            part = pending[first : first + size]
            deployments = simulate_deployments(
                [_trial(key, plans) for key in part],
                speed=speed,
                step=step,
                spacing=spacing,
                node_count=nodes,
                device=device,
                progress=lambda fraction, part=part: bar.update(fraction * len(part)),
            )
            ledger.add([_row(k, d, plans) for k, d in zip(part, deployments, strict=True)])
    simulated = time.perf_counter() - planned
    wanted = set(keys)
    rows = [row for row in ledger.rows if _key(row) in wanted]
    table = cells(rows)
    head = (
        f"Simulated accuracy, e_mean ± sigma [cm] (N = 50), {trials} trials a cell; contact speed "
        f"{speed:g} m/s, step {step:g} s, edges {spacing:g} m, patterns {settings['patterns']}."
    )
    text = markdown(table, head)
    (out / "table3.md").write_text(text, encoding="utf-8")
    written = [
        write_csv(out / "table3.csv", table),
        out / "table3.md",
        draw(out / "table3.png", rows, curves),
        ledger.path,
    ]
    steps = sum(row["steps"] for row in rows if _key(row) in set(pending))
    figures = {
        "machine": machine_line(device),
        "device": device,
        "trials": len(rows),
        "simulated_now": len(pending),
        "planning_seconds": planned - start,
        "simulation_seconds": simulated,
        "rod_steps_per_second": steps / simulated if pending else None,
        "nodes": nodes,
        "summary": summary(table),
        "written": [str(path) for path in written],
    }
    if as_json:
        click.echo(json.dumps(figures, indent=2))
        return
    click.echo(figures["machine"])
    click.echo(
        f"{len(pending)} trials of {nodes} nodes on {device} in {simulated:.1f} s "
        f"(plans {planned - start:.1f} s)"
        + (f", {steps / simulated:.0f} rod steps per second" if pending else "")
    )
    for line in figures["summary"]:
        click.echo(line)
    for path in written:
        click.echo(f"wrote {path}")


def _plans(curves: dict, device: str, quiet: bool) -> dict:
    """(rod, pattern, method) -> pattern with remainder, rod, trajectory, tail."""
    from tqdm import tqdm

    from wrod.bench.table3_paper import METHODS, RODS
    from wrod.deployment import with_remainder_of
    from wrod.deployment_setup import tail
    from wrod.material import rod
    from wrod.planner import plan

    plans = {}
    jobs = list(product(RODS, curves, METHODS))
    for name, curve, method in tqdm(jobs, desc="plans", leave=False, disable=quiet):
        material = rod(name)
        trajectory = plan(curves[curve], material, method, device=device)
        led = with_remainder_of(curves[curve], trajectory)
        plans[name, curve, method] = (led, material, trajectory, tail(led, material, trajectory))
    return plans


def _key(row: dict) -> tuple:
    from wrod.bench.table3_report import KEYS

    return tuple(row[key] for key in KEYS)


def _trial(key: tuple, plans: dict):
    """INT and OPT meet the same disturbances, every cell others."""
    from wrod.bench.table3_paper import PATTERNS, RODS, SUBSTRATES, friction
    from wrod.deployment import Trial
    from wrod.deployment_setup import Disturbance
    from wrod.substrate import Friction

    rod, substrate, name, method, trial = key
    cell = (RODS.index(rod) * 3 + SUBSTRATES.index(substrate)) * 7 + PATTERNS.index(name)
    curve, material, trajectory, rest = plans[rod, name, method]
    return Trial(
        curve,
        material,
        trajectory,
        Friction(friction(rod, substrate)),
        Disturbance.random(1000 * cell + trial),
        rest,
    )


def _row(key: tuple, deployment, plans: dict) -> dict:
    """What is kept of a trial: figures [cm], and the laid curve at 60 points [m]."""
    import numpy as np

    from wrod.bench.table3_report import KEYS

    curve = plans[key[0], key[2], key[3]][0]
    s = np.linspace(0.0, curve.length, 60) + curve.remainder_length
    laid = [np.interp(s, deployment.arc_length, deployment.centerline[:, c]) for c in range(2)]
    names = ("error_mean", "error_std", "released_error_mean", "released_error_std")
    return {
        **dict(zip(KEYS, key, strict=True)),
        **{name: 100.0 * getattr(deployment, name) for name in names},
        "slip": 100.0 * float(deployment.slip.max()),
        "diverged": deployment.diverged,
        "steps": deployment.steps,
        "curve": np.round(np.column_stack(laid), 5).tolist(),
    }
