"""Sub-pixel centrelines: edges measured across the strand, smoothed with least bending energy."""

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import median_filter

from wrod.patterns.curve import arc_length

SMOOTHING = 6.0  # wavelength that the smoothing halves, in strand radii: no rod bends that often
REACH = 2.2  # how far across the strand edges are looked for, in strand radii
EDGE = 127.5  # foreground value at which a strand ends
ONE_SIDED = 0.3  # weight of a point of which one edge only is visible, the other being covered


def smooth(
    points: np.ndarray, weight: np.ndarray, wavelength: float, closed: bool = False
) -> np.ndarray:
    """Curve of least weighted misfit and bending energy through evenly spaced samples.

    Args:
        points: (n, k) samples; those of weight zero are bridged.
        weight: (n,) 1 for a full measurement.
        wavelength: [samples] waves of this length lose half their amplitude.
        closed: the last sample is followed by the first.

    Returns:
        (n, k) minimiser of sum w |z - p|^2 + (wavelength / 2 pi)^4 sum |second difference of z|^2.
    """
    n = len(points)
    if closed:
        pad = min(n, int(4 * wavelength) + 2)
        ring = np.arange(-pad, n + pad) % n
        return smooth(points[ring], weight[ring], wavelength)[pad : pad + n]
    if n < 3:
        return points.copy()
    stiffness = (wavelength / (2 * np.pi)) ** 4
    bands = np.zeros((3, n))
    bands[0, 2:] = 1.0
    bands[1, 1:] = -4.0
    bands[1, [1, -1]] = -2.0
    bands[2] = 6.0
    bands[2, [1, -2]] = 5.0
    bands[2, [0, -1]] = 1.0
    if n == 3:
        bands[1, 1:], bands[2] = -2.0, [1.0, 4.0, 1.0]
    bands *= stiffness
    # Without any measurement a straight line remains free; this holds it near the samples.
    held = weight + 1e-6
    bands[2] += held
    return solveh_banded(bands, held[:, None] * points, check_finite=False)


def resample(points: np.ndarray, step: float, *values: np.ndarray) -> list[np.ndarray]:
    """Points (and values along them) at even spacing close to `step`, ends kept."""
    arc = arc_length(points)
    keep = np.r_[True, np.diff(arc) > 1e-9]
    arc, points = arc[keep], points[keep]
    at = np.linspace(0.0, arc[-1], max(round(arc[-1] / step), 1) + 1)
    out = [np.column_stack([np.interp(at, arc, points[:, i]) for i in (0, 1)])]
    return out + [np.interp(at, arc, v[keep]) for v in values]


def normals(points: np.ndarray, closed: bool = False) -> np.ndarray:
    """(n, 2) unit normals, to the left of the direction of travel in picture axes (y down)."""
    if closed:
        tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    else:
        tangent = np.gradient(points, axis=0)
    tangent = tangent / np.maximum(np.hypot(*tangent.T), 1e-12)[:, None]
    return np.column_stack([tangent[:, 1], -tangent[:, 0]])


def sample(foreground: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Bilinear values (n, m) of `foreground` at points (n, m, 2); the border value outside."""
    import cv2

    xy = points.astype(np.float32)
    return cv2.remap(
        foreground, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )


def edge_distances(
    foreground: np.ndarray, points: np.ndarray, normal: np.ndarray, reach: float
) -> np.ndarray:
    """Distance (2, n) from each point to where the strand ends on either side [px].

    Args:
        foreground: (H, W) uint8; strands end where it passes 127.5.
        reach: [px] how far to look; infinity where the foreground goes on beyond it.
    """
    steps = np.arange(0.0, np.ceil(reach) + 1.0)
    both = np.concatenate([normal, -normal])
    rays = np.concatenate([points, points])[:, None] + steps[None, :, None] * both[:, None]
    # cv2.remap takes at most 32767 rows.
    pieces = [sample(foreground, rays[i : i + 30000]) for i in range(0, len(rays), 30000)]
    value = np.vstack(pieces)
    below = value < EDGE
    found = below.any(1)
    index = below.argmax(1)
    row = np.arange(len(value))
    inner, outer = (value[row, i].astype(float) for i in (np.maximum(index - 1, 0), index))
    distance = index - 1 + (inner - EDGE) / np.maximum(inner - outer, 1e-6)
    distance[index == 0] = 0.0
    distance[~found] = np.inf
    return distance.reshape(2, -1)


def centre_offsets(
    distances: np.ndarray, alone: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the middle of the strand lies on the normal of each sample.

    Args:
        distances: (2, n) from `edge_distances`.
        alone: (n,) bool, samples where no other strand is expected.

    Returns:
        offset (n,) along the normal [px], weight (n,), half-width (n,) [px].
    """
    left, right = distances
    half = (left + right) / 2
    trusted = alone & np.isfinite(half) & (half > 0.25)
    left, right = np.minimum(distances, 1e6)
    if not trusted.any():
        return np.zeros(len(alone)), np.zeros(len(alone)), np.full(len(alone), np.nan)
    typical = float(np.median(half[trusted]))
    trusted &= np.abs(half - typical) < 0.35 * typical + 0.5
    if not trusted.any():
        return np.zeros(len(alone)), np.zeros(len(alone)), np.full(len(alone), typical)
    at = np.flatnonzero(trusted)
    running = median_filter(half[at], min(25, len(at)), mode="nearest")
    width = np.interp(np.arange(len(alone)), at, running)
    near_left, near_right = (np.abs(d - width) < 0.35 * width for d in (left, right))
    offset, weight = np.zeros(len(alone)), np.zeros(len(alone))
    both = trusted | (near_left & near_right)
    offset[both], weight[both] = (left - right)[both] / 2, 1.0
    only = near_left & ~both & (right > width)
    offset[only], weight[only] = (left - width)[only], ONE_SIDED
    only = near_right & ~both & (left > width)
    offset[only], weight[only] = (width - right)[only], ONE_SIDED
    return offset, weight, width
