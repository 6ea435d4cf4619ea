"""The comparison of plans on slippery tables."""

import pytest
from click.testing import CliRunner

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
