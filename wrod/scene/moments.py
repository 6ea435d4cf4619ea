"""The telling moments of a scene as one picture."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wrod.errors import SceneError
from wrod.scene.render import Renderer, save_png
from wrod.scene.validate import open_stage

CAMERAS = ("side", "close")  # the second without the arms, which hide the rods
_ARMS = {"robot_0", "robot_1"}
_GAP, _PAPER = 4, 255  # [pixels], grey


def draw_moments(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    size: tuple[int, int] = (400, 300),
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Write one PNG with a column for every moment that a stage names, a row for every camera.

    Args:
        path: a stage of `wrod.scene.tying.export_scene`.
        out: the picture.
        size: of each [pixels].
        progress: called with (done, total).

    Raises:
        SceneError: the stage names no moments, or see `wrod.scene.render.Renderer`.
    """
    rows, done = [], 0
    for camera in CAMERAS:
        stage = open_stage(path)
        codes = moments(stage)
        if not codes:
            raise SceneError(f"{path}: names no moments; give a number of frames instead")
        arms = {prim.GetName() for prim in stage.Traverse()} & _ARMS
        renderer = Renderer(path, camera, size, tuple(arms) if camera == "close" else ())
        row = []
        for code in codes.values():
            row += [np.full((size[1], _GAP, 3), _PAPER, dtype=np.uint8), renderer.frame(code)]
            done += 1
            if progress is not None:
                progress(done, len(codes) * len(CAMERAS))
        rows += [np.full((_GAP, sum(p.shape[1] for p in row[1:]), 3), _PAPER, dtype=np.uint8)]
        rows.append(np.hstack(row[1:]))
    return save_png(out, np.vstack(rows[1:]))


def moments(stage) -> dict[str, float]:
    """Time codes of a stage's moments by name, in the order of time."""
    for prim in stage.Traverse():
        told = prim.GetCustomDataByKey("wrod") or {}
        if "moments" in told:
            return dict(sorted(told["moments"].items(), key=lambda item: item[1]))
    return {}
