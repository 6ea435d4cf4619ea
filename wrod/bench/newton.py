"""`wrod bench newton`: `SolverDER` beside Newton's cable and PyElastica, on one problem."""

import json
from pathlib import Path

import click

from wrod import cost
from wrod.options import parse_list, refuse_idle_options
from wrod.telling import asked, json_option

# Steps of the implicit solvers over the period.
_DER_STEP, _VBD_STEP = 1.0 / 80.0, 1.0 / 400.0
_SWING = 0.01  # amplitude over the length


def _numbers(context, parameter, value: str) -> list[int]:
    least = 2 if parameter.name == "edges" else 1  # nothing bends between two nodes
    return [int(n) for n in parse_list(value, parameter.opts[0], least, 10_000, whole=True)]


@click.command(name="newton")
@click.option("--rod", "rod_name", default="green-vps", show_default=True, help="Rod.")
@click.option("--length", default=0.1, show_default=True, help="Its free length [m].")
@click.option(
    "--scale",
    default=10.0,
    show_default=True,
    help="Enlarges all lengths: Newton's cable is made for metres.",
)
@click.option("--edges", default="10,20,40", show_default=True, callback=_numbers, help="Meshes.")
@click.option(
    "--iterations",
    default="10,40,160",
    show_default=True,
    callback=_numbers,
    help="Iterations of Newton's cable.",
)
@click.option("--rods", default=64, show_default=True, help="Rods of the batch that is timed.")
@click.option("--periods", default=4.0, show_default=True, help="Time to come to rest.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--bodies", is_flag=True, help="Only cables that pull bodies, and a pile.")
@click.option("--many", is_flag=True, help="Only many worlds, a step in a graph, a large pile.")
@click.option("--worlds", default=1024, show_default=True, help="Worlds of --many.")
@click.option("--cables", default=40, show_default=True, help="Cables of the pile of --many.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for table and picture.")
@json_option
def command(bodies: bool, many: bool, worlds: int, cables: int, **given) -> None:
    """Compare a heavy cantilever at rest and swinging with the continuum, and time it.

    SolverDER, Newton's cable (SolverVBD) and, where it is installed, PyElastica, in one run.
    With --bodies: SolverDER's coupling with free bodies and an arm against closed forms and
    statics, and a pile, on the CPU. With --many: lines of JSON, as they come.
    """
    from importlib import import_module

    # Before newton, which starts Warp: its banner would be the first line of --json.
    import_module("wrod.kernels")
    table = ("rod", "length", "scale", "iterations", "rods", "periods", "out")
    if bodies:
        refuse_idle_options("--bodies", "many", "edges", "device", *table)
    elif many:
        refuse_idle_options("--many", *table)
    if not many:
        refuse_idle_options("no --many", "worlds", "cables")
    if bodies:
        _measure_bodies()
        return
    if many:
        _measure_many(given["device"], worlds, cables, given["edges"][-1])
        return
    _measure_cantilever(**given)


def _measure_cantilever(
    rod_name: str,
    length: float,
    scale: float,
    edges: list[int],
    iterations: list[int],
    rods: int,
    periods: float,
    device: str,
    out: Path | None,
) -> None:
    import importlib.util
    from importlib.metadata import version

    from wrod.bench.cantilever import Cantilever
    from wrod.bench.newton_report import draw, markdown
    from wrod.machine import machine_line
    from wrod.rods.catalogue import rod
    from wrod.rods.device import resolve_device
    from wrod.rods.material import RodMaterial

    device = resolve_device(device)
    small = rod(rod_name)
    material = RodMaterial(
        scale * small.radius, scale * small.gravito_bending_length, scale * small.length,
        small.poisson, small.density, small.gravity,
    )  # fmt: skip
    problem = Cantilever(material, scale * length)
    duration = periods * problem.period
    with_elastica = all(map(importlib.util.find_spec, ("elastica", "numba")))
    if not with_elastica:
        click.echo("PyElastica is not installed; for its rows: pip install wrod[peers]", err=True)

    _settle(edges, iterations, rods, periods)
    rows, speed = _compare(problem, edges, iterations, rods, duration, device, with_elastica)
    versions = f"newton {version('newton')}"
    if with_elastica:
        versions += f"; pyelastica {version('pyelastica')}"
    figures = {
        "machine": f"{machine_line(device)}; {versions}",
        "device": device,
        "problem": {
            "rod": rod_name, "scale": scale, "length": problem.length, "tip": problem.tip.tolist(),
            "period": problem.period,
        },
        "rows": rows,
        "speed": speed,
    }  # fmt: skip
    text = markdown(figures)
    click.echo(json.dumps(figures) if asked("json") else text)
    if out is not None:
        from wrod.files import write_text

        write_text(out / "newton.md", text + "\n")
        for path in (out / "newton.md", draw(out / "newton.png", figures)):
            click.echo(f"wrote {path}", err=bool(asked("json")))


def _settle(edges: list, iterations: list, rods: int, periods: float) -> None:
    """Say what the table costs, most of it the steps of Newton's cable, or refuse it."""
    swings, timed = periods + 2.6, min(periods, 0.4)
    of_rods = edges[len(edges) // 2] * iterations[-1] * timed * (1 + rods)
    passes = (sum(edges) * sum(iterations) * swings + of_rods) / _VBD_STEP
    work = cost.Cost(cost.NEWTON_ROW * len(edges) * (2 + len(iterations)) + cost.VBD_EDGE * passes)
    what = f"{len(edges)} meshes, {len(iterations)} numbers of iterations"
    cost.settle(work, what, "ask for fewer, or fewer --rods or --periods")


def _compare(problem, edges, iterations, rods: int, duration, device, with_elastica) -> tuple:
    """Rows of accuracy, one for each solver and mesh, and of speed with one rod and with many."""
    import warnings
    from dataclasses import asdict

    from tqdm import tqdm

    from wrod.bench.cantilever import Start, come_to_rest, swing
    from wrod.bench.cantilever_solvers import Der, Elastica, Vbd

    def der(mesh, start):
        return Der(problem, mesh, _DER_STEP * problem.period, start, device)

    def vbd(count):
        return lambda mesh, start: Vbd(
            problem, mesh, _VBD_STEP * problem.period, start, device, count
        )

    def elastica(mesh, start):
        return Elastica(problem, mesh, Elastica.stable_step(problem, mesh), start)

    solvers = [der, *map(vbd, iterations), *([elastica] if with_elastica else [])]
    free = Start(gravity=False, damping=False, swing=_SWING * problem.length)
    rows, speed = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Newton corrects the inertia of thin capsules
        for make, mesh in tqdm([(s, n) for n in edges for s in solvers], unit="row", disable=None):
            solver = make(mesh, Start())
            rest = come_to_rest(solver, problem, duration)
            rows.append(
                {
                    "solver": solver.name, "edges": mesh, "effort": solver.effort,
                    "step": solver.dt, "rest": asdict(rest),
                    "swing": asdict(swing(make(mesh, free), problem)),
                }
            )  # fmt: skip
        middle = edges[len(edges) // 2]
        batches = [der, vbd(iterations[-1]), *([elastica] if with_elastica else [])]
        for make, count in tqdm([(s, n) for s in batches for n in (1, rods)], disable=None):
            solver = make(middle, Start(rods=count))
            # Long enough to time it; its accuracy is in the table above.
            rest = come_to_rest(solver, problem, min(duration, 0.4 * problem.period), count)
            row = next(
                r for r in rows
                if (r["solver"], r["effort"], r["edges"]) == (solver.name, solver.effort, middle)
            )  # fmt: skip
            speed.append(
                {
                    "solver": solver.name, "rods": count, "edges": middle, "effort": solver.effort,
                    "step": solver.dt, "rod_steps_per_second": 1e3 * count / rest.step_ms,
                    "simulated_per_second": 1.0 / rest.cpu_per_second,
                    "error": row["rest"]["error"], "drift": row["rest"]["drift"],
                }
            )  # fmt: skip
    return rows, speed


def _measure_bodies() -> None:
    import warnings

    from wrod.bench.newton_bodies import measure
    from wrod.machine import machine_line

    cost.settle(cost.Cost(cost.NEWTON_BODIES), "all scenes")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Newton corrects the inertia of small bodies
        if asked("json"):
            names = ("what", "found", "expected")
            click.echo(json.dumps([dict(zip(names, row, strict=True)) for row in measure()]))
            return
        click.echo(machine_line("cpu"))
        click.echo("\n| what | found | expected |\n| --- | --- | --- |")
        for row in measure():
            click.echo(f"| {' | '.join(row)} |")


def _measure_many(device: str, worlds: int, cables: int, edges: int) -> None:
    import warnings

    from wrod.bench.newton_many import measure
    from wrod.machine import machine_line
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    work = cost.Cost(
        cost.NEWTON_BODIES + edges * (cost.WORLD_EDGE * worlds + cost.PILE_EDGE * cables**2)
    )
    cost.settle(work, f"{worlds} worlds and a pile of {cables}", "ask for fewer of them")
    click.echo(json.dumps({"machine": machine_line(device)}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Newton corrects the inertia of thin capsules
        for row in measure(device, worlds, cables, edges):
            click.echo(json.dumps(row))
