"""Optimised plans in files, one a plan: what is known of the errors of what lies."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wrod.errors import DataError
from wrod.files import read_fields, read_json, schemas, write_json, write_npz, write_text
from wrod.files.writing import keeps

_FORMAT = "wrod-plans-4"
_ARRAYS = ("laid", "curvature", "anchors")
# Models of the error with larger entries than this are those of rods that sprang off.
_LARGEST = 1e3


@dataclass(frozen=True)
class Bowl:
    """Gauss and Newton's model of the mean squared error of what lies [L_gb^2], for coefficients
    that differ by d (3 n,): `value` + 2 `slope` . d + d . `matrix` d.

    Attributes:
        value: [L_gb^2].
        slope: (3 n,) [L_gb].
        matrix: (3 n, 3 n) [-].
    """

    value: float
    slope: np.ndarray
    matrix: np.ndarray

    @property
    def is_usable(self) -> bool:
        """Whether it is that of a rod that was laid."""
        parts = (np.atleast_1d(self.value), self.slope, self.matrix)
        return all(bool((np.abs(part) < _LARGEST).all()) for part in parts)


@dataclass(frozen=True)
class Sample:
    """One optimised plan, dimensionless.

    Attributes:
        laid: (T,) laid length [L_gb].
        curvature: (T,) signed, of the pattern at the contacts [1/L_gb].
        basis: (T, n) cubic splines over the laid length [-].
        anchors: (A, n, 3) coefficients of corrections of the grip's position (forward, left, up)
            in the contact's frame by which the rod was laid [L_gb]: none, the optimised ones, and
            then those of networks.
        bowls: the mean squared error near each of them, of the rod that was optimised for.
        length: of the rod [L_gb].
        stretch_ratio: k_s [-].
        friction: of the table [-].
    """

    laid: np.ndarray
    curvature: np.ndarray
    basis: np.ndarray
    anchors: np.ndarray
    bowls: tuple[Bowl, ...]
    length: float
    stretch_ratio: float
    friction: float

    @property
    def correction(self) -> np.ndarray:
        """(T, 3) optimised, of the grip's position [L_gb]."""
        return self.basis @ self.anchors[1]

    @property
    def errors(self) -> np.ndarray:
        """(A,) root mean square of what lay by each of the corrections [L_gb]."""
        return np.sqrt([bowl.value for bowl in self.bowls])

    def laid_by(self, values: np.ndarray, bowl: Bowl) -> "Sample":
        """With what lay by other corrections (n, 3)."""
        anchors = np.concatenate([self.anchors, values[None]])
        return replace(self, anchors=anchors, bowls=(*self.bowls, bowl))


def load(folder: str | os.PathLike[str]) -> list[Sample]:
    """All plans of a folder, by index.

    Raises:
        DataError: there are none, or one is damaged.
    """
    paths = sorted(Path(folder).glob("plan-*.npz"))
    out = [read(path) for path in paths if path.stat().st_size]
    if not out:
        raise DataError(f"{folder}: holds no optimised plan; let `wrod distil` make some")
    return out


def read(path: Path) -> Sample:
    """One plan.

    Raises:
        DataError: it is damaged.
    """
    found = read_fields(path, "OptimisedPlan")
    count = found["anchors"][0].size
    if found["bowls"].shape[1] != 1 + count + count * (count + 1) // 2:
        raise DataError(f"{path}: anchors and bowls do not fit together; delete the file")
    bowls = tuple(_unpacked(row, count) for row in found["bowls"])
    laid, curvature, anchors = (found[name] for name in _ARRAYS)
    figures = map(float, found["figures"])
    return Sample(laid, curvature, found["basis"], anchors, bowls, *figures)


def claim(folder: Path, seed: int) -> None:
    """Begin a folder of plans of that seed.

    Raises:
        DataError: it holds plans of another seed.
    """
    path = folder / "plans.json"
    keeps(path)
    folder.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        write_json(path, {"format": _FORMAT, "seed": seed})
    if read_json(path, schemas.Plans, "the label of optimised plans").seed != seed:
        raise DataError(f"{folder}: holds plans of another seed; choose another --out")


def store(path: Path, one: Sample | None) -> None:
    """Write a plan, or an empty file where the pattern cannot be laid."""
    if one is None:
        write_text(path, "")
        return
    arrays = {name: getattr(one, name).astype(np.float32) for name in _ARRAYS}
    # In half precision, which no training notices: most of a file is these.
    halves = {"basis": one.basis, "bowls": np.stack([_packed(bowl) for bowl in one.bowls])}
    arrays |= {name: values.astype(np.float16) for name, values in halves.items()}
    write_npz(path, **arrays, figures=[one.length, one.stretch_ratio, one.friction])


def _packed(bowl: Bowl) -> np.ndarray:
    """Value, slope and the matrix's upper triangle in a row."""
    upper = bowl.matrix[np.triu_indices(len(bowl.slope))]
    return np.concatenate([[bowl.value], bowl.slope, upper])


def _unpacked(row: np.ndarray, n: int) -> Bowl:
    matrix = np.zeros((n, n))
    matrix[np.triu_indices(n)] = row[1 + n :]
    matrix = matrix + np.triu(matrix, 1).T
    return Bowl(float(row[0]), row[1 : 1 + n], matrix)
