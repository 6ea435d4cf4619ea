"""Segmentation: what of a picture is rod or ink, pixel by pixel."""

from collections.abc import Callable
from functools import reduce

import numpy as np

from wrod.errors import PerceptionError

LEAST_CONTRAST = 12  # grey levels between strand and ground, below which there is only noise
_HUE = 0.25  # [rad] between the colours of rod and table, from which their hues differ
BRIGHT = 100  # median grey level from which a ground counts as paper


def segment(
    image: np.ndarray,
    kind: str = "auto",
    color: tuple[int, int, int] | None = None,
    region: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mask and foreground of the rods or strokes in a picture.

    Args:
        image: (H, W) or (H, W, 3) uint8 RGB.
        kind: "rod" for rods on a plain table, "ink" for strokes on paper under uneven light,
            "auto" takes ink on a bright ground, or where the region's exceptions are dark.
        color: RGB of the rods; None takes whatever differs from the table.
        region: (H, W) uint8, zero where nothing is to be looked for.

    Returns:
        mask (H, W) uint8, 255 on the foreground; foreground (H, W) uint8, its grey level 127.5
        is where the edge of a strand runs.

    Raises:
        PerceptionError: blank, or no strand stands out.
    """
    if kind not in ("auto", "rod", "ink"):
        raise PerceptionError(f"kind {kind!r} is unknown; choose auto, rod or ink")
    if color is not None:  # of NumPy, torch or Warp too
        red, green, blue = np.asarray(color).tolist()
        color = (red, green, blue)
    if color is not None and not (kind != "ink" and all(0 <= part <= 255 for part in color)):
        raise PerceptionError(
            f"color {tuple(color)} with kind {kind!r}: give red, green and blue from 0 to 255, of "
            "rods; ink is what is darker than its paper"
        )
    if kind == "auto":
        kind = "ink" if color is None and _is_paper(image, region) else "rod"
    return segment_ink(image, region) if kind == "ink" else segment_rods(image, color, region)


def _is_paper(image: np.ndarray, region: np.ndarray | None) -> bool:
    if region is None:
        return bool(np.median(image[::8, ::8]) > BRIGHT)
    grey = image if image.ndim == 2 else image[..., 1]
    dark, ground, bright = np.percentile(grey[region > 0], [0.3, 50, 99.7])
    return bool(ground - dark > bright - ground)


def segment_rods(
    image: np.ndarray, color: tuple[int, int, int] | None = None, region: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Rods on a plain table, as in `segment`."""
    import cv2

    plain = image[::4, ::4].reshape(-1, *image.shape[2:]) if region is None else image[region > 0]
    ground = np.atleast_1d(np.median(plain, axis=0))
    difference = _over_channels(cv2.max, cv2.absdiff(image, (*ground.tolist(), 0.0, 0.0, 0.0)[:4]))
    if color is not None:
        if image.ndim == 2:
            raise PerceptionError("a rod colour was given, but the picture is grey; leave it out")
        return _cut(255.0 * _likeness(image, ground, color, difference), 127.5, region)
    inside = difference if region is None else difference[region > 0]
    level, _ = cv2.threshold(inside, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    strands = inside[inside > level]
    if len(strands) == 0 or np.median(strands) < LEAST_CONTRAST:
        raise PerceptionError(
            "the picture is blank: no rod stands out of its background; "
            + _seen(image, region, float(np.median(strands)) if len(strands) else 0.0)
            + ", looked at as rods on a table; of kind ink they are strokes on paper"
        )
    # A rod is darker at its sides: its edge lies below half of its middle's brightness.
    return _cut(difference, min(level, 0.4 * float(np.median(strands))), region)


def _likeness(image, ground, color, difference) -> np.ndarray:
    """(H, W) from 0, as the table, to 1, as the rod; a half where the edge of a rod runs.

    Light and grain make a table brighter and darker by more than it may differ from the rod, and
    keep its hue: so distances are those from all brightnesses of either colour, as long as their
    hues differ, each over what the other colour itself has.
    """
    import cv2

    rod = np.array(color, float)
    across, length = np.linalg.norm(np.cross(rod, ground)), np.linalg.norm(ground)
    if across < _HUE * np.linalg.norm(rod) * length or length == 0.0:
        other = _over_channels(cv2.max, np.abs(image - rod.astype(np.float32)))
        return difference / (difference.astype(np.float32) + other + 1.0)

    def beside(hue):
        unit = (hue / np.linalg.norm(hue)).astype(np.float32)
        pixels = image.astype(np.float32)
        return np.linalg.norm(pixels - (pixels @ unit)[..., None] * unit, axis=-1)

    table, own = beside(ground) / np.linalg.norm(rod), beside(rod) / length
    return table / (table + own + 0.02)


def segment_ink(
    image: np.ndarray, region: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Strokes darker than the paper around them, as in `segment`."""
    import cv2

    height, width = image.shape[:2]
    # The paper's own brightness: strokes are closed over. Light varies slowly but for the edges of
    # shadows, which a closing and a median leave where they are, as a blur would not.
    small = cv2.resize(image, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    # OpenCV's median looks at 255 pixels across at most.
    size = min(max(int(0.02 * max(height, width)) // 2 * 2 + 1, 5), 255)
    paper = cv2.morphologyEx(
        small, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    )
    paper = cv2.GaussianBlur(cv2.medianBlur(paper, size), (0, 0), 1.0)
    paper = cv2.resize(paper, (width, height), interpolation=cv2.INTER_LINEAR)
    # Share of the paper's light that is missing, in the channel where most is.
    bright = cv2.divide(image, paper, scale=220.0)
    darkness = 220 - np.minimum(_over_channels(cv2.min, bright), 220)
    darkness = cv2.GaussianBlur(darkness, (3, 3), 0)
    inside = darkness if region is None else darkness[region > 0]
    level, _ = cv2.threshold(inside, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    strokes, noise = inside[inside > level], inside[inside <= level]
    ink = float(np.median(strokes)) if len(strokes) else 0.0
    if ink < max(LEAST_CONTRAST, 4.0 * float(noise.std())):
        raise PerceptionError(
            "the picture is blank: no stroke stands out of the paper; "
            + _seen(image, region, ink, 4.0 * float(noise.std()))
            + ", looked at as strokes on paper; of kind rod they are rods on a table"
        )
    return _cut(darkness, max(0.5 * ink, LEAST_CONTRAST / 2), region)


def _seen(image: np.ndarray, region: np.ndarray | None, stands_out: float, noise=0.0) -> str:
    """What there is in a picture that holds nothing."""
    height, width = image.shape[:2]
    inside = image if region is None else image[region > 0]
    where = "it" if region is None else f"the {np.mean(region > 0):.0%} of it between the markers"
    return (
        f"of {width} x {height} px, {where} has a middle grey of {np.median(inside):.0f}, and what "
        f"differs most does so by {stands_out:.0f} of 255 where {max(LEAST_CONTRAST, noise):.0f} "
        "are needed"
    )


def _cut(
    value: np.ndarray, level: float, region: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    import cv2

    foreground = cv2.convertScaleAbs(value, alpha=127.5 / max(level, 1.0))
    if region is not None:
        foreground[region == 0] = 0
    _, mask = cv2.threshold(foreground, 127, 255, cv2.THRESH_BINARY)
    return mask, foreground


def _over_channels(choose: Callable, image: np.ndarray) -> np.ndarray:
    """(H, W) what `choose` takes of two channels after the other; of a grey picture, itself."""
    import cv2

    return image if image.ndim == 2 else reduce(choose, cv2.split(image))
