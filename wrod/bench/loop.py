"""`wrod bench loop`: a rod with an unknown effect is measured, understood, and laid better."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from wrod.bench.loop_trials import CONTROLLERS
from wrod.commands.options import read_roll

EFFECTS = ("natural_curvature", "stiffness", "varied")


@click.command(name="loop")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option(
    "--effect", "effects", multiple=True, type=click.Choice(EFFECTS), help="Default: all."
)
@click.option("--pattern", "names", multiple=True, help="Pattern (repeatable); default: seven.")
@click.option(
    "--patterns",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
)
@click.option("--rod", "rod_name", default="green-vps", show_default=True, help="Believed rod.")
@click.option("--curvature", default=4.0, show_default=True, help="Natural curvature [1/m].")
@click.option("--lgb-error", default=0.15, show_default=True, help="Of the believed L_gb.")
@click.option("--trials", default=16, show_default=True, help="Clamped shapes measured.")
@click.option("--noise", default=3e-4, show_default=True, help="Of a marker coordinate [m].")
@click.option(
    "--candidate", "candidates", multiple=True,
    help="Let the identification try this effect only (repeatable); default: all it knows.",
)  # fmt: skip
@click.option(
    "--controller",
    "controllers",
    multiple=True,
    type=click.Choice(CONTROLLERS),
    help="Who plans (repeatable); default: network, and default: what `wrod plan` does unasked.",
)
@click.option(
    "--grasps", default=2048, show_default=True, help="That a curved rod's network learns."
)
@click.option("--steps", type=click.IntRange(min=1), help="Of its training; default: the recipe's.")
@click.option("--friction", default=1.0, show_default=True, help="Friction coefficient.")
@click.option("--rolling", is_flag=True, help="Let the laid rod roll freely.")
@click.option(
    "--roll",
    "roll_text",
    default="plane",
    show_default=True,
    help="How all plans hold the rod: plane, as one would by accident who knows of no curvature, "
    "up, or degrees (see `wrod plan`).",
)
@click.option("--speed", default=0.03, show_default=True, help="Speed of the contact [m/s].")
@click.option("--step", default=0.02, show_default=True, help="Largest time step [s].")
@click.option("--spacing", default=0.006, show_default=True, help="Length of the edges [m].")
@click.option("--seed", default=0, show_default=True, help="Of poses and noise.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    out: Path,
    effects: tuple[str, ...],
    names: tuple[str, ...],
    patterns: Path | None,
    rod_name: str,
    curvature: float,
    lgb_error: float,
    trials: int,
    noise: float,
    candidates: tuple[str, ...],
    controllers: tuple[str, ...],
    grasps: int,
    steps: int | None,
    friction: float,
    rolling: bool,
    roll_text: str,
    speed: float,
    step: float,
    spacing: float,
    seed: int,
    device: str,
    as_json: bool,
) -> None:
    """Close the loop on a rod that has an effect nobody declared.

    For each effect: synthetic measurements of the true rod between two clamps (a continuous rod by
    collocation), identification that is not told the effect, a network trained for the identified
    rod where that is curved, plans with the old and with the identified model, and simulated
    deployments of the true rod with both, beside those of a rod without the effect.
    """
    from tqdm import tqdm

    from wrod.bench.loop_report import draw, markdown, summary, write_csv
    from wrod.bench.loop_trials import (
        Case,
        identified,
        network_for,
        row,
        trials_along,
        varied_rod,
        with_length,
    )
    from wrod.bench.table3_paper import PATTERNS, read_pattern
    from wrod.deployment.simulate import simulate_deployments
    from wrod.files import write_atomically
    from wrod.machine import machine_line
    from wrod.rods.batch import resolve_device
    from wrod.rods.material import rod
    from wrod.solvers.contact import Friction

    device, believed = resolve_device(device), rod(rod_name)
    curves = {name: read_pattern(name, patterns) for name in names or PATTERNS}
    true = {
        "natural_curvature": replace(believed, natural_curvature=(curvature, 0.0)),
        "stiffness": replace(
            believed, gravito_bending_length=(1.0 + lgb_error) * believed.gravito_bending_length
        ),
        "varied": varied_rod(believed),
    }
    controllers = controllers or ("network", "default")
    seconds, cases, written = {}, {}, []
    shown = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
    with _timed(seconds, "identification"):
        reports = {
            effect: identified(true[effect], believed, trials, noise, seed, candidates, device)
            for effect in tqdm(effects or EFFECTS, desc="identify", leave=False, disable=as_json)
        }
    for effect, report in reports.items():
        written += report.save(out / effect)
        model, network = with_length(report.model, believed), None
        roll = read_roll(roll_text, model)
        if "network" in controllers:
            with (
                _timed(seconds, "training"),
                tqdm(
                    total=100, leave=False, desc="train", disable=as_json, bar_format=shown
                ) as bar,
            ):
                network = network_for(
                    model, out / effect, roll=roll, grasps=grasps, steps=steps, seed=seed,
                    device=device,
                    progress=lambda share, bar=bar: bar.update(100 * share - bar.n),
                )  # fmt: skip
        if network is not None:
            written.append(out / effect / "controller.safetensors")
        cases[effect] = Case(true[effect], report, model, network, roll)
    jobs, law = {}, Friction(friction, rolling=rolling)
    with _timed(seconds, "plans"):
        for name, curve in tqdm(curves.items(), desc="plans", leave=False, disable=as_json):
            jobs |= trials_along(name, curve, believed, cases, controllers, law)
    with (
        _timed(seconds, "deployments"),
        tqdm(total=100, leave=False, desc="laid", disable=as_json, bar_format=shown) as bar,
    ):
        laid = simulate_deployments(
            list(jobs.values()), speed=speed, step=step, spacing=spacing, device=device,
            progress=lambda fraction: bar.update(min(100 * fraction, bar.total - bar.n)),
        )  # fmt: skip
    rows = [row(key, jobs[key], d) for key, d in zip(jobs, laid, strict=True)]
    found = {effect: _found(case) for effect, case in cases.items()}
    head = (
        f"Simulated deployments of {rod_name}, e_mean ± sigma [cm] (N = 50); friction "
        f"{friction:g}{', rolling freely' if rolling else ''}, roll {roll_text}, "
        f"contact speed {speed:g} m/s, step {step:g} s, edges {spacing:g} m, "
        f"{'built-in patterns' if patterns is None else 'patterns of a folder'}."
    )
    text = markdown(rows, found, head)
    write_atomically(out / "loop.md", lambda file: file.write(text))
    written += [
        write_csv(out / "loop.csv", rows),
        out / "loop.md",
        draw(out / "loop.png", rows, curves),
    ]
    figures: dict[str, Any] = {
        "machine": machine_line(device),
        "device": device,
        "found": found,
        "summary": summary(rows),
        "seconds": seconds,
        "rows": [{k: v for k, v in one.items() if k != "curve"} for one in rows],
        "written": [str(path) for path in written],
    }
    if as_json:
        click.echo(json.dumps(figures, indent=2))
        return
    click.echo(figures["machine"])
    click.echo(text)
    parts = ", ".join(f"{name} {value:.0f} s" for name, value in figures["seconds"].items())
    click.echo(parts)
    for path in written:
        click.echo(f"wrote {path}")


@contextmanager
def _timed(seconds: dict[str, float], what: str):
    """Add how long something took [s]."""
    clock = time.perf_counter()
    yield
    seconds[what] = seconds.get(what, 0.0) + time.perf_counter() - clock


def _found(case) -> dict:
    """What the identification said, beside the truth, and how well its network learnt."""
    true, report = case.true, case.report
    learnt = None
    if case.network is not None:
        metadata = case.network.metadata
        learnt = {key: metadata[key] for key in ("samples", "steps", "seconds", "held_out")}
    return {
        "network": learnt,
        "verdict": report.verdict,
        "before_mm": 1e3 * report.before,
        "after_mm": 1e3 * report.after,
        "noise_floor_mm": 1e3 * report.noise_floor,
        "effects": {
            e.name: {key: asdict(value) for key, value in e.parameters.items()}
            for e in report.effects
        },
        "set_aside": list(report.found.set_aside),
        "rod_has": list(report.model.not_uniform()),
        "true": {
            "natural_curvature": list(true.curvature_held(0.0)),
            "gravito_bending_length": true.gravito_bending_length,
        },
        "model": {
            "natural_curvature": list(report.material.natural_curvature),
            "gravito_bending_length": report.material.gravito_bending_length,
        },
    }
