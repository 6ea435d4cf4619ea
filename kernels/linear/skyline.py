"""Direct solution of a rod's banded system with the coupling of contacts: skyline L D L^T.

Nodes are in the order of `wrod.kernels.linear.skyline_order`. Blocks of 4 x 4 (a node and the angle
of the edge after it) are stored from the first one of each row on; block (p, b) is at `row[p] + b`.
There is no pivoting, as in `wrod.kernels.linear.banded`, so that negative pivots count the negative
eigenvalues of the whole free matrix. One rod a thread.
"""

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.linear.banded import SMALLEST_PIVOT
from wrod.kernels.linear.coupling import free_of
from wrod.kernels.linear.skyline_order import Skyline, is_solved


@wp.func
def unit_lower_solve(m: wp.mat44d, diagonal: wp.mat44d) -> wp.mat44d:
    """X with X l^T = m, l the unit lower triangle of `diagonal`."""
    out = m
    for c in range(1, 4):
        for d in range(4):
            if d < c:
                for x in range(4):
                    out[x, c] = out[x, c] - out[x, d] * diagonal[c, d]
    return out


@wp.func
def over_pivots(m: wp.mat44d, diagonal: wp.mat44d) -> wp.mat44d:
    out = m
    for c in range(4):
        pivot = ONE / diagonal[c, c]
        for x in range(4):
            out[x, c] = m[x, c] * pivot
    return out


@wp.func
def factorise_diagonal(m: wp.mat44d, size: wp.vec4d) -> wp.mat44d:
    """Unit lower triangle, and the pivots on the diagonal; `size` what they were before."""
    out = m
    for c in range(4):
        pivot = out[c, c]
        floor = SMALLEST_PIVOT * (wp.abs(size[c]) + SMALLEST_PIVOT)
        if wp.abs(pivot) < floor:
            pivot = wp.where(pivot < ZERO, -floor, floor)
        out[c, c] = pivot
        for x in range(4):
            if x > c:
                scaled = out[x, c] / pivot
                for y in range(4):
                    if y > c and y <= x:
                        out[x, y] = out[x, y] - scaled * out[y, c]
        for x in range(4):
            if x > c:
                out[x, c] = out[x, c] / pivot
    return out


@wp.kernel
def factorise(
    # State in:
    m: Skyline,
    # State in and out:
    block: wp.array2d(dtype=wp.mat44d),
    # State out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """L D L^T in place, block row by block row from left to right."""
    r, _lane = wp.tid()
    if not is_solved(m, r):
        return
    negative = int(0)
    for p in range(m.first.shape[1]):
        start = m.first[r, p]
        at = m.row[r, p]
        diagonal = block[r, at + p]
        size = wp.vec4d(diagonal[0, 0], diagonal[1, 1], diagonal[2, 2], diagonal[3, 3])
        # Until the second loop the entries are those of L D.
        for b in range(start, p):
            value = block[r, at + b]
            there = m.row[r, b]
            for c in range(wp.max(start, m.first[r, b]), b):
                value = value - block[r, at + c] * wp.transpose(block[r, there + c])
            block[r, at + b] = unit_lower_solve(value, block[r, there + b])
        for b in range(start, p):
            value = block[r, at + b]
            scaled = over_pivots(value, block[r, m.row[r, b] + b])
            diagonal = diagonal - value * wp.transpose(scaled)
            block[r, at + b] = scaled
        diagonal = factorise_diagonal(diagonal, size)
        block[r, at + p] = diagonal
        for c in range(4):
            if diagonal[c, c] < ZERO:
                negative += 1
    negative_pivots_out[r] = negative


@wp.kernel
def solve(
    # State in:
    m: Skyline,
    free: wp.array2d(dtype=wp.int32),
    block: wp.array2d(dtype=wp.mat44d),
    # Scratch:
    y: wp.array2d(dtype=wp.vec4d),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Solve in place for the right-hand side [rod, 0, :]; prescribed ones come out as zero."""
    r, _lane = wp.tid()
    if not is_solved(m, r):
        return
    n = m.first.shape[1]
    for p in range(n):
        v = m.order[r, p]
        value = wp.vec4d()
        for c in range(4):
            if 4 * v + c < x.shape[2]:
                value[c] = x[r, 0, 4 * v + c] * free_of(free, r, v, c)
        at = m.row[r, p]
        for b in range(m.first[r, p], p):
            value = value - block[r, at + b] * y[r, b]
        diagonal = block[r, at + p]
        for c in range(1, 4):
            for d in range(4):
                if d < c:
                    value[c] = value[c] - diagonal[c, d] * value[d]
        y[r, p] = value
    for p in range(n):
        diagonal = block[r, m.row[r, p] + p]
        value = y[r, p]
        for c in range(4):
            value[c] = value[c] / diagonal[c, c]
        y[r, p] = value
    for back in range(n):
        p = n - 1 - back
        at = m.row[r, p]
        diagonal = block[r, at + p]
        value = y[r, p]
        for k in range(4):
            c = 3 - k
            for d in range(4):
                if d > c:
                    value[c] = value[c] - diagonal[d, c] * value[d]
        y[r, p] = value
        for b in range(m.first[r, p], p):
            y[r, b] = y[r, b] - wp.transpose(block[r, at + b]) * value
        v = m.order[r, p]
        for c in range(4):
            if 4 * v + c < x.shape[2]:
                x[r, 0, 4 * v + c] = value[c]
