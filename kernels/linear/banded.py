"""Banded direct factorisation, one rod a thread: A = L D L^T with half-bandwidth 10, no pivoting.

Rows and columns of prescribed degrees of freedom (`free` is 0) count as those of the identity.
L overwrites nothing: `factor[r, a, k]` holds L[a, a - k] for k = 1...10 and D[a] for k = 0.
By Sylvester's law the number of negative D is that of the negative eigenvalues of the free block.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ONE, ZERO

wp.set_module_options({"enable_backward": False})

SMALLEST_PIVOT = wp.constant(wp.float64(1.0e-14))


@wp.func
def factorise_row(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.float64,
    factor: wp.array3d(dtype=wp.float64),
    r: int,
    a: int,
) -> wp.float64:
    """Row a of L and its pivot D[a], given the rows above; returns the pivot."""
    if free[r, a] == 0:
        for k in range(1, HALF_BANDWIDTH + 1):
            factor[r, a, k] = ZERO
        return ONE
    first = wp.max(0, a - HALF_BANDWIDTH)
    diagonal = hessian[r, a, 0] + shift
    pivot = wp.float64(diagonal)
    # Left to right; until the second loop divides by D, the entry is (L D)[a, b].
    for b in range(first, a):
        value = hessian[r, a, a - b] * wp.float64(free[r, b])
        for c in range(wp.max(first, b - HALF_BANDWIDTH), b):
            value -= factor[r, a, a - c] * factor[r, b, b - c]
        factor[r, a, a - b] = value
    for b in range(first, a):
        value = factor[r, a, a - b]
        scaled = value / factor[r, b, 0]
        pivot -= value * scaled
        factor[r, a, a - b] = scaled
    # A pivot that cancels to nothing would end as infinity; keep its sign and give it a size.
    floor = SMALLEST_PIVOT * (wp.abs(diagonal) + SMALLEST_PIVOT)
    if wp.abs(pivot) < floor:
        pivot = wp.where(pivot < ZERO, -floor, floor)
    return pivot


@wp.kernel
def factorise(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """Factorise the free block of `hessian + shift * identity` and count its negative pivots."""
    r = wp.tid()
    if active[r] == 0:
        return
    negative = int(0)
    for a in range(hessian.shape[1]):
        pivot = factorise_row(free, hessian, shift[r], factor_out, r, a)
        factor_out[r, a, 0] = pivot
        if pivot < ZERO:
            negative += 1
    negative_pivots_out[r] = negative


@wp.kernel
def solve(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    # In and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Solve L D L^T x = x in place for every right-hand side [rod, j, :].

    Prescribed degrees of freedom come out as zero.
    """
    r, j = wp.tid()
    if active[r] == 0:
        return
    n = factor.shape[1]
    for a in range(n):
        value = x[r, j, a] * wp.float64(free[r, a])
        for k in range(1, wp.min(a, HALF_BANDWIDTH) + 1):
            value -= factor[r, a, k] * x[r, j, a - k]
        x[r, j, a] = value
    for back in range(n):
        a = n - 1 - back
        value = x[r, j, a] / factor[r, a, 0]
        for k in range(1, wp.min(back, HALF_BANDWIDTH) + 1):
            value -= factor[r, a + k, k] * x[r, j, a + k]
        x[r, j, a] = value


@wp.func
def banded_entry(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, b: int) -> wp.float64:
    k = wp.abs(a - b)
    if k > HALF_BANDWIDTH:
        return ZERO
    return hessian[r, wp.max(a, b), k]


@wp.kernel
def multiply(
    # In:
    active: wp.array(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    vector: wp.array3d(dtype=wp.float64),
    # Out:
    product_out: wp.array3d(dtype=wp.float64),
):
    """Product of the whole banded matrix with every vector [rod, j, :]."""
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    n = hessian.shape[1]
    value = wp.float64(0.0)
    for b in range(wp.max(0, a - HALF_BANDWIDTH), wp.min(n, a + HALF_BANDWIDTH + 1)):
        value += banded_entry(hessian, r, a, b) * vector[r, j, b]
    product_out[r, j, a] = value
