"""Datasets of grasps on disk: a manifest, and shards of a range of sample numbers each.

A shard is a safetensors file, written atomically, that names its dataset and carries a checksum;
its bytes follow from the manifest and its number alone. Whoever solves a shard, in whatever order,
writes the same file, so ranks need no word with each other.
"""

import hashlib
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec import structs, to_builtins
from wrod.training.sampling import RodInputs

from wrod.errors import DataError
from wrod.files import (
    check_arrays,
    decode_json,
    read_json,
    read_tensors,
    schemas,
    write_json,
    write_tensors,
)
from wrod.files.writing import keeps

FORMAT = "wrod-grasps-1"
MANIFEST = "manifest.json"
# Columns by name: type and shape of a row, dimensionless as in `wrod.grasps.optimal.Grasps`.
COLUMNS = {
    "inputs": (np.float64, (3,)),
    "position": (np.float64, (3,)),
    "rotation": (np.float64, (3,)),
    "force": (np.float64, (3,)),
    "residual": (np.float64, ()),
    "converged": (np.bool_, ()),
    "stable": (np.bool_, ()),
}
# Of a naturally curved rod: angle between contact and grip, which may be more than a turn [rad].
TWIST = {"twist": (np.float64, ())}
SENSITIVITIES = {
    f"{name}_sensitivity": (np.float64, (3, 3)) for name in ("position", "rotation", "force")
}


def row_bytes(sensitivities: bool) -> int:
    """Bytes of a grasp on the disk, at most."""
    columns = {**COLUMNS, **TWIST, **(SENSITIVITIES if sensitivities else {})}
    return sum(np.dtype(kind).itemsize * math.prod(shape) for kind, shape in columns.values())


class Manifest(schemas.Manifest, frozen=True):
    """What a dataset is: everything that its rows follow from.

    Its `seed` is that of the Sobol' sequence, `edge_count` of the finest mesh, `solver` the version
    that solved it; the last shard may hold fewer than `shard_size` samples.
    """

    @property
    def rod_inputs(self) -> RodInputs | None:
        """The rod that all samples are of, or None."""
        return None if self.rod is None else RodInputs(**structs.asdict(self.rod))

    @property
    def shard_count(self) -> int:
        return -(-self.size // self.shard_size)

    @property
    def columns(self) -> dict:
        one = self.rod_inputs
        twist = {} if one is None or one.is_straight else TWIST
        return {**COLUMNS, **twist, **(SENSITIVITIES if self.sensitivities else {})}

    @property
    def identity(self) -> str:
        """Name of the family of datasets that this one begins: all but the size counts."""
        content = to_builtins(self) | {"size": None}
        del content["format"]
        if self.rod is None:
            del content["rod"]  # datasets of the whole range were there before those of one rod
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

    def command(self, folder: Path) -> str:
        """The `wrod dataset` command that makes this dataset in `folder`, on any device."""
        words = ["wrod dataset", f"--size {self.size}", f"--seed {self.seed}"]
        words += [f"--closure {self.closure}", f"--shard-size {self.shard_size}"]
        words += [] if self.sensitivities else ["--no-sensitivities"]
        words += [] if self.rod is None else ["--rod ROD"]
        return " ".join([*words, f"--out {folder}"])

    def rows(self, shard: int) -> tuple[int, int]:
        """(first, count) sample numbers of a shard."""
        first = shard * self.shard_size
        return first, min(self.shard_size, self.size - first)


def create(folder: Path, manifest: Manifest) -> None:
    """Begin a dataset, or go on with the one that the folder holds.

    Raises:
        DataError: the folder holds another dataset.
    """
    path = folder / MANIFEST
    keeps(path)
    if path.exists():
        found = read_manifest(folder)
        if found.identity != manifest.identity:
            new, old = to_builtins(manifest), to_builtins(found)
            other = ", ".join(
                f"{k} {old[k]!r} (now {new[k]!r})" for k in new if k != "size" and new[k] != old[k]
            )
            raise DataError(
                f"{folder}: holds a dataset with {other}; choose another --out or its options"
            )
        if found.size > manifest.size:
            raise DataError(
                f"{folder}: holds a dataset of {found.size} samples; "
                f"ask for at least as many or choose another --out"
            )
        if found.size == manifest.size:
            return
    write_json(path, to_builtins(manifest))


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a dataset.

    Raises:
        DataError: there is none, or it is not one of ours.
    """
    return read_json(Path(folder) / MANIFEST, Manifest, "the manifest that `wrod dataset` writes")


def shard_path(folder: Path, shard: int) -> Path:
    return Path(folder) / f"grasps-{shard:05d}.safetensors"


def write_shard(folder: Path, manifest: Manifest, shard: int, columns: dict) -> Path:
    """Write one shard, whole or not at all.

    Raises:
        DataError: the dataset's folder has vanished meanwhile; shards alone are no dataset.
    """
    if not (Path(folder) / MANIFEST).exists():
        raise DataError(
            f"{folder}: was removed while grasps were written to it; run the same command again"
        )

    first, count = manifest.rows(shard)
    arrays = {}
    for name, (kind, shape) in manifest.columns.items():
        arrays[name] = np.ascontiguousarray(columns[name], dtype=kind)
        if arrays[name].shape != (count, *shape):
            raise DataError(f"shard {shard}: column {name} has shape {arrays[name].shape}")
    label = {"format": FORMAT, "dataset": manifest.identity, "first": first, "count": count}
    return write_tensors(shard_path(folder, shard), label, arrays)


def sweep(folder: Path, mine: range) -> None:
    """Remove what a killed process left of writing these shards."""
    for path in Path(folder).glob(".grasps-*.safetensors.*"):
        number = path.name.removeprefix(".grasps-").partition(".")[0]
        if number.isdecimal() and int(number) in mine:
            path.unlink(missing_ok=True)


def read_shard(folder: Path, manifest: Manifest, shard: int) -> dict:
    """Columns of one shard by name.

    Raises:
        DataError: the shard is missing, truncated, damaged or of another dataset.
    """
    first, whole = manifest.rows(shard)
    path = shard_path(folder, shard)
    label, arrays = _open(path)
    if label.get("dataset") != manifest.identity or label.get("first") != first:
        raise DataError(f"{path}: belongs to another dataset or place; delete it to solve it again")
    if label.get("count") != whole:
        raise DataError(f"{path}: holds {label.get('count')} of {whole} rows; run `wrod dataset`")
    found = check_arrays(arrays, "ShardColumns", str(path))
    missing = manifest.columns.keys() - found.keys()
    if missing or len(found["inputs"]) != label["count"]:
        raise DataError(f"{path}: {min(missing, default='a row')} is missing; delete the file")
    return found


def is_solved(folder: Path, manifest: Manifest, shard: int) -> bool:
    """Whether a shard is there with all its rows.

    Raises:
        DataError: a file stands in its place that is damaged or of another dataset.
    """
    path = shard_path(folder, shard)
    if not path.exists():
        return False
    label, _ = _open(path)
    # A dataset that grows solves its last shard again.
    if label.get("dataset") == manifest.identity and label.get("count") != manifest.rows(shard)[1]:
        return False
    read_shard(folder, manifest, shard)
    return True


def shards(folder: Path) -> Iterator[dict]:
    """The shards of a complete dataset, one at a time."""
    manifest = read_manifest(folder)
    for shard in range(manifest.shard_count):
        yield read_shard(folder, manifest, shard)


def _open(path: Path) -> tuple[dict, dict]:
    if not path.exists():
        raise DataError(f"{path}: is missing; run the same `wrod dataset` again")
    what = "a shard of a dataset; delete the file"
    text, arrays = read_tensors(path, what)
    return to_builtins(decode_json(text, schemas.Shard, str(path), what)), arrays
