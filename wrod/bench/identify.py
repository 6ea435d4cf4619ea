"""`wrod bench identify`: verdicts, parameters, errors and times on sets of measurements."""

import time
from collections.abc import Iterable
from pathlib import Path

import click

from wrod import cost


@click.command(name="identify")
@click.option(
    "--sets",
    "folder",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of measured sets (.npz).",
)
@click.option(
    "--hidden",
    "seeds",
    type=int,
    multiple=True,
    help="Seed of sets made here, each with a hidden effect; may be given again.",
)
@click.option(
    "--noise",
    "noises",
    multiple=True,
    help="Hidden: kind of noise of the markers; may be given again. Default: white.",
)
@click.option(
    "--only",
    multiple=True,
    help="Hidden: only the case of this name, or else all with this text in theirs, "
    "in the order of the texts; may be given again.",
)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Hidden: keep rows.")
@click.option("--workers", default=1, show_default=True, help="Hidden: processes side by side.")
@click.option(
    "--minutes",
    type=click.FloatRange(min=0, min_open=True),
    help="For each set: end its search by then with the best verdict so far.",
)
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda:0 or auto.")
@cost.force_option
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def command(
    folder: Path | None,
    seeds: tuple[int, ...],
    noises: tuple[str, ...],
    only: tuple[str, ...],
    out: Path | None,
    workers: int,
    minutes: float | None,
    device: str,
    as_json: bool,
    force: bool,
) -> None:
    """Identify many sets: those of a folder, or rods made here whose effects are known.

    With --sets: verdict, error before and after, parameters and time of every file. With --hidden:
    a confusion table. A solver of the continuous rod by collocation, which shares nothing with the
    solver that identifies, makes a set for each effect, for pairs, for none and for effects that
    no plug-in covers; with --out, OUT/rows.jsonl keeps what is finished and a stopped run goes on.
    """
    from wrod.errors import DataError
    from wrod.rods.device import resolve_device

    if (folder is None) == (not seeds):
        raise click.UsageError("give either --sets FOLDER or --hidden SEED")
    if workers < 1:
        raise DataError(f"workers is {workers}; give 1 or more")
    device = resolve_device(device)
    seconds = None if minutes is None else 60.0 * minutes
    if seeds:
        _hidden(seeds, noises or ("white",), only, out, workers, seconds, device, as_json, force)
    else:
        if noises or only or out is not None or workers > 1:
            said = "--noise, --only, --out and --workers are of --hidden; drop them beside --sets"
            raise click.UsageError(said)
        _measured(folder, seconds, device, as_json)


def _hidden(seeds, noises, only, out, workers, limit, device, as_json, force) -> None:
    from wrod.bench.hidden_noise import NOISES
    from wrod.bench.hidden_sets import cases
    from wrod.bench.hidden_table import examine_all, lines, summary
    from wrod.errors import DataError
    from wrod.files.ledger import Ledger
    from wrod.machine import machine_line, printed_as_json

    names = list(dict.fromkeys(n for text in only or ("",) for n in _called(text, cases())))
    if not names:
        raise DataError(
            f"no case is called like {', '.join(only)}; the cases: {', '.join(cases())}"
        )
    if unknown := set(noises) - set(NOISES):
        raise DataError(f"no noise is called {', '.join(unknown)}; there are {', '.join(NOISES)}")
    rows: list[dict] = []
    keep, have = rows.append, {}
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        from wrod.files import row_schemas

        keys = ("set", "seed", "noise")
        ledger = Ledger(out / "rows.jsonl", {}, keys, "identification", row_schemas.HiddenRow)
        have = {ledger.key(r): r for r in ledger.rows}

        def keep(row):
            ledger.add([row])
            rows.append(row)

    wanted = [(name, seed, noise) for noise in noises for name in names for seed in seeds]
    rows += [have[key] for key in wanted if key in have]
    pending = [key for key in wanted if key not in have]
    start = time.perf_counter()
    cost.settle(
        cost.Cost(len(pending) * cost.IDENTIFIED_SET / workers, 5e8 * workers, 1e4 * len(pending)),
        f"{len(pending)} sets in {workers} processes", out,
        "ask for fewer with --only or --hidden", force=force, quiet=as_json,
    )  # fmt: skip
    with cost.progress_bar(total=len(wanted), initial=len(rows), unit="set", quiet=as_json) as bar:
        examine_all(pending, min(workers, max(len(pending), 1)), device, limit, keep, bar.update)
    rows.sort(key=lambda r: wanted.index((r["set"], r["seed"], r["noise"])))
    seconds = time.perf_counter() - start
    if printed_as_json(
        {"machine": machine_line(device), "seconds": seconds, "rows": rows}, as_json
    ):
        return
    click.echo("\n".join(lines(rows) + [""] + summary(rows)))
    click.echo(f"{len(pending)} sets in {seconds:.0f} s with {workers} processes")
    if out is not None:
        click.echo(f"wrote {out / 'rows.jsonl'}")


def _called(text: str, names: Iterable[str]) -> list[str]:
    """The name that is this text, else those that hold it."""
    return [n for n in names if n == text] or [n for n in names if text in n]


def _measured(folder: Path, limit: float | None, device: str, as_json: bool) -> None:
    from wrod.bench.identify_row import row
    from wrod.errors import DataError
    from wrod.identification.entry import identification_cost
    from wrod.identification.motion.loading import is_motion
    from wrod.machine import machine_line, printed_as_json

    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise DataError(f"{folder}: holds no .npz file of measurements")
    seconds = sum(identification_cost(path).seconds for path in paths)  # reads them, too
    for path in filter(is_motion, paths):
        raise DataError(f"{path}: holds recordings of motion; use `wrod bench cables` for those")
    cost.settle(cost.Cost(seconds), f"{len(paths)} sets", None, "give fewer", quiet=as_json)
    rows = []
    with cost.progress_bar(paths, unit="set", quiet=as_json) as bar:
        for path in bar:
            bar.set_description(path.stem)
            rows.append(row(path, device, limit))
    if printed_as_json({"machine": machine_line(device), "device": device, "rows": rows}, as_json):
        return
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
