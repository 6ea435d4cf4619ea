"""`wrod bench newton`: `SolverDER` in Newton: what its cables pull and touch, and many worlds."""

import json
import warnings
from importlib import import_module

import click

from wrod import cost
from wrod.machine import machine_line
from wrod.options import option, own_options, refuse_idle_options
from wrod.telling import asked, json_option


@click.command(name="newton")
@own_options
@json_option
def command(
    bodies: bool = option("Cables that pull bodies, and a pile; the default."),
    many: bool = option("Many worlds, a step in a graph, a large pile."),
    worlds: int = option("Worlds of --many.", default=1024),
    cables: int = option("Cables of the pile of --many; of SolverVBD too if tens.", default=40),
    edges: int = option("Edges of a cable of --many.", default=40),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
) -> None:
    """SolverDER's coupling with free bodies and an arm against closed forms and statics, and a
    pile, on the CPU. With --many: lines of JSON, as they come.
    """
    # Before newton, which starts Warp: its banner would be the first line of --json.
    import_module("wrod.kernels")
    if bodies:
        refuse_idle_options("--bodies", "many")
    if not many:
        refuse_idle_options("no --many", "worlds", "cables", "edges", "device")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Newton corrects the inertia of small and thin bodies
        if many:
            _measure_many(device, worlds, cables, edges)
        else:
            _measure_bodies()


def _measure_bodies() -> None:
    from wrod.bench.newton_bodies import measure

    cost.settle(cost.Cost(cost.NEWTON_BODIES), "all scenes")
    if asked("json"):
        names = ("what", "found", "expected")
        click.echo(json.dumps([dict(zip(names, row, strict=True)) for row in measure()]))
        return
    click.echo(machine_line("cpu"))
    click.echo("\n| what | found | expected |\n| --- | --- | --- |")
    for row in measure():
        click.echo(f"| {' | '.join(row)} |")


def _measure_many(device: str, worlds: int, cables: int, edges: int) -> None:
    from wrod.bench.newton_many import measure
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    work = cost.Cost(
        cost.NEWTON_MANY + edges * (cost.WORLD_EDGE * worlds + cost.PILE_EDGE * cables**2)
    )
    cost.settle(work, f"{worlds} worlds and a pile of {cables}", "ask for fewer of them")
    click.echo(json.dumps({"machine": machine_line(device)}))
    for row in measure(device, worlds, cables, edges):
        click.echo(json.dumps(row))
