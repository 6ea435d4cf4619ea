import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrod
from wrod.commands import main
from wrod.rods.catalogue import catalogue, find


def test_entries_say_where_they_come_from_and_keep_what_was_measured():
    entries = catalogue()
    assert len({entry.name for entry in entries}) == len(entries) == 10
    assert all(entry.source and entry.note and entry.what for entry in entries)
    held = find("power-cable-15mm").rod
    assert held.bending_stiffness == pytest.approx(0.059)
    assert held.weight == pytest.approx(9.81 * 0.40 / 0.75)
    # What hangs straight out by its own length bends by about its gravito-bending length.
    assert held.gravito_bending_length == pytest.approx(
        np.cbrt(0.059 / (2 * 9.81 * 0.40 / 0.75)), rel=1e-9
    )
    assert find("green-vps").rod == wrod.rod("green-vps")
    with pytest.raises(wrod.errors.RodError, match="unknown rod 'usb-c'; known rods: pink-vps"):
        find("usb-c")


def test_command_lists_them():
    run = CliRunner().invoke(main, ["rods", "--json"])
    rows = {row["name"]: row for row in json.loads(run.output)}
    assert rows["thin-cable-black"]["spread"] == 0.30
    assert "2310.00911" in rows["thin-cable-black"]["source"]
    assert "power-cable-20mm" in CliRunner().invoke(main, ["rods"]).output
