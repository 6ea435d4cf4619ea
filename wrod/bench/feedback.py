"""`wrod bench feedback`: what looking at the laid rod saves where the rod is not as believed."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np

# Row by row, what the true rod differs by though nobody declared it.
EFFECTS = {
    "none": "as believed",
    "friction": "friction halved",
    "stiffness": "L_gb 15 % larger",
    "curvature": "4 /m of natural curvature",
    "offset": "robot 2 mm beside its place",
    "half": "half the table with half the friction",
}
# Without looking; looking on; and knowing the truth from the first look on, which no looking beats.
WAYS = ("blind", "followed", "known")
KEYS = ("rod", "pattern", "effect", "way")
_OFFSET = 2e-3 / np.sqrt(2.0)
_FAR, _GRID = 1.0, 401


@click.command(name="feedback")
@click.option("--rod", "rod_name", default="green-vps", show_default=True)
@click.option("--name", default="letter-U", show_default=True, help="The pattern.")
@click.option(
    "--patterns",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder of pattern files; default: the built-in patterns.",
)
@click.option("--friction", default=0.4, show_default=True, help="That is believed in.")
@click.option("--effects", default=",".join(EFFECTS), show_default=True, help="Rows of the table.")
@click.option("--ways", default=",".join(WAYS), show_default=True, help="Columns of the table.")
@click.option("--every", default=0.03, show_default=True, help="Laid length between two looks [m].")
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    rod_name: str,
    name: str,
    patterns: Path | None,
    friction: float,
    effects: str,
    ways: str,
    every: float,
    device: str,
    out: Path,
    as_json: bool,
) -> None:
    """Lay a pattern with rods and tables that differ from the plan's, blindly and looking on.

    The plan knows the table that is believed in; it is kept in OUT/plans, and finished deployments
    in OUT/feedback.jsonl: a run that was stopped goes on from there. Beside them stands the floor:
    what is left where the truth is known from the first look on.
    """
    from wrod.bench.ledger import Ledger
    from wrod.bench.slippery import Shelf
    from wrod.errors import RodError
    from wrod.rods.device import resolve_device

    chosen, asked = effects.split(","), ways.split(",")
    for what, given, known in (("effect", chosen, tuple(EFFECTS)), ("way", asked, WAYS)):
        if unknown := [one for one in given if one not in known]:
            raise RodError(f"unknown {what} {unknown[0]!r}; use some of {', '.join(known)}")
    device = resolve_device(device)
    shelf = Shelf(out / "plans", patterns, device)
    led, material = shelf.course(rod_name, name)
    out.mkdir(parents=True, exist_ok=True)
    settings = {
        "friction": friction, "every": every,
        "patterns": "built-in" if patterns is None else patterns.name,
    }  # fmt: skip
    ledger = Ledger(out / "feedback.jsonl", settings, KEYS, "feedback")
    done, keys = ledger.done(), [(rod_name, name, e, way) for e in chosen for way in asked]
    for key in keys:
        if key not in done:
            trajectory = shelf.plan(rod_name, name, friction, "optimised")
            world = _world(key[2], led, material, friction)
            figures = _laid(key[3], led, material, trajectory, friction, world, every, device)
            ledger.add([dict(zip(KEYS, key, strict=True)) | figures])
    rows = ledger.of(keys)
    if as_json:
        click.echo(json.dumps({"rows": rows, "written": [str(ledger.path)]}, indent=2))
        return
    click.echo(f"{rod_name}, {name}, friction {friction:g} believed; e_mean [cm]")
    for effect in chosen:
        errors = {row["way"]: row["error_mean"] for row in rows if row["effect"] == effect}
        said = ", ".join(f"{way} {errors[way]:.3f}" for way in asked)
        click.echo(f"{EFFECTS[effect]}: {said}")
    click.echo(f"wrote {ledger.path}")


def _world(effect: str, led, material, friction: float):
    from wrod.deployment.feedback import World
    from wrod.deployment.setup import Disturbance
    from wrod.solvers.contact import Friction, FrictionField

    law = Friction(0.5 * friction if effect == "friction" else friction)
    how = {
        "stiffness": Disturbance(lgb_error=0.15),
        "curvature": Disturbance(natural_curvature=4.0),
        "offset": Disturbance(offset=(_OFFSET, _OFFSET)),
    }.get(effect, Disturbance())
    field = None
    if effect == "half":
        x = led.sample(np.linspace(0.0, led.length, 200))[0][:, 0]
        middle = 0.5 * (x.min() + x.max())
        reach = (middle - _FAR, middle + _FAR)
        field = FrictionField.of(
            lambda x, y: np.where(x > middle, 0.5, 1.0), reach, reach, (_GRID, _GRID)
        )
    return World(material, law, how, field)


def _laid(way, led, material, trajectory, friction, world, every, device) -> dict:
    from dataclasses import asdict

    from wrod.deployment.expectation import FINE
    from wrod.deployment.feedback import lay_with_feedback
    from wrod.deployment.result import errors_along
    from wrod.deployment.simulate import Trial
    from wrod.deployment.tangents import lay

    looks: list = []
    if way == "blind":
        trial = Trial(led, world.rod, trajectory, world.friction, world.disturbance)
        (laid,) = lay([trial], friction_field=world.friction_field, device=device, **FINE)
    else:
        followed = lay_with_feedback(
            led, material, trajectory, friction, world,
            every=every, known=way == "known", device=device, **FINE,
        )  # fmt: skip
        laid, looks = followed.laid, followed.looks
    error = 100.0 * errors_along(led, laid.arc_length, laid.centerline)[1]
    return {
        "error_mean": float(error.mean()),
        "error_by_tenth": error.reshape(10, -1).mean(axis=1).tolist(),
        "diverged": laid.diverged,
        "looks": [asdict(look) for look in looks],
    }
