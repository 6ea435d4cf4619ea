"""`wrod bench table3`: the paper's accuracy table, laid in simulation. Restartable."""

import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import click

from wrod import cost
from wrod.bench import campaign, courses
from wrod.bench.table3_paper import METHODS, PATTERNS, RODS, SUBSTRATES, friction, read_pattern
from wrod.files import row_schemas, write_text
from wrod.files.ledger import Ledger
from wrod.files.writing import keeps
from wrod.machine import machine_line
from wrod.options import gathered, option, refuse_idle_options
from wrod.telling import json_option, tell


@dataclass(frozen=True)
class _Asked:
    """What of the table is asked for, and how its OPT is planned."""

    trials: int = option("Trials a cell.", default=10)
    closure: str | None = option("Closure of OPT; default: the one that the planner favours.")
    known_table: bool = option(
        "Plan OPT for the friction of each substrate; plans are kept in OUT/plans."
    )
    left: float | None = option(
        "Of OPT's rods hangs so much when the pattern is laid [L_gb]; default: all, as the paper's."
    )
    workers: int = option("Known table: processes that plan side by side.", default=1)
    rods: tuple[str, ...] = option(
        "Only this rod; may be given again.", "--rod", type=click.Choice(RODS)
    )
    substrates: tuple[str, ...] = option(
        "Only this substrate; may be given again.", "--substrate", type=click.Choice(SUBSTRATES)
    )
    names: tuple[str, ...] = option(
        "Only this pattern; may be given again.", "--pattern", type=click.Choice(PATTERNS)
    )

    def check(self) -> None:
        from wrod.grasps.inputs import closure_number

        if self.closure is not None:
            closure_number(self.closure)
        if not self.known_table:
            refuse_idle_options("plans for no table in particular", "workers")

    def cells(self, patterns: Path | None) -> tuple[tuple[str, ...], tuple[str, ...], dict]:
        """Rods, substrates and curves, in the table's own order."""
        rods = tuple(name for name in RODS if name in (self.rods or RODS))
        substrates = tuple(name for name in SUBSTRATES if name in (self.substrates or SUBSTRATES))
        names = [name for name in PATTERNS if name in (self.names or PATTERNS)]
        return rods, substrates, {name: read_pattern(name, patterns) for name in names}

    def settings(self, common: campaign.Common) -> dict:
        """What has to be the same for trials to stand in one table."""
        closure = "favoured" if self.closure is None else self.closure
        settings = common.settings | {"closure": closure, "patterns": common.source}
        settings |= {} if self.left is None else {"left": self.left}
        return settings | ({"known_table": True} if self.known_table else {})


@click.command(name="table3")
@gathered("asked", _Asked)
@gathered("common", campaign.Common, speed=0.02, step=0.02, spacing=0.005)
@json_option
@cost.force_option
def command(asked: _Asked, common: campaign.Common) -> None:
    """Rods 1-3 x fabric, steel, foam x seven patterns x {INT, OPT} x ten trials.

    Finished trials are kept in OUT/trials.jsonl: a run that was stopped goes on from there.
    """
    from wrod.bench.table3_report import KEYS
    from wrod.deployment.simulate import nodes_needed, simulate_deployments
    from wrod.rods.catalogue import rod
    from wrod.rods.device import resolve_device
    from wrod.solvers.compiling import compile_steps

    asked.check()
    device, settings, out = resolve_device(common.device), asked.settings(common), common.out
    rods, substrates, curves = asked.cells(common.patterns)
    ledger = Ledger(out / "trials.jsonl", settings, KEYS, "table3", row_schemas.Table3Row)
    # One trial of every cell before the second of any, so that a stopped run covers the table.
    keys = [
        (material, substrate, name, method, trial)
        for trial, material, substrate, name, method in product(
            range(asked.trials), rods, substrates, curves, METHODS
        )
    ]
    campaign.settle(common, len(ledger.lacking(keys)), max(rod(name).length for name in rods))
    start = time.perf_counter()
    compile_steps(device, "grip")
    compiled = time.perf_counter() - start
    plans = _plans(rods, curves, asked.closure, asked.left, device)
    if asked.known_table:
        plans |= _corrected_plans(
            plans, substrates, out / "plans", common.speed, device, asked.workers
        )
    first = [_trial(key, plans) for key in keys[: len(keys) // asked.trials]]
    nodes = nodes_needed(first, common.spacing)
    planned = time.perf_counter() - start - compiled

    def simulate(part, progress):
        deployments = simulate_deployments(
            [_trial(key, plans) for key in part],
            device=device, progress=progress, **common.how(nodes),
        )  # fmt: skip
        return [
            dict(zip(KEYS, key, strict=True)) | campaign.figures_of(laid, _plan_of(key, plans)[0])
            for key, laid in zip(part, deployments, strict=True)
        ]

    clock = time.perf_counter()
    count, steps = campaign.run(ledger, keys, simulate, device=device, batch=common.batch)
    seconds = time.perf_counter() - clock
    rows = ledger.of(keys)
    words, written = _reported(out, rows, curves, asked.trials, settings)
    figures = {
        "machine": machine_line(device),
        "device": device,
        "trials": len(rows),
        "simulated_now": count,
        "compiling_seconds": compiled,
        "planning_seconds": planned,
        "simulation_seconds": seconds,
        "rod_steps_per_second": steps / seconds if count else None,
        "nodes": nodes,
        "summary": words,
        "written": [str(path) for path in (*written, out / "trials.jsonl")],
    }
    rate = f", {steps / seconds:.0f} rod steps per second" if count else ""
    tell(
        figures,
        f"{count} trials in {seconds:.1f} s{rate} of {nodes} nodes on {device} "
        f"(compiling {compiled:.1f} s, plans {planned:.1f} s)",
        *words,
    )


def _reported(out: Path, rows, curves, trials: int, settings) -> tuple[list[str], list[Path]]:
    """What the rows say, and the files written of them."""
    from wrod.bench.table3_report import cells, draw, markdown, summary, write_csv

    table = cells(rows)
    head = (
        f"Simulated accuracy, e_mean ± sigma [cm] (N = 50), {trials} trials a cell; contact speed "
        f"{settings['speed']:g} m/s, step {settings['step']:g} s, edges {settings['spacing']:g} m, "
        f"free end held for the first {settings['release']:g} m, OPT with closure "
        f"{settings['closure']}, patterns {settings['patterns']}."
    )
    text = markdown(table, head)
    write_text(out / "table3.md", text)
    return summary(table), [
        write_csv(out / "table3.csv", table),
        out / "table3.md",
        draw(out / "table3.png", rows, curves),
    ]


def _plans(rods, curves: dict, closure: str | None, left: float | None, device: str) -> dict:
    """(rod, pattern, method) -> pattern with remainder, rod, trajectory, tail; OPT is a default
    plan, or the rod solver's with a closure that was asked for."""
    from wrod.deployment.plan import plan
    from wrod.planning.hold import held_near
    from wrod.planning.remainder import prepare
    from wrod.planning.tail import tail
    from wrod.rods.catalogue import rod

    plans = {}
    jobs = list(product(rods, curves, METHODS))
    for name, curve, method in cost.progress_bar(jobs, desc="plans"):
        material = rod(name)
        led = prepare(curves[curve], material, None)
        optimal = method == "numeric"
        if optimal and left is not None:
            material = held_near(led, material, left)
        how = "auto" if optimal and closure is None else method
        chosen = closure if optimal else None
        trajectory = plan(led, material, how, closure=chosen, device=device)
        plans[name, curve, method] = (led, material, trajectory, tail(led, material, trajectory))
    return plans


def _corrected_plans(
    plans: dict, substrates, folder: Path, pace: float, device: str, workers: int
) -> dict:
    """(rod, substrate, pattern, "numeric") -> the same as `_plans`, corrected for the table and the
    pace [m/s] at which they are laid."""
    from wrod.planning.tail import tail
    from wrod.planning.trajectory import Trajectory

    paths, jobs = {}, []
    for key, substrate in product([key for key in plans if key[2] == "numeric"], substrates):
        name, curve, method = key
        led, material, trajectory, _ = plans[key]
        path = paths[name, substrate, curve, method] = folder / f"{name}-{substrate}-{curve}.npz"
        keeps(path)
        if not path.exists():
            jobs.append((path, led, material, trajectory, friction(name, substrate), None, pace))
    with cost.progress_bar(total=len(jobs), desc="corrections") as bar:

        def save(job: tuple, best: Trajectory) -> None:
            best.save(job[0])
            bar.update(1)

        courses.run(_course, jobs, save, device=device, workers=workers)
    corrected = {}
    for cell, path in paths.items():
        led, material, *_ = plans[cell[0], cell[2], cell[3]]
        trajectory = Trajectory.load(path)
        corrected[cell] = (led, material, trajectory, tail(led, material, trajectory))
    return corrected


def _course(path: Path, *what):
    """What is laid to correct a plan, which is kept in `path`."""
    from wrod.deployment.descent import TableTask
    from wrod.deployment.optimise import course

    return course(TableTask(*what))


def _plan_of(key: tuple, plans: dict) -> tuple:
    rod, substrate, name, method, _ = key
    return plans.get((rod, substrate, name, method)) or plans[rod, name, method]


def _trial(key: tuple, plans: dict):
    """INT and OPT meet the same disturbances, every cell others."""
    from wrod.deployment.setup import Disturbance
    from wrod.deployment.simulate import Trial
    from wrod.solvers.friction import Friction

    rod, substrate, name, _, trial = key
    cell = (RODS.index(rod) * 3 + SUBSTRATES.index(substrate)) * 7 + PATTERNS.index(name)
    curve, material, trajectory, rest = _plan_of(key, plans)
    return Trial(
        curve,
        material,
        trajectory,
        Friction(friction(rod, substrate)),
        Disturbance.random(1000 * cell + trial),
        rest,
    )
