"""Smallest eigenvalues against buckling loads and vibrations of beams."""

import numpy as np
import pytest
from scipy.linalg import eigh

from wrod.rods.batch import RodBatch
from wrod.rods.state import full_hessian
from wrod.solvers.banded import BandedSystem
from wrod.solvers.stability import smallest_eigenvalue
from wrod.solvers.statics import prescribe, solve_equilibria


def columns(end_load, weight, edges=100):
    """Straight columns of unit length and stiffness, clamped below, under end load and weight."""
    end_load, weight = np.broadcast_arrays(np.atleast_1d(end_load), np.atleast_1d(weight))
    n, h = len(end_load), 1.0 / edges
    force = np.zeros((n, edges + 2, 3))
    force[:, -1, 2] = -end_load
    mass = np.full(edges + 2, h)
    mass[[0, 1, -1]] = 0.0, h / 2, h / 2
    # The column under load is shorter by its strain: put it there, in balance.
    below = end_load[:, None] + weight[:, None] * (1.0 - (np.arange(edges) + 0.5) * h)
    strain = np.concatenate([np.zeros((n, 1)), below / 1e6], axis=1)
    z = np.concatenate([np.full((n, 1), -h), -h + np.cumsum((1 - strain) * h, axis=1)], axis=1)
    position = np.zeros((n, edges + 2, 3))
    position[:, :, 2] = z
    # Ghost edge and twice the stiffness at the clamp: second order.
    stiffness = np.where(np.arange(edges + 2) == 1, 2.0, 1.0)
    batch = RodBatch(
        position,
        rest_length=h,
        stretching_stiffness=1e6,
        bending_stiffness=stiffness,
        twisting_stiffness=stiffness,
        node_mass=mass,
        gravity=np.stack([0 * weight, 0 * weight, -weight], axis=1),
        point_load=force,
    )
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    return batch


def critical(load, eigenvalue):
    """Load at which the eigenvalue changes sign, between neighbours."""
    assert eigenvalue[0] > 0.0 > eigenvalue[-1]
    return np.interp(0.0, -eigenvalue, load)


def test_columns_stand_in_balance():
    batch = columns([2.0, 0.0], [0.0, 5.0])
    gradient = batch.evaluate(order=1).gradient.numpy()[batch.free.numpy() > 0]
    # Edges of stiffness 1e8, positions to rounding.
    assert np.abs(gradient).max() < 1e-7


def test_euler_load():
    """P = pi^2 B / (4 L^2) of a column clamped at one end."""
    exact = np.pi**2 / 4
    load = exact * np.linspace(0.99, 1.01, 5)
    found = critical(load, smallest_eigenvalue(columns(load, 0.0)))
    assert found == pytest.approx(exact, rel=1e-3)


def test_greenhill_load():
    """w L^3 / B = 7.8373 of a column that buckles under its own weight (Greenhill 1881)."""
    weight = 7.8373 * np.linspace(0.99, 1.01, 5)
    found = critical(weight, smallest_eigenvalue(columns(0.0, weight)))
    assert found == pytest.approx(7.8373, rel=1e-3)


def twisted_shafts(moment, edges, ratio):
    """Straight shafts of unit length and stiffness between clamps, twisted by a moment."""
    n, h = len(moment), 1.0 / edges
    position = np.zeros((n, edges + 3, 3))
    position[:, :, 2] = h * (np.arange(edges + 3) - 1)
    # Half a cell at both clamps.
    stiffness = np.where(np.isin(np.arange(edges + 3), (1, edges + 1)), 2.0, 1.0)
    batch = RodBatch(
        position,
        stretching_stiffness=1e6,
        bending_stiffness=stiffness,
        twisting_stiffness=ratio * stiffness,
    )
    s = np.clip((np.arange(edges + 2) - 0.5) * h, 0.0, 1.0)
    batch.set_configuration(position, angle=moment[:, None] / ratio * s)
    prescribe(batch, clamped_nodes=(0, 1, -2, -1), clamped_angles=(0, -1))
    return batch


@pytest.mark.parametrize("edges", [50, 100])
@pytest.mark.parametrize("ratio", [0.6, 2 / 3])
def test_greenhill_shaft(edges, ratio):
    """M L / B = 8.98682, twice the root of tan x = x, of a shaft between clamps (Greenhill 1883):
    it depends neither on the stiffness against twist nor on the twist of an edge, 0.3 or 0.15."""
    exact = 8.986818916
    moment = exact * np.linspace(0.99, 1.01, 5)
    found = critical(moment, smallest_eigenvalue(twisted_shafts(moment, edges, ratio)))
    # Differences of waves of that number err by (k h)^2 / 12.
    assert found == pytest.approx(exact, rel=1.1 * (exact / edges) ** 2 / 12)


def test_eigenvalue_of_a_cantilever_is_that_of_its_slowest_vibration():
    """lambda = 1.87510^4 B / L^4, to second order in the edge length."""
    exact = 1.8751040687**4
    errors = [abs(smallest_eigenvalue(columns(0.0, 0.0, n))[0] - exact) for n in (20, 40, 80)]
    assert errors[2] < 3e-4 * exact
    assert errors[1] < 0.3 * errors[0] and errors[2] < 0.3 * errors[1]


def test_agrees_with_dense_eigenvalues_far_below_zero_and_near_it():
    batch = columns([0.0, 2.46, 2.48, 9.0, 60.0], 0.0, edges=40)
    value = smallest_eigenvalue(batch)
    hessian = batch.evaluate(order=2).hessian.numpy().copy()
    rest = batch.rest_length.numpy()[0]
    mass = np.zeros(batch.node_count)
    mass[:-1] += rest / 2
    mass[1:] += rest / 2
    # Angles carry no mass; for an isotropic rod with no twist they do not couple either.
    moving = [a for a in range(8, batch.dof_count) if a % 4 != 3]
    for r in range(batch.rod_count):
        dense = full_hessian(hessian[r])[np.ix_(moving, moving)]
        weights = np.diag([mass[a // 4] for a in moving])
        expected = eigh(dense, weights, eigvals_only=True, subset_by_index=[0, 0])[0]
        assert value[r] == pytest.approx(expected, rel=1e-3, abs=1e-4)


def test_signs_agree_with_negative_pivots():
    batch = columns(np.linspace(0.5, 30.0, 12), 0.0, edges=40)
    hessian = batch.evaluate(order=2).hessian
    system = BandedSystem(batch)
    system.factorise(hessian, batch.every_rod)
    negative = system.negative_pivots.numpy() > 0
    assert negative.any() and not negative.all()
    np.testing.assert_array_equal(smallest_eigenvalue(batch) < 0.0, negative)


def test_a_column_past_its_load_does_not_stay_on_the_saddle():
    """Hardly disturbed at three times Euler's load, it must end bent and stable."""
    batch = columns([7.4, 7.4], 0.0, edges=40)
    load = batch.point_load.numpy()
    load[:, -1, 0] = 1e-3, -1e-3
    batch.point_load.assign(load)
    result = solve_equilibria(batch, max_iterations=200)
    assert result.converged.all()
    assert (smallest_eigenvalue(batch) > 0.0).all()
    tip = batch.positions()[:, -1, 0]
    assert tip[0] > 0.5 and tip[1] == pytest.approx(-tip[0], abs=1e-6)
