"""Campaigns go on where they were stopped, and write the same as if they had not been."""

import json

import pytest
from cli import refused
from click.testing import CliRunner

from wrod.bench import campaign
from wrod.commands import main
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
    assert (spent.trials, spent.steps) == (4, 40)
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


@pytest.mark.slow
def test_comparison_of_closures_is_resumed_to_the_same_files(tmp_path, monkeypatch):
    """Laid on coarse meshes; the second run is stopped after two of its eight deployments."""
    import wrod.deployment.simulate

    def call(folder):
        args = ["bench", "closures", "--out", str(tmp_path / folder), "--device", "cpu"]
        args += ["--frictions", "0.4", "--curvatures", "1", "--names", "line", "--json"]
        args += ["--rods", "pink-vps", "--batch", "2"]
        return CliRunner().invoke(
            main, [*args, "--speed", "0.2", "--step", "0.05", "--spacing", "0.03"]
        )

    whole = call("whole")
    assert whole.exit_code == 0, whole.output
    simulate, calls = wrod.deployment.simulate.simulate_deployments, []

    def stopped(*args, **options):
        calls.append(len(args[0]))
        if len(calls) == 2:
            raise KeyboardInterrupt
        return simulate(*args, **options)

    monkeypatch.setattr(wrod.deployment.simulate, "simulate_deployments", stopped)
    assert call("stopped").exit_code != 0
    lines = (tmp_path / "stopped" / "trials.jsonl").read_text().splitlines()
    assert len(lines) == 1 + 2
    assert not (tmp_path / "stopped" / "closures.csv").exists()
    monkeypatch.setattr(wrod.deployment.simulate, "simulate_deployments", simulate)
    assert '"simulated_now": 6' in call("stopped").output
    for name in ("closures.csv", "closures.md"):
        one, two = (tmp_path / folder / name for folder in ("whole", "stopped"))
        assert one.read_bytes() == two.read_bytes()
    text = (tmp_path / "whole" / "closures.md").read_text()
    assert "put down exactly" in text and "min friction" in text
    assert (tmp_path / "whole" / "closures.png").stat().st_size > 10_000


@pytest.mark.parametrize("text", ["", "one", "0.1,-1", "nan"])
def test_bad_axes_are_refused(tmp_path, text):
    arguments = ["bench", "closures", "--frictions", text, "--out", str(tmp_path / "out")]
    refused("frictions", *arguments)
    assert not (tmp_path / "out").exists()


def test_comparisons_of_closures_without_friction_are_drawn(tmp_path):
    """Nothing is left there for axes that are logarithmic."""
    from wrod.bench.closures_picture import draw_friction
    from wrod.bench.closures_report import Cell

    cell = Cell(**dict.fromkeys(Cell.__dataclass_fields__, 0.5))
    draw_friction(tmp_path / "x.png", {("rope", "line", 0.0, "min_force"): cell})
    assert (tmp_path / "x.png").stat().st_size > 1000


def test_edges_longer_than_a_rod_bends_are_refused_before_it_is_planned(tmp_path, monkeypatch):
    monkeypatch.setattr("wrod.bench.closures._plans", None)
    refused("longest that bends", "bench", "closures", "--spacing", 1.0, "--out", tmp_path / "out")
