"""`wrod bench cosserat`: other people's experiments on rods, beside other people's solvers."""

import json
import time
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from math import isfinite
from pathlib import Path

import click
import msgspec

from wrod import cost
from wrod.errors import DataError, RodError
from wrod.files.reading import MAX_JSON, read_text, refuse_depth
from wrod.files.row_schemas import CosseratRows
from wrod.machine import machine_line
from wrod.options import option, own_options
from wrod.telling import asked, json_option

_METRICS = {
    "cantilever": "tip_deflection_error",
    "catenary": "shape_error",
    "pendulum": "period_error",
    "twist": "critical_twist_error",
    "crossing": "shape_error",
    "capstan": "slide",
    "pile": "max_rod_overlap",
}
_SOLVERS = ("wrod", "pyelastica", "newton-vbd", "mujoco", "dismech", "dismech-newton")


@click.command("cosserat")
@own_options
@json_option
def command(
    chosen: tuple[str, ...] = option(
        "Only this one; may be repeated. Default: all.",
        "--experiment",
        type=click.Choice(list(_METRICS)),
    ),
    solvers: tuple[str, ...] = option(
        "Only this one; may be repeated. Default: all that are installed.",
        "--solver",
        type=click.Choice(_SOLVERS),
    ),
    elements: tuple[int, ...] = option(
        "Elements of each rod; may be repeated. Default: the experiment's."
    ),
    longer: float = option(
        "Take so many times as long: what is judged at rest may move.", default=1.0
    ),
    out: Path | None = option("Folder for a picture of all."),
    others: tuple[Path, ...] = option(
        "Rows of another run's --json to draw too; may be repeated.",
        "--with",
        type=click.Path(exists=True, path_type=Path),
    ),
) -> None:
    """Experiments of cosseratbench: error and time, side by side.

    Each is scored by cosseratbench's own metrics, in one run on one machine; times are
    of a processor, after a warm-up, without compiling.
    """
    import_module("wrod.kernels")  # before newton, whose Warp would speak before --json does
    if find_spec("cosseratbench") is None:
        raise DataError("this bench needs cosseratbench; run pip install 'wrod[peers]'")
    runs = len(chosen or _METRICS) * len(solvers or _SOLVERS) * len(elements or (None,))
    cost.settle(cost.Cost(longer * cost.EXPERIMENT * runs), f"{runs} runs")
    as_json = asked("json")
    if not as_json:
        click.echo(machine_line())
        click.echo(f"{'experiment':12s} {'solver':11s} {'n':>4s} {'s':>8s}  outcome")
    rows, drawn = [], [row for path in others for row in _rows_of(path)]
    for experiment in chosen or _METRICS:
        for solver, count in product(solvers or _SOLVERS, elements or (None,)):
            row = _run(experiment, solver, count, longer)
            rows.append(row)
            if not as_json:
                click.echo(
                    f"{experiment:12s} {solver:11s} {row['elements']:4d} {row['seconds']:8.2f}"
                    f"  {row['said']}"
                )
        if out is not None:
            from wrod.bench.cosserat_picture import draw

            # After each: some take their time.
            draw(out / "peers.png", rows + drawn, _METRICS, machine_line())
    if as_json:
        click.echo(json.dumps({"machine": machine_line(), "rows": rows}))


def _rows_of(path: Path) -> list[dict]:
    """Rows that this command has printed.

    Raises:
        DataError: the file holds something else.
    """
    what = "what `wrod bench cosserat --json` prints"
    text = read_text(path, what, limit=MAX_JSON)
    try:
        refuse_depth(text.encode("utf-8", "replace"))
        rows = msgspec.convert(json.loads(text), CosseratRows).rows
    except (ValueError, RecursionError):  # msgspec's are of the former
        rows = None
    known = rows is not None and all(
        row.experiment in _METRICS
        and row.solver in _SOLVERS
        and _is_number(row.metrics.get(_METRICS[row.experiment]))
        for row in rows
    )
    if rows is None or not known:
        raise DataError(f"{path} is not {what}; run that again")
    return msgspec.to_builtins(rows)


def _is_number(value) -> bool:
    """Whether an error is one, or not there; one that diverged may be NaN."""
    return value is None or (isinstance(value, (int, float)) and not abs(value) > 1e300)


def _adapter(name: str, registry):
    """wrod's, Newton's and dismech-newton's are here, the others cosseratbench's own."""
    if name == "wrod":
        from wrod.bench.cosserat_solver import WrodSolver

        return WrodSolver()
    if name == "newton-vbd":
        from wrod.bench.cosserat_vbd import VbdSolver

        return VbdSolver()
    if name == "dismech-newton":
        from wrod.bench.cosserat_dismech_newton import DismechNewtonSolver

        return DismechNewtonSolver()
    return registry.load_solver(name)


def _prolong(experiment, factor: float):
    """An experiment that takes so many times as long."""

    def build(**values):
        scenario = experiment.build(**values)
        return replace(scenario, duration=factor * scenario.duration)

    return replace(experiment, build=build)


class _Timed:
    """An adapter, and what its last run took of a processor [s], whatever else is running."""

    def __init__(self, adapter):
        self._adapter, self.seconds = adapter, 0.0

    def __getattr__(self, name: str):
        return getattr(self._adapter, name)

    def run(self, *given, **options):
        start = time.process_time()
        try:
            return self._adapter.run(*given, **options)
        finally:
            self.seconds = time.process_time() - start


def _run(name: str, solver: str, elements: int | None, longer: float) -> dict:
    from cosseratbench import registry
    from cosseratbench.experiment import run

    experiment = _prolong(registry.load_experiment(name), longer)
    row = {
        "experiment": name,
        "solver": solver,
        "elements": elements or experiment.n_elements,
        "seconds": 0.0,
    }
    try:
        adapter = _Timed(_adapter(solver, registry))
    except (ImportError, KeyError, RodError) as error:
        return {**row, "outcome": "not installed", "said": f"not installed ({error})"}
    try:
        summary = run(experiment, adapter, n_elements=elements).summary()
    except Exception as error:
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        if isinstance(error, RodError):
            return {**row, "outcome": "refused", "said": f"refused ({what:.80})"}
        if solver == "wrod":
            raise
        # A peer's adapter that does not fit the version of its library, for one.
        return {**row, "outcome": "crashed", "said": f"its adapter crashed ({what:.80})"}
    row |= {"seconds": adapter.seconds, "outcome": summary["outcome"]}
    row["simulated"] = experiment.build(**experiment.values()).duration
    metrics = summary.get("metrics") or {}
    overlap = (summary.get("observations") or {}).get("max_rod_overlap")
    if overlap is not None and isfinite(overlap):
        metrics = {**metrics, "max_rod_overlap": overlap}
    said = ", ".join(f"{key} {value:.3g}" for key, value in metrics.items() if value is not None)
    if summary["outcome"] != "completed":
        said = f"{summary['outcome']}: {summary.get('failure') or summary.get('missing')}"
    return {**row, "metrics": metrics, "said": said}
