"""Triangle meshes of a user's robot, in every format that trimesh reads, as vertices and faces."""

import logging
import re
from functools import lru_cache
from pathlib import Path

import numpy as np

from wrod.errors import RobotError, needed_extras
from wrod.files.reading import MIB, checked_path

FORMATS = (".stl", ".obj", ".dae", ".ply", ".glb", ".gltf", ".off", ".3mf")
# Bytes of a mesh: a million triangles. Capsules about the links take a second of each such one.
_LARGEST = 64 * MIB


@needed_extras()
def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read vertices (V, 3) [file's unit; COLLADA's: m] and triangles (F, 3) of a mesh file.

    A COLLADA file's <unit> is applied, its <up_axis> is not, as ROS's own readers have it.

    Raises:
        RobotError: another format, a file that is truncated, empty or of more than 64 MiB, or no
            library to read it.
    """
    file = checked_path(path, "a mesh of a robot's link", error=RobotError, limit=_LARGEST)
    return _read(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=128)
def _read(path: Path, stamp: int) -> tuple[np.ndarray, np.ndarray]:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise RobotError(
            f"{path}: {suffix or 'this'} meshes are not read; convert the mesh to one of "
            f"{', '.join(FORMATS)}"
        )
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.ERROR)
    try:
        scale = _collada_unit(path) if suffix == ".dae" else 1.0
        mesh = trimesh.load_mesh(path, process=False)
        vertices = np.asarray(mesh.vertices, dtype=float) * scale
        faces = np.asarray(mesh.faces, dtype=int)
    except ImportError:
        raise
    except Exception as error:
        raise RobotError(f"{path}: not a readable {suffix[1:].upper()} mesh ({error})") from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise RobotError(f"{path}: the mesh has no triangle, or a vertex that is not finite")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise RobotError(f"{path}: a face of the mesh names a vertex that is not there")
    if not np.ptp(vertices[faces.ravel()], axis=0).any():
        raise RobotError(f"{path}: all triangles of the mesh are one point; give another")
    return vertices, faces


def _collada_unit(path: Path) -> float:
    """Metres in the unit of a COLLADA file, which trimesh leaves in it."""
    found = re.search(rb'<unit\b[^>]*\bmeter="([0-9.eE+-]+)"', path.read_bytes()[:65536])
    return float(found[1]) if found else 1.0
