"""What results look like where a user prints them."""

import numpy as np
import pytest

import wrod


@pytest.mark.parametrize("closure", ["zero_tension", "min_friction"])
def test_results_are_shown_in_a_few_lines(closure):
    green = wrod.rod("green-vps")
    plan = wrod.plan(wrod.pattern("circle"), green, closure=closure)
    grasps = wrod.solve_grasps([5.0, 2.0], [1.0, 0.2], 2087.0)
    for result, field in ((plan, "arc_length"), (grasps, "converged")):
        assert f"{field}=array(" in repr(result)
        assert len(repr(result)) < 2000 and "\n" not in repr(result)


def test_a_rod_and_a_pattern_say_what_they_are():
    assert repr(wrod.pattern("circle").scaled(2.0)) == "<Pattern 'circle', 1.068 m>"
    stated = repr(wrod.RodModel.of(wrod.rod("rope")))
    assert "stretching_stiffness=Profile(" in stated and "\n" not in stated
    rising = wrod.Profile(np.linspace(1.0, 2.0, 300), np.linspace(0.0, 0.5, 300))
    assert repr(rising) == "Profile(300 values from 1 to 2 over 0 to 0.5 m)"
