"""Reading and checking the points of a pattern; every refusal names the file, line and value."""

import os
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from wrod.errors import PatternError
from wrod.files import check_arrays, checked_path, read_arrays, read_text, write_atomically

# Suffixes of points that are read as NumPy's arrays.
NUMPY = (".npy", ".npz")
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
_UNIT_WORDS = {
    "metre": "m", "metres": "m", "meter": "m", "meters": "m",
    "millimetre": "mm", "millimetres": "mm", "millimeter": "mm", "millimeters": "mm",
    "centimetre": "cm", "centimetres": "cm", "centimeter": "cm", "centimeters": "cm",
    "inch": "in", "inches": "in", "µm": "um", "μm": "um",
}  # fmt: skip
_DECLARED = re.compile(r"\bunits?\b\s*(?:[:=]|\bin\b|[\[(])\s*[\[(\"']?\s*([A-Za-zµμ]+)", re.I)
_COLUMN = re.compile(r"^\s*[\"']?([xyz])(?:[\s_\[(]+([A-Za-zµμ]+)[\])]*)?[\"']?\s*$", re.I)
_SPLIT = re.compile(r"[,;\s]+")
# Names of columns that are no coordinates on a table.
_OTHER_AXES = {"rho", "theta", "phi", "lat", "latitude", "lon", "lng", "longitude"}
# A drawn metre has a point every 50 micrometres then; smoothing takes a second for so many.
_MAX_POINTS = 20_000
_MAX_BYTES = 16 * 2**20
# A table lies within so much [m].
_FARTHEST = 100.0
# Nor is a rod laid along less than its own radius [m].
_SHORTEST = 1e-4
_DECIMAL_COMMA = re.compile(r"^[+-]?\d+(,\d+)?([eE][+-]?\d+)?$")
_COMMAS_ONLY = re.compile(r"^\s*[+-]?\d+(\s*,\s*[+-]?\d+)+\s*$")


@dataclass
class RawPoints:
    """Points as they stand in a source, in its own unit, and where each one stands."""

    points: np.ndarray
    source: str
    units: str | None = None
    lines: list[int] | None = None

    def where(self, index: int) -> str:
        """Name of a point for a message, such as `letter.txt, line 12`."""
        if self.lines is not None:
            return f"{self.source}, line {self.lines[index]}"
        return f"{self.source}, point {index + 1}"


def unit_scale(units: str, source: str) -> float:
    """Metres in one unit of that name.

    Raises:
        PatternError: no such unit.
    """
    word = units.strip() if isinstance(units, str) else units
    name = _UNIT_WORDS.get(str(word).lower(), str(word).lower())
    if name not in UNITS:
        raise PatternError(f"{source}: unknown units {units!r}; use one of {', '.join(UNITS)}")
    return UNITS[name]


def read_points(path: str | os.PathLike[str]) -> RawPoints:
    """Points of a text, CSV, NPY or NPZ file. Nothing in the file is executed.

    Raises:
        PatternError: the file is missing, unreadable or holds no table of points.
    """
    path = checked_path(path, "a file of points or a built-in pattern", error=PatternError)
    if path.suffix.lower() in NUMPY:
        return _read_numpy(path)
    return _read_text(path)


def _read_numpy(path: Path) -> RawPoints:
    what = "a NumPy file of points"
    read = partial(read_arrays, path, what, error=PatternError, limit=_MAX_BYTES)
    # Of a scan the metric path alone: its image of labels may be larger than points are let be.
    arrays = read(only=["path_m"]) or read()
    names = [name for name, array in arrays.items() if array.ndim == 2]
    known = ("", "points", "path_m")  # the last of `wrod scan`
    names = [name for name in known if name in arrays] or names
    if len(names) != 1:
        raise PatternError(
            f"{path}: holds {len(names)} tables; save the points as the array 'points'"
        )
    table = {"points": arrays[names[0]]} | {k: v for k, v in arrays.items() if k == "units"}
    found = check_arrays(table, "Points", str(path), PatternError)
    if len(found["points"]) > _MAX_POINTS:
        raise PatternError(f"{path}: {_too_many(len(found['points']))}")
    return RawPoints(found["points"], str(path), found.get("units"))


def _read_text(path: Path) -> RawPoints:
    text = read_text(path, "text, CSV, NPY or NPZ", error=PatternError, limit=_MAX_BYTES)
    units, columns, count, rows, lines = None, None, 0, [], []
    named = False
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.replace('"', "").strip()  # spreadsheets put cells between quotes
        if not content:
            continue
        if content[0] in "#%" or (not rows and _is_header(content)):
            units = _declared_units(content, path, number) or units
            columns = _columns(content) or columns
            named = columns is not None
            other = _OTHER_AXES & set(_SPLIT.split(content.lower()))
            many = len(re.split(r"[,;\t]", content)) > 3  # the first ones may be of anything
            if not named and content[0] not in "#%" and (other or many):
                raise PatternError(
                    f"{path}, line {number}: {content[:60]!r} names other columns than x and y; "
                    "give coordinates on the table"
                )
            continue
        cells = _cells(content)
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            raise PatternError(
                f"{path}, line {number}: {content[:60]!r} is not a row of numbers; "
                "give x and y (and z) on each line"
            ) from None
        if columns is None:
            columns = list(range(min(len(values), 3)))
        width = max(columns) + 1
        if len(values) < max(width, 2) or len(columns) < 2 or (rows and len(values) != count):
            wanted = count if rows else max(width, 2)
            raise PatternError(
                f"{path}, line {number}: holds {len(values)} numbers, {wanted} are expected"
            )
        count = len(values)
        rows.append([values[column] for column in columns])
        lines.append(number)
        if len(rows) > _MAX_POINTS:
            raise PatternError(f"{path}: {_too_many(len(rows))}")
    if not rows:
        raise PatternError(f"{path}: holds no points; give at least 2")
    if count in (4, 6) and _COMMAS_ONLY.match(text.splitlines()[lines[0] - 1]):
        raise PatternError(
            f"{path}, line {lines[0]}: {count} whole numbers between commas look like {count // 2} "
            "with decimal commas; write decimal points, or put semicolons between the columns"
        )
    if not named and count > 3:
        raise PatternError(
            f"{path}, line {lines[0]}: holds {count} columns without names; say which are "
            "coordinates in a first line (index, x, y)"
        )
    points = np.array(rows, dtype=float)
    if not named and count == 3 and np.ptp(points[:, 2]) and (np.diff(points[:, 0]) == 1.0).all():
        raise PatternError(
            f"{path}, line {lines[0]}: its first column counts the points; say which columns are "
            "coordinates in a first line (index, x, y)"
        )
    return RawPoints(points, str(path), units, lines)


def _too_many(count: int) -> str:
    return f"has {count} points or more, and at most {_MAX_POINTS} are taken; thin it out"


def _cells(content: str) -> list[str]:
    """Numbers of a line as Python writes them; decimal commas where semicolons, blanks or tabs
    stand between the columns."""
    words = [word for word in re.split(r"[;\s]+", content) if word]
    if len(words) > 1 and any("," in w for w in words) and all(map(_DECIMAL_COMMA.match, words)):
        return [word.replace(",", ".") for word in words]
    return [cell for cell in _SPLIT.split(content) if cell]


def _is_header(content: str) -> bool:
    """Whether no cell of a line is a number."""

    def is_number(cell: str) -> bool:
        try:
            float(cell)
        except ValueError:
            return False
        return True

    return not any(is_number(cell) for cell in _SPLIT.split(content))


def _named_columns(content: str) -> list[tuple[int, str, str | None]]:
    """(index, axis, unit) of the columns called x, y or z in a header."""
    content = re.sub(r"\s+(?=[\[(])", "", content.lstrip("#% "))
    for cells in (re.split(r"[,;\t]", content), content.split()):
        found = [(i, m[1].lower(), m[2]) for i, m in enumerate(map(_COLUMN.match, cells)) if m]
        if {"x", "y"} <= {axis for _, axis, _ in found}:
            return found
    return []


def _columns(content: str) -> list[int] | None:
    first = {}
    for index, axis, _ in _named_columns(content):
        first.setdefault(axis, index)
    return [first[axis] for axis in "xyz" if axis in first] or None


def _declared_units(content: str, path: Path, number: int) -> str | None:
    """Unit that a header names: `units: mm`, `x [mm], y [mm]`, `x_mm y_mm` or the unit alone."""
    match = _DECLARED.search(content)
    if match:
        return match[1]
    found = {unit for _, _, unit in _named_columns(content) if unit}
    if len(found) > 1:
        raise PatternError(
            f"{path}, line {number}: the columns have different units ({', '.join(sorted(found))})"
        )
    if found:
        return found.pop()
    alone = content.lstrip("#% ").strip("[](). ").lower()
    return alone if _UNIT_WORDS.get(alone, alone) in UNITS else None


def checked_points(raw: RawPoints, units: str | None) -> np.ndarray:
    """Points in metres, (n, 3), planar and without repetition or spikes.

    Raises:
        PatternError: says which point is wrong, and what to do.
    """
    declared = raw.units
    scale = unit_scale(units or declared or "m", raw.source)
    if declared is not None and scale != unit_scale(declared, raw.source):
        raise PatternError(
            f"{raw.source}: says its units are {declared!r}, but {units!r} was asked for; "
            "drop one of them"
        )
    points = raw.points
    if points.ndim == 0 or len(points) == 0:
        raise PatternError(f"{raw.source}: holds no points; give at least 2")
    if len(points) > _MAX_POINTS:
        raise PatternError(f"{raw.source}: {_too_many(len(points))}")
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise PatternError(
            f"{raw.source}: has shape {points.shape}; give one row of x, y (and z) per point"
        )
    bad = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    if len(bad):
        value = next(value for value in points[bad[0]] if not np.isfinite(value))
        raise PatternError(
            f"{raw.where(bad[0])}: a coordinate is {value}; remove the point or correct it"
        )
    with np.errstate(over="ignore"):
        points = points * scale
    far = np.flatnonzero(np.abs(points).max(axis=1) > _FARTHEST)
    if len(far):
        raise PatternError(
            f"{raw.where(far[0])}: lies {np.abs(points[far[0]]).max():.3g} m from the origin; a "
            "table lies within 100 m, so check the units"
        )
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    if len(points) == 2:  # the line between them
        points = np.insert(points, 1, points.mean(axis=0), axis=0)
    distinct = len(np.unique(points, axis=0))
    if distinct < 3:
        said = (
            "is one point; give at least 2"
            if distinct == 1
            else "goes to and fro on one line; give points"
        )
        raise PatternError(f"{raw.source}: {said}, in their order along the curve")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if steps.sum() < _SHORTEST:
        raise PatternError(
            f"{raw.source}: is {steps.sum():.3g} m long in all; no rod is so thin, so check the "
            "units"
        )
    repeated = np.flatnonzero(steps <= 1e-9 * np.sum(steps))
    if len(repeated):
        raise PatternError(
            f"{raw.where(repeated[0] + 1)}: repeats the point before it; remove one of the two"
        )
    return _planar(points, raw)


def _planar(points: np.ndarray, raw: RawPoints) -> np.ndarray:
    height = float(np.median(points[:, 2]))
    off = np.abs(points[:, 2] - height)
    extent = float(np.max(np.ptp(points[:, :2], axis=0)))
    if off.max() > 1e-3 * extent:
        worst = int(np.argmax(off))
        raise PatternError(
            f"{raw.where(worst)}: is {off[worst]:.3g} m above or below the other points; "
            "a pattern lies in one horizontal plane, so give one z for all points"
        )
    flat = points.copy()
    flat[:, 2] = height
    return flat


def refuse_spikes(points: np.ndarray, raw: RawPoints, corners: np.ndarray) -> None:
    """Refuse points that stand off the curve of their neighbours; corners are none.

    A point is compared with the cubic through two neighbours on each side: 0.1 of the spacing off
    it is a change of direction by some 20 degrees and back, unless the other points say that the
    noise is of that size. A corner lies on the line of its neighbours on either side, a spike on
    neither.

    Raises:
        PatternError: names the first such point.
    """
    flat = points[:, :2]
    if len(points) < 5:
        return
    off, near = _distance_from_neighbours(flat, np.linalg.norm(np.diff(flat, axis=0), axis=1))
    noise = 1.4826 * np.median(off)
    excess = off / np.maximum(8.0 * noise, 0.1 * near)
    for corner in corners:
        if _on_lines(flat, corner, max(8.0 * noise, 0.1 * near[corner - 1])):
            excess[max(corner - 3, 0) : corner + 2] = 0.0
    worst = int(np.argmax(excess))
    if excess[worst] > 1.0:
        raise PatternError(
            f"{raw.where(worst + 1)}: stands {off[worst]:.2g} m off the curve of its "
            "neighbours, a spike of curvature; remove or correct the point, or round the curve "
            "there, if it turns back on itself"
        )


def _on_lines(flat: np.ndarray, index: int, slack: float) -> bool:
    """Whether a point lies on the lines of its two neighbours on both sides."""
    for way in (-1, 1):
        first, second = index + way, index + 2 * way
        if not 0 <= second < len(flat):
            continue
        along = flat[first] - flat[second]
        along = along / np.linalg.norm(along)
        off = flat[index] - flat[first]
        if abs(off[0] * along[1] - off[1] * along[0]) > slack:
            return False
    return True


def _distance_from_neighbours(
    flat: np.ndarray, spacing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance of inner points from Lagrange interpolation by their neighbours, and the spacing."""
    arc = np.concatenate([[0.0], np.cumsum(spacing)])
    index = np.arange(1, len(flat) - 1)
    around = (index - 2).clip(0, len(flat) - 5)[:, None] + np.arange(5)
    around = around[around != index[:, None]].reshape(-1, 4)
    places = arc[around]
    # Factors of Lagrange's weights, of each with each of the others.
    apart = places[:, :, None] - places[:, None] + np.eye(4)
    factors = np.where(np.eye(4) > 0.0, 1.0, (arc[index, None] - places)[:, None] / apart)
    off = flat[index] - np.einsum("nk,nka->na", factors.prod(axis=2), flat[around])
    return np.linalg.norm(off, axis=1), np.minimum(spacing[:-1], spacing[1:])


def write_points(path, position: np.ndarray, others: tuple[str, ...]) -> Path:
    """Write (n, 3) points [m] as a table.

    Raises:
        PatternError: `path` has the suffix of another kind of file, NumPy's or one of `others`.
    """
    if Path(os.path.expanduser(path)).suffix.lower() in (*others, *NUMPY):
        raise PatternError(f"{path}: is not for a table of points; give it the suffix .csv")

    def write(file):
        file.write("x [m],y [m],z [m]\n")
        file.writelines(f"{x:.9f},{y:.9f},{z:.9f}\n" for x, y, z in position)

    return write_atomically(path, write)
