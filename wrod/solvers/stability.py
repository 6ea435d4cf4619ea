"""Elastic stability: the smallest eigenvalue of the constrained Hessian of every rod of a batch.

An equilibrium is stable when no eigenvalue of its free Hessian H is negative. How many are is the
number of negative pivots of the factorisation (Sylvester). How far the nearest is from zero is the
smallest lambda of H v = lambda M v, M the rest length that each node stands for: the stiffness per
length of the softest sideways motion, which does not depend on the mesh.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wrod.kernels.linear.spectrum import shift_by_mass
from wrod.rods.batch import RodBatch
from wrod.solvers.banded import BandedSystem

_VECTORS = 3
_MAX_ITERATIONS = 40
_TOLERANCE = 1e-4
# Shifts tried below zero until the factorisation has no negative pivot, in units of k_b / L^4.
_FIRST_SHIFT, _SHIFT_GROWTH, _SHIFTS = 1.0, 8.0, 16


def smallest_eigenvalue(
    batch: RodBatch,
    *,
    factor: wp.array | None = None,
    negative_pivots: np.ndarray | None = None,
) -> np.ndarray:
    """Smallest eigenvalue of the free Hessian by block inverse iteration.

    Args:
        batch: the rods in the configurations asked about, with their free degrees of freedom.
        factor, negative_pivots: of the Hessian there without a shift, where they are at hand.

    Returns:
        (rod,) eigenvalues [force/length^2]; their signs agree with the negative pivots. Where the
        iteration does not settle the value is an upper bound, as every Rayleigh quotient is.
    """
    rods, dofs, device = batch.rod_count, batch.dof_count, batch.device
    rest = batch.rest_length.numpy()
    mass = np.zeros((rods, dofs))
    for axis in range(3):
        mass[:, axis:-3:4] += rest / 2
        mass[:, 4 + axis :: 4] += rest / 2
    mass *= batch.free.numpy()
    mass_device = wp.array(mass, dtype=wp.float64, device=device)
    system = BandedSystem(batch, right_hand_sides=_VECTORS)
    if factor is None or negative_pivots is None:
        system.factorise(batch.evaluate(order=2).hessian, batch.every_rod)
        negative_pivots = system.negative_pivots.numpy().copy()
    else:
        system.factor = factor
    shift = np.zeros(rods)
    unstable = negative_pivots > 0
    if unstable.any():
        system.factor, hessian = wp.clone(system.factor), batch.evaluate(order=2).hessian
        unit = batch.bending_stiffness.numpy()[:, 1:-1].max(axis=(1, 2)) / rest.sum(axis=1) ** 4
        shift = _shift_below(system, hessian, mass_device, unit, unstable)
    return _inverse_iteration(system, mass, shift)


def _shift_below(system, hessian, mass, unit, unstable) -> np.ndarray:
    """Shift every unstable rod to below its spectrum, and factorise there."""
    batch, device = system.batch, system.batch.device
    shift = np.where(unstable, -_FIRST_SHIFT * unit, 0.0)
    pending = unstable.copy()
    shifted = wp.clone(hessian)
    for _ in range(_SHIFTS):
        active = wp.array(pending.astype(np.int32), dtype=wp.int32, device=device)
        wp.launch(
            shift_by_mass,
            dim=(batch.rod_count, batch.dof_count),
            inputs=[active, hessian, mass, wp.array(shift, dtype=wp.float64, device=device)],
            outputs=[shifted],
            device=device,
        )
        system.factorise(shifted, active)
        pending &= system.negative_pivots.numpy() > 0
        if not pending.any():
            break
        shift[pending] *= _SHIFT_GROWTH
    return shift


def _inverse_iteration(system, mass, shift) -> np.ndarray:
    """Rayleigh-Ritz on a block of vectors under repeated (H - shift M)^-1 M."""
    batch = system.batch
    rods, dofs, device = batch.rod_count, batch.dof_count, batch.device
    # The same start for every rod and every call; any with a share of the softest motion serves.
    block = np.random.default_rng(0).standard_normal((_VECTORS, dofs))
    x = np.array(np.broadcast_to(block, (rods, _VECTORS, dofs)))
    # Smooth starts: a softest motion is one long wave.
    s = np.linspace(0.0, np.pi, dofs)
    for j in range(_VECTORS):
        x[:, j] = 0.05 * x[:, j] + np.sin((1 + j // 2) * s) * (np.arange(dofs) % 4 == (1 + j) % 3)
    value = np.full(rods, np.inf)
    active = np.ones(rods, dtype=bool)
    for _ in range(_MAX_ITERATIONS):
        flags = wp.array(active.astype(np.int32), dtype=wp.int32, device=device)
        system.x.assign(x * mass[:, None])
        system.solve(flags)
        y = system.x.numpy()[active]
        m = mass[active]
        # H y = M x, so both Gram matrices need the masses only.
        stiffness = np.einsum("rja,ra,rka->rjk", y, m, x[active])
        stiffness = 0.5 * (stiffness + stiffness.transpose(0, 2, 1))
        gram = np.einsum("rja,ra,rka->rjk", y, m, y)
        lower = np.linalg.cholesky(gram + 1e-14 * _trace(gram) * np.eye(_VECTORS))
        inverse = np.linalg.inv(lower)
        ritz, vectors = np.linalg.eigh(inverse @ stiffness @ inverse.transpose(0, 2, 1))
        x[active] = np.einsum("rkj,rkl,rla->rja", vectors, inverse, y)
        new = shift[active] + ritz[:, 0]
        settled = np.abs(new - value[active]) <= _TOLERANCE * np.maximum(
            np.abs(new), 1e-3 * np.abs(ritz[:, -1])
        )
        value[active] = new
        active[active] = ~settled
        if not active.any():
            break
    return value


def _trace(matrix: np.ndarray) -> np.ndarray:
    return np.trace(matrix, axis1=1, axis2=2)[:, None, None]
