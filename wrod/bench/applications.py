"""`wrod bench applications`: cables laid between fixtures, and knots. Restartable."""

import time
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import click

from wrod import cost
from wrod.errors import DataError
from wrod.machine import machine_line
from wrod.options import FOLDER, option, own_options
from wrod.telling import json_option, tell

CASES = ("S cable", "U cable", "trefoil", "reef")


@click.command(name="applications")
@own_options
@cost.force_option
@json_option
def command(
    out: Path = option(None, type=FOLDER, required=True),
    trials: int = option("Trials of each method.", default=10),
    first: int = option("Number of the first trial, the seed of its luck.", default=0),
    chosen: tuple[str, ...] = option(
        "Only this application; may be given again.", "--case", type=click.Choice(CASES)
    ),
    batch: int | None = option("Trials simulated at once; default: 5, CUDA all."),
    asked: tuple[str, ...] = option(
        "Only this method; default: both.", "--method", type=click.Choice(["INT", "OPT"])
    ),
    usd: Path | None = option(
        "Write every trial run now as a scene with both arms into this folder.", type=FOLDER
    ),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
) -> None:
    """The paper's success table: cable placement along S and U, trefoil and reef knot, {INT, OPT} x
    ten trials.

    Every trial is disturbed: L_gb by 3 %, the robot's place by 0.5 mm and 0.2 degrees, the grip by
    0.3 mm of shaking, the rod's natural curvature by 0.2 /m; cables slip through the grip by 1 mm;
    in knots each hand's place is off by 1 mm in every direction, up too, and the friction of its
    fingertips, which decides when a rod slips out, by 30 % (standard deviations). INT and OPT meet
    the same. A knot has to be tied and then to bear the plan's pull for 3 s, giving less than a
    diameter of its thinnest rod. The report says what was drawn. Finished trials are kept in
    OUT/trials.jsonl: a run that was stopped goes on from there.
    """
    from wrod.bench.applications_report import markdown, table
    from wrod.bench.applications_trials import METHODS, SHORT, disturbances_text
    from wrod.files import row_schemas
    from wrod.files.ledger import Ledger
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    for module in ("newton", "pxr", "pytorch_kinematics") if usd else ():
        if find_spec(module) is None:  # said before hours of work
            raise DataError(f"--usd needs {module}; install it with: pip install 'wrod[all]'")
    cases = chosen or CASES
    kind = row_schemas.ApplicationsRow
    ledger = Ledger(out / "trials.jsonl", {}, ("case", "method", "trial"), "applications", kind)
    methods = [method for method in METHODS if not asked or SHORT[method] in asked]
    numbers = range(first, first + trials)
    keys = [(case, method, trial) for trial, case, method in product(numbers, cases, methods)]
    pending = ledger.lacking(keys)
    size = batch or (5 if device == "cpu" else max(trials, 1))
    start = time.perf_counter()
    seconds = sum(cost.APPLICATION[case] for case, *_ in pending)
    cost.settle(
        cost.Cost(seconds, 2e7 * size, 1e5 * len(pending)), f"{len(pending)} trials",
        "ask for fewer --trials or for one --case",
    )  # fmt: skip
    written = _run(pending, len(keys), cases, size, ledger, device, usd)
    seconds = time.perf_counter() - start
    rows = ledger.of(keys)
    cells = table(rows)
    text = markdown(cells) + "\n" + disturbances_text(rows)
    written += [*_write(out, text, rows), ledger.path]
    figures: dict[str, Any] = {
        "machine": machine_line(device),
        "device": device,
        "trials": len(rows),
        "simulated_now": len(pending),
        "seconds": seconds,
        "cells": [
            {"case": case, "method": method, **cell} for (case, method), cell in cells.items()
        ],
        "written": [str(path) for path in written],
    }
    tell(figures, f"{len(pending)} trials on {device} in {seconds:.1f} s", text)


def _run(pending: list, total: int, cases, size: int, ledger, device, usd) -> list[Path]:
    """Run the trials that are left into the ledger; the scenes written."""
    from wrod.bench.applications_trials import METHODS, run_trials

    written: list[Path] = []
    with cost.progress_bar(total=total, initial=total - len(pending), unit="trial") as bar:
        for case, method in product(cases, METHODS):
            mine = [trial for *cell, trial in pending if cell == [case, method]]
            for start_at in range(0, len(mine), size):
                part = mine[start_at : start_at + size]
                bar.set_postfix_str(f"{case} {method}")
                rows, scenes = run_trials(case, method, part, device=device, folder=usd)
                ledger.add(rows)
                written += scenes
                bar.update(len(part))
    return written


def _write(out: Path, text: str, rows: list[dict]) -> list[Path]:
    """The report and its pictures."""
    from wrod.bench.applications_report import draw, draw_cables
    from wrod.files import write_text

    write_text(out / "applications.md", text)
    cables = draw_cables(out / "cables.png", rows)
    written = [out / "applications.md", draw(out / "applications.png", rows)]
    return written if cables is None else [*written, cables]
