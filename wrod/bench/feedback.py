"""`wrod bench feedback`: what looking at the laid rod saves where the rod is not as believed."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrod import cost
from wrod.bench.table3_paper import patterns_option
from wrod.machine import machine_line
from wrod.telling import json_option, tell

# Row by row, what the true rod differs by though nobody declared it.
EFFECTS = {
    "none": "as believed",
    "friction": "friction halved",
    "stiffness": "L_gb 15 % larger",
    "softness": "L_gb 15 % smaller",
    "curvature": "4 /m of natural curvature",
    "offset": "robot 2 mm beside its place",
    "half": "half the table with half the friction",
}
# How: "known" is a floor, not a way.
WAYS = "blind", "forwards", "followed", "above", "known"
KEYS = ("rod", "pattern", "effect", "way", "seed")
_LGB = {"stiffness": 1.15, "softness": 0.85}
_OFFSET = 2e-3 / np.sqrt(2.0)
_FAR, _GRID = 1.0, 401
# Seeds of disturbances that no plan was fitted to or judged by.
_FIRST_SEED = 9_000


@click.command(name="feedback")
@click.option("--rods", default="green-vps", show_default=True, help="With commas between them.")
@click.option(
    "--names", default="letter-U,letter-A,letter-C,sine", show_default=True, help="Patterns."
)
@click.option("--seeds", default=1, show_default=True,
              help="Trials a cell: each its own disturbance and noise.")  # fmt: skip
@click.option("--seed", default=0, show_default=True, help="Of the first trial.")
@patterns_option
@click.option("--friction", default=0.4, show_default=True, help="That is believed in.")
@click.option("--effects", default=",".join(EFFECTS), show_default=True, help="Rows of the table.")
@click.option(
    "--ways", default="blind,followed", show_default=True,
    help=f"Columns of the table, of {', '.join(WAYS)}: without looking; looking on, without going "
    "back; and going back; the same without a camera at the side; and "
    "with the truth known from the first look on.",
)  # fmt: skip
@click.option("--every", default=0.03, show_default=True, help="Way between two looks [m].")
@click.option("--horizon", default=6.0, show_default=True,
              help="How far ahead the path is corrected after a look [L_gb].")  # fmt: skip
@click.option("--patience", default=4.0, show_default=True,
              help="Reckoned processor time that a look takes at most [s].")  # fmt: skip
@click.option("--undisturbed", is_flag=True, help="The effect alone, without shaking and the rest.")
@click.option("--finished", is_flag=True, help="Tell what is finished in OUT, and lay nothing.")
@click.option("--workers", default=1, show_default=True,
              help="Processes.")  # fmt: skip
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@json_option
@cost.force_option
def command(
    rods: str, names: str, effects: str, ways: str, seeds: int, seed: int, out: Path, workers: int,
    device: str, finished: bool, **how,
) -> None:  # fmt: skip
    """Lay patterns with rods and tables that differ from the plan's, blindly and looking on.

    Plans know the table that is believed in. They are kept in OUT/plans, and finished deployments
    in OUT/feedback.jsonl: a run that was stopped goes on from there. Every trial is disturbed as in
    a careful laboratory, and the effect comes on top. An effect is made up for where it leaves no
    more than 1.5 times the error of trials without it.
    """
    from wrod.bench import campaign, courses
    from wrod.bench.slippery import Shelf, some
    from wrod.deployment.effort import looking_on
    from wrod.files import row_schemas
    from wrod.files.ledger import Ledger
    from wrod.rods.batch import resolve_device

    chosen, asked = some(effects, "effect", tuple(EFFECTS)), some(ways, "way", WAYS)
    device = resolve_device(device)
    shelf = Shelf(out / "plans", how.pop("patterns"), device)
    places = list(product(rods.split(","), names.split(",")))
    for place in places:
        shelf.course(*place)  # refused before anything is written
    patterns = "built-in" if shelf.patterns is None else shelf.patterns.name
    settings = how | {"patterns": patterns}
    ledger = Ledger(out / "feedback.jsonl", settings, KEYS, "feedback", row_schemas.FeedbackRow)
    keys = [
        (*place, effect, way, one)
        for one, way, effect, place in product(range(seed, seed + seeds), asked, chosen, places)
    ]
    keys, lacking = campaign.still_to_lay(ledger, keys, finished)
    jobs = [(shelf, key, how) for key in lacking]
    unplanned = sorted({job[1][:2] for job in jobs})
    seconds = shelf.effort((*place, how["friction"]) for place in unplanned)
    seconds += sum(looking_on(shelf.course(*key[:2])[0]) for _, key, _ in jobs if key[3] != "blind")
    cost.settle(
        cost.Cost(seconds / workers), f"{len(jobs)} deployments",
        "ask for fewer --seeds, --names or --effects",
    )  # fmt: skip
    shelf.stock([(*place, how["friction"], "optimised") for place in unplanned], workers)
    courses.run(_course, jobs, lambda _, row: ledger.add([row]), device=device, workers=workers)
    rows = ledger.of(keys)
    table = summary(rows)
    tell(
        {
            "machine": machine_line(device),
            "rows": rows,
            "table": table,
            "written": [str(ledger.path)],
        },
        f"friction {how['friction']:g} believed; e_mean [cm] of each trial, and in brackets their "
        "mean over that of the same trials without an effect; the last column is of all "
        "trials that are there with and without",
        *table_told(table, asked),
        *_looks_told(rows),
    )


def summary(rows: list[dict]) -> list[dict]:
    """Errors [cm] of the trials of each effect, rod, pattern and way, by their seeds; their mean;
    and its ratio to the mean of the same trials without an effect (None where one is not there)."""
    cells: dict[tuple, dict[int, float]] = {}
    for row in rows:
        key = row["effect"], row["rod"], row["pattern"], row["way"]
        cells.setdefault(key, {})[row["seed"]] = row["error_mean"]
    table = []
    for (effect, *cell), errors in cells.items():
        base = cells.get(("none", *cell), {})
        mean, over = float(np.mean(list(errors.values()))), None
        if errors.keys() <= base.keys():
            over = mean / float(np.mean([base[seed] for seed in errors]))
        named = dict(zip(("effect", "rod", "pattern", "way"), (effect, *cell), strict=True))
        table.append(named | {"errors": errors, "error_mean": mean, "over_none": over})
    return table


def table_told(table: list[dict], ways: Sequence[str]) -> list[str]:
    """The lines of a table of effects by patterns for each way, in Markdown."""
    lines = []
    for way, rod in product(ways, dict.fromkeys(one["rod"] for one in table)):
        cells = {
            (one["effect"], one["pattern"]): one
            for one in table
            if (one["way"], one["rod"]) == (way, rod)
        }
        names = list(dict.fromkeys(name for _, name in cells))
        lines += ["", " | ".join([f"| {rod}, {way}", *names, "mean"]) + " |"]
        lines.append("| --- " * (len(names) + 2) + "|")
        for effect in dict.fromkeys(effect for effect, _ in cells):
            told = [_told(cells.get((effect, name))) for name in names]
            told.append(_told_of_all(effect, cells, names))
            lines.append(" | ".join([f"| {EFFECTS[effect]}", *told]) + " |")
    return lines


def _told(cell: dict | None) -> str:
    if cell is None:
        return "-"
    errors = ", ".join(f"{cell['errors'][seed]:.3f}" for seed in sorted(cell["errors"]))
    over = cell["over_none"]
    return errors if over is None or cell["effect"] == "none" else f"{errors} ({over:.2f})"


def _told_of_all(effect: str, cells: dict[tuple[str, str], dict], names: list[str]) -> str:
    """The mean over patterns and seeds, of the trials of which there is one without an effect, and
    over the mean of these."""
    pairs = [
        (error, cells["none", name]["errors"][seed])
        for name in names
        if {("none", name), (effect, name)} <= cells.keys()
        for seed, error in cells[effect, name]["errors"].items()
        if seed in cells["none", name]["errors"]
    ]
    if not pairs:
        return "-"
    mean, none = np.mean(pairs, axis=0)
    return f"{mean:.3f}" if effect == "none" else f"{mean:.3f} ({mean / none:.2f})"


def _looks_told(rows: list[dict]) -> list[str]:
    """How long looks took, and how often the grip went back."""
    looks = [look for row in rows for look in row.get("looks", ())]
    if not looks:
        return []
    seconds = [look["seconds"] for look in looks]
    back = sum(look["back"] is not None for look in looks)
    return [
        f"{len(looks)} looks took {np.median(seconds):.1f} s of a processor each (median; at most "
        f"{max(seconds):.1f}), for the beliefs and the path; the grip went back {back} times"
    ]


@cache
def _half(middle: float):
    """Half the friction beyond that x [m]; one field for all rods on such a table, so that a GPU
    lays them together."""
    from wrod.solvers.friction import FrictionField

    reach = (middle - _FAR, middle + _FAR)
    return FrictionField.of(
        lambda x, y: np.where(x > middle, 0.5, 1.0), reach, reach, (_GRID, _GRID)
    )


def _world(effect: str, led, material, friction: float, seed: int, undisturbed: bool):
    from wrod.deployment.feedback import Plant
    from wrod.deployment.setup import Disturbance
    from wrod.solvers.friction import Friction

    law = Friction(0.5 * friction if effect == "friction" else friction)
    how = Disturbance() if undisturbed else Disturbance.random(_FIRST_SEED + seed)
    if effect in _LGB:
        how = replace(how, lgb_error=_LGB[effect] * (1.0 + how.lgb_error) - 1.0)
    if effect == "curvature":
        how = replace(how, natural_curvature=how.natural_curvature + 4.0)
    if effect == "offset":
        how = replace(how, offset=(how.offset[0] + _OFFSET, how.offset[1] + _OFFSET))
    field = None
    if effect == "half":
        x = led.sample(np.linspace(0.0, led.length, 200))[0][:, 0]
        field = _half(0.5 * float(x.min() + x.max()))
    return Plant(material, law, how, field)


def _course(shelf, key: tuple, how: dict):
    """The deployments of a trial, and its row."""
    from dataclasses import asdict

    from wrod.deployment.expectation import FINE, PACE
    from wrod.deployment.feedback import following
    from wrod.deployment.looking_on import FeedbackLoop
    from wrod.deployment.result import errors_along
    from wrod.deployment.sight import Sight
    from wrod.deployment.simulate import Trial
    from wrod.deployment.together import Asked
    from wrod.planning.tail import Tail

    rod_name, name, effect, way, seed = key
    led, material = shelf.course(rod_name, name)
    trajectory = shelf.plan(rod_name, name, how["friction"], "optimised")
    how_laid: dict[str, Any] = {"discretisation": FINE, "speed": PACE}
    plant = _world(effect, led, material, how["friction"], seed, how["undisturbed"])
    mu, looks = how["friction"], []
    if way == "blind":
        rest = Tail.none(trajectory)
        trial = Trial(led, plant.rod, trajectory, plant.friction, plant.disturbance, rest)
        (laid,) = yield Asked([trial], None, {"friction_field": plant.friction_field, **how_laid})
    else:
        told = {name: how[name] for name in ("every", "horizon", "patience")}
        loop = FeedbackLoop(led, material, trajectory, mu, again=way != "forwards", **told)
        sight = Sight(seed=seed)
        sight = replace(sight, hanging=np.inf) if way == "above" else sight
        known = way == "known"
        followed = yield from following(loop, plant, sight=sight, known=known, **how_laid)
        laid, looks = followed.laid, followed.looks
    error = 100.0 * errors_along(led, laid.arc_length, laid.centerline)[1]
    return dict(zip(KEYS, key, strict=True)) | {
        "error_mean": float(error.mean()),
        "error_by_tenth": error.reshape(10, -1).mean(axis=1).tolist(),
        "diverged": laid.diverged,
        "looks": [asdict(look) for look in looks],
    }
