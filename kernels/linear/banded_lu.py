"""Banded factorisation without pivoting of a matrix that is symmetric but for its nodes' blocks.

The matrix is a Hessian (`wrod.kernels.elastic.assembly`) plus a 3 x 3 block of each node, such as
what friction takes from the normal force. `factor[r, a, 10 + k]` holds U[a, a + k], 1 / U[a, a] for
k = 0, and `factor[r, a, 10 - k]` L[a, a - k]; entries outside the matrix are zero.
"""

from typing import Any

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.lanes import wait_for_lanes

wp.set_module_options({"enable_backward": False})

BAND = wp.constant(2 * 10 + 1)


@wp.func
def jacobian_entry(
    hessian: wp.array3d(dtype=wp.float64),
    coupling: wp.array2d(dtype=wp.mat33d),
    r: int,
    a: int,
    b: int,
) -> wp.float64:
    value = hessian[r, wp.max(a, b), wp.abs(a - b)]
    if a / 4 == b / 4 and a % 4 < 3 and b % 4 < 3:
        value += coupling[r, a / 4][a % 4, b % 4]
    return value


@wp.kernel
def factorise(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    coupling: wp.array2d(dtype=wp.mat33d),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
):
    """A = L U. Rows that are not free are those of the identity; their columns are kept, which is
    how what is prescribed moves the rest. Launched over (rod, lane) in blocks of `TEAM`."""
    r, lane = wp.tid()
    if active[r] == 0:
        return
    n = hessian.shape[1]
    for a in range(lane, n, wp.block_dim()):
        for k in range(BAND):
            b = a + k - HALF_BANDWIDTH
            value = wp.float64(0.0)
            if free[r, a] == 0:
                value = wp.where(b == a, ONE, ZERO)
            elif b >= 0 and b < n:
                value = jacobian_entry(hessian, coupling, r, a, b)
            factor_out[r, a, k] = value
    wait_for_lanes()
    for t in range(n):
        # What row t takes from the ten below it, an entry a lane.
        inverse = ONE / factor_out[r, t, HALF_BANDWIDTH]
        rows = wp.min(HALF_BANDWIDTH, n - 1 - t)
        for m in range(lane, rows * HALF_BANDWIDTH, wp.block_dim()):
            i = m / HALF_BANDWIDTH + 1
            j = m % HALF_BANDWIDTH + 1
            below = factor_out[r, t + i, HALF_BANDWIDTH - i] * inverse
            factor_out[r, t + i, HALF_BANDWIDTH - i + j] = (
                factor_out[r, t + i, HALF_BANDWIDTH - i + j]
                - below * factor_out[r, t, HALF_BANDWIDTH + j]
            )
        wait_for_lanes()
    for a in range(lane, n, wp.block_dim()):
        for k in range(1, wp.min(a, HALF_BANDWIDTH) + 1):
            factor_out[r, a, HALF_BANDWIDTH - k] = (
                factor_out[r, a, HALF_BANDWIDTH - k] / factor_out[r, a - k, HALF_BANDWIDTH]
            )
    wait_for_lanes()
    for a in range(lane, n, wp.block_dim()):
        factor_out[r, a, HALF_BANDWIDTH] = ONE / factor_out[r, a, HALF_BANDWIDTH]


@wp.func
def substitute(factor: wp.array3d(dtype=wp.float64), r: int, p: int, x: wp.array3d(dtype=Any)):
    """Solve L U x = x in place. What is outside the matrix multiplies its first or last unknown by
    zero, so that all rows are of one length."""
    n = x.shape[2]
    for a in range(n):
        value = x[r, p, a]
        for k in range(1, 11):
            value -= factor[r, a, 10 - k] * x[r, p, wp.max(a - k, 0)]
        x[r, p, a] = value
    for back in range(n):
        a = n - 1 - back
        value = x[r, p, a]
        for k in range(1, 11):
            value -= factor[r, a, 10 + k] * x[r, p, wp.min(a + k, n - 1)]
        x[r, p, a] = factor[r, a, 10] * value
