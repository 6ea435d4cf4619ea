"""`wrod bench photographs`: real rods laid by a robot, against simulated ones. Restartable."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from wrod.options import FOLDER, SCHEME, SOURCE_FOLDER, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell


@click.command(name="photographs")
@own_options
@json_option
def command(
    data: Path = option(
        "Folder of photographs (ROD-PATTERN-int.npz).", required=True, type=SOURCE_FOLDER
    ),
    out: Path = option(None, required=True, type=FOLDER),
    quick: bool = option("One rod, two patterns, no predictions."),
    nothing_fitted: bool = option("One scenario a picture, as told; no predictions."),
    spacing: float = option("Length of the edges [m].", default=0.01),
    step: float = option("Largest time step [s].", default=0.025),
    scheme: str = SCHEME,
    damping: float | None = option(
        "Kelvin-Voigt time of the rods' material [s]; default: that of recorded cables."
    ),
    scenarios: int = option("Drawn scenarios a rod, beside 11.", default=64),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
    threads: int | None = option("CPU threads; default: one per core."),
    workers: int = option("Processes side by side.", default=1),
) -> None:
    """Find the scenario in which photographed rods were laid; predict what other grips would lay.

    Every rod is laid by the intuitive path in a set of scenarios (friction, L_gb, natural
    curvature, too much rod below the grip, the free end held or let go). A picture is predicted by
    the scenarios that pictures of other patterns choose, as far as such predictions gain, seen by
    the camera that those tell of, and judged after one rigid motion. With the scenarios found, the
    optimal path's deployment is predicted for every rod and pattern, and default plans made with
    what was found are laid there. Finished deployments are kept in OUT/laid.jsonl and plans in
    OUT/plans.jsonl: a run that was stopped goes on from there.
    """
    from wrod.bench.photographs_deployments import Deployments
    from wrod.bench.photographs_judge import judge
    from wrod.bench.photographs_report import left_out_table, practice_of
    from wrod.files import write_json
    from wrod.identification.laid.photographs import load_photograph, load_photographs
    from wrod.machine import machine_line
    from wrod.rods.device import resolve_device

    if quick:
        refuse_idle_options("--quick", "scenarios")
    if nothing_fitted:
        refuse_idle_options("--nothing-fitted", "scenarios")
    photographs = load_photographs(data)
    short = quick or nothing_fitted
    if not short and practice_of(data).exists():
        load_photograph(practice_of(data))  # refused before the work
    if quick:
        first = photographs[0].rod
        photographs = [p for p in photographs if p.rod == first][:2]
    device = resolve_device(device)
    laid = Deployments(
        out / "laid.jsonl",
        {"spacing": spacing, "step": step, "scheme": scheme, "damping": damping, "data": data.name},
        device=device,
        threads=threads,
        workers=workers,
    )
    drawn = None if nothing_fitted else 0 if quick else scenarios
    looked = {} if short else _lay_all(photographs, laid, drawn)
    verdicts = judge(photographs, laid, drawn)
    figures: dict[str, Any] = {
        "machine": machine_line(device),
        "left_out": [row.as_dict() for verdict in verdicts for row in verdict.rows],
        "camera": asdict(verdicts[0].camera),
        "cameras": {
            row.pattern: asdict(camera)
            for row, camera in zip(verdicts[0].rows, verdicts[0].cameras, strict=True)
        },
    }
    summary, written = out / "photographs.json", []
    if not short:
        written = _add_predictions(figures, summary, photographs, verdicts, laid, data, looked)
    write_json(summary, figures)
    figures["written"] = [str(path) for path in (*written, summary, laid.path)]
    lines = [left_out_table(verdicts)]
    if not short:
        lines += [figures[part]["text"] for part in ("table3", "plans", "mode", "waves")]
        practice = figures["predictions"]["practice"]
        lines.append(f"practice (green VPS, letter L, optimal path): {practice}")
    tell(figures, *lines)


def _lay_all(photographs, laid, drawn: int | None) -> dict:
    """Lay what hangs on no verdict, at once: processes wait for the last of each lot. What is
    looked at of the lines."""
    from wrod.bench.photographs_deployments import scenarios_of, straight_held
    from wrod.bench.photographs_waves import looked_at

    looked = looked_at(photographs)
    laid.prepare(
        [
            *((p, "int", scenarios_of(p.rod, drawn)) for p in photographs),
            *((p, "opt", straight_held()) for p in photographs),
            *(one for _, wanted in looked.values() for one in wanted),
        ]
    )
    return looked


def _add_predictions(
    figures: dict, summary: Path, photographs, verdicts, laid, data: Path, looked: dict
) -> list:
    """What the scenarios that were found foretell, added to the figures; the files written."""
    from wrod.bench.photographs_mode import modes
    from wrod.bench.photographs_plans import plans_in_scenarios_found, table3
    from wrod.bench.photographs_report import draw, draw_lines, write_predictions
    from wrod.bench.photographs_waves import waves
    from wrod.files import write_json

    out = summary.parent
    figures["predictions"], files = write_predictions(out, photographs, verdicts, laid, data)
    figures["table3"] = table3(photographs, laid)
    written = [*files, *draw(out, photographs, verdicts)]
    written += draw_lines(out, photographs, verdicts, laid)
    figures["mode"], files = modes(photographs, out)
    written += files
    figures["waves"], files = waves(looked, verdicts[0].camera, laid, out)
    write_json(summary, figures)  # plans take minutes
    figures["plans"] = plans_in_scenarios_found(photographs, verdicts, laid)
    return [*written, *files]
