"""`wrod rods`: the catalogue of rods, cables and ropes, with sources and spread."""

import json

import click

from wrod.telling import asked, json_option


@click.command(name="rods", short_help="List the rods, cables and ropes that --rod knows.")
@json_option
def command() -> None:
    """List rods, cables and ropes that --rod knows, with their stiffness, its spread and source.

    A cable of your own is measured in minutes: see `wrod loop` and `wrod measure`.
    """
    from wrod.rods.catalogue import catalogue

    entries = catalogue()
    if asked("json"):
        rows = [
            {
                "name": entry.name, "what": entry.what, "radius": entry.rod.radius,
                "gravito_bending_length": entry.rod.gravito_bending_length,
                "length": entry.rod.length, "weight_per_length": entry.rod.weight,
                "bending_stiffness": entry.rod.bending_stiffness, "spread": entry.spread,
                "note": entry.note, "source": entry.source,
            }
            for entry in entries
        ]  # fmt: skip
        click.echo(json.dumps(rows, indent=2))
        return
    click.echo(
        f"{'name':25s} {'L_gb cm':>8s} {'EI N m^2':>9s} {'spread':>6s} {'radius mm':>9s}  what"
    )
    for entry in entries:
        spread = "-" if entry.spread is None else f"{100 * entry.spread:.0f} %"
        click.echo(
            f"{entry.name:25s} {100 * entry.rod.gravito_bending_length:8.2f} "
            f"{entry.rod.bending_stiffness:9.2g} {spread:>6s} {1e3 * entry.rod.radius:9.1f}  "
            f"{entry.what}; {entry.note}"
        )
    for source in dict.fromkeys(entry.source for entry in entries):
        names = ", ".join(entry.name for entry in entries if entry.source == source)
        click.echo(f"{names}: {source}")
    click.echo(
        "No published stiffness was found of Ethernet cables and climbing ropes; yours takes a "
        "ruler and two minutes: fold it over on a table and give `wrod loop` the height of the fold"
    )
