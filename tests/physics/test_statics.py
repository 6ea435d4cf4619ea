"""Equilibria against closed forms of elastic rods."""

import numpy as np
import pytest
import warp as wp
from scipy.integrate import solve_bvp

from wrod.rods.batch import RodBatch
from wrod.solvers.statics import prescribe, solve_equilibria


def straight_rods(node_count, length, direction, rod_count=1, **properties):
    s = np.linspace(0.0, length, node_count)
    position = np.broadcast_to(
        s[:, None] * np.asarray(direction, dtype=float), (rod_count, node_count, 3)
    )
    edge = length / (node_count - 1)
    mass = np.full(node_count, edge)
    mass[[0, -1]] /= 2
    defaults = dict(
        stretching_stiffness=1e6,
        bending_stiffness=1.0,
        twisting_stiffness=2 / 3,
        node_mass=mass,
        gravity=(0.0, 0.0, 0.0),
    )
    defaults.update(properties)
    return RodBatch(position, **defaults)


def test_heavy_cantilever_small_deflection():
    """Tip deflection w L^4 / (8 B) of a clamped beam under its weight."""
    weight = 1e-3
    batch = straight_rods(81, 1.0, (1, 0, 0), gravity=(0, 0, -weight))
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    result = solve_equilibria(batch)
    assert result.converged.all()
    # The clamp holds the first edge, so the free length starts half an edge later: O(h).
    free = 1.0 - 0.5 / 80
    assert -batch.positions()[0, -1, 2] == pytest.approx(weight * free**4 / 8, rel=2e-3)


def test_heavy_cantilever_large_deflection():
    """Elastica theta'' = w (L - s) cos(theta) / B, theta(0) = 0, theta'(L) = 0."""
    weight, length = 20.0, 1.0

    def rhs(s, y):
        return [y[1], weight * (length - s) * np.cos(y[0])]

    s = np.linspace(0, length, 200)
    sol = solve_bvp(rhs, lambda a, b: [a[0], b[1]], s, np.zeros((2, 200)) - 0.5, tol=1e-10)
    x = np.trapezoid(np.cos(sol.sol(np.linspace(0, 1, 4001))[0]), dx=1 / 4000)
    z = np.trapezoid(np.sin(sol.sol(np.linspace(0, 1, 4001))[0]), dx=1 / 4000)
    tips = []
    for nodes in (41, 81, 161):
        h = length / (nodes - 1)
        # Second-order clamp at s = 0: a ghost edge before it, and at the node between twice the
        # stiffness, since only the half of its length that is free bends.
        s = np.arange(-1, nodes) * h
        position = (s[:, None] * np.array([1.0, 0, 0]))[None]
        mass = np.full(nodes + 1, h)
        mass[[0, 1, -1]] = 0, h / 2, h / 2
        batch = RodBatch(
            position,
            stretching_stiffness=1e6,
            bending_stiffness=np.where(np.arange(nodes + 1) == 1, 2.0, 1.0),
            twisting_stiffness=1.0,
            node_mass=mass,
            gravity=(0, 0, -weight),
        )
        prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
        assert solve_equilibria(batch).converged.all()
        tips.append(np.hypot(batch.positions()[0, -1, 0] - x, batch.positions()[0, -1, 2] - z))
    assert tips[-1] < 2e-4
    assert np.log2(tips[0] / tips[1]) > 1.8
    assert np.log2(tips[1] / tips[2]) > 1.8


def euler_negative_pivots(load, node_count=201):
    """Clamped-free strut under an axial end force: is the straight state still stable?"""
    h = 1.0 / (node_count - 1)
    s = np.arange(-1, node_count) * h
    position = (s[:, None] * np.array([0.0, 0, 1.0]))[None]
    force = np.zeros((node_count + 1, 3))
    force[-1, 2] = -load
    batch = RodBatch(
        position,
        stretching_stiffness=1e6,
        bending_stiffness=1.0,
        twisting_stiffness=1.0,
        point_load=force,
    )
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    system_batch = solve_equilibria(batch, max_iterations=3)
    return int(system_batch.negative_pivots[0])


def test_euler_load_of_a_clamped_rod():
    """P = pi^2 B / (4 L^2); both bending directions lose stability together."""
    critical = np.pi**2 / 4
    assert euler_negative_pivots(critical * 0.995) == 0
    assert euler_negative_pivots(critical * 1.005) == 2


def test_helix_from_natural_curvature_and_twist():
    """Curvature and twist at rest make a helix of that curvature and torsion, free of energy to
    second order."""
    k, t, n = 3.0, 1.2, 161
    batch = straight_rods(n, 3.0, (0, 0, 1), natural_curvature=(k, 0.0), natural_twist=t)
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    assert solve_equilibria(batch).converged.all()
    q = batch.positions()[0]
    d1 = np.gradient(q, 3.0 / (n - 1), axis=0)
    d2 = np.gradient(d1, 3.0 / (n - 1), axis=0)
    d3 = np.gradient(d2, 3.0 / (n - 1), axis=0)
    inner = slice(20, -20)
    binormal = np.cross(d1, d2)[inner]
    curvature = np.linalg.norm(binormal, axis=1) / np.linalg.norm(d1[inner], axis=1) ** 3
    torsion = np.sum(binormal * d3[inner], axis=1) / np.sum(binormal**2, axis=1)
    assert np.abs(curvature - k).max() < 5e-3 * k
    assert np.abs(torsion - t).max() < 5e-3 * k
    # Nothing loads it: what is stored is B k^2 / 2 sin^2(d / 2) of the twist d of an edge.
    stored = batch.evaluate(order=1).energy.numpy()[0]
    assert stored < 1.05 * 0.5 * k**2 * 3.0 * (0.5 * t * 3.0 / (n - 1)) ** 2


def test_rods_of_a_batch_do_not_see_each_other():
    weights = np.array([1.0, 7.0, 30.0])
    gravity = np.zeros((3, 3))
    gravity[:, 2] = -weights
    batch = straight_rods(41, 1.0, (1, 0, 0), rod_count=3, gravity=gravity)
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    assert solve_equilibria(batch).converged.all()
    together = batch.positions()
    for r in range(3):
        alone = straight_rods(41, 1.0, (1, 0, 0), gravity=gravity[r])
        prescribe(alone, clamped_nodes=(0, 1), clamped_angles=(0,))
        solve_equilibria(alone)
        assert np.abs(alone.positions()[0] - together[r]).max() < 1e-9


def test_hopeless_rod_is_flagged_and_others_go_on():
    gravity = [[0.0, 0.0, -50.0], [0.0, 0.0, 0.0]]
    batch = straight_rods(21, 1.0, (1, 0, 0), rod_count=2, gravity=gravity)
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
    result = solve_equilibria(batch, max_iterations=1)
    assert result.converged.tolist() == [False, True]
    assert result.residual[0] > 1e-9
    assert np.isfinite(batch.positions()).all()


def test_continuation_reaches_what_a_cold_start_does_not():
    """A rod folded end to end: in one go its middle cannot tell which way to buckle."""
    batch = straight_rods(41, 1.0, (1, 0, 0), gravity=(0, 0, -5.0))
    prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,), pinned_nodes=(-1,))
    target = batch.state.dof.numpy()
    target[0, -3:] = (0.15, 0.3, 0.2)
    result = solve_equilibria(batch, prescribed=target)
    assert result.converged.all()
    assert result.progress[0] == 1.0
    assert result.negative_pivots[0] == 0
    assert np.abs(batch.positions()[0, -1] - (0.15, 0.3, 0.2)).max() < 1e-12


@pytest.mark.parametrize("layered", [False, True])
def test_a_batch_is_what_its_arrays_are(layered):
    """Other numbers in an array, and another array in its place, are the same rod."""
    tips = []
    for another in (False, True):
        batch = straight_rods(31, 1.0, (1, 0, 0), gravity=(0, 0, -5.0))
        prescribe(batch, clamped_nodes=(0, 1), clamped_angles=(0,))
        if layered:
            batch.set_layers([(np.full((1, 31, 2), 0.5), np.full((1, 31, 2), 0.1))])
        assert solve_equilibria(batch).converged.all()
        before = batch.positions()[0, -1]
        for name, change in (("bending_stiffness", 3.0), ("natural_curvature", 0.4)):
            old = getattr(batch, name)
            values = old.numpy() + change
            if another:
                setattr(batch, name, wp.array(values, dtype=old.dtype, device=batch.device))
            else:
                old.assign(values)
        assert solve_equilibria(batch).converged.all()
        tips.append(batch.positions()[0, -1])
        assert np.abs(tips[-1] - before).max() > 0.1
    assert np.array_equal(*tips)
