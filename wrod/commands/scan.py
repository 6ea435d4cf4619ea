"""`wrod scan IMAGE...`: ordered centrelines of the rods or strokes in pictures."""

import json
from dataclasses import dataclass
from pathlib import Path

import click

from wrod import cost
from wrod.commands.options import SCALE, PatternOptions, parse_numbers, parse_start
from wrod.errors import PerceptionError
from wrod.options import FOLDER, gathered, option, own_options, refuse_idle_options
from wrod.telling import asked, json_option


@dataclass(frozen=True)
class _Reading:
    """How pictures are read."""

    mask: bool = option("The pictures are masks, white on black.")
    kind: str = option(
        "Rods on a plain table, or strokes on paper.",
        type=click.Choice(["auto", "rod", "ink"]),
        default="auto",
    )
    color: str | None = option("Colour of the rods as R,G,B; default: all that differs.")

    def of_pictures(self, scale: PatternOptions) -> dict:
        """What `read_scan` takes.

        Raises:
            PerceptionError: an option, or a file that it names, cannot be understood.
        """
        from wrod.perception.metric import CameraIntrinsics, MarkerLayout

        markers, sheet, camera = scale.markers, scale.sheet, scale.camera
        if (markers, sheet, scale.scale) == (None, None, None):
            refuse_idle_options("a picture without a scale", "start", "several", "camera")
        if self.mask:
            refuse_idle_options("--mask", "kind", "color")
        return {
            "markers": None if markers is None else MarkerLayout.load(markers),
            "sheet": None if sheet is None else parse_numbers(sheet, 2, "--sheet", "x"),
            "scale": scale.scale,
            "camera": None if camera is None else CameraIntrinsics.load(camera),
            "mask": self.mask,
            "kind": self.kind,
            "color": None if self.color is None else parse_numbers(self.color, 3, "--color"),
        }


@click.command(name="scan", short_help="Turn pictures of drawn curves into patterns.")
@click.argument("images", nargs=-1, required=True, type=click.Path(path_type=Path))
@own_options
@gathered("reading", _Reading)
@gathered("scale", PatternOptions, SCALE)
@cost.force_option
@json_option
def command(
    images: tuple[Path, ...],
    reading: _Reading,
    scale: PatternOptions,
    out: Path = option(None, type=FOLDER, required=True),
    start: str = option(
        "Where a metric curve begins: X,Y [m], dot, or a corner such as upper-right.",
        default="lower-left",
    ),
    several: bool = option("Allow several curves in a metric picture."),
    overlay: bool = option(
        "Write a picture of what was found.", "--overlay/--no-overlay", default=True
    ),
) -> None:
    """Write STEM.npz and STEM-overlay.png for each picture.

    The NPZ holds `paths` (x, y of all polylines in pixels, one after the other), `path_start`
    (where each begins), `radius_px`, `labels` (H, W) and the crossings; with a scale also
    `path_m` in metres.
    """
    from tqdm import tqdm

    from wrod.perception.image import picture_pixels

    stems = [image.stem for image in images]
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
    if twice:
        raise PerceptionError(
            f"several pictures are called {', '.join(twice)}; scan them into different folders"
        )
    how, begin = reading.of_pictures(scale), parse_start(start)
    rows, failures = [], []
    pixels = sum(map(picture_pixels, images))
    cost.settle(
        cost.Cost(pixels * cost.TRACED_PIXEL, 60.0 * pixels / len(images)),
        f"{len(images)} pictures", "scale them down",
    )  # fmt: skip
    for image in cost.progress_bar(images, unit="picture"):
        try:
            row = _scan(image, out, how, begin, several, overlay)
        except PerceptionError as error:
            failures.append(str(error) if str(image) in str(error) else f"{image}: {error}")
            continue  # one bad picture must not cost the others
        rows.append(row)
        if not asked("json"):
            tqdm.write(_summary(row))
    if asked("json"):
        click.echo(json.dumps(rows, indent=2))
    if failures:
        raise PerceptionError("\nwrod: ".join(failures))


def _scan(image: Path, out: Path, how: dict, start, several: bool, overlay: bool) -> dict:
    """Scan one picture, write what was found, and say what it is."""
    from wrod.files import write_picture
    from wrod.patterns.curve import arc_length
    from wrod.perception.crossings import find_crossings
    from wrod.perception.export import draw_overlay, write_scan
    from wrod.perception.scan import read_scan

    result = read_scan(image, **how)
    crossings = find_crossings(result.lines, None if how["mask"] else result.image)
    written = [write_scan(out / f"{image.stem}.npz", result, crossings, start, several)]
    if overlay:
        picture = draw_overlay(result.image, result.lines, crossings)
        written.append(write_picture(out / f"{image.stem}-overlay.png", picture))
    row = {
        "image": str(image),
        "curves": len(result.lines),
        "crossings": len(crossings),
        "length_px": [round(line.length, 1) for line in result.lines],
        "radius_px": [round(line.radius, 2) for line in result.lines],
        "written": [str(path) for path in written],
    }
    if result.plane is not None:
        row["length_m"] = [float(arc_length(p)[-1]) for p in result.metric_lines()]
    return row


def _summary(row: dict) -> str:
    lengths = row.get("length_m")
    sizes = (
        ", ".join(f"{length:.4f} m" for length in lengths)
        if lengths
        else ", ".join(f"{length:.0f} px" for length in row["length_px"])
    )
    curves, crossings = row["curves"], row["crossings"]
    head = (
        f"{row['image']}: {curves} curve{'s' * (curves != 1)} ({sizes}), "
        f"{crossings} crossing{'s' * (crossings != 1)}"
    )
    return "\n".join([head, *(f"wrote {path}" for path in row["written"])])
