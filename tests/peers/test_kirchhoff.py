"""Grasps against a continuous Kirchhoff rod solved by collocation (SciPy), not by elements."""

import numpy as np
import pytest
from continuum import guess_of, kirchhoff_grasp

from wrod.grasps.optimal import solve_grasps


@pytest.mark.parametrize(
    "ls, kappa, ks",
    [
        (1.2, 0.7, 300.0),
        (2.5, 3.3, 8000.0),
        (6.0, 2.2, 150.0),
        (14.0, 0.2, 15000.0),
        (23.0, 1.4, 900.0),
        (49.0, 2.9, 4000.0),
    ],
)
def test_grasp_of_the_continuum(ls, kappa, ks):
    grasps = solve_grasps(ls, kappa, ks)
    position, rotation, force = kirchhoff_grasp(ls, kappa, ks, guess_of(ls, kappa, ks))
    assert np.abs(grasps.position[0] - position).max() < 2e-3
    assert np.abs(grasps.rotation[0] - rotation).max() < 2e-3
    assert np.abs(grasps.force[0] - force).max() < 2e-3
