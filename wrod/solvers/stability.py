"""Elastic stability: the smallest eigenvalue of the constrained Hessian of every rod of a batch.

An equilibrium is stable when no eigenvalue of its free Hessian H is negative. How many are is the
number of negative pivots of the factorisation (Sylvester). How far the nearest is from zero is the
smallest lambda of H v = lambda M v, M the rest length that each node stands for: the stiffness per
length of the softest sideways motion, which does not depend on the mesh.
"""

from collections.abc import Callable

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.linear.banded import shift_by_mass
from wrod.rods.batch import RodBatch
from wrod.solvers.banded import BandedSystem

# A step of the search for a critical load looks at this many loads at once.
_LOADS = 9
_VECTORS = 3
_MAX_ITERATIONS = 40
_TOLERANCE = 1e-4
# Shifts tried below zero until the factorisation has no negative pivot, in units of k_b / L^4.
_FIRST_SHIFT, _SHIFT_GROWTH, _SHIFTS = 1.0, 8.0, 16


def smallest_eigenvalue(
    batch: RodBatch, *, factor: wp.array | None = None, negative_pivots: np.ndarray | None = None
) -> np.ndarray:
    """Smallest eigenvalue of the free Hessian by block inverse iteration.

    Args:
        batch: the rods in the configurations asked about, with their free degrees of freedom.
        factor, negative_pivots: of the Hessian there without a shift, where they are at hand.

    Returns:
        (rod,) eigenvalues [force/length^2]; their signs agree with the negative pivots. Where the
        iteration does not settle the value is an upper bound, as every Rayleigh quotient is.
    """
    rest = batch.rest_length.numpy()
    mass = _lumped(rest) * batch.free.numpy()
    mass_device = batch.array(mass)
    system = BandedSystem(batch, right_hand_sides=_VECTORS)
    if factor is None or negative_pivots is None:
        system.factorise(batch.evaluate(order=2).hessian, batch.every_rod)
        negative_pivots = system.negative_pivots.numpy().copy()
    else:
        system.factor = factor
    shift = np.zeros(batch.rod_count)
    unstable = negative_pivots > 0
    if unstable.any():
        system.factor, hessian = wp.clone(system.factor), batch.evaluate(order=2).hessian
        unit = batch.bending_stiffness.numpy()[:, 1:-1].max(axis=(1, 2)) / rest.sum(axis=1) ** 4
        shift = _shift_below(system, hessian, mass_device, unit, unstable)
    return _inverse_iteration(system, mass, shift)


@arguments.checked(RodError, neutral=arguments.number(0.0, 1e6))
def count_unstable_modes(batch: RodBatch, *, neutral: float = 1e-6) -> np.ndarray:
    """How many independent motions lower the energy of every rod where it stands.

    They are negative pivots of H + neutral k_b / L^4 M, k_b the least bending stiffness, M as in
    `smallest_eigenvalue`, and L^2 times the length of an edge for its angle: what costs nothing,
    like moving a rod that nothing holds or spinning one about its axis, is not counted, whichever
    way rounding tips it.

    Args:
        batch: the rods in equilibrium, with their free degrees of freedom.
        neutral: eigenvalues down to minus this, in units of k_b / L^4, count as zero.

    Returns:
        (rod,) counts.

    Raises:
        RodError: `neutral` is negative or not finite.
    """
    rest = batch.rest_length.numpy()
    length = rest.sum(axis=1)
    mass = _lumped(rest)
    mass[:, 3::4] = rest * length[:, None] ** 2
    bending = batch.bending_stiffness.numpy()[:, 1:-1].reshape(batch.rod_count, -1)
    # Of the softer direction, but not of a cut.
    unit = np.where(bending > 0.0, bending, np.inf).min(axis=1) / length**4
    hessian = batch.evaluate(order=2).hessian
    shifted = wp.clone(hessian)
    batch.launch_dofs(
        shift_by_mass,
        [batch.every_rod, hessian, batch.array(mass), batch.array(-neutral * unit)],
        [shifted],
    )
    system = BandedSystem(batch)
    system.factorise(shifted, batch.every_rod)
    return system.negative_pivots.numpy().copy()


@arguments.checked(
    RodError,
    low=arguments.number(),
    high=arguments.number(),
    neutral=arguments.number(0.0, 1e6),
    tolerance=arguments.number(1e-12, 1.0),
)
def find_critical_load(
    equilibria: Callable[[np.ndarray], RodBatch],
    low: float,
    high: float,
    *,
    neutral: float = 1e-6,
    tolerance: float = 1e-5,
) -> tuple[float, int]:
    """The least load at which rods lose stability, between two loads.

    Args:
        equilibria: gives rods that stand in equilibrium under the given (n,) loads, a row each.
        low, high: loads; at the lower one the rods are stable, at the higher one they are not.
        neutral: see `count_unstable_modes`.
        tolerance: to which the load is found, relative to it.

    Returns:
        The load, and how many motions lower the energy just above it.

    Raises:
        RodError: the rods are unstable at `low` or stable at `high`, or the range is none.
    """
    if not low < high:
        raise RodError(f"loads from {low!r} to {high!r} are no range to search")

    def counts(loads):
        return count_unstable_modes(equilibria(loads), neutral=neutral)

    first, last = counts(np.array([low, high]))
    if first or not last:
        raise RodError(
            f"{first} motions are unstable at {low:g} and {last} at {high:g}; give a load below "
            "the critical one and one above it"
        )
    while high - low > tolerance * max(abs(low), abs(high)):
        loads = np.linspace(low, high, _LOADS + 2)
        found = counts(loads[1:-1])
        k = int(np.argmax(np.append(found, last) > 0))
        low, high = loads[k], loads[k + 1]
        last = found[k] if k < _LOADS else last
    return 0.5 * (low + high), int(last)


def _lumped(rest: np.ndarray) -> np.ndarray:
    """(rod, dof) rest length that a node stands for, at its coordinates; 0 at angles."""
    mass = np.zeros((len(rest), 4 * rest.shape[1] + 3))
    for axis in range(3):
        mass[:, axis:-3:4] += rest / 2
        mass[:, 4 + axis :: 4] += rest / 2
    return mass


def _shift_below(system, hessian, mass, unit, unstable) -> np.ndarray:
    """Shift every unstable rod to below its spectrum, and factorise there."""
    batch = system.batch
    shift = np.where(unstable, -_FIRST_SHIFT * unit, 0.0)
    pending = unstable.copy()
    shifted = wp.clone(hessian)
    for _ in range(_SHIFTS):
        active = batch.array(pending, dtype=wp.int32)
        batch.launch_dofs(
            shift_by_mass,
            [active, hessian, mass, batch.array(shift)],
            [shifted],
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
    rods, dofs = batch.rod_count, batch.dof_count
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
        flags = batch.array(active, dtype=wp.int32)
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
