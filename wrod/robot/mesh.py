"""Triangle meshes of a user's robot: STL and OBJ, as vertices and faces."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from wrod.errors import RobotError


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read vertices (V, 3) [file's unit] and triangles (F, 3) of an STL or OBJ file.

    Raises:
        RobotError: another format, or a file that is truncated or empty.
    """
    suffix = path.suffix.lower()
    try:
        if suffix == ".stl":
            vertices, faces = _read_stl(path.read_bytes())
        elif suffix == ".obj":
            vertices, faces = _read_obj(path.read_text(encoding="utf-8", errors="replace"))
        else:
            raise RobotError(
                f"{path}: {suffix or 'this'} meshes are not read; convert the mesh to STL or OBJ"
            )
    except (ValueError, IndexError) as error:
        if isinstance(error, RobotError):
            raise
        raise RobotError(f"{path}: not a readable {suffix[1:].upper()} mesh ({error})") from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise RobotError(f"{path}: the mesh has no triangle, or a vertex that is not finite")
    return vertices, faces


def _read_stl(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    if len(data) >= 84:
        count = int(np.frombuffer(data, "<u4", 1, 80)[0])
        if len(data) == 84 + 50 * count:
            record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
            corners = np.frombuffer(data, record, count, 84)["corners"].reshape(-1, 3)
            return _merge(corners.astype(float))
    words = [line.split() for line in data.decode("ascii", errors="replace").splitlines()]
    corners = np.array([w[1:4] for w in words if w[:1] == ["vertex"]], float).reshape(-1, 3)
    if len(corners) % 3:
        raise ValueError("truncated: its corners do not make whole triangles")
    return _merge(corners)


def _merge(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3)


def _read_obj(text: str) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = [], []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            index = [int(w.split("/")[0]) for w in words[1:]]
            index = [i - 1 if i > 0 else len(vertices) + i for i in index]
            faces += [[index[0], a, b] for a, b in itertools.pairwise(index[1:])]
    faces = np.array(faces, int).reshape(-1, 3)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError("a face names a vertex that is not there")
    return np.array(vertices, float).reshape(-1, 3), faces
