"""Scans as files for other programs."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from wrod.files import write_npz
from wrod.perception.crossings import Crossing
from wrod.perception.scan import Scan, oriented


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
