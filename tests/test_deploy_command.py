"""`wrod deploy` from the command line."""

import numpy as np
import pytest
from cli import done, refused, run, told

import wrod
from wrod.deployment.result import Deployment


@pytest.fixture(scope="module")
def arc(tmp_path_factory):
    """A file of points along a gentle arc, short enough to be laid in a second or two."""
    path = tmp_path_factory.mktemp("pattern") / "arc.csv"
    angle = np.linspace(0.0, 0.7, 60)
    points = 0.2 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    np.savetxt(path, points, delimiter=",")
    return path


SHORT = ["--radius", "0.0016", "--lgb", "0.018", "--length", "0.25"]


def test_deploys_and_writes_what_it_says(arc, tmp_path):
    out = tmp_path / "laid"
    args = ["deploy", str(arc), *SHORT, "--out", str(out), "--json"]
    args += ["--method", "numeric", "--device", "cpu"]
    figures = told(*args, "--speed", "0.03", "--trials", "2")
    assert len(figures["trials"]) == 2
    assert figures["trials"][0]["error_mean"] < 3e-3
    assert figures["trials"][0]["error_mean"] != figures["trials"][1]["error_mean"]
    names = sorted(path.name for path in out.iterdir())
    assert names == ["deployment-0.npz", "deployment-1.npz", "deployment.png"]
    assert sorted(figures["written"]) == sorted(str(out / name) for name in names)
    saved = Deployment.load(out / "deployment-0.npz")
    assert saved.error_mean == pytest.approx(figures["trials"][0]["error_mean"])


def test_takes_a_saved_trajectory(arc, tmp_path):
    rod = wrod.RodMaterial(0.0016, 0.018, 0.25)
    path = wrod.plan(wrod.Pattern.load(arc), rod, "intuitive").save(tmp_path / "plan")[1]
    args = ["deploy", str(arc), *SHORT, "--trajectory", str(path), "--out", str(tmp_path / "o")]
    result = done(*args, "--device", "cpu", "--speed", "0.03")
    assert "grip holding" in result.output
    assert f"wrote {tmp_path / 'o' / 'deployment.npz'}" in result.output


def test_a_plan_for_a_table_leaves_little_hanging_and_is_laid_so(tmp_path):
    """Of the whole rod that is named to both commands; held at its end as asked."""
    rod = ["--radius", "0.0016", "--lgb", "0.018", "--length", "0.3"]
    np.savetxt(tmp_path / "line.txt", np.column_stack([np.linspace(0.0, 0.15, 20), np.zeros(20)]))
    args = [str(tmp_path / "line.txt"), *rod, "--device", "cpu"]
    how = [*args, "--friction", "0.3", "--method", "distilled", "--no-robot", "--no-expect"]
    near = told("plan", *how, "--out", str(tmp_path / "near"), "--json")
    assert near["beyond_grip"] == pytest.approx(0.3 - 0.15 - 4.0 * 0.018, abs=1e-6)
    assert near["rod"]["length"] == pytest.approx(0.15 + 4.0 * 0.018, abs=1e-6)
    assert any("0.078 m hang beyond the grip" in note for note in near["notes"])
    end = told("plan", *how, "--hold", "0.3", "--out", str(tmp_path / "end"), "--json")
    assert end["beyond_grip"] == 0.0 and end["beyond"] is None
    assert end["highest_grip"] > near["highest_grip"] + 0.05
    path = ["--trajectory", str(tmp_path / "near" / "trajectory.npz")]
    figures = told("deploy", *args, *path, "--out", str(tmp_path / "laid"), "--json")
    assert figures["trials"][0]["error_mean"] < 2e-3
    assert figures["beyond_grip"] == near["beyond_grip"]
    assert figures["trials"][0]["lies_beyond"] < 0.02  # it just comes down
    whole = Deployment.load(tmp_path / "laid" / "deployment.npz")
    assert whole.arc_length[-1] == pytest.approx(0.3)
    cut = ["deploy", *args[:-3], "0.222", "--device", "cpu", *path]
    figures = told(*cut, "--out", str(tmp_path / "cut"), "--json")
    assert "lies_beyond" not in figures["trials"][0]
    ends = Deployment.load(tmp_path / "cut" / "deployment.npz")
    assert ends.arc_length[-1] == pytest.approx(0.222)
    assert near["beyond"]["met"] is None and 0.06 < near["beyond"]["off_the_table"] < 0.078
    assert 0.14 < near["beyond"]["on_the_table_from"] <= 0.15
    assert any("comes down to the table" in note for note in near["notes"])
    other = run("deploy", *args[:-3], "0.31", *path, "--out", str(tmp_path / "other"))
    assert other.exit_code == 2 and "whose length is 0.222 m" in other.output


@pytest.mark.parametrize(
    ("extra", "word"),
    [
        (["--friction", "-1"], "friction"),
        (["--trials", "0"], "trials"),
        (["--speed", "0"], "speed"),
        (["--trajectory", "missing.npz"], "missing.npz"),
        (["--device", "cuda:9"], "device"),
    ],
)
def test_bad_input_is_one_sentence(arc, tmp_path, extra, word):
    out = tmp_path / "out"
    result = run("deploy", arc, *SHORT, "--out", out, *extra)
    assert result.exit_code == 2
    assert word in result.output
    assert "Traceback" not in result.output
    assert not out.exists()


@pytest.mark.parametrize(
    "pattern, changes, says",
    [
        ("line", [], "give the pattern that it was planned for"),
        (None, ["--lgb", "0.025"], "gravito_bending_length is 0.018 m"),
        (None, ["--method", "numeric"], "--method does nothing beside --trajectory"),
        (None, ["--closure", "min_force"], "--closure does nothing beside --trajectory"),
    ],
)
def test_refuses_a_trajectory_of_something_else(arc, tmp_path, pattern, changes, says):
    rod = wrod.RodMaterial(0.0016, 0.018, 0.25)
    path = wrod.plan(wrod.Pattern.load(arc), rod, "intuitive").save(tmp_path / "plan")[1]
    args = ["deploy", pattern or str(arc), *SHORT, "--trajectory", str(path), *changes]
    result = run(*args, "--out", tmp_path / "o")
    assert result.exit_code == 2
    assert says in result.output
    assert not (tmp_path / "o").exists()


def test_refuses_a_closure_that_the_intuitive_method_ignores(arc, tmp_path):
    args = ["deploy", str(arc), *SHORT, "--method", "intuitive", "--closure", "min_force"]
    refused("--closure does nothing", *args, "--out", tmp_path / "o")
