"""`wrod bench loop`: a rod with an unknown effect is measured, understood, and laid better."""

from pathlib import Path

import click

from wrod.bench.loop_trials import CONTROLLERS, EFFECTS
from wrod.telling import json_option, tell


@click.command(name="loop")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option(
    "--effect", "effects", multiple=True, type=click.Choice(EFFECTS), help="Default: all."
)
@click.option(
    "--recording",
    type=click.Path(dir_okay=False, exists=True, path_type=Path),
    help="Recordings of a cable in motion (.npz) instead: what is found in them is planned with, "
    "and lays that cable along a bend of its own size.",
)
@click.option("--pattern", "names", multiple=True, help="Pattern (repeatable); default: seven.")
@click.option(
    "--patterns",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder of pattern files (line.txt, letterA.txt, ...); default: the built-in patterns.",
)
@click.option("--rod", "rod_name", default="green-vps", show_default=True, help="Believed rod.")
@click.option("--curvature", default=4.0, show_default=True, help="Natural curvature [1/m].")
@click.option("--lgb-error", default=0.15, show_default=True, help="Of the believed L_gb.")
@click.option("--trials", default=16, show_default=True, help="Clamped shapes measured.")
@click.option("--noise", default=3e-4, show_default=True, help="Of a marker coordinate [m].")
@click.option(
    "--candidate", "candidates", multiple=True,
    help="Let the identification try this effect only (repeatable); default: all it knows.",
)  # fmt: skip
@click.option(
    "--controller",
    "controllers",
    multiple=True,
    type=click.Choice(CONTROLLERS),
    help="Who plans (repeatable); default: network, and default: what `wrod plan` does unasked.",
)
@click.option(
    "--grasps", default=2048, show_default=True, help="That a curved rod's network learns."
)
@click.option("--steps", type=int, help="Of its training; default: the recipe's.")
@click.option("--friction", default=1.0, show_default=True, help="Friction coefficient.")
@click.option(
    "--known-table",
    is_flag=True,
    help="Correct new plans for that friction, as `wrod plan --friction` does (a minute or two).",
)
@click.option("--rolling", is_flag=True, help="Let the laid rod roll freely.")
@click.option(
    "--roll",
    "roll_text",
    default="plane",
    show_default=True,
    help="How all plans hold the rod: plane, as one would by accident who knows of no curvature, "
    "up, or degrees (see `wrod plan`).",
)
@click.option("--speed", default=0.03, show_default=True, help="Speed of the contact [m/s].")
@click.option("--step", default=0.02, show_default=True, help="Largest time step [s].")
@click.option("--spacing", default=0.006, show_default=True, help="Length of the edges [m].")
@click.option("--seed", default=0, show_default=True, help="Of poses and noise.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda:0 or auto.")
@json_option
def command(**given) -> None:
    """Close the loop on a rod that has an effect nobody declared.

    For each effect: synthetic measurements of the true rod between two clamps (a continuous rod by
    collocation), identification that is not told the effect, a network trained for the identified
    rod where that is curved, plans with the old and with the identified model, and simulated
    deployments of the true rod with both, beside those of a rod without the effect.

    With --recording nobody knows the true rod: the cable that was found in the recordings is laid,
    with plans of the straight, uniform, damped cable that fits them best and with its own.
    """
    from wrod.bench.loop_report import markdown
    from wrod.bench.loop_run import Loop, run

    loop = Loop(**given)
    figures = run(loop)
    spent = ", ".join(f"{name} {value:.0f} s" for name, value in figures["seconds"].items())
    tell(figures, markdown(figures["rows"], figures["found"], loop.head), spent)
