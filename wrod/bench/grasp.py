"""`wrod bench grasp`: cold grasps per second over the whole range, and how cost grows."""

from __future__ import annotations

import json
import time

import click


def whole_range(count: int, seed: int = 0):
    """(l_s, kappa, k_s): l_s uniform and log-uniform in 1...50, k_s log-uniform."""
    import numpy as np

    rng = np.random.default_rng(seed)
    short, long = count // 2, count - count // 2
    ls = np.concatenate([rng.uniform(1, 50, long), np.exp(rng.uniform(0, np.log(50), short))])
    kappa = rng.uniform(-3.5, 3.5, count)
    return ls, kappa, np.exp(rng.uniform(np.log(150), np.log(15000), count))


@click.command(name="grasp")
@click.option("--count", default=512, show_default=True, help="Grasps in the main measurement.")
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--threads", default=1, show_default=True, help="CPU threads.")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def command(count: int, device: str, threads: int, as_json: bool) -> None:
    """Cold starts over l_s 1..50, |kappa| 0..3.5, k_s 150..15000."""
    from wrod.grasps.optimal import CLOSURES, EDGE_COUNT, solve_grasps
    from wrod.machine import machine_line
    from wrod.rods.batch import resolve_device

    device = resolve_device(device)

    def measure(n: int, **options) -> dict:
        inputs = whole_range(n)
        clock, cpu = time.perf_counter(), time.process_time()
        grasps = solve_grasps(*inputs, device=device, threads=threads, **options)
        wall, cpu = time.perf_counter() - clock, time.process_time() - cpu
        return {
            "grasps": n,
            "edges": options.get("edge_count", EDGE_COUNT),
            "closure": options.get("closure", "zero_tension"),
            "per_second": n / wall,
            "cpu_seconds_per_grasp": cpu / n,
            "converged": float(grasps.converged.mean()),
            "iterations": float(grasps.iterations.mean()),
        }

    for closure in CLOSURES:  # compile the kernels outside the clock
        solve_grasps([5.0], [0.5], [1000.0], closure=closure, device=device)
    rows = [measure(n) for n in (count // 4, count // 2, count)]
    rows += [measure(count // 2, edge_count=n) for n in (64, 256)]
    rows += [measure(count // 2, closure=c) for c in ("min_force", "min_friction")]
    figures = {"machine": machine_line(device), "device": device, "rows": rows}
    if as_json:
        click.echo(json.dumps(figures))
        return
    click.echo(figures["machine"])
    click.echo(f"device {device}, {threads} thread(s); cold starts over the whole range")
    click.echo(
        f"{'grasps':>8} {'edges':>6} {'closure':>13} {'per s':>9} {'cpu ms':>8} "
        f"{'converged':>10} {'iterations':>10}"
    )
    for row in rows:
        click.echo(
            f"{row['grasps']:8d} {row['edges']:6d} {row['closure']:>13} {row['per_second']:9.1f} "
            f"{1e3 * row['cpu_seconds_per_grasp']:8.3f} {row['converged']:10.4f} "
            f"{row['iterations']:10.1f}"
        )
