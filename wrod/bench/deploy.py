"""`wrod bench deploy`: what one simulated deployment costs, and how it converges."""

import time
from collections.abc import Iterator

import click

from wrod import cost
from wrod.machine import machine_line
from wrod.options import option, own_options
from wrod.telling import json_option, tell

# What is halved in each study of convergence, and where it begins.
STUDIES = {
    "spacing": {"spacing": 0.01},
    "step": {"step": 0.04},
    "step by euler": {"step": 0.04},
    "spacing and step": {"spacing": 0.01, "step": 0.04},
    "speed": {"speed": 0.04},
}


@click.command(name="deploy")
@own_options
@json_option
def command(
    name: str = option("Pattern.", "--pattern", default="letter-U"),
    rod_name: str = option("Rod.", "--rod", default="green-vps"),
    friction: float = option("Friction coefficient.", default=0.6),
    batch: int = option("Rods of the batch that is timed.", default=8),
    levels: int = option("Meshes and steps, each half the last.", default=3),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
) -> None:
    """Time one deployment and a batch on one thread; halve edges, steps of second and of first
    order, both, and speed."""
    from wrod.bench.campaign import points_of
    from wrod.deployment.discretisation import Discretisation
    from wrod.deployment.plan import plan
    from wrod.deployment.setup import Disturbance
    from wrod.deployment.simulate import Trial, simulate_deployments, with_remainder_of
    from wrod.patterns.named import pattern
    from wrod.planning.tail import tail
    from wrod.rods.catalogue import rod
    from wrod.rods.device import resolve_device
    from wrod.solvers.friction import Friction

    device = resolve_device(device)
    material, curve = rod(rod_name), pattern(name)
    _settle(material.length, batch, levels, device)
    path = plan(curve, material, "numeric", device="cpu")
    curve = with_remainder_of(curve, path)
    rest = tail(curve, material, path)

    def simulate(count: int = 1, **options):
        cut = {name: value for name, value in options.items() if name != "speed"}
        trials = [
            Trial(
                curve, material, path, Friction(friction),
                Disturbance() if count == 1 else Disturbance.random(k), rest,
            )
            for k in range(count)
        ]  # fmt: skip
        clock, cpu = time.perf_counter(), time.process_time()
        deployments = simulate_deployments(
            trials, speed=options.get("speed", 0.02), discretisation=Discretisation(**cut),
            device=device, threads=1,
        )  # fmt: skip
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
    for title, first in STUDIES.items():
        laid, study = [], []
        for level in range(levels):
            options: dict = {what: value / 2**level for what, value in first.items()}
            if title == "step by euler":
                options["scheme"] = "euler"
            if title == "speed":
                # Slower and slower the deployment becomes a sequence of equilibria.
                options["step"] = 0.01 * 2**level
            deployment, row = simulate(**options)
            laid.append(points_of(curve, deployment.arc_length, deployment.centerline, 200))
            study.append(row)
        for row, change in zip(study, changes(laid, study), strict=True):
            row |= change
        rows[f"convergence in {title}"] = study
    tell(
        {"machine": machine_line(device), "device": device, "rows": rows},
        f"{material.length} m of {rod_name} along {name}, friction {friction:g}, {device}",
        *_lines(rows),
    )


def _settle(length: float, batch: int, levels: int, device: str) -> None:
    """Say what the batch and the studies cost: each level's rods have edges or steps of half the
    size, or half the speed."""
    usual = {"spacing": 0.005, "step": 0.01, "speed": 0.02}
    work = cost.deployments(1 + batch, length, device=device, **usual)
    for first in STUDIES.values():
        for level in range(levels):
            how = usual | {what: value / 2**level for what, value in first.items()}
            one = cost.deployments(1, length, device=device, **how)
            work = cost.Cost(work.seconds + one.seconds, max(work.memory, one.memory))
    cost.settle(work, f"a batch of {batch} and {levels} levels", "ask for fewer --levels")


def _lines(rows: dict[str, list[dict]]) -> Iterator[str]:
    for row in rows["speed"]:
        yield (
            f"{row['rods']} rods of {row['nodes']} nodes: {row['seconds']:.2f} s "
            f"(cpu {row['cpu_seconds']:.2f} s), {row['steps']} rod steps, "
            f"{row['rod_steps_per_second']:.0f} per second"
        )
    for title, study in list(rows.items())[1:]:
        whats = list(STUDIES[title.removeprefix("convergence in ")])
        yield (
            f"{title}: largest change of the laid curve and change of the error, from the line "
            "before, and their orders"
        )
        for row in study:
            yield (
                "  " + ", ".join(f"{what} {row[what]:<8g}" for what in whats)
                + f" error {row['error_mean']:.4f} cm"
                + _told(row, "change_cm", "order") + _told(row, "error_change_cm", "error_order")
                + f"  cpu {row['cpu_seconds']:.1f} s"
            )  # fmt: skip


def changes(laid: list, study: list[dict]) -> list[dict]:
    """How curve and error [cm] change from each level of a study to the next, half as coarse, and
    the orders of convergence that this shows: log2 of the ratio of two successive changes."""
    import numpy as np

    out = []
    for level, row in enumerate(study):
        entry = dict.fromkeys(("change_cm", "order", "error_change_cm", "error_order"))
        if level:
            apart = np.linalg.norm(laid[level] - laid[level - 1], axis=1)
            entry["change_cm"] = 100 * float(apart.max())
            entry["error_change_cm"] = abs(row["error_mean"] - study[level - 1]["error_mean"])
        if level > 1:
            for what, order in (("change_cm", "order"), ("error_change_cm", "error_order")):
                before, now = out[-1][what], entry[what]
                entry[order] = float(np.log2(before / now)) if min(before, now) > 0 else None
        out.append(entry)
    return out


def _told(row: dict, change: str, order: str) -> str:
    if row[change] is None:
        return " " * 25
    shown = "" if row[order] is None else f"({row[order]:+.1f})"
    return f"  {row[change]:.5f} cm {shown:<8}"
