"""`wrod bench loop`: a rod with an unknown effect is measured, understood, and laid better."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import click

EFFECTS = ("natural_curvature", "stiffness")


@click.command(name="loop")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option(
    "--effect", "effects", multiple=True, type=click.Choice(EFFECTS), help="Default: both."
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
@click.option("--friction", default=1.0, show_default=True, help="Friction coefficient.")
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
    friction: float,
    speed: float,
    step: float,
    spacing: float,
    seed: int,
    device: str,
    as_json: bool,
) -> None:
    """Close the loop on a rod that has an effect nobody declared.

    For each effect: synthetic measurements of the true rod between two clamps, identification that
    is not told the effect, plans with the old and with the identified model, and simulated
    deployments of the true rod with both, beside those of a rod without the effect.
    """
    from tqdm import tqdm

    from wrod.batch import resolve_device
    from wrod.bench import machine_line
    from wrod.bench.loop_report import draw, markdown, summary, write_csv
    from wrod.bench.table3_paper import PATTERNS, read_pattern
    from wrod.deployment import simulate_deployments
    from wrod.material import rod

    device, believed = resolve_device(device), rod(rod_name)
    curves = {name: read_pattern(name, patterns) for name in names or PATTERNS}
    true = {
        "natural_curvature": replace(believed, natural_curvature=(curvature, 0.0)),
        "stiffness": replace(
            believed, gravito_bending_length=(1.0 + lgb_error) * believed.gravito_bending_length
        ),
    }
    clock, cases, written = time.perf_counter(), {}, []
    for effect in effects or EFFECTS:
        report = _identified(true[effect], believed, trials, noise, seed, candidates, device)
        written += report.save(out / effect)
        cases[effect] = (true[effect], report)
    identified = time.perf_counter()
    jobs = {}
    for name, curve in tqdm(curves.items(), desc="plans", leave=False, disable=as_json):
        jobs |= _trials(name, curve, believed, cases, friction)
    planned = time.perf_counter()
    shown = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
    with tqdm(total=100, leave=False, desc="laid", disable=as_json, bar_format=shown) as bar:
        laid = simulate_deployments(
            list(jobs.values()), speed=speed, step=step, spacing=spacing, device=device,
            progress=lambda fraction: bar.update(min(100 * fraction, bar.total - bar.n)),
        )  # fmt: skip
    simulated = time.perf_counter()
    rows = [_row(key, jobs[key], d) for key, d in zip(jobs, laid, strict=True)]
    found = {effect: _found(*case) for effect, case in cases.items()}
    head = (
        f"Simulated deployments of {rod_name}, e_mean ± sigma [cm] (N = 50); friction "
        f"{friction:g}, contact speed {speed:g} m/s, step {step:g} s, edges {spacing:g} m, "
        f"{'built-in patterns' if patterns is None else 'patterns of a folder'}."
    )
    text = markdown(rows, found, head)
    (out / "loop.md").write_text(text, encoding="utf-8")
    written += [
        write_csv(out / "loop.csv", rows),
        out / "loop.md",
        draw(out / "loop.png", rows, curves),
    ]
    figures = {
        "machine": machine_line(device),
        "device": device,
        "found": found,
        "summary": summary(rows),
        "seconds": {
            "identification": identified - clock,
            "plans": planned - identified,
            "deployments": simulated - planned,
        },
        "rows": [{k: v for k, v in row.items() if k != "curve"} for row in rows],
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


def _identified(true, believed, trials, noise, seed, candidates, device):
    """Report of an identification that knows the measurements and the believed rod only."""
    from wrod.identification import identify
    from wrod.identification.measurements import measurements_from_arrays
    from wrod.identification.synthetic import clamped_experiment

    data = clamped_experiment(true, believed, trials=trials, noise=noise, seed=seed)
    measurements = measurements_from_arrays(data, name="synthetic")
    return identify(measurements, candidates=candidates or None, device=device)


def _found(true, report) -> dict:
    """What the identification said, beside the truth."""
    return {
        "verdict": report.verdict,
        "before_mm": 1e3 * report.before,
        "after_mm": 1e3 * report.after,
        "noise_floor_mm": 1e3 * report.noise_floor,
        "effects": {
            e.name: {key: asdict(value) for key, value in e.parameters.items()}
            for e in report.effects
        },
        "true": {
            "natural_curvature": list(true.natural_curvature),
            "gravito_bending_length": true.gravito_bending_length,
        },
        "model": {
            "natural_curvature": list(report.material.natural_curvature),
            "gravito_bending_length": report.material.gravito_bending_length,
        },
    }


def _trials(name: str, curve, believed, cases: dict, friction: float) -> dict:
    """Deployments along one pattern by (effect, pattern, plan): old, new, and none of the effect.

    Old and new plan hold the rod at the same roll, so that only the grasps differ.
    """
    from wrod.deployment import Trial, with_remainder_of
    from wrod.deployment_setup import tail
    from wrod.planner import plan
    from wrod.substrate import Friction

    def trial(rod, model, method, roll=None):
        path = plan(curve, model, method, roll=roll, device="cpu")
        led = with_remainder_of(curve, path)
        return Trial(led, rod, path, Friction(friction), tail=tail(led, model, path))

    jobs = {("none", name, "old"): trial(believed, believed, "neural")}
    for effect, (true, report) in cases.items():
        model = replace(report.material, length=believed.length)
        new = trial(true, model, "auto")
        old = trial(true, believed, "neural", new.trajectory.metadata["roll"])
        jobs[effect, name, "old"], jobs[effect, name, "new"] = old, new
    return jobs


def _row(key: tuple[str, str, str], trial, deployment) -> dict:
    """Figures [cm] of a deployment, and the laid curve at 60 points [m]."""
    import numpy as np

    from wrod.friction import friction_bound

    curve = trial.pattern
    bound = friction_bound(curve, trial.rod)
    s = np.linspace(0.0, curve.length, 60) + curve.remainder_length
    laid = [np.interp(s, deployment.arc_length, deployment.centerline[:, c]) for c in range(2)]
    names = ("error_mean", "error_std", "released_error_mean", "released_error_std")
    return {
        **dict(zip(("effect", "pattern", "plan"), key, strict=True)),
        "method": trial.trajectory.metadata["method"],
        **{name: 100.0 * getattr(deployment, name) for name in names},
        "lacking_friction": float(np.mean(bound.required > trial.friction.static)),
        "slip": 100.0 * float(deployment.slip.max()),
        "diverged": deployment.diverged,
        "curve": np.round(np.column_stack(laid), 5).tolist(),
    }
