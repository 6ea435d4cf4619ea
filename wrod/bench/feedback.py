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
@click.option("--every", default=0.1, show_default=True, help="Laid length between two looks [m].")
@click.option("--device", default="auto", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option("--json", "as_json", is_flag=True, help="Print figures for machines.")
def command(
    rod_name: str,
    name: str,
    patterns: Path | None,
    friction: float,
    effects: str,
    every: float,
    device: str,
    out: Path,
    as_json: bool,
) -> None:
    """Lay a pattern with rods and tables that differ from the plan's, blindly and looking on.

    The plan knows the table that is believed in; it is kept in OUT/plans.
    """
    from wrod.bench.slippery import Shelf
    from wrod.errors import RodError
    from wrod.files import write_atomically
    from wrod.rods.batch import resolve_device

    chosen = effects.split(",")
    if unknown := [effect for effect in chosen if effect not in EFFECTS]:
        raise RodError(f"unknown effect {unknown[0]!r}; use some of {', '.join(EFFECTS)}")
    device = resolve_device(device)
    shelf = Shelf(out / "plans", patterns, device)
    led, material = shelf.course(rod_name, name)
    trajectory = shelf.plan(rod_name, name, friction, "optimised")
    rows = []
    for effect in chosen:
        world = _world(effect, led, material, friction)
        rows.append(_row(effect, led, material, trajectory, friction, world, every, device))
        if not as_json:
            click.echo(
                f"{rod_name}, {name}, friction {friction:g}, {EFFECTS[effect]}: "
                f"{rows[-1]['blind']:.3f} cm without, {rows[-1]['followed']:.3f} with feedback"
            )
    path = write_atomically(
        out / "feedback.json", lambda file: file.write(json.dumps(rows, indent=2))
    )
    if as_json:
        click.echo(json.dumps({"rows": rows, "written": [str(path)]}, indent=2))
        return
    click.echo(f"wrote {path}")


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


def _row(effect, led, material, trajectory, friction, world, every, device) -> dict:
    from dataclasses import asdict

    from wrod.deployment.feedback import lay_with_feedback
    from wrod.deployment.optimise import FINE
    from wrod.deployment.result import errors_along
    from wrod.deployment.simulate import Trial
    from wrod.deployment.tangents import lay

    blind = lay(
        [Trial(led, world.rod, trajectory, world.friction, world.disturbance)],
        friction_field=world.friction_field, device=device, **FINE,
    )[0]  # fmt: skip
    followed = lay_with_feedback(
        led, material, trajectory, friction, world, every=every, device=device, **FINE
    )

    def error(laid) -> float:
        return 100.0 * float(errors_along(led, laid.arc_length, laid.centerline)[1].mean())

    return {
        "effect": effect,
        "blind": error(blind),
        "followed": error(followed.laid),
        "looks": [asdict(look) for look in followed.looks],
    }
