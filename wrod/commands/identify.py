"""`wrod identify DATA.npz`: what a rod's model misses, and a better model."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from wrod import cost
from wrod.errors import DataError
from wrod.options import FOLDER, option, own_options, refuse_idle_options
from wrod.telling import json_option, tell

# Parameters of an effect that are printed, and of one that has more of them.
_SHOWN, _FEW = 8, 3


@click.command(name="identify", short_help="Find what the model of a rod lacks, from measurements.")
@click.argument("data", required=False, type=click.Path(path_type=Path))
@own_options
@json_option
def command(
    data: Path | None,
    test: Path | None = option("More data of the rod to score on."),
    out: Path = option(None, type=FOLDER, required=True),
    names: tuple[str, ...] = option("Try this effect only (repeatable).", "--effect"),
    template: str | None = option(
        "Write an example file of measurements into OUT instead: clamped or motion."
    ),
    minutes: float | None = option(
        "Of a clamped rod: end the search by then with the best verdict so far."
    ),
    device: str = option("cpu, cuda:0 or auto.", default="cpu"),
) -> None:
    """Find what the base model of the rod in DATA lacks, and prove it on data not fitted.

    DATA is an .npz file of a rod held between two clamps (see `wrod.load_measurements`), or of
    recordings of a rod that two grips move (see `wrod.identification.load_motion`). Of these what
    has been computed is kept in OUT/steps.jsonl meanwhile: a run that was stopped goes on from
    there.
    """
    from wrod.files import checked_path

    if template is not None:
        if data is not None:
            raise DataError(f"{data} and --template were both given; give one or the other")
        refuse_idle_options("--template", "test", "effect", "minutes", "device")
        _write_template(template, out)
        return
    if data is None:
        raise DataError("no measurements given; name an .npz file, or --template to write one")
    wanted = "an .npz file of measurements (`wrod identify --template clamped` writes an example)"
    checked_path(data, wanted)  # before much is loaded
    from wrod.identification import identify, is_motion
    from wrod.identification.entry import identification_cost
    from wrod.rods.device import resolve_device

    device = resolve_device(device)  # refused before anything is computed
    moves, work = is_motion(data), identification_cost(data)
    if moves and minutes is not None:
        raise DataError(
            f"{data} holds recordings of motion, whose search --minutes does not bound; stop it "
            "and begin it again with the same --out, and it goes on"
        )
    kept: dict[str, Any] = {"steps": out / "steps.jsonl"} if moves else {}
    what = f"{data.name} identified (minutes if it is far off its model, or nothing explains it)"
    if minutes is not None:
        kept["seconds"] = 60.0 * minutes
        work = replace(work, seconds=min(work.seconds, kept["seconds"]))
        what = f"{data.name} identified (a search of {minutes:g} min at most)"
    cost.settle(work, what, "give less data")
    shown = "{desc}: {elapsed}"
    with cost.progress_bar(total=4, desc="reading", bar_format=shown) as bar:

        def say(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        kept |= {"test": test, "candidates": names or None, "device": device}
        report = identify(data, progress=say, **kept)
    written = report.save(out)
    tell(report.to_dict() | {"written": [str(p) for p in written]}, *_lines(report))


def _lines(report) -> Iterator[str]:
    verdict = f"{report.verdict} so far" if report.out_of_time else report.verdict
    yield f"{report.measurements.name}: {verdict}; {report.reason}"
    yield (
        f"test error {1e3 * report.before:.2f} mm before, {1e3 * report.after:.2f} mm after, "
        f"noise floor {1e3 * report.noise_floor:.2f} mm"
    )
    for effect in report.effects:
        found = [f"{key} {e}" for key, e in effect.parameters.items()]
        if len(found) > _SHOWN:
            # The profile of a whole rod is for the report.
            found[_FEW:] = [f"and {len(found) - _FEW} more in report.json"]
        yield f"  {effect.name}: {', '.join(found)}"
    for name, size in report.scatter.items():
        yield f"  {name} scatters from trial to trial by {size} in each direction"
    for pair in report.selection.confounded:
        yield f"  {' and '.join(pair['effects'])} are confounded: {pair['evidence']}"
    yield from (f"  {caution}" for caution in report.cautions)


def _write_template(kind: str, out: Path) -> None:
    from wrod.files import read_arrays
    from wrod.identification.template import write_template

    path = write_template(kind, out / f"{kind}.npz")
    fields = {name: list(value.shape) for name, value in read_arrays(path).items()}
    tell(
        {"fields": fields, "written": [str(path)]},
        *(
            f"{name:16s} {tuple(shape) if shape else 'one number'}"
            for name, shape in fields.items()
        ),
    )
