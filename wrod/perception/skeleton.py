"""Skeleton of a mask as a pixel graph: chains of pixels between junctions and free ends."""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Chain:
    """Skeleton pixels between two nodes.

    Attributes:
        pixels: (n,) indices into the skeleton's points, in order.
        nodes: the junction pixel at either end, -1 for a free end.
        closed: the chain is a loop without any junction.
    """

    pixels: np.ndarray
    nodes: tuple[int, int]
    closed: bool = False


@dataclass
class Skeleton:
    """Attributes:
    points: (n, 2) pixel centres, x then y [px].
    clearance: (n,) distance to the nearest edge of the mask [px].
    chains: pixel chains; junction pixels themselves belong to none.
    junctions: indices of the pixels with three or more neighbours.
    links: (m, 2) pairs of junction pixels that touch.
    """

    points: np.ndarray
    clearance: np.ndarray
    chains: list[Chain] = field(default_factory=list)
    junctions: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    links: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), int))


def skeletonize(mask: np.ndarray) -> Skeleton:
    """Thin `mask` (H, W) uint8, non-zero on the rods, to chains of pixels.

    Two pixels are neighbours when they share a side, or a corner without a common side
    neighbour; so a staircase is a path, not a row of junctions.
    """
    import cv2
    from skimage.morphology import skeletonize as thin

    x0, y0, width, height = cv2.boundingRect(mask)
    # One pixel of background around, but none outside the picture: a rod that leaves the
    # picture has no edge there.
    x1, y1 = min(x0 + width + 1, mask.shape[1]), min(y0 + height + 1, mask.shape[0])
    x0, y0 = max(x0 - 1, 0), max(y0 - 1, 0)
    height, width = y1 - y0, x1 - x0
    inner = mask[y0:y1, x0:x1]
    distance = cv2.distanceTransform(inner, cv2.DIST_L2, 5)
    thinned = np.zeros((height + 2, width + 2), bool)
    thinned[1:-1, 1:-1] = thin(inner > 0)

    flat, stride = thinned.ravel(), width + 2
    index = np.flatnonzero(flat)
    around = np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1])
    near = index[:, None] + around
    joined = flat[near]
    for corner in (1, 3, 5, 7):
        joined[:, corner] &= ~(joined[:, corner - 1] | joined[:, (corner + 1) % 8])
    number = np.full(flat.size, -1, np.int32)
    number[index] = np.arange(len(index))
    neighbours = np.where(joined, number[near], -1)
    y, x = np.divmod(index, stride)
    skeleton = Skeleton(
        np.column_stack([x + (x0 - 1.0), y + (y0 - 1.0)]), distance[y - 1, x - 1] - 0.5
    )
    _walk(skeleton, neighbours, joined.sum(1))
    return skeleton


def _walk(skeleton: Skeleton, neighbours: np.ndarray, degree: np.ndarray) -> None:
    """Fill in chains, junctions and links from each pixel's neighbours (n, 8), -1 where none."""
    high = neighbours.max(1)
    low = np.where(degree >= 2, np.where(neighbours < 0, 0, neighbours).sum(1) - high, -1)
    degrees, high, low = degree.tolist(), high.tolist(), low.tolist()  # lists walk faster
    seen = bytearray(len(degrees))

    def follow(previous: int, pixel: int) -> tuple[list[int], int]:
        pixels = []
        while pixel >= 0 and degrees[pixel] <= 2 and not seen[pixel]:
            seen[pixel] = 1
            pixels.append(pixel)
            onward = low[pixel] if high[pixel] == previous else high[pixel]
            previous, pixel = pixel, onward
        return pixels, pixel

    junctions = np.flatnonzero(degree >= 3)
    links = []
    for junction in junctions.tolist():
        for pixel in neighbours[junction][neighbours[junction] >= 0].tolist():
            if degrees[pixel] >= 3:
                if junction < pixel:
                    links.append((junction, pixel))
            elif not seen[pixel]:
                pixels, last = follow(junction, pixel)
                skeleton.chains.append(Chain(np.array(pixels), (junction, last)))
    for pixel in np.flatnonzero(degree <= 1).tolist():
        if not seen[pixel]:
            pixels, last = follow(-1, pixel)
            skeleton.chains.append(Chain(np.array(pixels), (-1, last)))
    for pixel in np.flatnonzero(degree == 2).tolist():
        if not seen[pixel]:
            pixels, _ = follow(low[pixel], pixel)
            skeleton.chains.append(Chain(np.array(pixels), (-1, -1), closed=True))
    skeleton.junctions = junctions
    skeleton.links = np.array(links, int).reshape(-1, 2)
