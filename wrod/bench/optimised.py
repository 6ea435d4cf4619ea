"""`wrod bench optimised`: time of plans that know their table, and of deployments' derivatives."""

import time
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod import cost
from wrod.bench.table3_paper import patterns_option, read_pattern
from wrod.options import option, own_options
from wrod.telling import asked, json_option, tell

# Rods that are laid at once: one, and on a GPU as many as a learner might.
_BATCHES = (1, 64)


@click.command(name="optimised")
@own_options
@patterns_option
@json_option
def command(
    patterns: Path | None,
    rod_name: str = option(None, "--rod", default="green-vps"),
    names: str = option("Patterns.", default="letter-U,letter-A"),
    friction: float = option(None, default=0.3),
    times: int = option("Runs of each plan after the first; the median is told.", default=1),
    together: int = option("Optimise so many plans of random patterns together, too.", default=0),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
) -> None:
    """Optimise plans, and lay rods with and without derivatives by all directions of a plan.

    Each is done once before, which is told of plans. Derivatives on a GPU are compared with those
    of a CPU.
    """
    from wrod.deployment.effort import corrected
    from wrod.machine import machine_line
    from wrod.planning.remainder import prepare
    from wrod.rods.catalogue import rod
    from wrod.rods.device import resolve_device

    device, material = resolve_device(device), rod(rod_name)
    courses = {
        name: prepare(read_pattern(name, patterns), material, None) for name in names.split(",")
    }
    each = (corrected(led, material, friction, device=device) for led in courses.values())
    work = cost.Cost((1.0 + times) * sum(each) + cost.CORRECTED_PLAN * together)
    what = f"{(1 + times) * len(courses) + together} corrected plans"
    cost.settle(work, what, "ask for fewer")
    say = (lambda text: None) if asked("json") else click.echo
    told: dict[str, Any] = {"machine": machine_line(device), "plans": [], "derivatives": []}
    say(told["machine"])
    for name, led in courses.items():
        first, *warm = (_planned(led, material, friction, device) for _ in range(1 + times))
        row = {"pattern": name, **warm[0], "first_seconds": first["seconds"]}
        for one in ("seconds", "cpu_seconds"):
            row[one] = float(np.median([run[one] for run in warm]))
        told["plans"].append(row)
        say(
            f"{name} at friction {friction:g}: {row['seconds']:.2f} s ({row['cpu_seconds']:.1f} s "
            f"of processors; the first time {row['first_seconds']:.2f} s), {row['deployments']} "
            f"times laid; sample from "
            f"{100 * row['errors'][0]:.3f} to {100 * min(row['errors']):.3f} cm, expected "
            f"{100 * row['expected']:.3f} cm"
        )
    (led, *_) = courses.values()
    for count in _BATCHES if device != "cpu" else _BATCHES[:1]:
        row = _derived(led, material, friction, count, device)
        told["derivatives"].append(row)
        agree = "" if device == "cpu" else (
            f"; as a CPU's within {row['apart']:.1e} m, derivatives within "
            f"{row['rates_apart']:.1e} of the largest"
        )  # fmt: skip
        say(
            f"{count} rods: laid in {row['bare']:.2f} s, with {row['columns']} directions in "
            f"{row['derived']:.2f} s, {row['derived'] / row['bare']:.1f} times as long{agree}"
        )
    if together:
        told["together"] = row = _together(together, device)
        say(f"{row['plans']} plans of random patterns together: {row['seconds']:.1f} s")
    if asked("json"):
        tell(told)


def _planned(led, material, friction: float, device: str) -> dict:
    """Time and outcome of an optimised plan, its grasps included."""
    from wrod.deployment.plan import plan

    clock, spent = time.perf_counter(), time.process_time()
    made = plan(led, material, remainder=False, friction=friction, device=device)
    said, expected = made.optimised, made.expected
    return {
        "seconds": time.perf_counter() - clock,
        "cpu_seconds": time.process_time() - spent,
        "deployments": said["iterations"],
        "errors": said["errors"],
        "kept": said["kept"],
        "expected": expected["mean"],
        "expected_robot": float(np.mean(expected["error_robot"])),
    }


def _derived(led, material, friction: float, count: int, device: str) -> dict:
    """Time of a batch of rods with and without derivatives, and how far a CPU's lie apart."""
    from wrod.deployment.corrections import Corrections
    from wrod.deployment.expectation import COARSE, PACE
    from wrod.deployment.plan import plan
    from wrod.deployment.setup import Disturbance
    from wrod.deployment.simulate import Trial
    from wrod.deployment.tangents import Directions, lay
    from wrod.planning.tail import Tail
    from wrod.solvers.friction import Friction

    start = plan(led, material, spacing=0.005, remainder=False, device=device)
    columns = Corrections(led, start, material.gravito_bending_length, 0.05).columns()
    directions, rest = Directions.of_path(columns), Tail.none(start)
    trials = [
        Trial(led, material, start, Friction(friction), Disturbance.random(k), rest)
        for k in range(count)
    ]

    def timed(asked, where: str, chosen: list[Trial]):
        clock = time.perf_counter()
        laid = lay(chosen, asked, discretisation=COARSE, speed=PACE, device=where)
        return time.perf_counter() - clock, laid

    each = [directions] * count
    timed(each, device, trials)
    bare, _ = timed(None, device, trials)
    derived, laid = timed(each, device, trials)
    row = {"rods": count, "columns": len(directions), "bare": bare, "derived": derived}
    if device != "cpu":
        _, (same,) = timed([directions], "cpu", trials[:1])
        largest = np.abs(same.tangent).max()
        row["apart"] = float(np.abs(same.centerline - laid[0].centerline).max())
        row["rates_apart"] = float(np.abs(same.tangent - laid[0].tangent).max() / largest)
    return row


def _together(count: int, device: str) -> dict:
    """Time of plans of random patterns that are optimised together, as for `wrod distil`."""
    from wrod.deployment.together import follow
    from wrod.training.plans import solve

    clock = time.perf_counter()
    made = follow([solve(k, 0) for k in range(count)], device=device)
    return {
        "plans": sum(one is not None for one in made), "seconds": time.perf_counter() - clock
    }  # fmt: skip
