"""`wrod bench cosserat`: other people's experiments on rods, beside other people's solvers."""

from __future__ import annotations

import json
from importlib.util import find_spec

import click

from wrod.errors import DataError

_METRICS = {
    "cantilever": "tip_deflection_error",
    "catenary": "shape_error",
    "pendulum": "period_error",
    "twist": "critical_twist_error",
    "crossing": "shape_error",
    "capstan": "slide",
    "pile": "footprint",
}
_SOLVERS = ("wrod", "pyelastica", "mujoco")


@click.command("cosserat")
@click.option("--experiment", "chosen", multiple=True, type=click.Choice(list(_METRICS)),
              help="Only this one; may be repeated. Default: all.")  # fmt: skip
@click.option("--solver", "solvers", multiple=True, type=click.Choice(_SOLVERS),
              help="Only this one; may be repeated. Default: all that are installed.")  # fmt: skip
@click.option("--elements", type=click.IntRange(4, 2000), default=None,
              help="Elements of each rod; default: what the experiment has.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(chosen, solvers, elements, as_json) -> None:
    """Experiments of cosseratbench: error and time, side by side.

    Each is scored by cosseratbench's own metrics, in one run on one machine; times are
    wall times, after a warm-up, without compiling.
    """
    from wrod.machine import machine_line

    if find_spec("cosseratbench") is None:
        raise DataError("this bench needs cosseratbench; run pip install 'wrod[peers]'")
    if not as_json:
        click.echo(machine_line())
        click.echo(f"{'experiment':12s} {'solver':11s} {'n':>4s} {'s':>8s}  outcome")
    rows = []
    for experiment in chosen or _METRICS:
        for solver in solvers or _SOLVERS:
            row = _run(experiment, solver, elements)
            rows.append(row)
            if not as_json:
                click.echo(
                    f"{experiment:12s} {solver:11s} {row['elements']:4d} {row['seconds']:8.2f}"
                    f"  {row['said']}"
                )
    if as_json:
        click.echo(json.dumps({"machine": machine_line(), "rows": rows}))


def _run(name: str, solver: str, elements: int | None) -> dict:
    from cosseratbench import registry
    from cosseratbench.experiment import run

    from wrod.bench.cosserat_solver import WrodSolver

    experiment = registry.load_experiment(name)
    row = {
        "experiment": name,
        "solver": solver,
        "elements": elements or experiment.n_elements,
        "seconds": 0.0,
    }
    try:
        adapter = WrodSolver() if solver == "wrod" else registry.load_solver(solver)
    except (ImportError, KeyError) as error:
        return {**row, "outcome": "not installed", "said": f"not installed ({error})"}
    try:
        summary = run(experiment, adapter, n_elements=elements).summary()
    except Exception as error:
        if solver == "wrod":
            raise
        # A peer's adapter that does not fit the version of its library, for one.
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        return {**row, "outcome": "crashed", "said": f"its adapter crashed ({what:.80})"}
    row |= {"seconds": summary.get("wall_time") or 0.0, "outcome": summary["outcome"]}
    metrics = summary.get("metrics") or {}
    said = ", ".join(f"{key} {value:.3g}" for key, value in metrics.items() if value is not None)
    if summary["outcome"] != "completed":
        said = f"{summary['outcome']}: {summary.get('failure') or summary.get('missing')}"
    overlap = (summary.get("observations") or {}).get("max_rod_overlap")
    return {**row, "metrics": metrics, "overlap": overlap, "said": said}
