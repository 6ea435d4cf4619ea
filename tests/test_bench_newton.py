"""Scenes of `wrod bench newton` that are small in every way."""

import numpy as np
import pytest


def test_many_worlds():
    """Every scene has its row: a step in a graph is the same, and a pile loses energy."""
    pytest.importorskip("newton")
    from wrod.bench.newton_many import gradients_of_steps, graph_of_a_step, worlds_of_cables
    from wrod.bench.newton_piles import Pile, measure

    (row,) = worlds_of_cables("cpu", 2, 10, 0.25, (10,))
    assert 0.0 < row["tip_error_over_length"] < 0.02
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
    ply = wind(60, 6.0)
    force, moment = ply.expected()
    assert ply.speed < 1e-6 and np.radians(20.0) < ply.angle < np.radians(24.0)
    assert ply.force == pytest.approx(force, rel=0.02)
    assert ply.moment == pytest.approx(moment, rel=0.02)
