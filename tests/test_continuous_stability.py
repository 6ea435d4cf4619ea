"""Which equilibria of the continuous rod are stable: the loads of a column."""

import numpy as np
import pytest

from wrod.bench.continuous_rod import Experiment, _solve, constant
from wrod.bench.continuous_stability import conjugate_points
from wrod.rods.material import RodMaterial

# So stiff that its weight is a 40 000th of what buckles it.
ROD = RodMaterial(0.002, 5.0, 0.5, density=1.0)


def points_of(load: float) -> int:
    """Conjugate points of a rod that stands straight between clamps under a load [N], free to
    buckle in one plane only."""
    shortened = load * ROD.length / ROD.stretching_stiffness
    u = np.linspace(0.0, 1.0, 41)
    state = np.zeros((13, len(u)))
    state[2], state[3], state[9] = (ROD.length - shortened) * u, 1.0, -load
    ends = state[:3, 0], np.eye(3), state[:3, -1], np.eye(3)
    found, rhs = _solve(ROD, Experiment(bending=constant(1.0, 20.0)), 1.0, *ends, (u, state))
    assert abs(found.y[:2]).max() < 1e-6  # it stands straight, stable or not
    return conjugate_points(rhs, found.sol)


@pytest.mark.parametrize(
    ("load", "count"),
    [(20.0, 0), (38.5, 0), (40.5, 1), (79.5, 1), (82.0, 2), (156.0, 2), (160.0, 3)],
)
def test_a_column_buckles_at_its_critical_loads(load, count):
    """Between clamps P L^2 / B is (2 pi)^2 = 39.5, then 80.8, four times the square of the first
    root of tan x = x, then (4 pi)^2 = 157.9."""
    assert points_of(load * ROD.bending_stiffness / ROD.length**2) == count
