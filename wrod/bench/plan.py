"""`wrod bench plan`: time of plans, pattern by pattern and rod by rod."""

import time
from pathlib import Path
from typing import Any

import click

import wrod
from wrod import cost
from wrod.errors import PatternError
from wrod.machine import machine_line
from wrod.options import SOURCE_FOLDER, option, own_options
from wrod.telling import json_option, tell


@click.command(name="plan")
@own_options
@json_option
def command(
    patterns: Path | None = option(
        "Folder of pattern files (*.txt, *.csv); default: the built-in patterns.",
        type=SOURCE_FOLDER,
    ),
    method: str = option(None, default="numeric"),
    device: str = option("cpu, cuda:0 or auto.", default="auto"),
) -> None:
    """Plan every pattern for the paper's rods 1 to 3, at a node every 2.5 mm."""
    from wrod.rods.device import resolve_device

    device = resolve_device(device)
    if patterns is None:
        curves = [wrod.pattern(name) for name in wrod.pattern_names()]
    else:
        files = sorted([*patterns.glob("*.txt"), *patterns.glob("*.csv")])
        if not files:
            raise PatternError(f"{patterns}: holds no pattern files (*.txt, *.csv)")
        curves = [wrod.Pattern.load(file) for file in files]
    rods = wrod.rod_names()[:3]
    count = len(rods) * len(curves)
    cost.settle(cost.Cost(cost.PLAN * count), f"{count} plans")
    wrod.plan(curves[0], wrod.rod(rods[0]), method, device=device)  # compile
    rows: list[dict[str, Any]] = []
    for name in rods:
        for curve in curves:
            clock = time.perf_counter()
            trajectory = wrod.plan(curve, wrod.rod(name), method, device=device)
            seconds = time.perf_counter() - clock
            rows.append(
                {"rod": name, "pattern": curve.name, "nodes": len(trajectory), "seconds": seconds}
            )
    total = sum(row["seconds"] for row in rows)
    longest = 1e3 * max(row["seconds"] for row in rows)
    tell(
        {"machine": machine_line(device), "rows": rows, "seconds": total},
        f"{'rod':>12} {'pattern':>12} {'nodes':>6} {'ms':>8}",
        *(
            f"{row['rod']:>12} {row['pattern']:>12} {row['nodes']:6d} {1e3 * row['seconds']:8.1f}"
            for row in rows
        ),
        f"{len(rows)} plans in {total:.2f} s, {longest:.1f} ms at most",
    )
