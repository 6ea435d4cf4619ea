"""`wrod bench loop`: a rod with an unknown effect is measured, understood, and laid better."""

import click

from wrod.bench.loop_options import Loop
from wrod.options import gathered
from wrod.telling import json_option, tell


@click.command(name="loop")
@gathered("loop", Loop)
@json_option
def command(loop: Loop) -> None:
    """Close the loop on a rod that has an effect nobody declared.

    For each effect: synthetic measurements of the true rod between two clamps (a continuous rod by
    collocation), identification that is not told the effect, a network trained for the identified
    rod where that is curved, plans with the old and with the identified model, and simulated
    deployments of the true rod with both, beside those of a rod without the effect.

    With --recording nobody knows the true rod: the cable that was found in the recordings is laid,
    with plans of the straight, uniform, damped cable that fits them best and with its own.
    """
    from wrod.bench.loop_report import markdown
    from wrod.bench.loop_run import run

    figures = run(loop)
    spent = ", ".join(f"{name} {value:.0f} s" for name, value in figures["seconds"].items())
    tell(figures, markdown(figures["rows"], figures["found"], loop.head), spent)
