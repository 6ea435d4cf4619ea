"""`wrod bench NAME`: benchmarks that print their numbers with machine and versions."""

import click

from wrod.commands import LazyGroup

BENCHMARKS = (
    "controller",
    "grasp",
    "manifold",
    "perception",
    "plan",
    "robot",
    "table4",
    "table3",
    "deploy",
    "rounds",
    "bends",
    "newton",
    "cosserat",
    "identify",
    "cables",
    "loop",
    "optimised",
    "slippery",
    "feedback",
    "applications",
    "photographs",
    "hands",
)


@click.command(name="bench", cls=LazyGroup, package="wrod.bench", names=BENCHMARKS)
def command() -> None:
    """Measure speed and accuracy on this machine."""
