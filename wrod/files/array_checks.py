"""Reading files of arrays against their tables: one reader, one sentence for what is wrong."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from wrod import arguments
from wrod.errors import DataError, WrodError
from wrod.files.array_schemas import ARRAYS, ArrayFile, Field
from wrod.files.arrays import read_arrays

_KINDS = {
    "numbers": "fiu", "rotations": "fiu", "whole numbers": "iu", "truths": "b", "text": "US",
    "names": "USiu",
}  # fmt: skip
# What a value beyond its bounds was given in, more often than not.
_MISTAKEN = {"m": " (millimetres?)", "rad": " (degrees?)", "m/s^2": " (mm/s^2?)"}


def read_fields(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """The arrays of a file that `ARRAYS[kind]` names, as `check_arrays` gives them.

    Raises:
        DataError: as `read_arrays` or `check_arrays`.
    """
    table = ARRAYS[kind]
    wanted = [*table.fields, "format"]
    return check_arrays(read_arrays(path, table.what, only=wanted), kind, str(path))


def check_arrays(
    data: Mapping[str, Any], kind: str, where: str, error: type[WrodError] = DataError
) -> dict[str, Any]:
    """The arrays of `data` that `ARRAYS[kind]` names, if they are as it says; others are let be.

    Args:
        data: arrays by name.
        kind: a name of `ARRAYS`.
        where: begins the sentence: the file.
        error: type of the refusal.

    Returns:
        float64, int64 and bool arrays, text as a tuple; of a field that holds one, the value.

    Raises:
        WrodError: of type `error`; names the array, and the first value that is wrong.
    """
    table, lengths, found = ARRAYS[kind], {}, {}
    if table.format and str(data.get("format")) != table.format:
        raise error(f"{where}: is not of the format {table.format}; give {table.what}")
    for group in table.together:
        if 0 < sum(name in data for name in group) < len(group):
            raise error(f"{where}: has only one of {' and '.join(group)}; give both or none")
    for name, field in _laid_out(table, data).items():
        if name not in data:
            if field.needed:
                raise error(f"{where}: lacks the array {name}; give {table.what}")
            continue
        array = _converted(data[name], field, f"{where}: {name}", error)
        array = _fitted(array, name, field, table, lengths, f"{where}: {name}", error)
        _check_values(array, field, table, f"{where}: {name}", error)
        found[name] = _plain(array, field)
    for letter, least in table.least.items():
        have, name = lengths.get(letter, (least, ""))
        if have < least:
            axis = table.axes.get(letter, "entry")
            raise error(
                f"{where}: {name} has {have} {axis}{'' if have == 1 else 's'}; at least {least} "
                "are needed"
            )
    return found


def _laid_out(table: ArrayFile, data: Mapping[str, Any]) -> dict[str, Field]:
    """The fields of a table, those of layers as often as the file has layers."""
    out = {}
    for name, field in table.fields.items():
        if "{k}" not in name:
            out[name] = field
            continue
        layers = max(sum(key.startswith(name.partition("{")[0]) for key in data), 1)
        for k in range(layers):
            shape = tuple(_numbered(one, k) if isinstance(one, str) else one for one in field.shape)
            out[_numbered(name, k)] = Field(**{**vars(field), "shape": shape})
    return out


def _numbered(text: str, layer: int) -> str:
    return text.replace("{k+1}", str(layer + 1)).replace("{k}", str(layer))


def _converted(value: Any, field: Field, what: str, error: type[WrodError]) -> np.ndarray:
    """The values as float64, int64, bool or text."""
    try:
        array = np.asarray(value)
    except Exception:  # whatever an object does that is asked to be an array
        raise error(f"{what} is no array of {field.kind}") from None
    if array.size > arguments.MOST_NUMBERS:
        raise error(
            f"{what} holds {array.size:.3g} values, and may have {arguments.MOST_NUMBERS:.3g}"
        )
    if array.dtype.kind not in _KINDS[field.kind]:
        wanted = "numbers" if field.kind == "rotations" else field.kind
        raise error(f"{what} holds {array.dtype} values; it must hold {wanted}")
    kind = {"whole numbers": np.int64, "truths": np.bool_}.get(field.kind, np.float64)
    try:
        return array.astype(str if field.kind in ("text", "names") else kind, copy=False)
    except (TypeError, ValueError):  # bytes that are no text
        raise error(f"{what} is no array of {field.kind}") from None


def _fitted(array, name: str, field: Field, table, lengths: dict, what: str, error) -> np.ndarray:
    """The array with all its axes, of the lengths that the other arrays have."""
    shape, given = field.shape, array.shape
    said = f"({', '.join(table.axes.get(str(one), str(one)) for one in shape)})"
    if shape and str(shape[0]).endswith("?"):
        shape = (str(shape[0])[:-1], *shape[1:])
        array = array[None] if array.ndim == len(shape) - 1 else array
    if array.ndim != len(shape):
        raise error(f"{what} has shape {given}; it must have {said}")
    for have, want in zip(array.shape, shape, strict=True):
        beside = ""
        if isinstance(want, int):
            fits = have == want
        elif " or " in want:
            fits = str(have) in want.split(" or ")
        else:
            length, first = lengths.setdefault(want, (have, name))
            fits = have == length
            beside = "" if first == name else f", and {first} is {length} long there"
        if not fits:
            raise error(f"{what} has shape {given}; it must have {said}{beside}")
    return array


def _check_values(array, field: Field, table: ArrayFile, what: str, error) -> None:
    """Finiteness, bounds, order and rotations."""
    if field.kind in ("text", "names", "truths") or array.size == 0:
        return

    def first(bad) -> tuple[str, Any]:
        """Where the first wrong value is, and what it is."""
        at = np.argwhere(bad)[0] if array.ndim else np.zeros(0, int)
        letters = (str(one).rstrip("?") for one in field.shape)
        parts = [
            f"{table.axes[letter]} {k}"
            for letter, k in zip(letters, at, strict=False)
            if letter in table.axes
        ]
        return f" of {', '.join(parts)}" if parts else "", array[tuple(at)]

    bad = np.isinf(array) if field.gaps else ~np.isfinite(array)
    if bad.any():
        place, value = first(bad)
        raise error(f"{what}{place} is {value:g}, not a number that can be used; leave it out")
    low = field.low if field.above is None else field.above
    bad = (array < low) | (array > field.high)
    if field.above is not None:
        bad |= array <= low
    if bad.any():
        place, value = first(bad)
        unit = f" {field.unit}" if field.unit else ""
        bounds = [f"{'above' if field.above is not None else 'at least'} {low:g}"]
        bounds = [] if np.isneginf(low) else bounds
        bounds += [] if np.isposinf(field.high) else [f"at most {field.high:g}"]
        doubt = _MISTAKEN.get(field.unit, "") if abs(value) > field.high else ""
        raise error(f"{what}{place} is {value:g}{unit}; it must be {' and '.join(bounds)}{doubt}")
    if field.order and array.ndim and len(array) > 1:
        steps = np.diff(array, axis=0)
        bad = steps <= 0 if field.order == "rising" else steps < 0
        if bad.any():
            k = int(np.argwhere(bad)[0, 0]) + 1
            axis = table.axes.get(str(field.shape[0]), "entry")
            verb = "grow" if field.order == "rising" else "stay or grow"
            raise error(f"{what} does not {verb} at {axis} {k}; give them in their order")
    if field.kind == "rotations":
        off = np.abs(np.swapaxes(array, -1, -2) @ array - np.eye(3)).max(axis=(-2, -1))
        off = np.maximum(off, np.abs(np.linalg.det(array) - 1.0))
        if off.max() > field.precision:
            place, _ = first(off[..., None, None] > field.precision)
            raise error(f"{what}{place} is not a rotation")


def _plain(array: np.ndarray, field: Field) -> Any:
    """The value of a field that holds one; text as a tuple."""
    if array.ndim == 0:
        return array.item()
    return tuple(array.tolist()) if field.kind in ("text", "names") else array
