"""Arrays that users hand over, in .npy, .npz and .safetensors files.

Headers are read first: what would run code, is larger than the limit when unpacked, or is of
another kind than numbers and text is refused before anything is unpacked.
"""

import hashlib
import json
import math
import os
import warnings
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from wrod.errors import DataError, WrodError
from wrod.files.reading import MIB, checked_path, shown
from wrod.files.writing import write_atomically

# Bytes of all arrays of a file together, unpacked.
MAX_ARRAYS = 512 * MIB
_MAX_MEMBERS = 256
_KINDS = "biufUS"


def read_arrays(
    path: str | os.PathLike[str],
    what: str = "an .npz file",
    *,
    error: type[WrodError] = DataError,
    limit: int = MAX_ARRAYS,
    only: Collection[str] | None = None,
) -> dict[str, np.ndarray]:
    """Arrays of an .npz file by name, or of an .npy file under the name "".

    Args:
        path: the file.
        what: what it should be, for messages: "a trajectory that `wrod plan` wrote".
        error: type of the refusal.
        limit: most bytes of the unpacked arrays together.
        only: read no others than these, where they are there.

    Raises:
        WrodError: of type `error`: there is no such regular file, or it is damaged, larger than
            `limit` when unpacked, or holds other than numbers and text.
    """
    file = checked_path(path, what, error=error, limit=limit)
    try:
        with warnings.catch_warnings(), open(file, "rb") as stream:
            warnings.simplefilter("ignore")  # of numpy, on headers that an old version wrote
            start = stream.read(len(npy.MAGIC_PREFIX))
            stream.seek(0)
            if start == npy.MAGIC_PREFIX:
                size = os.fstat(stream.fileno()).st_size
                _check_header(stream, size, limit, path, error)
                stream.seek(0)
                return {"": np.load(stream, allow_pickle=False)}
            return _unpack(stream, path, limit, only, error)
    except WrodError:
        raise
    except MemoryError:
        raise error(f"{path}: its arrays do not fit into memory; give {what}") from None
    except Exception as reason:  # zipfile, zlib, numpy and ast each have their own
        raise error(f"{path}: is not readable ({shown(reason, 200)}); give {what}") from None


def _unpack(stream, path, limit: int, only, error) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        names = [member.filename.removesuffix(".npy") for member in members]
        if len(members) > _MAX_MEMBERS:
            raise error(f"{path}: holds {len(members)} arrays; at most {_MAX_MEMBERS} are read")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise error(f"{path}: holds the array {shown(twice)} twice")
        wanted = [
            (name, member)
            for name, member in zip(names, members, strict=True)
            if member.filename.endswith(".npy") and (only is None or name in only)
        ]
        left = limit
        for name, member in wanted:
            with archive.open(member) as one:
                left -= _check_header(one, member.file_size, left, f"{path}: {shown(name)}", error)
        found = {}
        for name, member in wanted:
            with archive.open(member) as one:
                found[name] = npy.read_array(one, allow_pickle=False)
        return found


def _check_header(stream, size: int, limit: int, where, error) -> int:
    """Bytes of an array, from its header alone.

    Args:
        stream: at the start of the array.
        size: bytes that the file says to hold of it, header included.
        limit: most bytes.
        where: what to call it in messages.
    """
    version = npy.read_magic(stream)
    if version not in ((1, 0), (2, 0), (3, 0)):
        raise error(f"{where}: is of NumPy's unknown file version {version}")
    # Versions 2 and 3 differ in the encoding of field names alone, and those are refused.
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise error(f"{where}: holds Python objects, which could run code; save plain numbers")
    if dtype.kind not in _KINDS or dtype.names is not None:
        raise error(f"{where}: holds {dtype} values; save plain numbers")
    if any(length < 0 for length in shape) or len(shape) > 8:
        raise error(f"{where}: has shape {shape}, which is none")
    count = math.prod(shape) * dtype.itemsize
    if count > limit:
        raise error(
            f"{where}: has {count / MIB:.0f} MiB when unpacked; at most {limit / MIB:.0f} MiB are "
            "read"
        )
    if stream.tell() + count != size:
        raise error(
            f"{where}: holds {size} bytes where its header promises {stream.tell() + count}"
        )
    return count


def read_tensors(path: str | os.PathLike[str], what: str) -> tuple[str, dict[str, np.ndarray]]:
    """The text "wrod" among the metadata of a .safetensors file, and its arrays by name.

    Raises:
        DataError: there is no such file, it is larger than four times `MAX_ARRAYS`, or damaged:
            cut, or of another checksum than the one that its label may give.
    """
    from safetensors import SafetensorError, safe_open

    file = checked_path(path, what, error=DataError, limit=4 * MAX_ARRAYS)
    try:
        with safe_open(file, framework="numpy") as content:
            label = (content.metadata() or {}).get("wrod", "null")
            arrays = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except (OSError, TypeError, ValueError, AttributeError, KeyError, SafetensorError) as reason:
        raise DataError(f"{path}: is truncated or not {what} ({shown(reason, 200)})") from None
    except MemoryError:
        raise DataError(f"{path}: does not fit into memory") from None
    try:
        said = json.loads(label)
    except (ValueError, RecursionError):  # for the reader of labels
        said = None
    if isinstance(said, dict) and said.get("sha256", None) not in (None, _digest(arrays)):
        raise DataError(f"{path}: is damaged (its checksum is another); make it again")
    return label, arrays


def write_tensors(
    path: str | os.PathLike[str], label: dict[str, Any], arrays: dict[str, np.ndarray]
) -> Path:
    """Write a .safetensors file that `read_tensors` reads, with a checksum in its label."""
    from safetensors.numpy import save

    # One key only: the order of several would not be the same in every process.
    text = json.dumps({**label, "sha256": _digest(arrays)})
    content = save(arrays, metadata={"wrod": text})
    return write_atomically(path, lambda file: file.write(content), "wb")


def _digest(arrays: dict[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(arrays[name]).data)
    return digest.hexdigest()
