"""Where centrelines cross, and which strand lies on top."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from wrod.patterns.curve import arc_length
from wrod.perception.trace import Centerline

# Strands whose colours differ by less are told apart by their edges [grey levels].
SAME_COLOR = 30.0
CERTAIN = 0.25  # least lead of one strand's evidence over the other's, as a share of both


@dataclass(frozen=True)
class Crossing:
    """Attributes:
    point: (2,) [px].
    strands: index of either centreline in the list.
    arc_lengths: where on either the crossing lies [px].
    over: 0 or 1, which of the two lies on top; None where the picture does not show it.
    """

    point: np.ndarray
    strands: tuple[int, int]
    arc_lengths: tuple[float, float]
    over: int | None = None


def find_crossings(lines: list[Centerline], image: np.ndarray | None = None) -> list[Crossing]:
    """Self-crossings and mutual crossings, in order along the first strand.

    Args:
        lines: centrelines.
        image: (H, W, 3) or (H, W) uint8 to read over and under from; None leaves them open. Ink
            has neither.
    """
    starts = np.vstack([line.points[:-1] for line in lines])
    ends = np.vstack([line.points[1:] for line in lines])
    owner = np.concatenate([np.full(len(line.points) - 1, k) for k, line in enumerate(lines)])
    arc = np.concatenate([arc_length(line.points)[:-1] for line in lines])
    reach = float(np.hypot(*(ends - starts).T).max()) + 1e-6
    i, j = cKDTree((starts + ends) / 2).query_pairs(reach, output_type="ndarray").T
    apart = (owner[i] != owner[j]) | (np.abs(i - j) > 1)
    i, j = i[apart], j[apart]
    d, e, w = ends[i] - starts[i], ends[j] - starts[j], starts[j] - starts[i]
    cross = _cross(d, e)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = _cross(w, e) / cross, _cross(w, d) / cross
    hit = (a >= 0) & (a < 1) & (b >= 0) & (b < 1)
    found = []
    for p, q, s, t in zip(i[hit], j[hit], a[hit], b[hit], strict=True):
        point = starts[p] + s * (ends[p] - starts[p])
        length, other = (
            float(arc[k] + f * np.hypot(*(ends[k] - starts[k]))) for k, f in ((p, s), (q, t))
        )
        lengths = (length, other)
        strands = (int(owner[p]), int(owner[q]))
        if (strands[1], lengths[1]) < (strands[0], lengths[0]):
            strands, lengths = strands[::-1], lengths[::-1]
        first, last = lines[strands[0]], strands[0] == strands[1]
        if last and first.closed and lengths[0] < 1e-6:
            continue  # where a closed curve meets itself it does not cross
        found.append(Crossing(point, strands, lengths))
    found = _merge(sorted(found, key=lambda c: (c.strands, c.arc_lengths)), lines)
    if image is None:
        return found
    return [_stacked(crossing, lines, image) for crossing in found]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _merge(found: list[Crossing], lines: list[Centerline]) -> list[Crossing]:
    """Crossings of the same two strands within a few radii are one, or none if they are even."""
    groups: list[list[Crossing]] = []
    for crossing in found:
        reach = 4 * max(lines[k].radius for k in crossing.strands)
        for group in groups:
            near = group[-1]
            if near.strands == crossing.strands and all(
                abs(a - b) < reach
                for a, b in zip(near.arc_lengths, crossing.arc_lengths, strict=True)
            ):
                group.append(crossing)
                break
        else:
            groups.append([crossing])
    return [group[len(group) // 2] for group in groups if len(group) % 2]


def _stacked(crossing: Crossing, lines: list[Centerline], image: np.ndarray) -> Crossing:
    """The crossing with its over strand, where colours or edges tell."""
    import cv2

    pixels = image.astype(np.float32) if image.ndim == 3 else image.astype(np.float32)[..., None]
    frames = []
    for strand, at in zip(crossing.strands, crossing.arc_lengths, strict=True):
        line = lines[strand]
        arc = arc_length(line.points)
        ends = [
            np.array([np.interp(at + side, arc, line.points[:, k]) for k in (0, 1)])
            for side in (-2.0 * line.radius, 2.0 * line.radius)
        ]
        tangent = (ends[1] - ends[0]) / max(np.hypot(*(ends[1] - ends[0])), 1e-9)
        frames.append((tangent, np.array([-tangent[1], tangent[0]]), line.radius))
    sine = abs(float(np.cross(np.append(frames[0][0], 0), np.append(frames[1][0], 0))[2]))
    if sine < 0.2:
        return crossing  # too flat: the strands cover each other's edges

    def colors(points):
        xy = np.asarray(points, np.float32).reshape(-1, 1, 2)
        return cv2.remap(pixels, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR).reshape(
            len(xy), pixels.shape[2]
        )

    inside, beside, edges = [], [], []
    for (tangent, normal, radius), (_, _, other) in (frames, frames[::-1]):
        along = np.linspace(-0.6, 0.6, 7) * other / sine
        course = crossing.point + along[:, None] * tangent
        inside.append(colors(course))
        away = (other / sine + 1.5 * radius + np.arange(4)) * np.array([[1], [-1]])
        beside.append(np.median(colors(crossing.point + away.reshape(-1, 1) * tangent), axis=0))
        steps = [
            np.abs(
                colors(course + side * (radius + 1.5) * normal)
                - colors(course + side * (radius - 1.5) * normal)
            ).max(1)
            for side in (1, -1)
        ]
        edges.append(float(np.median(np.concatenate(steps))))
    centre = np.median(np.vstack(inside), axis=0)
    contrast = np.abs(beside[0] - beside[1]).max()
    if contrast > SAME_COLOR:
        far = [float(np.linalg.norm(centre - color)) for color in beside]
        lead = (far[1] - far[0]) / max(sum(far), 1e-9)
    else:
        lead = (edges[0] - edges[1]) / max(sum(edges), 8.0)
    if abs(lead) < CERTAIN:
        return crossing
    return replace(crossing, over=0 if lead > 0 else 1)
