"""`wrod bench identify`: verdicts, parameters, errors and times on sets of measurements."""

from __future__ import annotations

import json
import time
from pathlib import Path

import click


def row(path: Path, device: str) -> dict:
    """One set: what `wrod identify` says of it, and what that cost."""
    from wrod.identification import identify

    clock, cpu = time.perf_counter(), time.process_time()
    report = identify(path, device=device)
    content = report.to_dict()
    left_out = ("reference", "title")
    return {
        "set": path.stem,
        "verdict": report.verdict,
        "reason": report.reason,
        "before_mm": content["before_mm"],
        "after_mm": content["after_mm"],
        "noise_floor_mm": content["noise_floor_mm"],
        "likeliest_print": report.prints[0].name,
        "effects": [
            {key: value for key, value in effect.items() if key not in left_out}
            for effect in content["effects"]
        ],
        "confounded": content["confounded"],
        "selection": content["selection"],
        "seconds": time.perf_counter() - clock,
        "cpu_seconds": time.process_time() - cpu,
    }


@click.command(name="identify")
@click.option(
    "--sets",
    "folder",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    required=True,
    help="Folder of measured sets (.npz).",
)
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda:0 or auto.")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def command(folder: Path, device: str, as_json: bool) -> None:
    """Identify every set of a folder: verdict, error before and after, parameters, time."""
    from tqdm import tqdm

    from wrod.batch import resolve_device
    from wrod.bench import machine_line
    from wrod.errors import DataError

    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise DataError(f"{folder}: holds no .npz file of measurements")
    device = resolve_device(device)
    rows = []
    with tqdm(paths, disable=None, leave=False) as bar:
        for path in bar:
            bar.set_description(path.stem)
            rows.append(row(path, device))
    if as_json:
        click.echo(json.dumps({"machine": machine_line(device), "device": device, "rows": rows}))
        return
    click.echo(machine_line(device))
    click.echo(
        f"{'set':28} {'verdict':17} {'before':>7} {'after':>7} {'/floor':>7} {'wall s':>7} "
        f"{'cpu s':>7}"
    )
    for entry in rows:
        ratio = entry["after_mm"] / entry["noise_floor_mm"]
        click.echo(
            f"{entry['set']:28} {entry['verdict']:17} {entry['before_mm']:7.2f} "
            f"{entry['after_mm']:7.2f} {ratio:7.3f} {entry['seconds']:7.1f} "
            f"{entry['cpu_seconds']:7.1f}"
        )
        for effect in entry["effects"]:
            found = ", ".join(
                f"{key} {e['value']:.4g} ± {e['stderr']:.2g} {e['unit']}".rstrip()
                for key, e in effect["parameters"].items()
            )
            click.echo(f"    {effect['name']}: {found}")
        for pair in entry["confounded"]:
            click.echo(f"    {' and '.join(pair['effects'])}: {pair['evidence']}")
