"""The accuracy campaign: its ledger, its tables, and that a stopped run goes on."""

import json
import shutil

import pytest
from cli import told
from click.testing import CliRunner
from forked import full_disk

from wrod.bench import courses, table3_paper
from wrod.bench.table3_paper import METHODS, PATTERNS, RODS, SUBSTRATES, friction, measured
from wrod.bench.table3_report import KEYS, cells, markdown, summary
from wrod.commands import main
from wrod.errors import DataError
from wrod.files.ledger import Ledger


def row(method="numeric", trial=0, error=0.1, diverged=False, **key):
    base = dict(rod="rope", substrate="steel", pattern="circle", method=method, trial=trial)
    errors = dict(
        error_mean=error,
        error_std=error / 2,
        released_error_mean=2 * error,
        released_error_std=error,
    )
    return {**base, **key, **errors, "diverged": diverged, "steps": 10, "curve": [[0, 0]]}


def test_paper_table_is_complete():
    table = measured()
    assert len(table) == len(RODS) * len(SUBSTRATES) * len(PATTERNS) * len(METHODS) == 126
    assert table["pink-vps", "fabric", "line", "intuitive"] == (0.40, 0.22)
    assert table["rope", "foam", "letter-A", "numeric"] == (0.52, 0.20)
    for key in table:
        if key[3] == "numeric":
            assert table[key][0] < table[*key[:3], "intuitive"][0]


def test_paper_table_matches_the_paper(shared):
    """Every number, read from the table's source."""
    import re

    text = (shared / "paper.tex").read_text(encoding="utf-8")
    body = text[text.index("label{tab:timeDiff}") - 40000 : text.index("label{tab:results}")]
    lines = [re.split("& (?:INT|OPT) &", line) for line in body.split("\n")]
    numbers = [
        [float(x) for x in re.findall(r"\d+\.\d+", parts[1])] for parts in lines if len(parts) == 2
    ]
    rows = [[float(x) for x in line.split()] for line in table3_paper._ROWS.split("\n") if line]
    assert numbers == rows


def test_friction_words():
    """Table 2: VPS slips most on fabric, rope on steel."""
    assert friction("green-vps", "fabric") < friction("green-vps", "steel")
    assert friction("rope", "steel") < friction("rope", "fabric") < friction("rope", "foam")


def test_ledger_goes_on_where_it_was_killed(tmp_path):
    path = tmp_path / "trials.jsonl"
    ledger = Ledger(path, {"speed": 0.02}, KEYS)
    ledger.add([row(trial=0), row(trial=1)])
    with open(path, "a") as file:
        file.write('{"rod": "ro')  # killed while it wrote
    again = Ledger(path, {"speed": 0.02}, KEYS)
    assert {again.key(row) for row in again.rows} == {
        ("rope", "steel", "circle", "numeric", k) for k in (0, 1)
    }
    again.add([row(trial=2)])
    assert len(Ledger(path, {"speed": 0.02}, KEYS).rows) == 3
    with pytest.raises(DataError, match="other settings"):
        Ledger(path, {"speed": 0.05}, KEYS)
    path.write_text("what is this")
    with pytest.raises(DataError, match="not readable"):
        Ledger(path, {"speed": 0.02}, KEYS)


def test_cells_leave_diverged_trials_out_and_count_them():
    table = cells([row(error=0.1), row(error=0.3, trial=1), row(error=9.0, trial=2, diverged=True)])
    cell = table["rope", "steel", "circle", "numeric"]
    assert cell.held == pytest.approx((0.2, 0.1))
    assert cell.released == pytest.approx((0.4, 0.2))
    assert (cell.trials, cell.diverged) == (3, 1)


def test_summary_names_the_cells_that_fall_short():
    good = cells([row(error=0.1), row("intuitive", error=2.0)])
    assert summary(good)[0].endswith("in 1 of 1 cells, and at or below the paper's error in 1.")
    bad = cells([row(error=3.0), row("intuitive", error=2.0)])
    text = " ".join(summary(bad))
    assert "in 0 of 1 cells" in text
    assert "INT lays better: rope steel circle (3.00 cm)" in text
    assert "0.29 ± 0.13" in markdown(good, "head")  # the paper's cell


def undrawn(monkeypatch):
    """The picture of a table takes longer than its cells."""
    monkeypatch.setattr("wrod.bench.table3_report.draw", lambda path, *_: path)


def test_part_of_a_campaign_is_written_and_resumed(tmp_path, monkeypatch):
    """Two cells on coarse meshes and long steps; a second call does what lacks, a third goes on to
    more cells with the trials that are there."""
    args = ["bench", "table3", "--out", str(tmp_path), "--trials", "2", "--device", "cpu"]
    args += ["--speed", "0.2", "--step", "0.1", "--spacing", "0.04", "--json", "--batch", "1"]
    args += ["--closure", "zero_tension", "--rod", "green-vps", "--pattern", "line"]
    figures = told(*args, "--substrate", "steel")
    assert figures["simulated_now"] == figures["trials"] == 4
    table = (tmp_path / "table3.md").read_text()
    assert table.count("let go") == 2 and "| rope |" not in table
    assert (tmp_path / "table3.png").read_bytes()[:4] == b"\x89PNG"
    undrawn(monkeypatch)
    lines = (tmp_path / "trials.jsonl").read_text().splitlines()
    (tmp_path / "trials.jsonl").write_text("\n".join(lines[:3]) + "\n")
    figures = json.loads(CliRunner().invoke(main, [*args, "--substrate", "steel"]).output)
    assert figures["simulated_now"] == 2
    assert (tmp_path / "table3.md").read_text() == table
    words = [*args, "--substrate", "foam", "--substrate", "steel"]
    figures = json.loads(CliRunner().invoke(main, words).output)
    assert (figures["simulated_now"], figures["trials"]) == (4, 8)
    assert set(table.splitlines()) - set((tmp_path / "table3.md").read_text().splitlines()) == {
        line for line in table.splitlines() if "cells" in line or "trials diverged" in line
    }
    _full(args, tmp_path, table)
    _vanished(args, tmp_path, table, monkeypatch)


def test_plans_that_know_their_table_know_the_pace_too(tmp_path, monkeypatch):
    """What they are optimised for is how they are laid."""
    asked = []

    def run(course, jobs, done, **_):
        for job in jobs:
            asked.append(next(course(*job)))
            done(job, job[3])

    monkeypatch.setattr(courses, "run", run)
    undrawn(monkeypatch)
    args = ["bench", "table3", "--out", str(tmp_path), "--trials", "1", "--device", "cpu"]
    args += ["--speed", "0.2", "--step", "0.1", "--spacing", "0.04", "--json", "--known-table"]
    told(*args, "--rod", "pink-vps", "--pattern", "line")
    least = [one.trials[0].friction.static for one in asked]
    assert least == pytest.approx([0.95 * mu for mu in (0.3, 0.6, 1.0)])
    assert {one.how["speed"] for one in asked} == {0.2}


def _full(args, done, table):
    """A disk that fills up while trials are kept: the same command goes on, to the same table."""
    args = [str(done / "full") if word == str(done) else word for word in args]
    with full_disk(4096):
        result = CliRunner().invoke(main, [*args, "--substrate", "steel"])
    assert result.exit_code == 2 and result.stderr.count("\n") == 1, result.output
    assert "trials.jsonl" in result.stderr and "make room" in result.stderr
    kept = (done / "full" / "trials.jsonl").read_text().count("\n") - 1
    assert 0 < kept < 4
    figures = json.loads(CliRunner().invoke(main, [*args, "--substrate", "steel"]).output)
    assert figures["simulated_now"] == 4 - kept
    assert (done / "full" / "table3.md").read_text() == table


def _vanished(args, done, table, monkeypatch):
    """A folder that is removed while trials are simulated loses none of them."""
    args, added = [str(done / "gone") if word == str(done) else word for word in args], []
    add = Ledger.add

    def vanish(self, rows):
        if len(added) == 2:
            shutil.rmtree(self.path.parent)
        added.append(rows)
        add(self, rows)

    monkeypatch.setattr(Ledger, "add", vanish)
    result = CliRunner().invoke(main, [*args, "--substrate", "steel"])
    assert result.exit_code == 0 and len(added) == 4, result.output
    assert (done / "gone" / "trials.jsonl").read_text().count("\n") == 5
    assert (done / "gone" / "table3.md").read_text() == table


@pytest.mark.slow
def test_killed_campaign_goes_on_to_the_same_table(tmp_path):
    """Killed without warning in the middle, and called again: the tables are those of a run that
    was left alone, byte by byte."""
    import signal
    import subprocess
    import sys
    import time

    def call(folder):
        code = "from wrod.commands import main; main()"
        args = ["bench", "table3", "--out", str(tmp_path / folder), "--trials", "1", "--json"]
        args += ["--speed", "0.1", "--step", "0.05", "--spacing", "0.02", "--batch", "8"]
        return subprocess.Popen(
            [sys.executable, "-c", code, *args, "--device", "cpu"], stdout=subprocess.DEVNULL
        )

    kept = tmp_path / "killed" / "trials.jsonl"
    process = call("killed")
    while process.poll() is None and not (kept.exists() and kept.read_text().count("\n") > 17):
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    done = kept.read_text().count("\n") - 1
    assert 16 <= done < 126
    for folder in ("killed", "whole"):
        assert call(folder).wait() == 0
    for name in ("table3.csv", "table3.md"):
        one, two = (tmp_path / folder / name for folder in ("killed", "whole"))
        assert one.read_bytes() == two.read_bytes()
