"""From a picture to a metric pattern."""

import itertools
import os
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from wrod import arguments
from wrod.errors import PerceptionError, WrodWarning, needed_extras
from wrod.patterns.curve import arc_length
from wrod.patterns.pattern import Pattern
from wrod.perception.gaps import join_gaps
from wrod.perception.image import as_image, is_mask, read_image
from wrod.perception.metric import CameraIntrinsics, MarkerLayout, SeenPlane
from wrod.perception.refine import resample
from wrod.perception.segment import segment
from wrod.perception.trace import Centerline, trace_mask

PATTERN_POINTS = 400
# A traced centreline is trusted to this share of the stroke's half-width, and this length [m], at
# best: nobody draws better, and a curve through every point of it bends to and fro, and the grip's
# path with it.
_LEAST_SHARE, _LEAST_NOISE = 0.03, 5e-5
# Ends of two curves meet within so many of their radii together.
_MEET = 4.0
_WIDEST = 100.0  # [m] of a picture
CORNERS = ("lower-left", "lower-right", "upper-left", "upper-right")


@dataclass(frozen=True)
class Scan:
    """What was found in a picture.

    Attributes:
        name: stem of the picture's file, or "picture".
        image: (H, W) or (H, W, 3) uint8.
        mask: (H, W) uint8, non-zero on the strands.
        lines: centrelines [px], longest first.
        plane: pixels to metres, None without a scale.
        dots: (k, 2) centres of round dots beside the strands [px].
    """

    name: str
    image: np.ndarray
    mask: np.ndarray
    lines: list[Centerline]
    plane: SeenPlane | None = None
    dots: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def metric_lines(self) -> list[np.ndarray]:
        """(n, 2) points of every centreline [m]."""
        if self.plane is None:
            raise PerceptionError(
                f"{self.name}: the picture has no scale; give markers, the sheet's size or a scale"
            )
        return [self.plane.to_metres(line.points) for line in self.lines]

    def single(self) -> Centerline:
        """The one centreline; raises if there are several."""
        if len(self.lines) != 1:
            seen = ", ".join(
                "{:.0f} px from ({:.0f}, {:.0f}) to ({:.0f}, {:.0f})".format(
                    line.length, *line.points[0], *line.points[-1]
                )
                for line in self.lines[:4]
            )
            raise PerceptionError(
                f"{self.name}: the picture holds {len(self.lines)} curves ({seen}) where one is "
                f"wanted; {self._meeting()}cover or erase the others (`wrod scan --several` draws "
                "what it sees)"
            )
        return self.lines[0]

    def _meeting(self) -> str:
        """What to do where an end lies at another curve's end: a line turns back on itself there,
        or has a gap."""
        for line, other in itertools.combinations(self.lines[:4], 2):
            for a, b in itertools.product(line.points[[0, -1]], other.points[[0, -1]]):
                if np.hypot(*(a - b)) < _MEET * (line.radius + other.radius):
                    return (
                        f"round the sharp point, or close the gap, at ({a[0]:.0f}, {a[1]:.0f}), or "
                    )
        return ""


def _is_array(value):
    return arguments.picture(value) if isinstance(value, np.ndarray) else "must be an array"


@needed_extras()
@arguments.checked(
    PerceptionError,
    image=arguments.either(arguments.path, _is_array),
    markers=arguments.optional(
        arguments.either(arguments.path, arguments.like("a MarkerLayout", "corners"))
    ),
    sheet=arguments.optional(arguments.array((2,))),
    scale=arguments.optional(arguments.number(1e-9, 10.0)),
    camera=arguments.optional(
        arguments.either(
            arguments.path, arguments.like("a CameraIntrinsics", "matrix", "distortion")
        )
    ),
    mask=arguments.either(arguments.flag, arguments.picture),
    kind=arguments.text,
    color=arguments.optional(arguments.array((3,))),
)
def read_scan(
    image: str | os.PathLike[str] | np.ndarray,
    *,
    markers: str | os.PathLike[str] | MarkerLayout | None = None,
    sheet: tuple[float, float] | None = None,
    scale: float | None = None,
    camera: str | os.PathLike[str] | CameraIntrinsics | None = None,
    mask: bool | np.ndarray = False,
    kind: str = "auto",
    color: tuple[int, int, int] | None = None,
) -> Scan:
    """Every centreline of a picture, with the plane it lies in; arguments as in `scan`."""
    name = "picture" if isinstance(image, np.ndarray) else Path(image).stem
    picture = as_image(image) if isinstance(image, np.ndarray) else read_image(image)
    if sum(way is not None for way in (markers, sheet, scale)) > 1:
        raise PerceptionError("markers, sheet and scale were given; the scale comes from one only")
    try:
        if camera is not None and not isinstance(camera, CameraIntrinsics):
            camera = CameraIntrinsics.load(camera)
        plane, region = _plane(picture, markers, sheet, scale, camera)
        if region is not None and not region.any():
            raise PerceptionError("the sheet lies outside the picture; is it the right layout?")
        found, foreground = _foreground(picture, mask, kind, color, region)
        dots = _take_dots(found)
        lines = trace_mask(found, foreground)
    except PerceptionError as error:
        if isinstance(image, np.ndarray):
            raise
        raise PerceptionError(f"{image}: {error}") from None
    return Scan(name, picture, found, lines, plane, dots)


@arguments.checked(
    PerceptionError,
    start=arguments.either(arguments.text, arguments.array((2,))),
    smoothing=arguments.optional(arguments.number(0.0, 1e3)),
)
def scan(
    image: str | os.PathLike[str] | np.ndarray,
    *,
    markers: str | os.PathLike[str] | MarkerLayout | None = None,
    sheet: tuple[float, float] | None = None,
    scale: float | None = None,
    camera: str | os.PathLike[str] | CameraIntrinsics | None = None,
    mask: bool | np.ndarray = False,
    kind: str = "auto",
    color: tuple[int, int, int] | None = None,
    start: str | tuple[float, float] = "lower-left",
    smoothing: float | None = None,
):
    """Pattern along the one curve in a picture.

    Args:
        image: a picture file, or an array (H, W) or (H, W, 3) RGB.
        markers: layout of the four ArUco markers in the picture, as a JSON file or read.
        sheet: width and height of the bright sheet that the curve is drawn on [m].
        scale: metres per pixel of a camera that looks straight down [m/px].
        camera: camera matrix and distortion, as a JSON file or read.
        mask: True if `image` is a mask, bright on the curve; or the mask (H, W) itself.
        kind: "ink", "rod" or "auto".
        color: RGB of the rod.
        start: where the pattern begins: a point (x, y) [m], "dot" for the end beside a drawn dot,
            or the sheet's corner that the first end is nearest to ("lower-left", ...).
        smoothing: as in `Pattern.from_points`.

    Returns:
        `wrod.Pattern`, in the frame of the markers, or with x right and y up.

    Raises:
        PerceptionError: no or several curves, no scale, markers missing or there twice.
    """
    if markers is None and sheet is None and scale is None:
        raise PerceptionError(
            "the picture has no scale; give markers, the sheet's size or metres per pixel"
        )
    result = read_scan(
        image, markers=markers, sheet=sheet, scale=scale, camera=camera, mask=mask, kind=kind,
        color=color,
    )  # fmt: skip
    result = _without_gaps(result)
    points = oriented(result, start)
    # Errors of the centreline are alike over a strand's width. Points closer than that would look
    # exact to the pattern's estimate of their noise, which would then fit it.
    length, line = arc_length(points)[-1], result.lines[0]
    spacing = max(2.0 * line.radius * length / line.length, length / PATTERN_POINTS)
    (points,) = resample(points, spacing)
    pattern = Pattern.from_points(points, smoothing=smoothing, name=result.name, traced=True)
    least = max(_LEAST_SHARE * line.radius * length / line.length, _LEAST_NOISE)
    if smoothing is None and pattern.noise < least:
        return Pattern.from_points(points, smoothing=least, name=result.name, traced=True)
    return pattern


def _without_gaps(result: Scan) -> Scan:
    """A scan whose strokes go on in each other as one, with a warning; else as it is."""
    if len(result.lines) < 2:
        return result
    lines, gaps = join_gaps(result.lines)
    if len(lines) != 1:
        return result
    warnings.warn(
        WrodWarning(
            f"{result.name}: the stroke is broken in {len(gaps)} places, by {max(gaps):.0f} px at "
            "most; taken for one where its ends go on in each other"
        ),
        stacklevel=4,
    )
    return replace(result, lines=lines)


def oriented(result: Scan, start: str | tuple[float, float] = "lower-left") -> np.ndarray:
    """(n, 2) points [m] of the only centreline, from the end that `start` names (see `scan`)."""
    line = result.single()
    points = result.metric_lines()[0]
    target = _start_point(result, start)
    if line.closed:
        first = int(((points - target) ** 2).sum(1).argmin())
        return np.vstack([points[first:-1], points[: first + 1]])
    ends = ((points[[0, -1]] - target) ** 2).sum(1)
    if not isinstance(start, str):
        _refuse_far_start(result, target, float(np.sqrt(ends.min())))
    return points if ends[0] <= ends[1] else points[::-1]


def _refuse_far_start(result: Scan, target: np.ndarray, distance: float) -> None:
    """Refuse a point that is farther from the curve's ends [m] than the picture is large."""
    size = float(np.hypot(*np.ptp(_corners(result), axis=0)))
    if distance > size:
        raise PerceptionError(
            f"{result.name}: start {target[0]:g}, {target[1]:g} is {distance:.3g} m from the "
            f"nearest end of the curve, and the picture shows {size:.3g} m; give it in metres"
        )


def _corners(result: Scan) -> np.ndarray:
    height, width = result.image.shape[:2]
    return result.plane.to_metres(np.array([[0, 0], [width, 0], [width, height], [0, height]]))


def _start_point(result: Scan, start: str | tuple[float, float]) -> np.ndarray:
    if not isinstance(start, str):
        point = np.asarray(start, float)
        if point.shape != (2,) or not np.isfinite(point).all():
            raise PerceptionError(f"start {start!r}: give two coordinates in metres, or a corner")
        return point
    if start == "dot":
        if len(result.dots) != 1:
            raise PerceptionError(
                f"{result.name}: {len(result.dots)} dots lie beside the curve; draw one beside its "
                "start, or name the start another way"
            )
        return result.plane.to_metres(result.dots)[0]
    if start not in CORNERS:
        raise PerceptionError(f"start {start!r}: give x and y, dot, or one of {', '.join(CORNERS)}")
    corners = _corners(result)
    low, high = corners.min(0), corners.max(0)
    return np.array(
        [low[0] if "left" in start else high[0], low[1] if "lower" in start else high[1]]
    )


def _plane(picture, markers, sheet, scale, camera) -> tuple[SeenPlane | None, np.ndarray | None]:
    if markers is not None:
        layout = markers if isinstance(markers, MarkerLayout) else MarkerLayout.load(markers)
        plane = SeenPlane.from_markers(picture, layout, camera)
        return plane, layout.region(plane, picture.shape[:2])
    if sheet is not None:
        plane = SeenPlane.from_sheet(picture, sheet, camera)
        size = np.array(sheet)
        return plane, plane.sheet(0.02 * size, 0.98 * size, picture.shape[:2])
    if scale is not None:
        wide = scale * max(picture.shape[:2])
        if wide > _WIDEST:
            raise PerceptionError(
                f"a scale of {scale:g} m per pixel makes the picture {wide:.3g} m wide; no table "
                f"is over {_WIDEST:g} m, so check the scale's unit"
            )
        return SeenPlane.from_scale(scale, picture.shape[0], camera), None
    return None, None


def _foreground(picture, mask, kind, color, region) -> tuple[np.ndarray, np.ndarray | None]:
    if not isinstance(mask, (bool, np.bool_)):
        mask = np.asarray(mask)
        if mask.shape != picture.shape[:2]:
            raise PerceptionError(
                f"the mask has shape {mask.shape}, the picture {picture.shape[:2]}; they must agree"
            )
        return (mask > 0).astype(np.uint8) * np.uint8(255), None
    if mask or (kind == "auto" and color is None and is_mask(picture)):
        grey = picture if picture.ndim == 2 else picture.max(axis=2)
        # Masks of labels are 0 and 1; compressed ones have values around 0 and 255.
        middle = 0.5 * (float(grey.min()) + float(grey.max()))
        found = np.where(grey > middle, np.uint8(255), np.uint8(0))
        if region is not None:
            found[region == 0] = 0
        return found, None
    return segment(picture, kind, color, region)


def _take_dots(mask: np.ndarray) -> np.ndarray:
    """Centres (k, 2) of round specks that stand alone [px]; they are removed from the mask."""
    import cv2

    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    dots = []
    for contour in contours:
        (x, y), radius = cv2.minEnclosingCircle(contour)
        # The contour runs through the middles of its pixels, half a pixel inside the edge.
        if radius >= 2.0 and cv2.contourArea(contour) > 0.7 * np.pi * radius**2:
            holes = cv2.mean(mask[int(y) - 1 : int(y) + 2, int(x) - 1 : int(x) + 2])[0]
            if holes > 0 and radius < 0.05 * min(mask.shape):
                dots.append((x, y))
                cv2.drawContours(mask, [contour], 0, 0, -1)
    return np.array(dots).reshape(-1, 2)
