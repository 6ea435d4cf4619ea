"""Campaigns that survive a kill: one finished trial a line."""

from __future__ import annotations

import json
from pathlib import Path

from wrod.errors import DataError
from wrod.files import write_atomically


class Ledger:
    """A file of one finished trial a line; what a killed run wrote is there for the next.

    Args:
        path: the file.
        settings: of the campaign; a file that was begun with others is refused.
        keys: entries that name a trial.
        format: what the file calls itself.

    Raises:
        DataError: the file belongs to a campaign with other settings, or is not one.
    """

    def __init__(self, path: Path, settings: dict, keys: tuple[str, ...], format: str):
        self.path, self.keys, self.rows = path, keys, []
        head = {"format": format, **settings}
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

    def done(self) -> set[tuple]:
        return {tuple(row[key] for key in self.keys) for row in self.rows}

    def add(self, rows: list[dict]) -> None:
        with open(self.path, "a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
        self.rows += rows
