"""Banded factorisations and solutions against dense ones, and a GPU's against a CPU's."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from wrod.kernels.linear import banded, banded_ends, banded_lanes, factor_lanes, two_warps

from wrod.rods.state import full_hessian

needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
SIZES = (7, 11, 31, 32, 33, 42, 43, 64, 95, 179)
RODS, COLUMNS = 5, 3


def problem(n, seed=0, by_nodes=True):
    """Indefinite matrices that differ from rod to rod, `by_nodes` of four that are coupled with two
    before them; the last rod is not active."""
    rng = np.random.default_rng([seed, n])
    hessian = rng.normal(size=(RODS, n, 11))
    if by_nodes:
        hessian[:, np.arange(11) > np.arange(n)[:, None] % 4 + 8] = 0.0
    hessian[:, :, 0] += rng.uniform(-12, 24, (RODS, n))
    free = rng.random((RODS, n)) > 0.15
    free[0] = True
    shift = rng.normal(size=RODS)
    active = np.arange(RODS) < RODS - 1
    return hessian, free, shift, active, rng.normal(size=(RODS, COLUMNS, n))


def run(kernels, device, hessian, free, shift, active, right):
    """(factor, negative pivots, solutions) of the kernels, on a CPU over one lane."""
    lanes = () if kernels is banded else ((1,) if device == "cpu" else (32,))
    rods, n = free.shape

    def array(value, dtype):
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=device)

    active, free = array(active, wp.int32), array(free, wp.int32)
    factor = wp.full((rods, n, 11), 7.0, dtype=wp.float64, device=device)
    negative = wp.full(rods, -1, dtype=wp.int32, device=device)
    x = array(right, wp.float64)
    block = lanes[0] if lanes else 1
    whole = [wp.array([wp.vec2i(0, n)], dtype=wp.vec2i, device=device)] if lanes else []
    lanes = (1, *lanes) if lanes else ()
    wp.launch(
        kernels.factorise,
        dim=(rods, *lanes),
        inputs=[*whole, active, free, array(hessian, wp.float64), array(shift, wp.float64)],
        outputs=[factor, negative],
        device=device,
        block_dim=block,
    )
    wp.launch(
        kernels.solve,
        dim=(rods, right.shape[1], *lanes),
        inputs=[*whole, active, free, factor],
        outputs=[x],
        device=device,
        block_dim=block,
    )
    return factor.numpy().copy(), negative.numpy().copy(), x.numpy().copy()


BY_WARPS = SimpleNamespace(factorise=factor_lanes.factorise, solve=banded_lanes.solve)
WAYS = [
    pytest.param(banded, "cpu", id="thread-cpu"),
    pytest.param(BY_WARPS, "cpu", id="warp-cpu"),
    pytest.param(BY_WARPS, "cuda:0", id="warp-gpu", marks=needs_gpu),
]


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_factors_inertia_and_solutions_are_those_of_dense_matrices(kernels, device, n):
    hessian, free, shift, active, right = problem(n, by_nodes=kernels is banded)
    factor, negative, x = run(kernels, device, hessian, free, shift, active, right)
    for r in np.flatnonzero(active):
        f = free[r]
        dense = (full_hessian(hessian[r]) + shift[r] * np.eye(n))[np.ix_(f, f)]
        lower = np.eye(n)
        for k in range(1, min(n, 11)):
            rows = np.arange(k, n)
            lower[rows, rows - k] = factor[r, k:, k]
        again = lower @ np.diag(factor[r, :, 0]) @ lower.T
        # Without pivoting rounding grows with the entries of L D L^T.
        growth = np.abs(lower @ np.diag(np.abs(factor[r, :, 0])) @ lower.T).max()
        growth = max(growth, (np.abs(lower) * np.abs(factor[r, :, 0])).max(), np.abs(dense).max())
        assert np.abs(again[np.ix_(f, f)] - dense).max() < 1e-14 * growth
        assert (again[~f] == np.eye(n)[~f]).all()
        assert negative[r] == (np.linalg.eigvalsh(dense) < 0).sum()
        residual = np.abs(x[r][:, f] @ dense - right[r][:, f]).max()
        assert residual < 1e-13 * growth * np.abs(x[r]).max()
        assert (x[r][:, ~f] == 0).all()


@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_rods_that_are_not_active_are_left_alone(kernels, device):
    hessian, free, shift, active, right = problem(43, by_nodes=kernels is banded)
    factor, negative, x = run(kernels, device, hessian, free, shift, active, right)
    assert (factor[-1] == 7.0).all() and negative[-1] == -1
    assert (x[-1] == right[-1]).all()


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize(("kernels", "device"), WAYS[1:])
def test_a_warp_finds_what_a_thread_finds(kernels, device, n):
    case = problem(n, seed=1)
    rods = np.flatnonzero(case[3])
    factor, negative, x = run(banded, "cpu", *case)
    warp_factor, warp_negative, warp_x = run(kernels, device, *case)
    band = np.arange(11) <= np.arange(n)[:, None]
    assert np.allclose(factor[rods][:, band], warp_factor[rods][:, band], rtol=1e-8, atol=1e-8)
    assert (negative == warp_negative).all()
    assert np.allclose(x, warp_x, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_a_pivot_that_cancels_keeps_a_size(kernels, device):
    """The second row of [[1, 1], [1, 1]] has the pivot 0; its factor is tiny and finite."""
    n = 40
    hessian = np.zeros((1, n, 11))
    hessian[:, :, 0] = 1.0
    hessian[:, 35, 1] = 1.0  # couples rows 35 and 34
    case = hessian, np.ones((1, n), bool), np.zeros(1), np.ones(1, bool), np.ones((1, 1, n))
    factor, negative, x = run(kernels, device, *case)
    assert 0 < factor[0, 35, 0] < 1e-12 and negative[0] == 0
    assert np.isfinite(factor).all() and np.isfinite(x).all()


def from_ends(device, hessian, free, shift, active, right):
    """(negative pivots, solutions) for the first right-hand sides by `banded_ends`."""
    rods, n = free.shape
    block = 1 if device == "cpu" else two_warps.ENDS

    def array(value, dtype):
        return wp.array(np.ascontiguousarray(value), dtype=dtype, device=device)

    negative = wp.full(rods, -1, dtype=wp.int32, device=device)
    x = wp.full((rods, 2, n), 7.0, dtype=wp.float64, device=device)
    scratch = wp.zeros((rods, n, 11), dtype=wp.float64, device=device)
    inputs = [array(active, wp.int32), array(free, wp.int32), array(hessian, wp.float64)]
    inputs += [array(right[:, 0], wp.float64), array(shift, wp.float64)]
    wp.launch(
        banded_ends.solve,
        dim=(rods, 1, block),
        inputs=[wp.array([wp.vec2i(0, n)], dtype=wp.vec2i, device=device), *inputs],
        outputs=[scratch, x, negative],
        device=device,
        block_dim=block,
    )
    return negative.numpy().copy(), x.numpy().copy()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=needs_gpu)])
def test_eliminating_from_both_ends_finds_what_a_thread_finds(device):
    for n in (3, 10, 11, 21, 30, 31, 32, 41, 42, 43, 52, 53, 75, 76, 106, 107, 179, 703):
        case = problem(n, seed=2)
        case[0][:, :, 0] *= 3.0  # still indefinite, but no pivot is small by chance
        _, negative, x = run(banded, "cpu", *case)
        ends_negative, ends_x = from_ends(device, *case)
        assert (negative == ends_negative).all(), n
        active = np.flatnonzero(case[3])
        error = np.abs(x[active, 0] - ends_x[active, 0]).max()
        assert error < 1e-9 * np.abs(x[active, 0]).max(), n
        assert (ends_x[-1] == 7.0).all() and (ends_x[:, 1] == 7.0).all()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=needs_gpu)])
@pytest.mark.parametrize("at", [3, 35, 36])
def test_pivots_that_cancel_keep_a_size_from_both_ends(device, at):
    n = 40
    hessian = np.zeros((1, n, 11))
    hessian[:, :, 0] = 1.0
    hessian[:, at, 1] = 1.0
    right = np.ones((1, 1, n))
    right[:, :, at - 1 : at + 1] = 0.0
    case = hessian, np.ones((1, n), bool), np.zeros(1), np.ones(1, bool), right
    negative, x = from_ends(device, *case)
    assert negative[0] == 0 and np.allclose(x[0, 0], right[0, 0])
