"""`wrod bench slippery`: how well do plans lie on slippery tables? Restartable."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod.bench import campaign
from wrod.bench.ledger import Ledger
from wrod.bench.slippery_report import KEYS, draw, means, summary, told, write_csv
from wrod.errors import RodError

ENGINES = ("wrod", "mujoco")
# A rod that is put down exactly, and one that lies exactly where a robot that stands elsewhere, and
# does not know it, has the pattern: what no plan can be better than on average.
PUT_DOWN, MISPLACED = "put_down", "misplaced"
METHODS = (
    "intuitive",
    "zero_tension",
    "min_friction",
    "optimised",
    "distilled",
    PUT_DOWN,
    MISPLACED,
)
# Seeds of disturbances that no plan was fitted to or judged by.
_FIRST_SEED = 9_000
_PLAN_SPACING = 0.005
# Largest curvature [1/L_gb] of patterns that hardly bend.
_GENTLE = 0.4


@click.command(name="slippery")
@click.option("--frictions", default="0.2,0.3,0.6", show_default=True, help="Of the tables.")
@click.option("--rods", default="green-vps", show_default=True, help="With commas between them.")
@click.option("--names", default="letter-U", show_default=True, help="Patterns.")
@click.option("--methods", default=",".join(METHODS), show_default=True, help="What lays them.")
@click.option("--trials", default=2, show_default=True, help="Disturbed trials a cell.")
@click.option(
    "--engines", default="wrod", show_default=True,
    help="What simulates: wrod, and mujoco, a chain of segments that shares nothing with it.",
)  # fmt: skip
@click.option(
    "--chain-step", default=0.004, show_default=True, help="Time step of the mujoco engine [s]."
)
@click.option("--undisturbed", is_flag=True, help="Lay the planned rod, placed as planned.")
@campaign.options(speed=0.04, step=0.01, spacing=0.005)
def command(
    frictions: str,
    rods: str,
    names: str,
    methods: str,
    trials: int,
    engines: str,
    chain_step: float,
    undisturbed: bool,
    **common,
) -> None:
    """Lay patterns by plans that do not know their table and by plans that do.

    Plans are kept in OUT/plans and finished trials in OUT/trials.jsonl: a run that was stopped goes
    on from there.
    """
    from wrod.bench.mujoco_chain import require_mujoco
    from wrod.commands.options import parse_list
    from wrod.rods.device import resolve_device

    if trials < 1:
        raise RodError(f"trials is {trials}; give 1 or more")
    asked = campaign.Common(**common)
    out, spacing, as_json = asked.out, asked.spacing, asked.as_json
    chosen, played = _some(methods, "method", METHODS), _some(engines, "engine", ENGINES)
    if "mujoco" in played:
        require_mujoco()
    device = resolve_device(asked.device)
    shelf = Shelf(out / "plans", asked.patterns, device)
    mus = parse_list(frictions, "--frictions", 0.01, 10.0)
    pace = {"speed": asked.speed, "step": asked.step, "release": asked.release}
    settings = {
        **pace,
        "spacing": spacing,
        "patterns": "built-in" if asked.patterns is None else asked.patterns.name,
        "undisturbed": undisturbed,
    }
    if "mujoco" in played:
        settings["chain_step"] = chain_step
    how = {**pace, "undisturbed": undisturbed, "chain_step": chain_step}
    for rod_name, name in product(rods.split(","), names.split(",")):
        shelf.course(rod_name, name)  # refused before anything is written
    out.mkdir(parents=True, exist_ok=True)
    ledger = Ledger(out / "trials.jsonl", settings, KEYS, "slippery")
    cells = list(product(rods.split(","), names.split(","), mus, chosen, played))
    keys = [
        (*cell, trial)
        for trial in range(trials)
        for cell in cells
        if trial == 0 or cell[3] != PUT_DOWN
    ]

    def simulate(part, progress):
        rows = []
        for key in part:
            s, place, steps, diverged = _laid(shelf, key, spacing, device, how)
            told = _disturbance(key, undisturbed)
            rows.append(dict(zip(KEYS, key, strict=True)) | _figures(shelf, key, s, place, told))
            rows[-1] |= {"steps": steps, "diverged": diverged}
            progress(1.0 / len(part))
        return rows

    campaign.run(ledger, keys, simulate, device=device, batch=asked.batch or 1, quiet=as_json)
    rows = ledger.of(keys)
    written = [write_csv(out / "slippery.csv", rows), ledger.path]
    written.append(draw(out / "slippery.png", rows, shelf.course, METHODS))
    table = summary(rows)
    groups = means(table, shelf.bends)
    if as_json:
        click.echo(
            json.dumps(
                {"cells": table, "means": groups, "written": [str(p) for p in written]}, indent=2
            )
        )
        return
    for line in told(table, groups):
        click.echo(line)
    for path in written:
        click.echo(f"wrote {path}")


def _some(names: str, what: str, known: tuple[str, ...]) -> list[str]:
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

    def course(self, rod_name: str, name: str):
        """The pattern as `plan` lays it, and the rod."""
        from wrod.bench.table3_paper import read_pattern
        from wrod.planning.remainder import prepare
        from wrod.rods.catalogue import rod

        material = rod(rod_name)
        return prepare(read_pattern(name, self.patterns), material, None), material

    def bends(self, rod_name: str, name: str) -> bool:
        """Whether the pattern's largest curvature is over 0.4 / L_gb."""
        led, material = self.course(rod_name, name)
        s = np.linspace(0.0, led.length, 2000)
        return bool(np.abs(led.sample(s)[2]).max() * material.gravito_bending_length > _GENTLE)

    def plan(self, rod_name: str, name: str, friction: float, method: str):
        """The trajectory of that method; friction counts for those that are corrected alone."""
        from wrod.deployment.plan import plan
        from wrod.planning.trajectory import Trajectory

        table = f"-{friction:g}" if method in ("optimised", "distilled") else ""
        path = self.folder / f"{rod_name}-{name}-{method}{table}.npz"
        if path.exists():
            return Trajectory.load(path)
        led, material = self.course(rod_name, name)
        ways: dict[str, dict[str, Any]] = {
            "intuitive": {"method": "intuitive"},
            "optimised": {"method": "auto", "friction": friction},
            "distilled": {"method": "distilled", "friction": friction},
        }
        how = ways.get(method, {"method": "numeric", "closure": method})
        made = plan(
            led, material, spacing=_PLAN_SPACING, remainder=False, device=self.device, **how
        )
        made.save(path)
        return made


def _laid(shelf: Shelf, key: tuple, spacing: float, device: str, how: dict):
    """Arc length (node,) and place (node, 3) [m] of what lies, steps taken, whether it diverged."""
    from wrod.bench.mujoco_chain import lay_in_mujoco, put_down_in_mujoco
    from wrod.bench.put_down import put_down
    from wrod.deployment.simulate import Trial
    from wrod.deployment.tangents import lay
    from wrod.solvers.contact import Friction

    rod_name, name, mu, method, engine, _ = key
    led, material = shelf.course(rod_name, name)
    if method == PUT_DOWN:
        if engine == "mujoco":
            return *put_down_in_mujoco(led, material, mu), 0, False
        nodes = int((led.length + led.remainder_length) / spacing) + 2
        job = (led, material, Friction(mu))
        s, place, diverged, steps = put_down([job], node_count=nodes, step=0.02, device=device)[0]
        return s, place, steps, diverged
    how = dict(how)
    disturbance, chain_step = _disturbance(key, how.pop("undisturbed")), how.pop("chain_step")
    if method == MISPLACED:
        s = np.linspace(-led.remainder_length, led.length, 400)
        place = led.sample(s)[0]
        return s + led.remainder_length, disturbance.displaced(place, place[0]), 0, False
    trajectory = shelf.plan(rod_name, name, mu, method)
    one = Trial(led, material, trajectory, Friction(mu), disturbance)
    if engine == "mujoco":
        asked = dict(release=how["release"], speed=how["speed"], step=chain_step)
        return *lay_in_mujoco(one, **asked), 0, False
    (laid,) = lay([one], spacing=spacing, device=device, **how)
    return laid.arc_length, laid.centerline, laid.steps, laid.diverged


def _disturbance(key: tuple, undisturbed: bool):
    """Of the trial; a rod that is put down exactly has none."""
    from wrod.deployment.setup import Disturbance

    if undisturbed or key[3] == PUT_DOWN:
        return Disturbance()
    return Disturbance.random(_FIRST_SEED + key[5])


def _figures(shelf: Shelf, key: tuple, s: np.ndarray, place: np.ndarray, disturbance) -> dict:
    from wrod.deployment.expectation import robot_error
    from wrod.deployment.result import errors_along

    led, _ = shelf.course(*key[:2])
    error = 100.0 * errors_along(led, s, place)[1]
    along = np.linspace(0.0, led.length, 60) + led.remainder_length
    curve = np.column_stack([np.interp(along, s, place[:, c]) for c in range(2)])
    return {
        "error_mean": float(error.mean()),
        "error_robot": 100.0 * robot_error(led, s, place, disturbance),
        "error_std": float(error.std()),
        "curve": np.round(curve, 5).tolist(),
    }
