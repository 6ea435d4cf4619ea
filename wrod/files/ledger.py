"""The file of a campaign: one finished trial a line, so that a stopped run goes on.

Every line ends in a digest of what is on it: what reads rows need not ask again what they hold.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import msgspec

from wrod.errors import DataError
from wrod.files import read_text, write_atomically
from wrod.files.reading import entry_message, refuse_depth, shown
from wrod.files.writing import grown, keeps

# Of a campaign of a million trials.
_MOST_BYTES = 2**31


class Ledger:
    """A file of one finished trial a line; what a killed run wrote is there for the next.

    Args:
        path: the file; None: nothing is kept.
        settings: what all trials have in common; a file that was begun with others is refused.
        keys: the fields of a row that tell which trial it is.
        fields: schema of a row, of `wrod.files.schemas`, or what tells it of a row.
        title: what the campaign's files are called.

    Raises:
        DataError: the file belongs to a campaign with other settings, is not one, or was changed.
    """

    def __init__(
        self,
        path: Path | None,
        settings: dict,
        keys: Sequence[str],
        title: str = "campaign",
        fields: type | Callable[[dict], type] | None = None,
    ):
        self.path, self.keys, self.rows = path, tuple(keys), []
        head = {"format": f"wrod-{title}-2", **settings}
        self._head = head
        if path is not None:
            keeps(path)
        if path is None or not path.exists():  # it begins with the first trial
            return
        lines = read_text(path, "a campaign's file", limit=_MOST_BYTES).split("\n")
        whole, broken = lines[:-1], lines[-1]  # a killed run may leave half a line
        remedy = "delete that line, or choose another --out"
        found = _line(whole[0] if whole else "", f"{path}, line 1", "choose another --out")
        if found != json.loads(json.dumps(head)):
            raise DataError(
                f"{path}: was begun with other settings ({shown(found, 300)}); choose another "
                "--out or delete it"
            )
        for number, line in enumerate(whole[1:], start=2):
            where = f"{path}, line {number}"
            row = _line(line, where, remedy)
            if row.pop("digest", None) != _digest(row):
                raise DataError(f"{where}: is damaged; {remedy}")
            if fields is not None:
                try:
                    msgspec.convert(row, fields if isinstance(fields, type) else fields(row))
                except msgspec.ValidationError as reason:
                    raise DataError(f"{where}: {entry_message(str(reason))}; {remedy}") from None
            for key in self.keys:
                if not isinstance(row.get(key), (str, int, float)):
                    raise DataError(f"{where}: is no trial, for it lacks {key!r}; {remedy}")
            self.rows.append(row)
        if broken:
            write_atomically(path, lambda file: file.write("\n".join(whole) + "\n"))

    def key(self, row: dict) -> tuple:
        return tuple(row[key] for key in self.keys)

    def lacking(self, keys: Iterable[tuple]) -> list[tuple]:
        """Those of some trials that are not finished, in their order."""
        done = {self.key(row) for row in self.rows}
        return [key for key in keys if key not in done]

    def add(self, rows: list[dict]) -> None:
        self.rows += rows
        if self.path is None:
            return
        if not self.path.exists():  # new, or removed meanwhile: what was finished is known here
            head, lines = json.dumps(self._head), map(_sealed, self.rows)
            write_atomically(self.path, lambda file: file.writelines([f"{head}\n", *lines]))
            return
        with open(self.path, "a", encoding="utf-8") as file:
            file.writelines(map(_sealed, rows))
        grown(self.path)

    def of(self, keys: Iterable[tuple]) -> list[dict]:
        """The rows of these trials, in the order in which the trials are given."""
        by_key = {self.key(row): row for row in self.rows}
        return [by_key[key] for key in keys if key in by_key]


def _sealed(row: dict) -> str:
    return json.dumps({**row, "digest": _digest(row)}) + "\n"


def _digest(row: dict) -> str:
    return hashlib.sha256(json.dumps(row).encode()).hexdigest()[:16]


def _line(text: str, where: str, remedy: str) -> dict:
    """The object on a line; figures of trials that diverged may be NaN."""
    try:
        refuse_depth(text.encode("utf-8", "replace"))
        found = json.loads(text)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise DataError(f"{where}: is not readable; {remedy}")
    return found
