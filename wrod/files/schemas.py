"""What the JSON files that wrod reads hold: a schema each, from which docs/formats.md is printed.

Lengths are metres and angles radians where a field does not say otherwise. JSON has no way to write
NaN or infinity, and numbers that no float64 holds are refused, so every number is finite.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

# A table, and everything on it or beside it, lies within 100 m.
Coordinate = Annotated[float, Meta(ge=-100.0, le=100.0, description="[m]")]
Length = Annotated[float, Meta(gt=0.0, le=100.0, description="[m]")]
Point = tuple[Coordinate, Coordinate]
Place = tuple[Coordinate, Coordinate, Coordinate]
Name = Annotated[str, Meta(min_length=1, max_length=200)]
Note = Annotated[str, Meta(max_length=10_000)]
Count = Annotated[int, Meta(ge=0, le=2**40)]
Fraction = Annotated[float, Meta(ge=-1e12, le=1e12)]


class _File(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file whose entries are all known."""


class _Open(Struct, frozen=True, kw_only=True):
    """A file that may hold more than what is read of it."""


class Cylinder(_File, frozen=True):
    """An upright post on its centre."""

    center: Place
    radius: Length
    height: Length


class Box(_File, frozen=True):
    """A box on the centre of its lower face; yaw is in degrees."""

    center: Place
    size: tuple[Length, Length, Length]
    yaw: Annotated[float, Meta(ge=-3600.0, le=3600.0, description="[degrees]")] = 0.0


class Fixture(_File, frozen=True):
    """A post or the wall of a clip: either a cylinder or a box."""

    name: Name
    cylinder: Cylinder | None = None
    box: Box | None = None


class Fixtures(_File, frozen=True):
    """Posts and clips that a cable is laid between (`wrod deploy --fixtures`)."""

    format: Literal["wrod-fixtures-1"]
    fixtures: Annotated[list[Fixture], Meta(min_length=1, max_length=200)]
    gates: Annotated[list[tuple[Name, Name]], Meta(max_length=200)] = []
    name: Annotated[str, Meta(max_length=200)] | None = None
    note: Note = ""


class Obstacle(_File, frozen=True):
    """One of a list of shapes in the arm's way (`--obstacles`), in its base's frame; the size is a
    sphere's radius, a cylinder's radius and length, a box's sides or a mesh's scale [m]."""

    kind: Literal["sphere", "cylinder", "box", "mesh"]
    size: Annotated[list[Coordinate], Meta(max_length=3)] | float | None = None
    xyz: Place = (0.0, 0.0, 0.0)
    rpy: tuple[Fraction, Fraction, Fraction] = (0.0, 0.0, 0.0)
    file: Note | None = None
    name: Note = ""


Corners = tuple[Point, Point, Point, Point]


class MarkerLayout(_Open, frozen=True):
    """Where the ArUco markers 0 to 3 lie on a sheet (`--markers`)."""

    marker_corners_m: dict[Literal["0", "1", "2", "3"], Corners]
    paper_size_m: tuple[Length, Length] | None = None
    dictionary: Literal["DICT_4X4_50"] = "DICT_4X4_50"


Pixels = Annotated[float, Meta(ge=-1e6, le=1e6, description="[px]")]
_Row = tuple[Pixels, Pixels, Pixels]
Coefficient = Annotated[float, Meta(ge=-1e3, le=1e3)]


class CameraIntrinsics(_Open, frozen=True):
    """A camera's matrix [px] and OpenCV's distortion coefficients (`--camera`)."""

    camera_matrix: tuple[_Row, _Row, _Row]
    distortion: Annotated[list[Coefficient], Meta(max_length=14)] = []


Knot = Annotated[int, Meta(ge=0, le=1)]


class Move(_File, frozen=True):
    """Pick a rod up at an arc length, carry it, put it down."""

    rod: Knot
    at: Annotated[float, Meta(ge=0.0, le=100.0, description="[m]")]
    to: Point
    hand: Knot
    lift: Length = 0.05
    turn: Annotated[float, Meta(ge=-3600.0, le=3600.0, description="[degrees]")] = 0.0
    lay_height: Annotated[float, Meta(ge=0.0, le=1e3, description="[radii]")] = 1.0
    where: Point | None = None


class Pull(_File, frozen=True):
    """Grasp a rod where its end was put, and pull."""

    rod: Knot
    at: Annotated[float, Meta(ge=0.0, le=100.0, description="[m]")]
    where: Point
    direction: tuple[Fraction, Fraction]
    distance: Length


class KnotRod(_File, frozen=True):
    """A rod of the paper's Table 2 by name, and the file of the pattern along which it is laid."""

    rod: Name
    pattern: Name


class KnotPlan(_File, frozen=True):
    """What is laid where, which moves tie it, and how it is pulled (`wrod bench applications`)."""

    format: Literal["wrod-knot-1"]
    name: Name
    knot: Name
    rods: Annotated[list[KnotRod], Meta(min_length=1, max_length=2)]
    steps: Annotated[
        list[Annotated[list[Move], Meta(min_length=1, max_length=2)]], Meta(max_length=100)
    ]
    load: Annotated[float, Meta(gt=0.0, le=1e4, description="[N]")]
    pull: Annotated[list[Pull], Meta(max_length=2)] = []
    note: Note = ""


_Curvature = Annotated[float, Meta(ge=-1e3, le=1e3, description="[1/L_gb]")]


class RodInputs(_File, frozen=True):
    """The one rod that a dataset's or a controller's grasps are of, dimensionless."""

    length: Annotated[float, Meta(gt=0.0, le=1e6, description="[L_gb]")]
    stretch_ratio: Annotated[float, Meta(gt=0.0, le=1e12)]
    natural_curvature: tuple[_Curvature, _Curvature] = (0.0, 0.0)
    poisson: Annotated[float, Meta(gt=-1.0, le=0.5)] = 0.5


class Plans(_File, frozen=True):
    """What the optimised plans of a folder are (`plans/plans.json` of `wrod distil`)."""

    format: Literal["wrod-plans-4"]
    seed: Annotated[int, Meta(ge=0, le=2**53)]


class Manifest(_File, frozen=True):
    """What a dataset of grasps is (`manifest.json` of `wrod dataset`)."""

    format: Literal["wrod-grasps-1"]
    size: Annotated[int, Meta(ge=1, le=2**30)]
    shard_size: Annotated[int, Meta(ge=1, le=2**30)]
    seed: Annotated[int, Meta(ge=0, le=2**53)]
    closure: Name
    edge_count: Annotated[int, Meta(ge=1, le=100_000)]
    sensitivities: bool
    solver: Name
    inputs: tuple[Literal["suspended_length"], Literal["curvature"], Literal["stretch_ratio"]] = (
        "suspended_length",
        "curvature",
        "stretch_ratio",
    )
    rod: RodInputs | None = None


class Shard(_Open, frozen=True):
    """What a shard of a dataset says of itself (text "wrod" of its metadata)."""

    format: Literal["wrod-grasps-1"]
    dataset: Name
    first: Count
    count: Count
    sha256: Name


Range = tuple[Annotated[float, Meta(ge=-1e12, le=1e12)], Annotated[float, Meta(ge=-1e12, le=1e12)]]


class ControllerRange(_File, frozen=True):
    """Smallest and largest of each input that a controller was trained for."""

    suspended_length: Range
    curvature: Range
    stretch_ratio: Range


class ControllerScore(_Open, frozen=True):
    """How far a controller's grips are from the rod solver's, which it has not learnt from: that of
    a hundredth of them is larger."""

    position_error_p99: Annotated[float, Meta(ge=0.0, le=1e12, description="[L_gb]")]
    rotation_error_p99: Annotated[float, Meta(ge=0.0, le=1e12, description="[rad]")]


class Controller(_Open, frozen=True):
    """What a controller says of itself (text "wrod" of its metadata)."""

    format: Literal["wrod-controller-1"]
    architecture: Literal["chain", "paper", "curved"]
    closure: Name
    range: ControllerRange
    rod: RodInputs | None = None
    held_out: ControllerScore | None = None


class CorrectorRange(_File, frozen=True):
    """Smallest and largest of what a corrector learnt."""

    friction: Range
    curvature: Range
    rod_length: Range
    stretch_ratio: Range


class Corrector(_Open, frozen=True):
    """What a corrector of plans says of itself (text "wrod" of its metadata)."""

    format: Literal["wrod-corrector-1"]
    range: CorrectorRange


Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
# What rods have in metres, and none has whose file was written in millimetres.
Radius = Annotated[float, Meta(gt=0.0, le=1.0, description="[m]")]
Bending = Annotated[float, Meta(gt=0.0, le=30.0, description="[m]")]
Long = Annotated[float, Meta(gt=0.0, le=1e3, description="[m]")]


class RodFile(_File, frozen=True):
    """A rod (`--rod`), as `wrod loop` writes it; SI units."""

    format: Literal["wrod-rod-1"]
    radius: Radius
    gravito_bending_length: Bending
    length: Long
    poisson: Annotated[float, Meta(gt=-1.0, le=0.5)] = 0.5
    density: Positive = 1180.0
    gravity: Positive = 9.81
    natural_curvature: tuple[Fraction, Fraction] = (0.0, 0.0)


class RodProfile(_File, frozen=True):
    """A property along a rod: linear between knots (arc lengths), constant beyond them."""

    knots: Annotated[list[Fraction], Meta(min_length=1, max_length=20_000, description="[m]")]
    values: Annotated[list[Fraction], Meta(min_length=1, max_length=20_000)]


Along = float | RodProfile


class RodModelFile(_File, frozen=True):
    """A rod that may vary along its length (`--rod`), as `wrod identify` writes it; SI units."""

    format: Literal["wrod-rod-model-3"]
    length: Positive
    bending_stiffness: tuple[Along, Along]
    twisting_stiffness: Along
    stretching_stiffness: Along
    line_mass: Along
    radius: Positive
    principal_angle: Fraction = 0.0
    natural_curvature: tuple[Along, Along] = (0.0, 0.0)
    natural_twist: Along = 0.0
    point_masses: Annotated[list[tuple[Fraction, Fraction]], Meta(max_length=1000)] = []
    law: dict[str, str | float] = field(default_factory=lambda: {"name": "linear"})
    internal_damping: Fraction | None = None
    relaxation_time: Fraction = 0.0
    air_damping: Fraction = 0.0
    quadratic_drag: Fraction = 0.0
    gravity: Positive = 9.81
    assumed: Annotated[list[Name], Meta(max_length=100)] = []
    found: dict[str, Any] = field(default_factory=dict)


class TableFriction(_File, frozen=True):
    """What laid rods told of a table (`wrod laid --table`, `--friction`)."""

    format: Literal["wrod-table-1"]
    friction: Annotated[float, Meta(gt=0.0, le=100.0)]
    log_error: Annotated[float, Meta(ge=0.0, le=100.0)]
    correlation: Annotated[float, Meta(ge=-1.0, le=1.0)] = 0.0


class TrajectoryMetadata(_Open, frozen=True):
    """What a trajectory says of itself (text "metadata" of its .npz file)."""

    method: Name = ""
    closure: Name | None = None
    pattern: Annotated[str, Meta(max_length=1000)] = ""
    pattern_length: Annotated[float, Meta(ge=0.0, le=1e6, description="[m]")] = 0.0
    remainder_length: Annotated[float, Meta(ge=0.0, le=1e6, description="[m]")] = 0.0
    roll: Annotated[float, Meta(ge=-1e6, le=1e6, description="[rad]")] = 0.0
    spin: Annotated[float, Meta(ge=-1e6, le=1e6, description="[rad]")] = 0.0
    beyond_grip: Annotated[float, Meta(ge=0.0, le=1e6, description="[m]")] = 0.0
    rod: dict[str, Any] | None = None
    warnings: Annotated[list[str], Meta(max_length=1000)] = []
