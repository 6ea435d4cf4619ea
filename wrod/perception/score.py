"""Scores of centrelines against labelled pictures."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from wrod.perception import refine
from wrod.perception.crossings import find_crossings
from wrod.perception.trace import Centerline


def score_paths(
    lines: list[Centerline], labels: np.ndarray, crossings: int | None = None
) -> dict[str, float]:
    """Agreement of centrelines with instance labels.

    Args:
        lines: centrelines [px].
        labels: (H, W) 0 for background, 1..K for the rods; the upper rod at a crossing.
        crossings: number of crossings in the picture, None if unknown.

    Returns:
        dice: mean over the rods of 2 |A and B| / (|A| + |B|), A the path drawn with its radius,
            for the best one-to-one match; count: 1 for the right number of paths; order: 1 if
            they also cross as often as the rods and 95 % of each path lies on its rod or within
            its width of it; offset_px: mean distance to the middle between a label's edges, away
            from crossings [px].
    """
    rods = [labels == k for k in range(1, int(labels.max()) + 1)]
    drawn = [_draw(line, labels.shape) for line in lines]
    dice = np.array(
        [[2.0 * (a & b).sum() / max(a.sum() + b.sum(), 1) for b in rods] for a in drawn]
    ).reshape(len(drawn), len(rods))
    rows, columns = linear_sum_assignment(-dice)
    count = float(len(lines) == len(rods))
    order, offsets = count, []
    for row, column in zip(rows, columns, strict=True):
        line, rod = lines[row], rods[column]
        at = np.round(line.points).astype(int).clip(0, np.array(labels.shape[::-1]) - 1)
        order *= float((_distances(rod, at) <= 2.5 * line.radius + 2).mean() >= 0.95)
        offsets.append(_offsets(line, rod, (labels > 0) & ~rod))
    if crossings is not None and lines:
        order *= float(len(find_crossings(lines)) == crossings)
    return {
        "dice": float(dice[rows, columns].sum() / len(rods)),
        "count": count,
        "order": order,
        "offset_px": finite_mean(np.concatenate([*offsets, []])),
    }


def finite_mean(values: ArrayLike) -> float:
    """Of the values that are numbers; NaN if none is, as where no rod was found."""
    found = np.asarray(values)[np.isfinite(values)]
    return float(found.mean()) if len(found) else float("nan")


def _draw(line: Centerline, shape: tuple[int, int]) -> np.ndarray:
    """All pixels whose centre is within the radius of the path."""
    low = np.floor(line.points.min(0) - line.radius).astype(int)
    high = np.ceil(line.points.max(0) + line.radius).astype(int) + 1
    (dense,) = refine.resample(line.points, 0.25)
    # From the nearest pixel that the path passes a distance is wrong by half a diagonal at most.
    off = np.ones(high[::-1] - low[::-1], bool)
    off[tuple((np.rint(dense).astype(int) - low).T[::-1])] = False
    rough = distance_transform_edt(off)
    inside = rough <= line.radius - 1.0
    y, x = np.nonzero(~inside & (rough <= line.radius + 1.0))
    distance, _ = cKDTree(dense).query(
        np.column_stack([x, y]) + low, distance_upper_bound=line.radius + 1e-9
    )
    inside[y, x] = distance <= line.radius
    out = np.zeros(shape, bool)
    first, last = (np.clip(end, 0, shape[::-1]) for end in (low, high))
    (left, top), (right, bottom) = first - low, last - low
    out[first[1] : last[1], first[0] : last[0]] = inside[top:bottom, left:right]
    return out


def _distances(mask: np.ndarray, at: np.ndarray) -> np.ndarray:
    """From pixels (point, 2) to the nearest of a mask [px]; infinite if it has none."""
    return cKDTree(np.argwhere(mask)[:, ::-1]).query(at)[0]


def _offsets(line: Centerline, rod: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distances of the path from the middle of the rod's label, away from crossings [px]."""
    (points,) = refine.resample(line.points, 1.0)
    skip = int(2 * line.radius) + 2
    points, normal = points[skip:-skip], refine.normals(points)[skip:-skip]
    if len(points) < 3:
        return np.zeros(0)
    reach = 2.5 * line.radius + 2
    label = rod.astype(np.uint8) * np.uint8(255)
    left, right = refine.edge_distances(label, points, normal, reach)
    at = np.round(points).astype(int)
    inside = ((at > skip) & (at < np.array(rod.shape[::-1]) - 1 - skip)).all(1)
    at = at.clip(0, np.array(rod.shape[::-1]) - 1)
    clear = inside & rod[at[:, 1], at[:, 0]] & (_distances(others, at) > 3 * line.radius)
    left, right = np.minimum(left, 1e6), np.minimum(right, 1e6)
    width = left + right
    clear &= (width > 1.2 * line.radius) & (width < 3 * line.radius + 1)
    return np.abs(left - right)[clear] / 2
