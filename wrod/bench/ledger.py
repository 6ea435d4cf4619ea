"""The file of a campaign: one finished trial a line, so that a stopped run goes on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from wrod.errors import DataError
from wrod.files import write_atomically


class Ledger:
    """A file of one finished trial a line; what a killed run wrote is there for the next.

    Args:
        path: the file.
        settings: what all trials have in common; a file that was begun with others is refused.
        keys: the fields of a row that tell which trial it is.
        title: what the campaign's files are called.

    Raises:
        DataError: the file belongs to a campaign with other settings, or is not one.
    """

    def __init__(self, path: Path, settings: dict, keys: Sequence[str], title: str = "campaign"):
        self.path, self.keys, self.rows = path, tuple(keys), []
        head = {"format": f"wrod-{title}-1", **settings}
        if not path.exists():
            write_atomically(path, lambda file: file.write(json.dumps(head) + "\n"))
            return
        lines = path.read_text(encoding="utf-8").split("\n")
        whole, broken = lines[:-1], lines[-1]  # a killed run may leave half a line
        try:
            found = json.loads(whole[0])
            self.rows = [json.loads(line) for line in whole[1:]]
        except (IndexError, ValueError):
            raise DataError(f"{path}: is not a readable campaign; choose another --out") from None
        if found != json.loads(json.dumps(head)):
            raise DataError(
                f"{path}: was begun with other settings ({found}); choose another --out or delete "
                "it"
            )
        if broken:
            write_atomically(path, lambda file: file.write("\n".join(whole) + "\n"))

    def key(self, row: dict) -> tuple:
        return tuple(row[key] for key in self.keys)

    def done(self) -> set[tuple]:
        return {self.key(row) for row in self.rows}

    def add(self, rows: list[dict]) -> None:
        with open(self.path, "a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
        self.rows += rows

    def of(self, keys: Sequence[tuple]) -> list[dict]:
        """The rows of these trials, in the order in which the trials are given."""
        by_key = {self.key(row): row for row in self.rows}
        return [by_key[key] for key in keys if key in by_key]
