"""`wrod bench slippery`: how well do plans lie on slippery tables? Restartable."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod import cost
from wrod.bench import campaign, courses
from wrod.bench import slippery_report as report
from wrod.deployment.bounds import refuse_coarse_edges, refuse_long_moves
from wrod.errors import RodError
from wrod.files import row_schemas
from wrod.files.ledger import Ledger
from wrod.files.writing import keeps
from wrod.machine import machine_line
from wrod.options import gathered, option, own_options, parse_list
from wrod.planning.hold import held_near
from wrod.planning.trajectory import Trajectory
from wrod.telling import json_option, tell

ENGINES = ("wrod", "mujoco")
METHODS = (
    "intuitive",
    "zero_tension",
    "min_force",
    "min_friction",
    "optimised",
    "certain",
    "distilled",
    "feedback",
    report.PUT_DOWN,
    report.MISPLACED,
    report.HELD,
)
# Those whose plan is corrected for its table, and that plan.
_CORRECTED = {
    "optimised": "optimised",
    "certain": "certain",
    "feedback": "optimised",
    "distilled": "distilled",
}
_OPTIMISED = ("optimised", "certain")
# Only where they are asked for.
_ASKED = ("min_force", "certain", report.HELD)
# Those that no other engine plays.
_OWN = ("feedback", report.HELD)
# Seeds of disturbances that no plan was fitted to or judged by.
_FIRST_SEED = 9_000
_PLAN_SPACING = 0.005
# What rows say, counted up when a method changes, so that a folder begun before that is refused:
# rods that are put down are disturbed as the others since the second.
_ROWS = 2
# Largest curvature [1/L_gb] of patterns that hardly bend.
_GENTLE = 0.4


@dataclass(frozen=True)
class _Disturbing:
    """What of a laboratory's disturbances the trials have."""

    undisturbed: bool = option("Lay the planned rod, placed as planned.")
    disturbed: str | None = option(
        "What alone disturbs the trials: jitter, lgb_error, placement, "
        "yaw, natural_curvature; default: all."
    )

    @property
    def kinds(self) -> list[str]:
        from wrod.deployment.setup import DEVIATIONS

        if self.undisturbed and self.disturbed is not None:
            raise RodError("--undisturbed leaves nothing for --disturbed to choose; leave one out")
        if self.disturbed is not None:
            return some(self.disturbed, "disturbance", tuple(DEVIATIONS))
        return [] if self.undisturbed else list(DEVIATIONS)


@click.command(name="slippery")
@own_options
@gathered("common", campaign.Common, speed=0.04, step=0.01, spacing=0.005)
@gathered("disturbing", _Disturbing)
@json_option
@cost.force_option
def command(
    common: campaign.Common,
    disturbing: _Disturbing,
    frictions: str = option("Of the tables.", default="0.1,0.2,0.3,0.6,1"),
    rods: str = option("With commas between them.", default="green-vps,rope,pink-vps"),
    names: str = option("Patterns.", default="sine,letter-U,letter-C,letter-L,letter-A"),
    methods: str = option(
        "What lays them; also min_force, certain (optimised for the very rod and table of the "
        "trials, but for what disturbs these) and held: the nearest curve that friction can hold.",
        default=",".join(m for m in METHODS if m not in _ASKED),
    ),
    trials: int = option("Disturbed trials a cell.", default=2),
    engines: str = option(
        "What simulates: wrod, and mujoco, a chain of segments that shares nothing with it.",
        default="wrod",
    ),
    chain_step: float = option("Time step of the mujoco engine [s].", default=0.004),
    left: float | None = option(
        "What hangs when the pattern is laid [L_gb]; default: all, held at the rod's end."
    ),
    finished: bool = option("Tell what is finished in OUT, and lay nothing."),
    workers: int = option("Processes, on a CPU.", default=1),
) -> None:
    """Lay patterns by plans that do not know their table and by plans that do.

    A GPU optimises all plans together, and lays all trials together.

    Plans are kept in OUT/plans and finished trials in OUT/trials.jsonl: a run that was stopped goes
    on from there.
    """
    from wrod.bench.mujoco_chain import require_mujoco
    from wrod.rods.device import resolve_device

    out = common.out
    chosen, played = some(methods, "method", METHODS), some(engines, "engine", ENGINES)
    by = disturbing.kinds
    if "mujoco" in played:
        require_mujoco()
    device = resolve_device(common.device)
    shelf = Shelf(out / "plans", common.patterns, device, left)
    mus = parse_list(frictions, "--frictions", 0.01, 10.0)
    settings = {**common.settings, "patterns": common.source, "disturbed": by, "rows": _ROWS}
    settings |= {"chain_step": chain_step} if "mujoco" in played else {}
    settings |= {} if left is None else {"left": left}
    how = {**common.how(), "disturbed": by, "chain_step": chain_step}
    shelf.refuse(product(rods.split(","), names.split(",")), common)
    ledger = Ledger(
        out / "trials.jsonl", settings, report.KEYS, "slippery", row_schemas.SlipperyRow
    )
    cells = list(product(rods.split(","), names.split(","), mus, chosen, played))
    keys = [
        (*cell, trial)
        for trial in range(trials)
        for cell in cells
        if cell[3] not in _OWN or cell[4] == "wrod"
    ]
    keys, lacking = campaign.still_to_lay(ledger, keys, finished)
    jobs = [(shelf, key, how) for key in lacking]
    longest = max(shelf.course(*cell[:2])[1].length for cell in cells)
    campaign.settle(common, len(jobs), longest, _effort(shelf, lacking))
    made = [(*key[:3], _CORRECTED[key[3]]) for key in lacking if key[3] in _CORRECTED]
    shelf.stock(made, workers)
    with cost.progress_bar(total=len(keys), initial=len(keys) - len(jobs), unit="trial") as bar:

        def note(_, row: dict) -> None:
            ledger.add([row])
            bar.update(1)

        courses.run(_course, jobs, note, device=device, workers=workers)
    rows = ledger.of(keys)
    written = [report.write_csv(out / "slippery.csv", rows), out / "trials.jsonl"]
    written.append(report.draw(out / "slippery.png", rows, shelf.course, METHODS))
    table = report.summary(rows)
    groups = report.means(table, shelf.bends)
    figures = {"machine": machine_line(device), "cells": table, "means": groups}
    tell(figures | {"written": [str(path) for path in written]}, *report.told(table, groups))


def _effort(shelf: Shelf, keys: list[tuple]) -> float:
    """Time of corrected plans, and of looking on [s]."""
    from wrod.deployment.effort import looking_on

    made = {(*key[:3], _CORRECTED.get(key[3])) for key in keys}
    plans = [cell[:3] for cell in made if cell[3] in _OPTIMISED]
    looks = [looking_on(shelf.course(*key[:2])[0]) for key in keys if key[3] == "feedback"]
    return shelf.effort(plans) + sum(looks)


def some(names: str, what: str, known: tuple[str, ...]) -> list[str]:
    """The names, with commas between, all of which must be known."""
    given = names.split(",")
    if unknown := [name for name in given if name not in known]:
        raise RodError(f"unknown {what} {unknown[0]!r}; use some of {', '.join(known)}")
    return given


@dataclass
class Shelf:
    """Plans, made when first asked for and kept in a folder."""

    folder: Path
    patterns: Path | None
    device: str
    left: float | None = None

    def course(self, rod_name: str, name: str):
        """The pattern as `plan` lays it, and the rod as it is held."""
        led, material = _led(rod_name, name, self.patterns)
        return led, material if self.left is None else held_near(led, material, self.left)

    def refuse(self, places: Iterable[tuple[str, str]], common: campaign.Common) -> None:
        """Refuse (rod, pattern) that are none, or cannot be laid so, before anything is written."""
        refuse_long_moves(common.speed, common.step)
        refuse_coarse_edges([self.course(*place)[1] for place in places], common.spacing)

    def bends(self, rod_name: str, name: str) -> bool:
        """Whether the pattern's largest curvature is over 0.4 / L_gb."""
        led, material = self.course(rod_name, name)
        s = np.linspace(0.0, led.length, 2000)
        return bool(np.abs(led.sample(s)[2]).max() * material.gravito_bending_length > _GENTLE)

    def effort(self, cells: Iterable[tuple[str, str, float]]) -> float:
        """Time that corrected plans of (rod, pattern, friction) take [s]."""
        from wrod.deployment.effort import corrected

        seconds = 0.0
        for rod_name, name, friction in cells:
            led, material = self.course(rod_name, name)
            seconds += corrected(led, material, friction, device=self.device)
        return seconds

    def place(self, rod_name: str, name: str, friction: float, method: str) -> Path:
        """Where the plan is kept; friction counts for those that are corrected alone."""
        table = f"-{friction:g}" if method in _CORRECTED else ""
        return self.folder / f"{rod_name}-{name}-{method}{table}.npz"

    def stock(self, cells: list[tuple], workers: int = 1) -> None:
        """Make the optimised plans among these (rod, pattern, friction, method) that are not there:
        together on a GPU, in processes on a CPU."""
        for cell in cells:
            keeps(self.place(*cell))
        jobs = [
            (self, *cell)
            for cell in dict.fromkeys(cells)
            if cell[3] in _OPTIMISED and not self.place(*cell).exists()
        ]

        def save(job: tuple, made) -> None:
            made.save(self.place(*job[1:]))

        courses.run(_planning, jobs, save, device=self.device, workers=workers)

    def plan(self, rod_name: str, name: str, friction: float, method: str):
        """The trajectory of that method; friction counts for those that are corrected alone."""
        from wrod.deployment.plan import plan

        path = self.place(rod_name, name, friction, method)
        if not path.exists() and method in _OPTIMISED:
            self.stock([(rod_name, name, friction, method)])
        if path.exists():
            return Trajectory.load(path)
        led, material = self.course(rod_name, name)
        # One after the other: a CPU is faster than a GPU.
        ways: dict[str, dict[str, Any]] = {
            "intuitive": {"method": "intuitive"},
            "distilled": {"method": "distilled", "friction": friction, "left": False},
        }
        how = ways.get(method, {"method": "numeric", "closure": method})
        made = plan(led, material, spacing=_PLAN_SPACING, remainder=False, device="cpu", **how)
        made.save(path)
        return made


@cache
def _led(rod_name: str, name: str, patterns: Path | None):
    """Once for all trials: whether a lead-in is needed takes a simulation."""
    from wrod.bench.table3_paper import read_pattern
    from wrod.planning.remainder import prepare
    from wrod.rods.catalogue import rod

    material = rod(rod_name)
    return prepare(read_pattern(name, patterns), material, None), material


def _planning(shelf: Shelf, rod_name: str, name: str, friction: float, method: str):
    """What is laid to optimise a plan, and the plan."""
    from wrod.deployment.descent import TableTask
    from wrod.deployment.optimise import course
    from wrod.deployment.plan import plan
    from wrod.deployment.spread import Spread

    led, material = shelf.course(rod_name, name)
    start = plan(led, material, spacing=_PLAN_SPACING, remainder=False, device="cpu")
    if method == "certain":
        one = Spread((friction, friction), lgb_error=0.0, natural_curvature=0.0, stretch=False)
        return (yield from course(TableTask(led, material, start, one), samples=1))
    return (yield from course(TableTask(led, material, start, friction)))


def _course(shelf: Shelf, key: tuple, how: dict):
    """What is laid in a trial, and its row."""
    from wrod.bench.held import held
    from wrod.bench.mujoco_chain import lay_in_mujoco, put_down_in_mujoco
    from wrod.bench.put_down import put_down
    from wrod.deployment.feedback import Plant, following
    from wrod.deployment.looking_on import FeedbackLoop
    from wrod.deployment.setup import Disturbance
    from wrod.deployment.sight import Sight
    from wrod.deployment.simulate import Trial
    from wrod.deployment.together import Asked
    from wrod.planning.tail import Tail
    from wrod.solvers.friction import Friction

    rod_name, name, mu, method, engine, seed = key
    led, material = shelf.course(rod_name, name)
    how = dict(how)
    told = Disturbance.random(_FIRST_SEED + seed, only=how.pop("disturbed"))
    steps, diverged = 0, False
    chain_step = how.pop("chain_step")
    if method == report.PUT_DOWN and engine == "mujoco":
        s, place = put_down_in_mujoco(led, material, mu, told)
    elif method == report.PUT_DOWN:
        edges = (led.length + led.remainder_length) / how["discretisation"].spacing
        nodes = int(edges) + 2
        job = (led, material, Friction(mu), told)
        (end,) = put_down([job], node_count=nodes, step=how["discretisation"].step)
        s, place, diverged, steps = end
    elif method == report.MISPLACED:
        s = np.linspace(-led.remainder_length, led.length, 400)
        place = led.sample(s)[0]
        s, place = s + led.remainder_length, told.displaced(place, place[0])
    elif method == report.HELD:
        s, place = held(led, material, mu)
    else:
        trajectory = shelf.plan(rod_name, name, mu, _CORRECTED.get(method, method))
        trial = Trial(led, material, trajectory, Friction(mu), told, Tail.none(trajectory))
        if engine == "mujoco":
            asked = dict(release=how["release"], speed=how["speed"], step=chain_step)
            s, place = lay_in_mujoco(trial, **asked)
        else:
            if method == "feedback":
                plant = Plant(material, Friction(mu), told)
                loop = FeedbackLoop(led, material, trajectory, mu)
                followed = yield from following(loop, plant, sight=Sight(seed=seed), **how)
                laid = followed.laid
            else:
                (laid,) = yield Asked([trial], None, how)
            s, place, diverged, steps = laid.arc_length, laid.centerline, laid.diverged, laid.steps
    row = dict(zip(report.KEYS, key, strict=True)) | _figures(shelf, key, s, place, told)
    return row | {"steps": steps, "diverged": diverged}


def _figures(shelf: Shelf, key: tuple, s: np.ndarray, place: np.ndarray, disturbance) -> dict:
    from wrod.deployment.expectation import robot_error
    from wrod.deployment.result import errors_along

    led, _ = shelf.course(*key[:2])
    error = 100.0 * errors_along(led, s, place)[1]
    return {
        "error_mean": float(error.mean()),
        "error_robot": 100.0 * robot_error(led, s, place, disturbance),
        "error_std": float(error.std()),
        "curve": campaign.curve_of(led, s, place),
    }
