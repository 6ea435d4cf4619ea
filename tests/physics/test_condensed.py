"""Contacts condensed to their own unknowns, against the exact factorisation of the same rows."""

import numpy as np
import pytest
import warp as wp
from wrod.kernels.lanes import lanes
from wrod.kernels.linear import dense_lanes

from wrod.rods.batch import RodBatch
from wrod.rods.state import full_hessian
from wrod.solvers.condensed import CondensedSystem
from wrod.solvers.coupled import CoupledSystem
from wrod.solvers.dynamics import Dynamics
from wrod.solvers.friction import Friction
from wrod.solvers.rod_contact import RodContact

RODS, NODES, RADIUS = 4, 9, 0.09
DEVICES = [
    "cpu",
    pytest.param(
        "cuda:0", marks=pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
    ),
]


def heap(spacing, friction=0.5, rows=1, device="cpu"):
    """Wavy rods across each other, one above the other, in rows alike; they weigh 1 each."""
    rng = np.random.default_rng(1)
    x = np.linspace(-0.5, 0.5, NODES)
    rods = []
    for k in range(RODS):
        c, s = np.cos(0.8 * k), np.sin(0.8 * k)
        wave = np.column_stack([x, *(0.006 * rng.normal(size=(2, NODES)))])
        rods.append(wave @ [[c, s, 0], [-s, c, 0], [0, 0, 1]] + [0, 0.01 * k, spacing * k])
    batch = RodBatch(
        np.repeat(np.concatenate(rods)[None], rows, axis=0),
        stretching_stiffness=50.0, bending_stiffness=1e-2, twisting_stiffness=1e-2,
        node_mass=np.full(RODS * NODES, 1.0 / NODES), device=device,
    )  # fmt: skip
    batch.cut(np.arange(1, RODS) * NODES - 1)
    return batch, RodContact(batch, RADIUS, Friction(friction), stiffness=30.0)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("shift", [0.7, 0.004])
def test_solutions_and_inertia(shift, device):
    """Those of the matrix that it stands for, and nearly those of the whole: pairs hardly press, so
    that what is left out, how normals turn, is nothing."""
    batch, contact = heap(1.83 * RADIUS, 3e9, device=device)
    contact.prepare(batch.every_rod, batch.state.dof)
    free = np.ones((1, batch.dof_count), dtype=bool)
    free[0, 5] = free[0, 40:44] = False
    batch.set_free(free)
    before = wp.clone(batch.state.dof)
    moved = before.numpy() + 1e-4 * np.random.default_rng(0).normal(size=before.shape)
    batch.state.dof.assign(moved)
    contact.rubbing.iteration.fill_(5)
    contact.add(batch.every_rod, batch.state.dof, before)
    # Some bristles hold, others slide.
    contact.held_load.assign(np.where(contact.depth.numpy() > 0, 1e-12, 0.0))
    batch.evaluate(order=2)
    contact.add(batch.every_rod, batch.state.dof, before)
    right = np.random.default_rng(3).normal(size=(1, 2, batch.dof_count))
    systems = [kind(contact, 2) for kind in (CondensedSystem, CoupledSystem)]
    for system in systems:
        system.shift.fill_(shift)
        system.factorise(batch.derivatives.hessian, batch.every_rod)
        system.x.assign(right)
        system.solve(batch.every_rod)
    condensed, exact = systems
    count = condensed.pair_count.numpy()[0]
    assert count == exact.pair_count.numpy()[0] > 10
    weight = np.zeros((3 * count, batch.dof_count + 1))
    rows = condensed._weight.numpy()[0][: 18 * count].reshape(count, 2, 3, 3, 4)
    for n, pair in enumerate(condensed.touching.numpy()[0][:count]):
        for end in range(2):
            for k in range(2):
                at = 4 * (pair[end] + k)
                weight[3 * n : 3 * n + 3, at : at + 4] += rows[n, end, k]
    f, weight = free[0], weight[:, :-1]
    matrix = full_hessian(batch.derivatives.hessian.numpy()[0]) + shift * np.eye(len(f))
    matrix = (matrix + weight.T @ weight)[np.ix_(f, f)]
    x = condensed.x.numpy()[0]
    assert (x[:, ~f] == 0).all()
    assert np.abs(x[:, f] @ matrix - right[0][:, f]).max() < 1e-9 * np.abs(x).max()
    negative = (np.linalg.eigvalsh(matrix) < 0).sum()
    assert condensed.negative_pivots.numpy()[0] == exact.negative_pivots.numpy()[0] == negative
    if shift > 0.1:
        assert negative == 0 and x == pytest.approx(exact.x.numpy()[0], abs=2e-3)
    else:
        assert negative > 0


@pytest.mark.parametrize("device", DEVICES)
def test_dense_solutions_and_inertia(device):
    """Of indefinite matrices of no tile, of one and of six, beside each other, against NumPy; what
    is above the diagonal is never read."""
    sizes, room = [0, 1, 6], 7 * dense_lanes.TILE
    rng = np.random.default_rng(4)
    given = np.full((3, room, room), np.nan)
    scale, right = np.ones((3, room)), rng.normal(size=(3, 2, room))
    whole = []
    for r, tiles in enumerate(sizes):
        n = tiles * dense_lanes.TILE
        root = rng.normal(size=(n, n))
        sign = np.where(np.arange(n) % 5 == 3, -1.0, 1.0)
        whole.append(root @ root.T / max(n, 1) + 40.0 * np.diag(sign))
        given[r, :n, :n] = np.where(np.tri(n) != 0, whole[r], np.nan)
        scale[r, :n] = np.diag(whole[r])

    def floats(values):
        return wp.array(values, dtype=wp.float64, device=device)

    count, arrived, negative = (
        wp.array(n, dtype=wp.int32, device=device) for n in (sizes, [0] * 3, [0] * 3)
    )
    matrix, x = floats(given), floats(right)
    panel, diagonal = (floats(np.full((3, n, dense_lanes.TILE), np.nan)) for n in (2 * room, room))
    there = wp.get_device(device)
    blocks = max(1, there.sm_count // 3) if there.is_cuda else 1
    inputs, outputs = [count, floats(scale), blocks], [arrived, matrix, panel, negative, diagonal]
    for kernel, dim, block, arguments in (
        (dense_lanes.factorise, blocks, dense_lanes.BLOCK, [*inputs, *outputs]),
        (dense_lanes.solve, 2, dense_lanes.SOLVE_BLOCK, [count, matrix, diagonal, x]),
    ):
        most = lanes(device, block)
        wp.launch(kernel, (3, dim, most), arguments, device=device, block_dim=most)
    for r, a in enumerate(whole):
        n = len(a)
        assert -negative.numpy()[r] == (np.linalg.eigvalsh(a) < 0).sum()
        assert x.numpy()[r, :, :n] @ a == pytest.approx(right[r, :, :n], abs=1e-12)
    assert negative.numpy()[2] < 0


def collide(kind, friction, device):
    """Rods that fly into each other, without gravity: where they end up and what they keep."""
    batch, contact = heap(2.02 * RADIUS, friction, 2, device)
    dynamics = Dynamics(batch, radius=RADIUS, contact=contact, tolerance=1e-9, keeps_recording=True)
    dynamics.system = kind(contact)
    velocity = np.zeros((2, RODS, NODES, 3))
    velocity[:, :, :, 2] = -0.3 * np.arange(RODS)[:, None]
    velocity[0, :, :, 0] = 0.1 * np.arange(RODS)[:, None]
    dynamics.set_velocity(velocity.reshape(2, -1, 3))
    energy = dynamics.energy()
    assert not dynamics.advance(0.15, 0.01).diverged.any()
    assert (dynamics.energy() < energy).all()
    momentum = dynamics.velocities().mean(axis=1)
    assert momentum == pytest.approx(velocity.mean(axis=(1, 2)), abs=1e-9)
    return batch.positions(), dynamics


@pytest.mark.parametrize("device", DEVICES)
def test_rods_move_as_with_the_exact_factorisation(device):
    """The same positions after the same steps, momentum conserved, energy lost; what is left out of
    the matrix costs no iterations. (Friction is balanced within 5 %, which tells where it slides.)
    """
    found, dynamics = collide(CondensedSystem, 0.0, device)
    expected, exact = collide(CoupledSystem, 0.0, device)
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.abs(found[1] - found[0]).max() > 1e-3  # rows have their own
    assert (dynamics.iteration_count.numpy() < 1.1 * exact.iteration_count.numpy()).all()
    rubbed, _ = collide(CondensedSystem, 0.5, device)
    assert rubbed == pytest.approx(collide(CoupledSystem, 0.5, device)[0], abs=5e-3)
    assert np.abs(rubbed - found).max() > 1e-3
