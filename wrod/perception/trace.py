"""Ordered, sub-pixel centrelines of every rod or stroke in a picture."""

from dataclasses import dataclass

import numpy as np

from wrod import arguments
from wrod.errors import PerceptionError, needed_extras
from wrod.patterns.curve import arc_length
from wrod.perception import refine
from wrod.perception.image import as_image, is_mask
from wrod.perception.junctions import is_doubtful, resolve, share_stretches
from wrod.perception.network import Network, build_network, refuse_a_texture
from wrod.perception.segment import segment
from wrod.perception.skeleton import skeletonize
from wrod.perception.strands import Strand, link_strands

EXPLAINED = 0.9  # least share of the foreground that the strands must cover
SHORTEST = 6.0  # shortest strand that is reported, in strand radii; less is dirt
HALVED = 4.0  # strand radius from which the skeleton is taken from every other pixel [px]
THICKEST = 1 / 12  # largest strand radius, as a share of the picture's shorter side
_MOST_CONTOURS = 50_000  # of the foreground, of specks too


@dataclass(frozen=True)
class Centerline:
    """Centreline of one rod or stroke, ordered from end to end.

    Attributes:
        points: (n, 2) float, x right and y down [px]; (0, 0) is the centre of the first pixel.
        half_width: (n,) half of the visible thickness at each point [px].
        closed: the curve returns to its first point, which is repeated as the last.
    """

    points: np.ndarray
    half_width: np.ndarray
    closed: bool = False

    @property
    def radius(self) -> float:
        """Median half-width [px]."""
        return float(np.median(self.half_width))

    @property
    def length(self) -> float:
        """Length of the polyline [px]."""
        return float(arc_length(self.points)[-1])

    @property
    def area(self) -> float:
        """Of the strand [px^2], whose width changes in an oblique view; what is twice as wide as
        its middle is a blob, and counts with its middle's width."""
        wide = np.where(self.half_width < 2.0 * self.radius, self.half_width, self.radius)
        caps = 0.5 * np.pi * (wide[0] ** 2 + wide[-1] ** 2)
        return float(2.0 * np.trapezoid(wide, arc_length(self.points)) + caps)

    def __array__(self, dtype=None, copy=None):
        return np.array(self.points, dtype=dtype)


@needed_extras()
@arguments.checked(
    PerceptionError,
    image=arguments.picture,
    mask=arguments.optional(arguments.picture),
    color=arguments.optional(arguments.array((3,))),
)
def trace_centerlines(
    image: np.ndarray,
    *,
    mask: np.ndarray | None = None,
    kind: str = "auto",
    color: tuple[int, int, int] | None = None,
) -> list[Centerline]:
    """Ordered centreline and width of every rod or stroke in a picture, longest first.

    Args:
        image: (H, W, 3) RGB or (H, W) grey picture; an array of two values is taken as a mask,
            bright on the strands.
        mask: (H, W) non-zero on the strands; replaces the segmentation, edges included.
        kind: "rod" for rods on a plain table, "ink" for strokes on paper, or "auto".
        color: RGB of the rods, where other things lie on the table too.

    Raises:
        PerceptionError: blank, nothing thin in it, or not a picture.
    """
    if mask is not None:
        return trace_mask(mask)
    image = as_image(image)
    if is_mask(image):
        return trace_mask(image > int(image.max()) // 2)
    return trace_mask(*segment(image, kind, color))


@needed_extras()
def trace_mask(mask: np.ndarray, foreground: np.ndarray | None = None) -> list[Centerline]:
    """Centrelines of all strands of a mask, longest first.

    Args:
        mask: (H, W) bool or uint8, non-zero on the strands.
        foreground: (H, W) uint8; strands end where it passes 127.5. None measures the mask.

    Raises:
        PerceptionError: nothing, or nothing thin, is in the mask.
    """
    import cv2

    mask = _checked(mask)
    clean, radius = _tidy(mask)
    # Every other pixel carries the topology of thick strands as well, in a fifth of the time;
    # where that leaves a doubt, the full resolution decides.
    scale = 2 if radius > HALVED else 1
    network, choices = _resolved(clean, scale)
    if scale == 2 and is_doubtful(network, choices):
        scale = 1
        network, choices = _resolved(clean, scale)
    if not network.arms:
        raise PerceptionError(
            "the picture holds no rod or stroke (only specks or blobs); check mask and exposure"
        )
    radius = scale * network.radius
    if radius > THICKEST * min(mask.shape):
        raise PerceptionError(
            f"the foreground is {2 * radius:.0f} px thick, too much for a rod or stroke in "
            f"a picture of {mask.shape[1]} x {mask.shape[0]} px; is the mask inverted?"
        )
    strands = link_strands(network, choices)
    for strand in strands:
        strand.points = scale * strand.points + (scale - 1) / 2
    if foreground is None:
        foreground = cv2.blur(clean * np.uint8(255), (3, 3))
    lines = _refine(strands, foreground, radius, scale)
    lines = [line for line in lines if line.length > SHORTEST * radius]
    if not lines:
        raise PerceptionError(
            "the picture holds no rod or stroke (only specks); check mask and exposure"
        )
    share = sum(line.area for line in lines) / cv2.countNonZero(clean)
    if share < EXPLAINED:
        raise PerceptionError(
            f"only {100 * share:.0f} % of what stands out of the background has the shape of rods "
            "or strokes; cover what else lies between markers, crop the picture to the plain sheet "
            "or table, or give the rod's colour or a mask"
        )
    return sorted(lines, key=lambda line: -line.length)


def _resolved(mask: np.ndarray, scale: int) -> tuple[Network, list]:
    import cv2

    if scale > 1:
        mask = cv2.resize(
            mask * np.uint8(2), None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA
        )
        mask = (mask > 0).view(np.uint8)
    network = build_network(skeletonize(mask))
    share_stretches(network)
    return network, resolve(network, mask)


def _checked(mask: np.ndarray) -> np.ndarray:
    mask = np.asarray(mask)
    if mask.ndim != 2 or min(mask.shape) < 16:
        raise PerceptionError(
            f"the mask has shape {mask.shape}; it must be (H, W) with at least 16 x 16 px"
        )
    mask = (mask > 0).view(np.uint8)
    share = np.count_nonzero(mask) / mask.size
    if share == 0.0:
        raise PerceptionError("the picture is blank: no rod or stroke stands out of its background")
    if share > 0.5:
        raise PerceptionError(
            f"{100 * share:.0f} % of the picture is foreground; rods or strokes cover less than "
            "half: is the mask inverted, or the table not plain? Then say the rod's colour"
        )
    return mask


def _tidy(mask: np.ndarray) -> tuple[np.ndarray, float]:
    """Mask without pinholes, specks and slits of one pixel, and a first guess of the radius.

    Pinholes would turn the skeleton into rings; labels and sharpening leave slits between
    crossing strands.
    """
    import cv2

    x, y, width, height = cv2.boundingRect(mask)
    out = np.zeros_like(mask)
    inner = mask[y : y + height, x : x + width]
    inner = cv2.morphologyEx(inner, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    contours, tree = cv2.findContours(inner, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    refuse_a_texture(len(contours), _MOST_CONTOURS, "outlines stand out of the background")
    perimeter = 0
    for contour, (_, _, _, parent) in zip(contours, tree[0], strict=True):
        perimeter += len(contour)
        if len(contour) <= 12:
            # The contour of a hole runs over the pixels around it.
            cv2.drawContours(inner, [contour], 0, int(parent >= 0), -1)
    out[y : y + height, x : x + width] = inner
    return out, 0.9 * cv2.countNonZero(inner) / max(perimeter, 1)


def _refine(
    strands: list[Strand], foreground: np.ndarray, radius: float, spacing: float
) -> list[Centerline]:
    """Measure all strands' edges in one pass, smooth, and set the ends.

    `spacing` is the distance of the strands' raw points [px].
    """
    step = float(np.clip(radius / 4, 1.0, 2.0))
    courses = []
    for strand in strands:
        if len(strand.points) < 4:
            continue
        weight = np.where(strand.alone, 1.0, 0.05)
        points = refine.smooth(
            strand.points, weight, 4.0 * max(radius, 1.5) / spacing, strand.closed
        )
        alone = strand.alone.astype(float)
        if strand.closed:
            points, alone = np.vstack([points, points[:1]]), np.r_[alone, alone[:1]]
        else:
            points, alone = _extend(points, alone, foreground, radius)
        points, alone = refine.resample(points, step, alone)
        if strand.closed:
            points, alone = points[:-1], alone[:-1]
        courses.append((points, refine.normals(points, strand.closed), alone > 0.5, strand.closed))
    if not courses:
        return []
    distances = refine.edge_distances(
        foreground,
        np.vstack([c[0] for c in courses]),
        np.vstack([c[1] for c in courses]),
        refine.REACH * radius + 2.0,
    )
    splits = np.cumsum([len(c[0]) for c in courses])[:-1]
    lines = []
    for (points, normal, alone, closed), pair in zip(
        courses, np.split(distances, splits, axis=1), strict=True
    ):
        offset, weight, width = refine.centre_offsets(pair, alone)
        if not np.isfinite(width).all():
            continue  # its edges are nowhere to be seen
        own = float(np.median(width))
        target = points + offset[:, None] * normal
        wavelength = refine.SMOOTHING * max(own, 1.5) / step
        # Where nothing was measured the raw course still tells shared stretches from straight.
        final = refine.smooth(target, np.maximum(weight, 0.01), wavelength, closed)
        if closed:
            final, width = np.vstack([final, final[:1]]), np.r_[width, width[:1]]
        else:
            final, width = _cut_ends(final, width, foreground, own)
        if len(final) >= 2:
            lines.append(Centerline(final, width, closed))
    return lines


def _ahead(points, foreground, radius, first, count) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 2) a pixel apart straight on from the last of a line, numbers `first` to `count`;
    which of them are within the picture, and which on the foreground."""
    step = np.hypot(*(points[-1] - points[-2])) or 1.0
    n = min(len(points), max(int(3 * radius / step), 4))
    out = points[-1] - points[-n]
    tangent = out / max(np.hypot(*out), 1e-12)
    beyond = points[-1] + np.arange(first, count)[:, None] * tangent
    inside = ((beyond >= 0) & (beyond <= np.array(foreground.shape[::-1]) - 1)).all(1)
    on = inside & (refine.sample(foreground, beyond[None])[0] > refine.EDGE)
    return beyond, inside, on


def _extend(points, alone, foreground, radius):
    """Prolong both ends straight over the rest of the foreground, at most 5 radii."""
    for _ in range(2):
        points, alone = points[::-1], alone[::-1]
        beyond, _, on = _ahead(points, foreground, radius, 1, int(5 * radius) + 2)
        n = len(beyond) if on.all() else int(on.argmin())
        points = np.vstack([points, beyond[:n]])
        alone = np.r_[alone, np.ones(n)]
    return points, alone


def _cut_ends(points, width, foreground, radius):
    """End the line one radius before its strand ends; at the picture's border, on the border."""
    for _ in range(2):
        points, width = points[::-1], width[::-1]
        beyond, inside, on = _ahead(points, foreground, radius, 0, int(3 * radius) + 4)
        end = int(np.argmin(on))
        if not inside.all() and end == int(np.argmin(inside)):
            points = np.vstack([points, beyond[1:end]])
            width = np.r_[width, np.repeat(width[-1], max(end - 1, 0))]
            continue
        arc = arc_length(points)
        own = np.median(width[arc > arc[-1] - 6.0 * radius])  # nearer or farther than the middle
        drop = own - max(end - 0.5, 0.0)
        if drop > 0:
            keep = arc <= arc[-1] - drop
            if keep.sum() >= 2:
                last = [np.interp(arc[-1] - drop, arc, points[:, i]) for i in (0, 1)]
                points, width = np.vstack([points[keep], last]), np.r_[width[keep], width[-1]]
    return points, width
