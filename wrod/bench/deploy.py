"""`wrod bench deploy`: what one simulated deployment costs, and how it converges."""

from __future__ import annotations

import json
import time

import click


@click.command(name="deploy")
@click.option("--pattern", "name", default="letter-U", show_default=True, help="Pattern.")
@click.option("--rod", "rod_name", default="green-vps", show_default=True, help="Rod.")
@click.option("--friction", default=0.6, show_default=True, help="Friction coefficient.")
@click.option("--batch", default=8, show_default=True, help="Rods of the batch that is timed.")
@click.option(
    "--levels", default=3, show_default=True, help="Meshes and steps, each half the last."
)
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    name: str,
    rod_name: str,
    friction: float,
    batch: int,
    levels: int,
    device: str,
    as_json: bool,
) -> None:
    """Time one deployment and a batch on one thread; halve edges, steps and speed."""
    import numpy as np

    from wrod.batch import resolve_device
    from wrod.bench import machine_line
    from wrod.deployment import Trial, simulate_deployments, with_remainder_of
    from wrod.deployment_setup import Disturbance, tail
    from wrod.material import rod
    from wrod.patterns import pattern
    from wrod.planner import plan
    from wrod.substrate import Friction

    device = resolve_device(device)
    material, curve = rod(rod_name), pattern(name)
    path = plan(curve, material, "numeric", device="cpu")
    curve = with_remainder_of(curve, path)
    rest = tail(curve, material, path)

    def simulate(count: int = 1, **options):
        trials = [
            Trial(
                curve, material, path, Friction(friction),
                Disturbance() if count == 1 else Disturbance.random(k), rest,
            )
            for k in range(count)
        ]  # fmt: skip
        clock, cpu = time.perf_counter(), time.process_time()
        deployments = simulate_deployments(trials, device=device, threads=1, **options)
        wall, cpu = time.perf_counter() - clock, time.process_time() - cpu
        steps = sum(d.steps for d in deployments)
        return deployments[0], {
            **options,
            "rods": count,
            "nodes": len(deployments[0].arc_length),
            "steps": steps,
            "error_mean": 100 * deployments[0].error_mean,
            "seconds": wall,
            "cpu_seconds": cpu,
            "rod_steps_per_second": steps / wall,
            "diverged": sum(d.diverged for d in deployments),
        }

    simulate(spacing=0.02, speed=0.2, step=0.05)  # compile the kernels outside the clock
    rows = {"speed": [simulate()[1], simulate(batch)[1]]}
    s = np.linspace(0.0, curve.length, 200) + curve.remainder_length
    for what, first in (("spacing", 0.01), ("step", 0.04), ("speed", 0.04)):
        study, curves = [], []
        for level in range(levels):
            options = {what: first / 2**level}
            if what == "speed":
                # Slower and slower the deployment becomes a sequence of equilibria.
                options["step"] = 0.01 * 2**level
            laid, row = simulate(**options)
            curves.append([np.interp(s, laid.arc_length, laid.centerline[:, c]) for c in range(2)])
            change = None
            if level:
                change = 100 * float(np.hypot(*np.subtract(curves[-1], curves[-2])).max())
            study.append({**row, "change_cm": change})
        rows[f"convergence in {what}"] = study
    figures = {"machine": machine_line(device), "device": device, "rows": rows}
    if as_json:
        click.echo(json.dumps(figures))
        return
    click.echo(figures["machine"])
    click.echo(f"{material.length} m of {rod_name} along {name}, friction {friction:g}, {device}")
    for row in rows["speed"]:
        click.echo(
            f"{row['rods']} rods of {row['nodes']} nodes: {row['seconds']:.2f} s "
            f"(cpu {row['cpu_seconds']:.2f} s), {row['steps']} rod steps, "
            f"{row['rod_steps_per_second']:.0f} per second"
        )
    for title, study in list(rows.items())[1:]:
        what = title.split()[-1]
        click.echo(f"{title}: largest change of the laid curve from the line before")
        for row in study:
            change = "" if row["change_cm"] is None else f"{row['change_cm']:.4f} cm"
            click.echo(
                f"  {what} {row[what]:<8g} error {row['error_mean']:.4f} cm  change "
                f"{change:<10}  cpu {row['cpu_seconds']:.1f} s"
            )
