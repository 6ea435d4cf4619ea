"""What commands tell: people in lines, machines, that give --json, in figures.

What --json and --force say is kept with the running command, where `tell` and `wrod.cost` look it
up: nothing has to be handed down to them.
"""

import json
from collections.abc import Iterable, Sequence
from typing import Any

import click


def _kept(context: click.Context, option: click.Parameter, given: bool) -> None:
    context.meta[f"wrod {option.name}"] = given


def flag(name: str, said: str):
    """A flag that `asked` knows of, and that is no argument of its command."""
    return click.option(f"--{name}", is_flag=True, expose_value=False, callback=_kept, help=said)


json_option = flag("json", "Print figures for machines.")


def asked(name: str) -> bool | None:
    """Whether the running command was given a `flag`; None where it has none."""
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(f"wrod {name}")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def tell(figures: dict[str, Any], *lines: str) -> None:
    """Print what a command found: with --json the figures; else the machine on which a benchmark
    ran, if they say it, the lines, and which files were "written"."""
    if asked("json"):
        click.echo(json.dumps(figures, indent=2))
        return
    if "machine" in figures:
        click.echo(figures["machine"])
    for line in lines:
        click.echo(line)
    for path in figures.get("written", ()):
        click.echo(f"wrote {path}")
