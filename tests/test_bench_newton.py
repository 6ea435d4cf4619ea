"""`wrod bench newton` on a problem that is small in every way."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from wrod.bench.cantilever import Cantilever
from wrod.bench.newton import command
from wrod.errors import DataError
from wrod.rods.catalogue import rod


def test_light_rods_sag_like_beams():
    """The continuum's tip for a short rod: w L^4 / (8 k_b), and weight stretches nothing yet."""
    problem = Cantilever(rod("green-vps"), 0.005)
    sag = problem.rod.weight * problem.length**4 / (8 * problem.rod.bending_stiffness)
    assert problem.tip[2] == pytest.approx(-sag, rel=1e-4)
    assert problem.tip[0] == pytest.approx(problem.length, rel=1e-6)


def test_command(tmp_path):
    """Every solver has its rows; SolverDER's are near the continuum."""
    options = {"edges": 6, "iterations": 4, "rods": 2, "periods": 2, "out": tmp_path}
    words = [str(word) for key, value in options.items() for word in (f"--{key}", value)]
    result = CliRunner().invoke(command, [*words, "--json"])
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout, parse_constant=pytest.fail)
    der = next(row for row in figures["rows"] if row["solver"] == "SolverDER")
    assert 0.0 < der["rest"]["error"] < 0.02
    assert 0.0 < abs(der["swing"]["frequency"]) < 0.05
    assert {row["rods"] for row in figures["speed"]} == {1, 2}
    assert (tmp_path / "newton.png").stat().st_size > 10_000
    table = (tmp_path / "newton.md").read_text()
    assert "SolverVBD | 6 | 4 iterations" in table
    for value in ("0", "a,b", ""):
        refused = CliRunner().invoke(command, ["--edges", value]).exception
        assert isinstance(refused, DataError) and "--edges" in str(refused)


def test_many_worlds():
    """Every scene has its row: a step in a graph is the same, and a pile loses energy."""
    pytest.importorskip("newton")
    from wrod.bench.newton_many import gradients_of_steps, graph_of_a_step, worlds_of_cables
    from wrod.bench.newton_piles import Pile, measure

    rows = list(worlds_of_cables("cpu", 2, 10, 0.25))
    assert [row["steps_per_second"] for row in rows] == [60, 120]
    assert all(0.0 < row["tip_error_over_length"] < 0.02 for row in rows)
    rows = list(worlds_of_cables("cpu", 2, 10, 0.25, armed=True))
    assert all(0.0 < row["tip_error_over_length"] < 0.02 for row in rows)
    (row,) = graph_of_a_step("cpu", 2, 10, 10)
    assert row["largest_difference_m"] == 0.0
    (row,) = gradients_of_steps("cpu", 2, 10, 10)
    assert row["gradients_differ"] == 0.0
    row = measure(Pile(3, 12), "stack", "SolverDER", 20)
    assert row["largest_rise_over_energy"] < 1e-3 and not row["diverged"]
    assert 0.0 < row["deepest_over_radius"] < 0.05


def test_plectoneme_pulls_as_its_angle_says():
    """F R^2 / B and M R / B of two wound strands follow from their angle alone."""
    from wrod.bench.newton_plectoneme import Ply, wind

    for angle, force in ((25.0, 0.065578), (30.0, 0.15625), (35.0, 0.370573)):
        assert Ply(np.radians(angle), 1, 0, 0, 0).expected()[0] == pytest.approx(force, rel=1e-5)
    ply = wind(80, 6.0, 0.38)
    force, moment = ply.expected()
    assert ply.speed < 1e-6 and np.radians(20.0) < ply.angle < np.radians(24.0)
    assert ply.force == pytest.approx(force, rel=0.02)
    assert ply.moment == pytest.approx(moment, rel=0.02)
