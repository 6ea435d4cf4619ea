"""Photographs of laid rods: what was read off each, in metres as they were laid.

A photograph shows the rod across its length only, and that with gaps where dots, labels or other
strands hide it; nothing is known along it. The pattern overlaid on it may be smaller than what was
laid: all lengths here are those on the table.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod.errors import DataError, WrodError
from wrod.files import read_fields
from wrod.patterns.pattern import Pattern

# What a pixel's place is known to when the dots are matched [m], if the file does not say.
_REGISTRATION = 0.35e-3


@dataclass(frozen=True)
class LaidPhotograph:
    """One rod that lies on a table, as a photograph shows it; metres on the table, the pattern's
    frame.

    Attributes:
        name: of the file.
        rod: name of the rod, such as "pink-vps".
        pattern_name: such as "letterU".
        method: of the grip's path: "int" or "opt".
        pattern: along which it was laid, at the size at which it was laid.
        centerline: (n, 2) the rod from the end that was laid first, gaps bridged [m].
        seen: (n,) whether the rod is seen there, not bridged.
        sigma: (n,) standard uncertainty across the rod [m].
        registration: standard uncertainty of the pattern's place in the picture [m].
        size_factor: metres on the table over metres of the pattern's file.
        middle: (2,) what the middle of the picture shows [m].
    """

    name: str
    rod: str
    pattern_name: str
    method: str
    pattern: Pattern
    centerline: np.ndarray
    seen: np.ndarray
    sigma: np.ndarray
    registration: float
    size_factor: float
    middle: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """(m, 2) the points that are seen [m]."""
        return self.centerline[self.seen]

    @property
    def uncertainty(self) -> np.ndarray:
        """(m,) standard uncertainty across the rod of the points that are seen [m]."""
        return np.hypot(self.sigma[self.seen], self.registration)


def load_photograph(path: str | os.PathLike[str]) -> LaidPhotograph:
    """Read one photograph's file, named ROD-PATTERN-METHOD.npz.

    Raises:
        DataError: the file is missing, its name does not say what it shows, an array is missing,
            of another shape or not finite where the rod is seen, or too little of it is seen.
    """
    path = Path(path)
    parts = path.stem.split("-")
    if len(parts) < 3:
        raise DataError(f"{path}: the name is to be ROD-PATTERN-METHOD.npz, such as rope-line-int")
    data = read_fields(path, "Photograph")
    size, filled = data["size_factor"], data["centerline_filled"]
    seen, sigma = data["hidden"] == 0, data["sigma"]
    if seen.sum() < 3:
        raise DataError(f"{path}: shows fewer than 3 points of the rod")
    if not (sigma[seen] > 0.0).all():  # nor where it is unknown
        raise DataError(f"{path}: sigma is not positive everywhere; give standard uncertainties")
    to_pixels = data["px_from_pattern"]
    if abs(np.linalg.det(to_pixels[:, :2])) < 1e-12:
        raise DataError(f"{path}: px_from_pattern maps the table onto a line")
    spread = data.get("registration_rms_px", np.nan) / (data.get("px_per_m") or np.nan)
    middle = np.linalg.solve(to_pixels[:, :2], _middle(path, data["pixels"]) - to_pixels[:, 2])
    pattern_name = parts[-2]
    try:
        pattern = Pattern.from_points(size * data["pattern"], name=pattern_name)
    except WrodError as error:
        raise DataError(f"{path}: {error}") from None
    return LaidPhotograph(
        path.stem,
        "-".join(parts[:-2]),
        pattern_name,
        parts[-1],
        pattern,
        size * filled,
        seen,
        size * sigma,
        size * spread if np.isfinite(spread) else _REGISTRATION,
        size,
        size * middle,
    )


def load_photographs(folder: str | os.PathLike[str]) -> list[LaidPhotograph]:
    """All photographs of a folder that show plans of method INT, sorted by name.

    Raises:
        DataError: there is none, or one is unreadable.
    """
    paths = sorted(Path(folder).glob("*-int.npz"))
    if not paths:
        raise DataError(f"{folder}: holds no file *-int.npz; give a folder of photographs")
    return [load_photograph(path) for path in paths]


def _middle(path: Path, pixels: np.ndarray) -> np.ndarray:
    """(2,) the middle of the picture [px]; of what is seen, where the picture is not there."""
    picture = path.with_suffix(".png")
    if picture.is_file():
        with open(picture, "rb") as file:
            head = file.read(24)
        if head[:8] == b"\x89PNG\r\n\x1a\n":
            if len(head) < 24:
                raise DataError(f"{picture}: ends within its head; copy it again, or remove it")
            size = np.frombuffer(head[16:24], dtype=">u4").astype(float)
            return 0.5 * (size - 1.0)
    return 0.5 * (np.nanmin(pixels, axis=0) + np.nanmax(pixels, axis=0))
