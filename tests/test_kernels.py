"""Energies, gradients and Hessians against each other, on rods that differ in everything."""

import importlib
import pkgutil

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from wrod import kernels
from wrod.rods.batch import RodBatch
from wrod.rods.state import full_hessian, node_positions


def deformed_rods(rod_count=4, node_count=7, seed=0, **changes):
    """Strongly bent and twisted, anisotropic, naturally curved and twisted rods."""
    rng = np.random.default_rng(seed)
    edges = rng.normal(size=(rod_count, node_count - 1, 3)) + [1.2, 0.0, 0.0]
    position = np.cumsum(np.concatenate([rng.normal(size=(rod_count, 1, 3)), edges], 1), 1)
    shape = (rod_count, node_count)
    arguments = dict(
        rest_length=rng.uniform(0.7, 1.6, (rod_count, node_count - 1)),
        stretching_stiffness=rng.uniform(1, 5, (rod_count, node_count - 1)),
        bending_stiffness=rng.uniform(0.5, 3, (*shape, 2)),
        twisting_stiffness=rng.uniform(0.5, 3, shape),
        natural_curvature=rng.normal(size=(*shape, 2)),
        natural_twist=rng.normal(size=shape),
        softening=rng.uniform(0, 0.8, (*shape, 2)) * rng.integers(0, 2, (*shape, 1)),
        node_mass=rng.uniform(0.1, 1, shape),
        gravity=rng.normal(size=(rod_count, 3)),
        point_load=rng.normal(size=(*shape, 3)),
    )
    arguments.update(changes)
    batch = RodBatch(position, **arguments)
    batch.set_configuration(position, angle=rng.normal(size=(rod_count, node_count - 1)))
    return batch


# Rods whose bending energy is an invariant of the edges alone, by a way of its own in the kernel.
ISOTROPIC = dict(bending_stiffness=1.7, natural_curvature=0.0, softening=0.0)
KINDS = [(seed, {}) for seed in range(3)] + [(3, ISOTROPIC)]


def displaced(batch, change, order):
    """Derivatives after a change of the degrees of freedom, frames carried along in time."""
    from wrod.rods.state import Derivatives, RodState

    state = RodState.zeros(batch.rod_count, batch.node_count, batch.device)
    state.assign(batch.state)
    state.dof.assign(batch.state.dof.numpy() + change)
    batch.transport_frames(batch.state, state, batch.every_rod)
    out = Derivatives.zeros(batch.rod_count, batch.dof_count, batch.device)
    return batch.evaluate(order=order, state=state, out=out)


def fourth_order(f, step):
    """Central difference quotient with an error of step^4."""
    return (8 * (f(step) - f(-step)) - (f(2 * step) - f(-2 * step))) / (12 * step)


@pytest.mark.parametrize(("seed", "kind"), KINDS)
def test_gradient_is_the_slope_of_the_energy(seed, kind):
    batch = deformed_rods(seed=seed, **kind)
    gradient = batch.evaluate(order=1).gradient.numpy()
    numeric = np.empty_like(gradient)
    for a in range(batch.dof_count):
        change = np.zeros(batch.dof_count)
        change[a] = 1.0
        numeric[:, a] = fourth_order(
            lambda h, change=change: displaced(batch, h * change, 1).energy.numpy(), 1e-3
        )
    assert np.abs(numeric - gradient).max() < 1e-7 * np.abs(gradient).max()


def beyond_two_nodes(batch):
    """(dof, 11) where the band of a Hessian couples a node with one more than two before it."""
    return np.arange(11) > np.arange(batch.dof_count)[:, None] % 4 + 8


@pytest.mark.parametrize(("seed", "kind"), KINDS)
def test_hessian_is_the_curvature_of_the_energy(seed, kind):
    """Second differences of the energy alone: independent of the gradient's formula.

    Differencing the gradient would show the holonomy of two successive transports as well, which
    is antisymmetric and not part of the Hessian; its symmetric part is compared below.
    """
    batch = deformed_rods(seed=seed, **kind)
    band = batch.evaluate(order=2).hessian.numpy()
    assert not band[:, beyond_two_nodes(batch)].any()
    jacobian = np.empty((batch.rod_count, batch.dof_count, batch.dof_count))
    for a in range(batch.dof_count):
        change = np.zeros(batch.dof_count)
        change[a] = 1.0
        jacobian[:, :, a] = fourth_order(
            lambda h, change=change: displaced(batch, h * change, 1).gradient.numpy(), 1e-3
        )
    for r in range(batch.rod_count):
        dense = full_hessian(band[r])
        symmetric = 0.5 * (jacobian[r] + jacobian[r].T)
        assert np.abs(symmetric - dense).max() < 1e-7 * np.abs(dense).max()
    rng = np.random.default_rng(seed)
    for _ in range(5):
        change = rng.normal(size=batch.dof_count)

        def energy(h, change=change):
            return displaced(batch, h * change, 1).energy.numpy()

        h = 1e-3
        second = (
            -energy(2 * h) + 16 * energy(h) - 30 * energy(0.0) + 16 * energy(-h) - energy(-2 * h)
        ) / (12 * h**2)
        for r in range(batch.rod_count):
            assert second[r] == pytest.approx(change @ full_hessian(band[r]) @ change, rel=1e-6)


def without_loads(**changes):
    return deformed_rods(gravity=0.0, point_load=0.0, **changes)


def test_twist_does_not_soften_bending():
    """E = 2 B tan^2(phi / 2) / l at every node of an isotropic rod, however much it is twisted;
    an anisotropic one has that for the mean of its stiffnesses where it is not twisted."""
    for kind in (ISOTROPIC, dict(ISOTROPIC, bending_stiffness=np.array([[[1.2, 2.2]]]))):
        batch = without_loads(seed=7, stretching_stiffness=1e-12, twisting_stiffness=1e-12, **kind)
        edge = np.diff(batch.positions(), axis=1)
        t = edge / np.linalg.norm(edge, axis=2, keepdims=True)
        cosine = (t[:, 1:] * t[:, :-1]).sum(axis=2)
        rest = batch.rest_length.numpy()
        length = 0.5 * (rest[:, 1:] + rest[:, :-1])
        expected = (2 * 1.7 * (1 - cosine) / (1 + cosine) / length).sum(axis=1)
        if kind is ISOTROPIC:
            energy = batch.evaluate(order=1).energy.numpy()
        else:
            # Without twist, and turned by half a right angle more: the mean over both.
            energies = []
            for angle in (0.3, 0.3 + np.pi / 2):
                angles = np.full(rest.shape, angle)
                batch.set_configuration(batch.positions(), angle=angles)
                energies.append(batch.evaluate(order=1).energy.numpy().copy())
            energy = np.mean(energies, axis=0)
        assert energy == pytest.approx(expected, rel=1e-9)


def test_internal_forces_and_torques_cancel():
    """Rotating a rod by w moves nodes by w x q and turns every material frame by w . t more than
    time-parallel transport does; neither changes the energy."""
    batch = without_loads(seed=5)
    gradient = batch.evaluate(order=1).gradient.numpy()
    position = batch.positions()
    force = node_positions(gradient)
    twist = gradient[:, 3::4, None] * batch.state.tangent.numpy()
    assert np.abs(force.sum(axis=1)).max() < 1e-12 * np.abs(force).max()
    torque = np.cross(position, force).sum(axis=1) + twist.sum(axis=1)
    assert np.abs(torque).max() < 1e-11 * np.abs(np.cross(position, force)).max()


def test_rigid_motion_changes_nothing_but_directions():
    batch = without_loads(seed=6)
    before = batch.evaluate(order=1)
    energy, force = before.energy.numpy().copy(), node_positions(before.gradient.numpy()).copy()
    rotation = Rotation.from_rotvec([0.7, -1.9, 0.4]).as_matrix()
    directors = batch.material_directors()[:, :, 0] @ rotation.T
    batch.set_configuration(batch.positions() @ rotation.T + [3.0, -1.0, 2.0], director=directors)
    # The new reference frames are the material ones; the twist between them is counted from
    # scratch, and these rods are twisted by less than half a turn.
    after = batch.evaluate(order=1)
    turns = np.abs(after.energy.numpy() - energy)
    assert turns.max() < 1e-10 * energy.max()
    assert np.abs(node_positions(after.gradient.numpy()) - force @ rotation.T).max() < 1e-9


def test_rods_far_apart_in_a_batch_do_not_mix():
    """The same rod alone and among different ones gives the same numbers."""
    together = deformed_rods(rod_count=3, seed=8).evaluate(order=2)
    energy, hessian = together.energy.numpy().copy(), together.hessian.numpy().copy()
    for r in range(3):
        batch = deformed_rods(rod_count=3, seed=8)
        active = batch.every_rod.numpy().copy()
        active[:] = 0
        active[r] = 1
        batch.every_rod.assign(active)
        alone = batch.evaluate(order=2)
        assert alone.energy.numpy()[r] == pytest.approx(energy[r], rel=1e-14)
        assert np.allclose(alone.hessian.numpy()[r], hessian[r], rtol=1e-13, atol=1e-13)
        assert (alone.energy.numpy()[active == 0] == 0).all()


def test_frames_of_inactive_rods_are_left_alone():
    """A rod that has converged keeps its twist while others are tried again."""
    from wrod.rods.state import RodState

    batch = deformed_rods(rod_count=2, seed=9)
    target = RodState.zeros(2, batch.node_count, batch.device)
    target.assign(batch.state)
    twist = target.reference_twist.numpy()
    twist[:] = 7.0
    active = wp.array([1, 0], dtype=wp.int32, device=batch.device)
    batch.transport_frames(batch.state, target, active)
    assert (target.reference_twist.numpy()[1] == 7.0).all()
    moved = target.reference_twist.numpy()[0, 1:-1]
    assert np.allclose(moved, batch.state.reference_twist.numpy()[0, 1:-1], atol=1e-12)


def test_no_module_has_adjoints_of_warps():
    """`wrod.kernels` says so for all of them, before they are imported."""
    names = [m.name for m in pkgutil.walk_packages(kernels.__path__, "wrod.kernels.")]
    for name in names:
        importlib.import_module(name)
    assert len(names) > 100
    assert not [name for name in names if wp.get_module(name).options["enable_backward"]]
