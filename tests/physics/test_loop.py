"""The loop that measures a rod, against the heavy elastica."""

import numpy as np
import pytest
from folded_loop import loop_height
from scipy.integrate import solve_bvp
from scipy.interpolate import CubicSpline

from wrod.rods.material import LOOP_HEIGHT_RATIO


def elastica_loop_height():
    """theta'' = (F - s/2) cos(theta) from a flat, moment-free start to a flat, moment-free end."""

    def rhs(u, y, p):
        force, length = p
        return length * np.stack([y[1], (force - u * length / 2) * np.cos(y[0]), np.sin(y[0])])

    def ends(a, b, p):
        return np.array([a[0], a[1], a[2], b[0] - np.pi, b[1]])

    u = np.linspace(0.0, 1.0, 201)
    coarse = [0.0, 0.4, 1.4, 2.5, 3.3, 3.6, 3.7, 3.6, 3.4, 3.2, np.pi]
    theta = CubicSpline(np.linspace(0.0, 1.0, 11), coarse)(u)
    guess = np.stack([theta, np.gradient(theta, u) / 6, 6 * np.cumsum(np.sin(theta)) / 201])
    found = solve_bvp(rhs, ends, u, guess, p=[2.0, 6.0], tol=1e-10, max_nodes=100000)
    assert found.success
    return found.sol(np.linspace(0.0, 1.0, 20001))[2].max()


def test_loop_height_of_the_discrete_rod():
    exact = elastica_loop_height()
    assert exact == pytest.approx(1.14224, abs=1e-5)
    assert loop_height() == pytest.approx(exact, abs=5e-5)
    assert pytest.approx(exact, abs=1e-5) == LOOP_HEIGHT_RATIO
