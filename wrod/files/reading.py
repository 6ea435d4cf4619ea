"""Text and JSON that users hand over: bounded in size and depth, of the declared kind, or refused.

A refusal is one sentence that names the file, the line or entry, and what to do. Reading stops
before memory or time are spent: on what is no regular file, by the size, by the nesting.
"""

import json
import os
import re
import stat
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from wrod.errors import DataError, WrodError

T = TypeVar("T")
MIB = 2**20
# Text files larger than this are not read: a million points need less.
MAX_TEXT = 64 * MIB
# Nor JSON files: scenes, rods, cameras and plans have a few kB.
MAX_JSON = 4 * MIB
# What files begin with that are no text, and what they are.
_PACKED = {
    b"\x1f\x8b": "compressed (gzip); unpack it",
    b"BZh": "compressed (bzip2); unpack it",
    b"\xfd7zXZ": "compressed (xz); unpack it",
    b"PK\x03\x04": "a zip archive or a spreadsheet; unpack it, or save the table as CSV",
    b"\xd0\xcf\x11\xe0": "a spreadsheet or a document; save the table as CSV",
    b"%PDF": "a PDF; save what it shows as a picture or a drawing",
    b"\x89HDF": "HDF5; save its table as CSV or NPZ",
}
# Whole numbers beyond these are not numbers of this field (2^53, exact in float64).
_MAX_INTEGER = 2**53
_DEEPEST = 32
# A text, which may lack its end, or a bracket; every byte is looked at once.
_MARKS = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*(?:"|\\?\Z)|[\[{\]}]', re.DOTALL)


def checked_path(
    path: str | os.PathLike[str],
    what: str = "a file",
    *,
    error: type[WrodError] = DataError,
    limit: int | None = None,
) -> Path:
    """`path`, if a regular file of at most `limit` bytes stands there; ~ is the home folder.

    Args:
        path: the file.
        what: what it should be, for the message: "a rod file".
        error: type of the refusal.
        limit: largest size [bytes]; None for any.

    Raises:
        WrodError: of type `error`: there is none, or it is a folder, pipe, device or socket, or
            it is too large or may not be read.
    """
    try:
        name = os.path.expanduser(os.fspath(path))
        path = str.__str__(name) if isinstance(name, str) else path  # a subclass may say otherwise
        found = os.stat(name)
    except FileNotFoundError:
        raise error(f"{shown(path, 300)}: no such file; give {what}") from None
    except Exception as reason:  # names with a null byte, endless ones, objects that are none
        raise error(f"{shown(path)}: cannot be read ({_reason(reason)}); give {what}") from None
    if stat.S_ISDIR(found.st_mode):
        raise error(f"{path}: is a folder; give {what}")
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{path}: is a pipe or a device; save its content and give {what}")
    if limit is not None and found.st_size > limit:
        raise error(
            f"{path}: has {found.st_size / MIB:.0f} MiB, and at most {limit / MIB:.0f} MiB are "
            f"read of {what}"
        )
    if not os.access(name, os.R_OK):
        raise error(f"{path}: may not be read; change its permissions")
    return Path(name)


def read_bytes(
    path: str | os.PathLike[str],
    what: str = "a file",
    *,
    error: type[WrodError] = DataError,
    limit: int = MAX_TEXT,
) -> bytes:
    """Content of a regular file of at most `limit` bytes; raises as `checked_path`."""
    file = checked_path(path, what, error=error, limit=limit)
    try:
        with open(file, "rb") as stream:
            content = stream.read(limit + 1)
    except OSError as reason:
        raise error(f"{path}: cannot be read ({_reason(reason)}); give {what}") from None
    if len(content) > limit:
        raise error(f"{path}: has more than {limit / MIB:.0f} MiB; that is not {what}")
    return content


def read_text(
    path: str | os.PathLike[str],
    what: str = "a text file",
    *,
    error: type[WrodError] = DataError,
    limit: int = MAX_TEXT,
) -> str:
    """UTF-8 text of a file, with or without a byte order mark.

    Raises:
        WrodError: of type `error`: as `checked_path`, or it is in another encoding or no text.
    """
    content = read_bytes(path, what, error=error, limit=limit)
    for start, kind in _PACKED.items():
        if content.startswith(start):
            raise error(f"{path}: is {kind}")
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise error(f"{path}: is in UTF-16; save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        line = content.count(b"\n", 0, reason.start) + 1
        raise error(
            f"{path}, line {line}: is not a readable text file (no UTF-8); give {what}, saved as "
            "UTF-8"
        ) from None
    if "\0" in text:
        raise error(f"{path}: is not a readable text file (it holds zero bytes); give {what}")
    return text


def read_json(
    path: str | os.PathLike[str],
    schema: type[T],
    what: str,
    *,
    error: type[WrodError] = DataError,
) -> T:
    """The content of a JSON file as a `schema` of `wrod.files.schemas`.

    Args:
        path: the file.
        schema: a `msgspec.Struct` or another type that msgspec knows.
        what: what the file should be, for messages: "a marker layout".
        error: type of the refusal.

    Raises:
        WrodError: of type `error`: as `read_text`, or it is no JSON, nested too deeply, or an
            entry is missing, unknown, of the wrong kind or out of bounds; names line or entry.
    """
    text = read_text(path, what, error=error, limit=MAX_JSON)
    return decode_json(text, schema, str(path), what, error=error)


def decode_json(
    text: str | bytes,
    schema: type[T],
    where: str,
    what: str,
    *,
    error: type[WrodError] = DataError,
) -> T:
    """As `read_json`, of JSON that stands within another file; `where` names it in messages."""
    content = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    try:
        refuse_depth(content)
        value = msgspec.json.decode(content, type=schema)
    except RecursionError:
        raise error(f"{where}: is nested too deeply to be {what}") from None
    except msgspec.ValidationError as reason:
        raise error(f"{where}: {entry_message(str(reason))}; that is not {what}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as reason:
        raise error(f"{where}{_syntax(str(reason), content)}; give {what} in JSON") from None
    _refuse_large(value, where, what, error)
    _refuse_twice(content, where, error)
    return value


def _refuse_twice(content: bytes, where: str, error: type[WrodError]) -> None:
    """Raise where an object has an entry twice: which one was meant, nobody knows."""

    def entries(pairs: list[tuple[str, Any]]) -> None:
        names = set()
        for name, _ in pairs:
            if name in names:
                raise error(f"{where}: has the entry {shown(name)} twice; keep one of them")
            names.add(name)

    json.loads(content, object_pairs_hook=entries, parse_int=len, parse_float=len, strict=False)


def decode_labels(
    text: str, schema: type, where: str, what: str, *, error: type[WrodError] = DataError
) -> dict:
    """As `decode_json`, of an object that may hold more than its schema: all that it holds."""
    content = decode_json(text, dict[str, Any], where, what, error=error)
    try:
        msgspec.convert(content, schema)
    except msgspec.ValidationError as reason:
        raise error(f"{where}: {entry_message(str(reason))}; that is not {what}") from None
    return content


def entry_message(reason: str) -> str:
    """msgspec's account of a wrong entry in our words: the entry first."""
    reason, _, place = reason.partition(" - at ")
    place = place.strip("`").removeprefix("$").removeprefix(".").replace("[...]", "")
    reason = re.sub(r"([`'][^`']{60})[^`']+([`'])", r"\1…\2", reason)
    place = place if len(place) <= 120 else f"{place[:119]}…"
    reason = reason.replace("`", "'").replace("Object missing required field", "lacks the entry")
    reason = reason.replace("Object contains unknown field", "has an unknown entry")
    reason = re.sub("^Invalid enum value", "has the unknown value", reason)
    reason = re.sub("^Expected", "must be", reason)
    reason = re.sub("^Number out of range", "is a number out of range", reason)
    reason = reason.replace("got 'null'", "but is null").replace("got", "but is")
    kinds = {
        "'float'": "a number", "'int'": "a whole number", "'str'": "text", "'array'": "a list",
        "'object'": "an object", "'bool'": "true or false", "'float | null'": "a number or null",
    }  # fmt: skip
    for kind, word in kinds.items():
        reason = reason.replace(kind, word)
    return f"{place} {reason}" if place else reason


def shown(value: object, most: int = 80) -> str:
    """A value for a message, cut where it is long."""
    try:
        text = str(value) if isinstance(value, (str, os.PathLike, Exception)) else repr(value)
    except Exception:  # it is nested deeply, or raises whatever it likes
        text = f"of type {type(value).__name__}"
    text = text if text.isprintable() else ascii(text)
    return text if len(text) <= most else f"{text[: most - 1]}…"


def refuse_depth(content: bytes) -> None:
    """Refuse JSON whose brackets outside of text are nested more deeply than any of ours."""
    depth = 0
    for mark in _MARKS.finditer(content):
        first = mark.group()[:1]
        if first in b"[{":
            depth += 1
            if depth > _DEEPEST:
                raise RecursionError
        elif first in b"]}":
            depth -= 1


def _refuse_large(value: Any, where: str, what: str, error: type[WrodError]) -> None:
    """Refuse whole numbers that no float holds, wherever a schema leaves the kind open."""
    stack = [value]
    while stack:
        one = stack.pop()
        if isinstance(one, msgspec.Struct):
            stack.extend(getattr(one, name) for name in one.__struct_fields__)
        elif isinstance(one, dict):
            stack.extend(one.values())
        elif isinstance(one, (list, tuple)):
            stack.extend(one)
        elif isinstance(one, int) and abs(one) > _MAX_INTEGER:
            raise error(f"{where}: holds a whole number beyond 2^53; that is not {what}")


def _syntax(reason: str, content: bytes) -> str:
    """Where JSON stops being JSON, and how."""
    place = re.search(r"\(byte (\d+)\)", reason)
    if place is None:
        return ": ends in the middle of its JSON" if "truncated" in reason else f": {reason}"
    at = int(place[1])
    line = content.count(b"\n", 0, at) + 1
    column = at - (content.rfind(b"\n", 0, at) + 1) + 1
    said = reason.replace(f" {place[0]}", "").replace("JSON is malformed: ", "")
    if re.match(rb"-?(NaN|Infinity)", content[at - (content[at - 1 : at] == b"-") :][:10]):
        said = "NaN and infinity are no numbers"
    return f", line {line}, column {column}: is no JSON ({said})"


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or str(error)
