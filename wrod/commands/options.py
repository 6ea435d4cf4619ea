"""Options that several commands share, and what they mean: a rod, a pattern, method and closure."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click

from wrod.errors import PatternError, PerceptionError, RodError
from wrod.options import option

CLOSURE = click.option(
    "--closure",
    default="zero_tension",
    show_default=True,
    help="zero_tension, min_force or min_friction.",
)


def _there(context: click.Context, option: click.Parameter, device: str) -> str:
    """Refuse a device that this machine has not, before anything else is loaded."""
    if device not in ("auto", "cpu"):
        from wrod.rods.device import resolve_device

        resolve_device(device)
    return device


DEVICE = click.option(
    "--device", default="auto", show_default=True, callback=_there, help="cpu, cuda:0 or auto."
)
ROLL = (
    "How a naturally curved rod is held: plane (curved in the table's plane), up (curved upwards), "
    "tilted (30 degrees up from the plane), or the roll of its first director from left to up "
    "[degrees]. Default: plane; plans tilt what would be laid in waves there."
)
# Of `PatternOptions`.
UNITS, DRAWING, SCALE = ("units",), ("layer", "stroke"), ("markers", "sheet", "scale", "camera")
PICTURE = (*SCALE, "start")
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")


def method_option():
    return option(
        "neural, numeric, auto or intuitive; with --friction also distilled.", default="auto"
    )


def closure_option():
    return option(
        "zero_tension, min_force or min_friction; default: the most accurate for auto, "
        "zero_tension for other methods."
    )


@dataclass(frozen=True)
class RodOptions:
    """A rod by its name, its file or its numbers."""

    rod_name: str | None = option(
        "Rod by name (see `wrod rods`), rod.json, or the model.json of `wrod identify`.", "--rod"
    )
    radius: float | None = option("Radius of a rod of your own, or a rod file's [m].")
    lgb: float | None = option("Its gravito-bending length [m] (see `wrod loop`).")
    length: float | None = option("Its total length, or a named rod's instead [m].")

    @property
    def given(self) -> bool:
        """Whether any of them was given."""
        return self != RodOptions()

    def read(self):
        """The `RodMaterial`, or `RodModel`, that they name.

        Raises:
            RodError: none, or more than one is named.
        """
        from wrod.rods.catalogue import rod
        from wrod.rods.material import RodMaterial
        from wrod.rods.model_file import load_rod

        name = self.rod_name
        own = {"--radius": self.radius, "--lgb": self.lgb, "--length": self.length}
        given = [option for option, value in own.items() if value is not None]
        from_file = name is not None and name.endswith(".json")
        if from_file and "--lgb" not in given:
            # Measurements between clamps know the stretch between them only, those of motion no
            # radius.
            return load_rod(name, radius=self.radius, length=self.length)
        if name is not None and given not in ([], ["--length"]):
            raise RodError(
                f"--rod {name} and {', '.join(given)} were both given; give one or the other"
            )
        if name is not None:
            named = rod(name)
            return replace(named, length=named.length if self.length is None else self.length)
        missing = [option for option in own if option not in given]
        if missing == list(own):
            raise RodError("no rod given; use --rod NAME, or --radius, --lgb and --length")
        if missing:
            raise RodError(f"{', '.join(missing)} missing; a rod of your own needs all three")
        return RodMaterial(self.radius, self.lgb, self.length)


@dataclass(frozen=True)
class PatternOptions:
    """How a pattern's file, drawing or picture is read."""

    units: str | None = option("Units of a pattern file: m, cm, mm, um or in.")
    layer: str | None = option("Layer of an SVG or DXF drawing, by name; default: all seen.")
    stroke: int | None = option("Which of a drawing's strokes, from 1.")
    markers: Path | None = option("A picture's scale: layout of its ArUco markers (JSON).")
    sheet: str | None = option("Or the size of the bright sheet drawn on: WIDTHxHEIGHT [m].")
    scale: float | None = option("Or its metres per pixel, seen from above [m/px].")
    camera: Path | None = option("Camera matrix and distortion.")
    start: str | None = option(
        "Where a picture's curve begins: X,Y [m], dot, or a corner (default lower-left)."
    )

    @property
    def given(self) -> dict:
        """What was given, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def read(self, name: str):
        """The `Pattern` of that name, file of points, drawing, or picture.

        Raises:
            PatternError, PerceptionError: unknown, unreadable, or an option does not belong to it.
        """
        from wrod.patterns.named import pattern, pattern_names
        from wrod.patterns.pattern import Pattern

        path, units = Path(name), self.units
        elsewhere = ("units", "layer", "stroke")
        of_picture = {k: v for k, v in self.given.items() if k not in elsewhere}
        if path.suffix.lower() in _PICTURES:
            if self.layer is not None or self.stroke is not None:
                raise PatternError(f"{name}: --layer and --stroke belong to SVG and DXF drawings")
            return _scanned(path, units, of_picture)
        if of_picture:
            named = ", ".join(f"--{option}" for option in of_picture)
            raise PatternError(f"{name} is no picture; leave out {named}")
        if name in pattern_names() and not path.is_file():
            if units is not None:
                raise PatternError(f"{name} is built in and has its size in metres; drop --units")
            if self.given:
                idle = " and ".join(f"--{option}" for option in self.given)
                raise PatternError(f"{name} is built in and no drawing; drop {idle}")
            return pattern(name)
        if not path.suffix and not path.exists():
            return pattern(name)
        return Pattern.load(path, units=units, layer=self.layer, stroke=self.stroke)


def parse_start(text: str) -> str | tuple[float, float]:
    """A point "x,y" [m], or a name as it is."""
    if "," not in text:
        return text
    x, y = parse_numbers(text, 2, "--start")
    return x, y


def parse_numbers(text: str, count: int, option: str, separator: str = ",") -> tuple[float, ...]:
    """`count` numbers, separated; raises a PerceptionError that names the option."""
    try:
        numbers = tuple(float(part) for part in text.lower().split(separator))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise PerceptionError(
            f"{option} {text:.80}: give {count} finite numbers separated by {separator!r}"
        )
    return numbers


def _scanned(path: Path, units: str | None, given: dict):
    from wrod.perception.scan import scan

    if units is not None:
        raise PatternError(f"{path}: a picture's scale is not --units; drop it")
    if "sheet" in given:
        given["sheet"] = parse_numbers(given["sheet"], 2, "--sheet", "x")
    if "start" in given:
        given["start"] = parse_start(given["start"])
    return scan(path, **given)
