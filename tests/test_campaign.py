"""Campaigns go on where they were stopped, and write the same as if they had not been."""

import json

import pytest

from wrod.bench import campaign
from wrod.errors import DataError
from wrod.files.ledger import Ledger

KEYS = ("course", "trial")


def rows_of(part, progress):
    progress(1.0)
    return [{"course": c, "trial": t, "steps": 10, "value": f"{c}{t}"} for c, t in part]


def test_stopped_run_simulates_the_rest_only(tmp_path):
    keys = [(course, trial) for trial in range(3) for course in "abcd"]
    asked = []

    def stopped(part, progress):
        if len(asked) == 2:
            raise KeyboardInterrupt
        asked.append(part)
        return rows_of(part, progress)

    ledger = Ledger(tmp_path / "trials.jsonl", {"speed": 1}, KEYS)
    with pytest.raises(KeyboardInterrupt):
        campaign.run(ledger, keys, stopped, device="cpu", batch=4)
    assert asked == [keys[:4], keys[4:8]]
    again = Ledger(tmp_path / "trials.jsonl", {"speed": 1}, KEYS)
    assert again.lacking(keys) == keys[8:]
    spent = campaign.run(again, keys, rows_of, device="cpu", batch=3)
    assert spent == (4, 40)
    assert [row["value"] for row in again.of(keys)] == [f"{c}{t}" for c, t in keys]


def test_rows_come_in_the_order_of_the_trials(tmp_path):
    """Whatever the order in which they were finished: so are the files of a resumed run."""
    ledger = Ledger(tmp_path / "trials.jsonl", {}, KEYS)
    ledger.add(rows_of([("b", 0), ("a", 0), ("c", 0)], lambda fraction: None))
    assert [row["course"] for row in ledger.of([("a", 0), ("b", 0), ("d", 0)])] == ["a", "b"]


def test_a_line_that_was_changed_is_refused(tmp_path):
    path = tmp_path / "trials.jsonl"
    Ledger(path, {}, KEYS).add(rows_of([("a", 0), ("b", 0)], lambda fraction: None))
    head, line, other = path.read_text().splitlines()
    row = json.loads(line)
    changed = [row | {"value": 7}, row | {"more": 1}, {k: row[k] for k in list(row)[1:]}, {}]
    for one in (*changed, {k: row[k] for k in list(row)[:-1]}, row | {"digest": None}):
        path.write_text("\n".join([head, other, json.dumps(one), ""]))
        with pytest.raises(DataError, match="line 3: is damaged; delete that line"):
            Ledger(path, {}, KEYS)
    path.write_text("\n".join([head, other, line.replace(", ", " ,\t"), ""]))
    assert Ledger(path, {}, KEYS).lacking([("a", 0), ("b", 0)]) == []
