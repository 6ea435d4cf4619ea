"""Scans as files for other programs, and as pictures."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from wrod.files import write_npz
from wrod.patterns.curve import arc_length
from wrod.perception.crossings import Crossing
from wrod.perception.scan import Scan, oriented
from wrod.perception.trace import Centerline

COLORS = (
    (230, 75, 53),
    (0, 114, 178),
    (0, 158, 115),
    (204, 121, 167),
    (230, 159, 0),
    (86, 180, 233),
)


def label_image(result: Scan) -> np.ndarray:
    """(H, W) uint8: 1 + index of the centreline that a pixel of the mask belongs to, 0 none."""
    import cv2

    labels = np.zeros(result.mask.shape, np.uint8)
    # Longest first, so that a short strand is not buried.
    for number, line in enumerate(result.lines[:255], start=1):
        points = np.round(line.points * 16).astype(np.int32)[:, None]
        thickness = max(round(2 * line.radius) + 1, 1)
        cv2.polylines(labels, [points], line.closed, number, thickness, cv2.LINE_8, shift=4)
    labels[result.mask == 0] = 0
    return labels


def write_scan(
    path: str | os.PathLike[str],
    result: Scan,
    crossings: list[Crossing],
    start: str | tuple[float, float] = "lower-left",
    several: bool = False,
) -> Path:
    """Write a scan as NPZ.

    Keys: paths (n, 2) points of all polylines, one after the other [px]; path_start (k,) where
    each begins (`np.split(paths, path_start[1:])`); radius_px (k,); closed (k,) bool; labels
    (H, W) uint8; crossings (c, 2) [px] with crossing_paths (c, 2), crossing_arc_lengths (c, 2)
    [px] and crossing_over (c,): 0 or 1 for the upper of the two, -1 unknown. With a scale also
    path_m (n, 2) [m] from the start on, or, of several curves, paths_m (n, 2) as paths.

    Raises:
        PerceptionError: the scan has a scale, holds several curves, and `several` is not set.
    """
    points = [line.points for line in result.lines]
    data: dict[str, Any] = {
        "paths": np.concatenate([np.empty((0, 2)), *points]),
        "path_start": np.cumsum([0, *map(len, points)])[: len(points)],
        "radius_px": np.array([line.radius for line in result.lines]),
        "closed": np.array([line.closed for line in result.lines]),
        "labels": label_image(result),
        "crossings": np.array([c.point for c in crossings]).reshape(-1, 2),
        "crossing_paths": np.array([c.strands for c in crossings], int).reshape(-1, 2),
        "crossing_arc_lengths": np.array([c.arc_lengths for c in crossings]).reshape(-1, 2),
        "crossing_over": np.array([-1 if c.over is None else c.over for c in crossings], np.int8),
    }
    if result.plane is not None:
        if several and len(result.lines) > 1:
            data["paths_m"] = np.concatenate(result.metric_lines())
        else:
            data["path_m"] = oriented(result, start)
    return write_npz(path, **data)


def draw_overlay(
    image: np.ndarray, lines: list[Centerline], crossings: list[Crossing] | tuple = ()
) -> np.ndarray:
    """(H, W, 3) uint8 RGB: the faded picture, each centreline in its colour with its direction.

    An open dot is the first point, a filled one the last; a crossing is a ring, and where one
    strand is known to lie on top its colour runs through.
    """
    import cv2

    height, width = image.shape[:2]
    zoom = max(1, round(1200 / max(height, width)))
    rgb = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    bright = np.median(rgb[::8, ::8]) > 100
    # Without its own colours, so that the lines' stand out.
    grey = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    faded = cv2.addWeighted(grey, 0.55, np.full_like(rgb, 255 if bright else 40), 0.45, 0)
    canvas = cv2.resize(faded, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
    paper = (255, 255, 255) if bright else (15, 15, 15)

    def place(points):
        # Pixel centres are whole numbers in both pictures.
        return np.round(((np.asarray(points) + 0.5) * zoom - 0.5) * 16).astype(np.int32)

    def stroke(points, color, thickness):
        line = place(points)[:, None]
        cv2.polylines(canvas, [line], False, color, thickness, cv2.LINE_AA, shift=4)

    for k, line in enumerate(lines):
        stroke(line.points, COLORS[k % len(COLORS)], 1 + zoom)
    for crossing in crossings:
        size = int(16 * zoom * 1.8 * max(lines[k].radius for k in crossing.strands))
        centre = place(crossing.point).tolist()
        if crossing.over is not None:
            strand = crossing.strands[crossing.over]
            at = crossing.arc_lengths[crossing.over]
            line = lines[strand]
            arc = arc_length(line.points)
            reach = np.linspace(at - 1.5 * line.radius, at + 1.5 * line.radius, 9)
            course = np.column_stack([np.interp(reach, arc, line.points[:, i]) for i in (0, 1)])
            stroke(course, paper, 3 + 3 * zoom)
            stroke(course, COLORS[strand % len(COLORS)], 1 + zoom)
        ring = (90, 90, 90) if bright else (200, 200, 200)
        cv2.circle(canvas, centre, size, ring, 1, cv2.LINE_AA, shift=4)
    for k, line in enumerate(lines):
        color, dot = COLORS[k % len(COLORS)], int(16 * (2.5 + 1.5 * zoom))
        for part in (0.25, 0.6):
            m = int(part * (len(line.points) - 1))
            step = line.points[min(m + 1, len(line.points) - 1)] - line.points[max(m - 1, 0)]
            t = step / max(np.hypot(*step), 1e-9)
            n = np.array([-t[1], t[0]])
            size = 3.0 + 1.2 * line.radius
            head = line.points[m] + size * np.array(
                [1.2 * t, -0.8 * t + 0.8 * n, -0.8 * t - 0.8 * n]
            )
            cv2.fillConvexPoly(canvas, place(head), color, cv2.LINE_AA, shift=4)
            outline = place(head)[:, None]
            cv2.polylines(canvas, [outline], True, paper, zoom, cv2.LINE_AA, shift=4)
        if not line.closed:
            for end, inner in ((0, paper), (-1, color)):
                centre = place(line.points[end]).tolist()
                cv2.circle(canvas, centre, dot, color, -1, cv2.LINE_AA, shift=4)
                cv2.circle(canvas, centre, int(0.55 * dot), inner, -1, cv2.LINE_AA, shift=4)
    return canvas
