"""What a user says stands in the arm's way: boxes, cylinders, spheres and meshes."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.arguments import ONCE_ROUND
from wrod.errors import RobotError, WrodWarning
from wrod.files import read_json, schemas
from wrod.robot.capsules import Capsule, capsules_of
from wrod.robot.urdf import LinkShape

_BAR = 0.06  # [m] widest bar that a box is cut into
# A cell has tens of them.
_MOST, _MOST_BARS = 500, 20_000
_FARTHEST = 10.0  # [m] nothing so far from its base is in an arm's way
_SIZES = {"sphere": 1, "cylinder": 2, "box": 3}


@dataclass(frozen=True)
class Obstacles:
    """Shapes that stand still, in the frame of the robot's base [m]."""

    shapes: tuple[LinkShape, ...]

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Obstacles:
        """Read a JSON list of {"kind": ..., "size": [...], "xyz": [...], "rpy": [...]}.

        kind is sphere (size: radius), cylinder (radius, length), box (x, y, z) or mesh ("file",
        and size: its scale in x, y, z); lengths in m, angles in rad, in the robot's base frame.

        Raises:
            RobotError: the file is missing, or an entry is not such a shape; names it.

        Warns:
            WrodWarning: a shape stands where no arm reaches.
        """
        path = Path(path)
        what = "a list of obstacles, [{'kind': 'box', ...}]"
        entries = read_json(path, list[schemas.Obstacle], what, error=RobotError)
        if len(entries) > _MOST:
            raise RobotError(f"{path}: holds {len(entries)} obstacles; at most {_MOST} are kept")
        return cls(tuple(_shape(path, k, entry) for k, entry in enumerate(entries)))

    def capsules(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Starts, ends (C, 3) and radii (C,) [m] of capsules that contain them, or None."""
        found: list[Capsule] = []
        for shape in self.shapes:
            found += _bars(shape) if shape.kind == "box" else capsules_of(shape)
        if not found:
            return None
        start, end, radius = (np.array(part) for part in zip(*found, strict=True))
        return start, end, radius


def _shape(path: Path, number: int, entry: schemas.Obstacle) -> LinkShape:
    where, kind = f"{path}: obstacle {number + 1}", entry.kind

    def numbers(name: str, value, wanted: int) -> np.ndarray:
        values = np.atleast_1d(np.asarray(value, dtype=float))
        if values.shape != (wanted,) or not (np.abs(values) <= 1e3).all():
            raise RobotError(f"{where}: {name} must be {wanted} finite numbers, at most 1000")
        return values

    given = [1.0] * 3 if kind == "mesh" and entry.size is None else entry.size
    size = numbers("size", given, _SIZES.get(kind, 3))
    if (size <= 0).any():
        raise RobotError(f"{where}: its size must be positive")
    turned = numbers("rpy", entry.rpy, 3)
    if np.abs(turned).max() > ONCE_ROUND:
        raise RobotError(f"{where}: is turned by {turned.tolist()} rad (degrees?)")
    off = float(np.linalg.norm(entry.xyz))
    if kind != "mesh" and off - 2.0 * size.max() > _FARTHEST:
        said = f"{where}: stands {off:g} m off, out of every arm's way (millimetres?)"
        warnings.warn(WrodWarning(said), stacklevel=4)
    pose = np.eye(4)
    pose[:3, 3] = entry.xyz
    pose[:3, :3] = Rotation.from_euler("xyz", turned).as_matrix()
    file = None
    if kind == "mesh":
        file = path.parent / (entry.file or "")
        if not file.is_file():
            raise RobotError(f"{where}: its mesh file {str(entry.file or None)!r} is missing")
    name = entry.name or f"obstacle {number + 1}"
    return LinkShape(name, kind, tuple(map(float, size)), pose, (0.6, 0.45, 0.2), file)


def _bars(shape: LinkShape) -> list[Capsule]:
    """Capsules along a box's longest side, thin enough not to reach far beyond it."""
    size = np.array(shape.size)
    long = int(size.argmax())
    across = [k for k in range(3) if k != long]
    counts = [int(np.ceil(size[k] / _BAR)) for k in across]
    if counts[0] * counts[1] > _MOST_BARS:
        raise RobotError(
            f"obstacle {shape.link!r} is {size.tolist()} m large; give a box of a few metres, or a "
            "mesh"
        )
    cell = size[across] / counts
    radius = float(np.hypot(*cell) / 2)
    found, turn, at = [], shape.pose[:3, :3], shape.pose[:3, 3]
    half = size[long] / 2 * np.eye(3)[long]
    for number in np.ndindex(*counts):
        middle = np.zeros(3)
        middle[across] = (np.array(number) + 0.5) * cell - size[across] / 2
        found.append((turn @ (middle - half) + at, turn @ (middle + half) + at, radius))
    return found
