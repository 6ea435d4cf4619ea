import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrod
from wrod.commands import main
from wrod.commands.options import RodOptions
from wrod.rods.catalogue import catalogue


def test_entries_say_where_they_come_from_and_keep_what_was_measured():
    entries = catalogue()
    assert len({entry.name for entry in entries}) == len(entries) == 20
    assert all(entry.source and entry.note and entry.what for entry in entries)
    held = wrod.rod("power-cable-15mm")
    assert held.bending_stiffness == pytest.approx(0.059)
    assert held.weight == pytest.approx(9.81 * 0.40 / 0.75)
    # What hangs straight out by its own length bends by about its gravito-bending length.
    assert held.gravito_bending_length == pytest.approx(
        np.cbrt(0.059 / (2 * 9.81 * 0.40 / 0.75)), rel=1e-9
    )
    wire = wrod.rod("guidewire-amplatz")
    assert wire.bending_stiffness == pytest.approx(60.3e9 * np.pi * (0.035 * 0.0254) ** 4 / 64)
    tube = wrod.rod("silicone-tube-3mm")  # 1/8 in around 1/16 in: a sixteenth of I is bore
    assert tube.bending_stiffness == pytest.approx(3.05e6 * np.pi * 3.175e-3**4 / 64 * 15 / 16)
    assert tube.weight == pytest.approx(9.81 * 1150 * np.pi * 3.175e-3**2 / 4 * 3 / 4)
    # The command and the library know the same names.
    assert wrod.rod_names() == [entry.name for entry in entries]
    assert RodOptions("thin-cable-red", None, None, None).read() == wrod.rod("thin-cable-red")
    with pytest.raises(wrod.errors.RodError, match="unknown rod 'usb-c'; known rods: pink-vps"):
        wrod.rod("usb-c")


def test_command_lists_them():
    run = CliRunner().invoke(main, ["rods", "--json"])
    rows = {row["name"]: row for row in json.loads(run.output)}
    assert rows["thin-cable-black"]["spread"] == 0.30
    assert "2310.00911" in rows["thin-cable-black"]["source"]
    assert "power-cable-20mm" in CliRunner().invoke(main, ["rods"]).output
