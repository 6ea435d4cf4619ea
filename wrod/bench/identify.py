"""`wrod bench identify`: verdicts, parameters, errors and times on sets of measurements."""

import difflib
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from wrod import cost, side_by_side
from wrod.errors import DataError, WrodError
from wrod.files import row_schemas
from wrod.files.ledger import Ledger
from wrod.machine import machine_line
from wrod.options import FOLDER, SOURCE_FOLDER, option, own_options
from wrod.telling import json_option, tell


@click.command(name="identify")
@own_options
@cost.force_option
@json_option
def command(
    folder: Path | None = option("Folder of measured sets (.npz).", "--sets", type=SOURCE_FOLDER),
    seeds: tuple[int, ...] = option(
        "Seed of sets made here, each with a hidden effect; may be given again.", "--hidden"
    ),
    noises: tuple[str, ...] = option(
        "Hidden: kind of noise of the markers; may be given again. Default: white.", "--noise"
    ),
    only: tuple[str, ...] = option(
        "Hidden: only the case of this name, or else all with this text in theirs, "
        "in the order of the texts; may be given again."
    ),
    listed: bool = option("Only say what cases --hidden has.", "--list"),
    out: Path | None = option("Hidden: keep rows.", type=FOLDER),
    workers: int = option("Hidden: processes side by side.", default=1),
    minutes: float | None = option(
        "For each set: end its search by then with the best verdict so far."
    ),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
) -> None:
    """Identify many sets: those of a folder, or rods made here whose effects are known.

    With --sets: verdict, error before and after, parameters and time of every file. With --hidden:
    a confusion table. A solver of the continuous rod by collocation, which shares nothing with the
    solver that identifies, makes a set for each effect, for pairs, for none and for effects that
    no plug-in covers; with --out, OUT/rows.jsonl keeps what is finished and a stopped run goes on.
    """
    from wrod.bench.hidden_sets import cases
    from wrod.rods.device import resolve_device

    if listed:
        tell({"cases": list(cases())}, *cases())
        return
    if (folder is None) == (not seeds):
        raise click.UsageError("give either --sets FOLDER or --hidden SEED")
    device = resolve_device(device)
    seconds = None if minutes is None else 60.0 * minutes
    if seeds:
        _hidden(seeds, noises or ("white",), only, out, workers, seconds, device)
    else:
        if noises or only or out is not None or workers > 1:
            said = "--noise, --only, --out and --workers are of --hidden; drop them beside --sets"
            raise click.UsageError(said)
        _measured(folder, seconds, device)


def _hidden(seeds, noises, only, out, workers, limit, device) -> None:
    from wrod.bench.hidden_noise import NOISES
    from wrod.bench.hidden_sets import cases
    from wrod.bench.hidden_table import examine, lines, summary

    names = list(dict.fromkeys(n for text in only or ("",) for n in _called(text, list(cases()))))
    if unknown := set(noises) - set(NOISES):
        raise DataError(f"no noise is called {', '.join(unknown)}; there are {', '.join(NOISES)}")
    kept, keys = None if out is None else out / "rows.jsonl", ("set", "seed", "noise")
    ledger = Ledger(kept, {}, keys, "identification", row_schemas.HiddenRow)
    wanted = [(name, seed, noise) for noise in noises for name in names for seed in seeds]
    pending = ledger.lacking(wanted)
    start = time.perf_counter()
    cost.settle(
        cost.Cost(len(pending) * cost.IDENTIFIED_SET / workers, 5e8 * workers, 1e4 * len(pending)),
        f"{len(pending)} sets in {workers} processes",
        "ask for fewer with --only or --hidden",
    )
    done, jobs = len(wanted) - len(pending), [(*key, device, limit) for key in pending]
    ended = side_by_side.run(examine, jobs, min(workers, max(len(pending), 1)))
    failed = []
    for _, row in cost.progress_bar(ended, total=len(wanted), initial=done, unit="set"):
        if row["outcome"] == "failed":  # not kept, so that another run tries it again
            failed.append(row)
        else:
            ledger.add([row])
    rows, seconds = ledger.of(wanted) + failed, time.perf_counter() - start
    tell(
        {"machine": machine_line(device), "seconds": seconds, "rows": rows},
        *lines(rows),
        "",
        *summary(rows),
        f"{len(pending)} sets in {seconds:.0f} s with {workers} processes",
        *[f"wrote {kept}"] * (kept is not None and bool(ledger.rows)),
        *(row["traceback"] for row in failed),
    )
    if failed:
        raise WrodError(
            f"{len(failed)} of {len(wanted)} sets failed by a fault of wrod, the first of them "
            f"{failed[0]['set']} of seed {failed[0]['seed']} ({failed[0]['reason']}); the others "
            "are complete, and the same command tries again those that failed"
        )


def _called(text: str, names: Sequence[str]) -> list[str]:
    """The name that is this text, else those that hold it."""
    found = [n for n in names if n == text] or [n for n in names if text in n]
    if not found:
        near = ", ".join(difflib.get_close_matches(text, names, 4, 0.4))
        raise DataError(
            f"--only: no case is called like {text!r}{near and f'; the nearest are {near}'}; "
            "`wrod bench identify --list` names all"
        )
    return found


def _measured(folder: Path, limit: float | None, device: str) -> None:
    from wrod.bench.identify_row import row
    from wrod.identification.entry import identification_cost
    from wrod.identification.motion.loading import is_motion

    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise DataError(f"{folder}: holds no .npz file of measurements")
    seconds = sum(identification_cost(path).seconds for path in paths)  # reads them, too
    for path in filter(is_motion, paths):
        raise DataError(f"{path}: holds recordings of motion; use `wrod bench cables` for those")
    cost.settle(cost.Cost(seconds), f"{len(paths)} sets", "give fewer")
    rows = []
    with cost.progress_bar(paths, unit="set") as bar:
        for path in bar:
            bar.set_description(path.stem)
            rows.append(row(path, device, limit))
    tell(
        {"machine": machine_line(device), "device": device, "rows": rows},
        f"{'set':28} {'verdict':17} {'before':>7} {'after':>7} {'/floor':>7} {'wall s':>7} "
        f"{'cpu s':>7}",
        *(line for entry in rows for line in _lines(entry)),
    )


def _lines(entry: dict) -> Iterator[str]:
    from wrod.identification.effect import Estimate

    ratio = entry["after_mm"] / entry["noise_floor_mm"]
    yield (
        f"{entry['set']:28} {entry['verdict']:17} {entry['before_mm']:7.2f} "
        f"{entry['after_mm']:7.2f} {ratio:7.3f} {entry['seconds']:7.1f} "
        f"{entry['cpu_seconds']:7.1f}"
    )
    for effect in entry["effects"]:
        found = ", ".join(f"{key} {Estimate(**e)}" for key, e in effect["parameters"].items())
        yield f"    {effect['name']}: {found}"
    for pair in entry["confounded"]:
        yield f"    {' and '.join(pair['effects'])}: {pair['evidence']}"
