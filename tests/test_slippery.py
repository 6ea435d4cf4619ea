"""The comparison of plans on slippery tables."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrod
from wrod.bench.slippery import summary
from wrod.commands import main


def test_summary_is_the_mean_over_trials():
    base = {"rod": "rope", "pattern": "line", "friction": 0.3, "engine": "wrod"}
    rows = [base | {"method": m, "error_mean": e} for m, e in (("a", 1.0), ("b", 2.0), ("a", 3.0))]
    assert summary(rows) == [base | {"error_mean": {"a": 2.0, "b": 2.0}}]


@pytest.mark.parametrize(
    "options, says",
    [
        (("--methods", "guess"), "unknown method 'guess'"),
        (("--engines", "wrod,bullet"), "unknown engine 'bullet'"),
        (("--trials", "0"), "--trials"),
        (("--frictions", "slippery"), "frictions is 'slippery'"),
    ],
)
def test_bad_options_are_refused(tmp_path, options, says):
    out = tmp_path / "out"
    result = CliRunner().invoke(main, ["bench", "slippery", "--out", str(out), *options])
    assert result.exit_code == 2
    assert says in result.output
    assert not out.exists()


def test_rods_put_down_exactly_are_compared_and_kept(tmp_path):
    arguments = ["bench", "slippery", "--methods", "put_down", "--frictions", "0.6", "--device"]
    arguments += ["cpu", "--spacing", "0.02", "--step", "0.02", "--trials", "1", "--out"]
    for _ in range(2):  # the second time nothing is simulated
        result = CliRunner().invoke(main, [*arguments, str(tmp_path)])
        assert result.exit_code == 0, result.output
        assert "green-vps, letter-U, friction 0.6: put_down 0.0" in result.output
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 2
    assert (tmp_path / "slippery.png").stat().st_size > 10_000


def test_where_the_robot_stands_bounds_what_a_plan_can_do(tmp_path):
    from wrod.deployment.setup import Disturbance

    arguments = ["bench", "slippery", "--methods", "misplaced", "--frictions", "0.6", "--device"]
    arguments += ["cpu", "--names", "line", "--trials", "1", "--out", str(tmp_path), "--json"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    (cell,) = json.loads(result.output)["cells"]
    # A line turned by a small angle about its first point, which is shifted.
    s = np.linspace(0.0, wrod.pattern("line").length, 50)
    how = Disturbance.random(9_000)
    along, aside = how.offset
    expected = np.hypot(along - 0.5 * s * how.yaw**2, aside + s * how.yaw).mean()
    assert cell["error_mean"]["misplaced"] == pytest.approx(100.0 * expected, rel=1e-3)
