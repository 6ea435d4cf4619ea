"""Skyline factorisation and solution on a GPU, one rod a block: the same L and D as `skyline`.

Launched over (rod, lane); the lanes share a rod's work, a block column of L at a time, and wait for
each other in between. They take blocks line by line: line x of block (p, b) is
`block[rod, 4 (row[p] + b) + x]`.
"""

import warp as wp
from wrod.kernels.banded import SMALLEST_PIVOT
from wrod.kernels.coupling import free_of
from wrod.kernels.frames import ONE, ZERO
from wrod.kernels.lanes import wait_for_lanes

wp.set_module_options({"enable_backward": False})


@wp.func
def four(values: wp.array2d(dtype=wp.float64), r: int, p: int) -> wp.vec4d:
    """Those of the node in place p."""
    a = 4 * p
    return wp.vec4d(values[r, a], values[r, a + 1], values[r, a + 2], values[r, a + 3])


@wp.struct
class Diagonal:
    """Factor of a diagonal block: unit lower triangle with the pivots on the diagonal, and their
    reciprocals."""

    factor: wp.mat44d
    inverse: wp.vec4d


@wp.func
def factorise_diagonal(
    block: wp.array2d(dtype=wp.vec4d), r: int, at: int, size: wp.vec4d
) -> Diagonal:
    """Of lines at, at + 1...; `size` is what the diagonal was at first."""
    out = wp.matrix_from_rows(block[r, at], block[r, at + 1], block[r, at + 2], block[r, at + 3])
    found = Diagonal()
    for c in range(4):
        pivot = out[c, c]
        floor = SMALLEST_PIVOT * (wp.abs(size[c]) + SMALLEST_PIVOT)
        if wp.abs(pivot) < floor:
            pivot = wp.where(pivot < ZERO, -floor, floor)
        out[c, c] = pivot
        inverse = ONE / pivot
        found.inverse[c] = inverse
        for x in range(4):
            if x > c:
                scaled = out[x, c] * inverse
                for y in range(4):
                    if y > c and y <= x:
                        out[x, y] = out[x, y] - scaled * out[y, c]
        for x in range(4):
            if x > c:
                out[x, c] = out[x, c] * inverse
    found.factor = out
    return found


@wp.kernel
def factorise(
    # State in:
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    last: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    # Scratch (rod, 4 node): diagonals of the blocks at first, a column of L D and of L.
    size: wp.array2d(dtype=wp.float64),
    product: wp.array2d(dtype=wp.vec4d),
    column: wp.array2d(dtype=wp.vec4d),
    # State in and out:
    block: wp.array2d(dtype=wp.vec4d),
    # State out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """L D L^T in place: block column by block column, each taken off what is to its right."""
    r, lane = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    n = first.shape[1]
    for a in range(lane, 4 * n, wp.block_dim()):
        size[r, a] = block[r, 4 * (row[r, a // 4] + a // 4) + a % 4][a % 4]
    # Four lanes share a block, where there are as many: one for each of its lines.
    parts = wp.min(wp.block_dim(), 4)
    part = lane % parts
    group = lane // parts
    groups = wp.block_dim() // parts
    # Groups take blocks (i, j) of a triangle, i >= j, in turn; this is the first one of each.
    start_i = int(0)
    start_j = int(group)
    while start_j > start_i:
        start_i += 1
        start_j -= start_i
    negative = int(0)
    wait_for_lanes()
    for b in range(n):
        at = 4 * (row[r, b] + b)
        below = last[r, b] - b
        before = wp.vec4d(
            size[r, 4 * b], size[r, 4 * b + 1], size[r, 4 * b + 2], size[r, 4 * b + 3]
        )
        diagonal = factorise_diagonal(block, r, at, before)
        d = diagonal.factor
        for i in range(group, below, groups):
            p = b + 1 + i
            if first[r, p] <= b:
                for x in range(part, 4, parts):
                    line = 4 * (row[r, p] + b) + x
                    m = block[r, line]
                    m[1] = m[1] - m[0] * d[1, 0]
                    m[2] = m[2] - m[0] * d[2, 0] - m[1] * d[2, 1]
                    m[3] = m[3] - m[0] * d[3, 0] - m[1] * d[3, 1] - m[2] * d[3, 2]
                    product[r, 4 * p + x] = m
                    m = wp.cw_mul(m, diagonal.inverse)
                    column[r, 4 * p + x] = m
                    block[r, line] = m
        wait_for_lanes()
        if lane == 0:
            for x in range(4):
                block[r, at + x] = d[x]
                if d[x, x] < ZERO:
                    negative += 1
        i = int(start_i)
        j = int(start_j)
        while i < below:
            p = b + 1 + i
            q = b + 1 + j
            if first[r, p] <= b and first[r, q] <= b:
                for x in range(part, 4, parts):
                    line = 4 * (row[r, p] + q) + x
                    m = product[r, 4 * p + x]
                    change = wp.vec4d(
                        wp.dot(m, column[r, 4 * q]),
                        wp.dot(m, column[r, 4 * q + 1]),
                        wp.dot(m, column[r, 4 * q + 2]),
                        wp.dot(m, column[r, 4 * q + 3]),
                    )
                    block[r, line] = block[r, line] - change
            j += groups
            while j > i:
                i += 1
                j -= i
        wait_for_lanes()
    if lane == 0:
        negative_pivots_out[r] = negative


@wp.kernel
def solve(
    # State in:
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    order: wp.array2d(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    last: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    block: wp.array2d(dtype=wp.vec4d),
    # Scratch (rod, 4 node), in the new order:
    y: wp.array2d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Solve in place for the right-hand side [rod, 0, :]; prescribed ones come out as zero."""
    r, lane = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    n = first.shape[1]
    parts = wp.min(wp.block_dim(), 4)
    part = lane % parts
    group = lane // parts
    groups = wp.block_dim() // parts
    for a in range(lane, 4 * n, wp.block_dim()):
        v = order[r, a // 4]
        y[r, a] = ZERO
        if 4 * v + a % 4 < x.shape[2]:
            y[r, a] = x[r, 0, 4 * v + a % 4] * free_of(free, r, v, a % 4)
    wait_for_lanes()
    for b in range(n):
        # Every lane finds what is known now, and takes it off some of the rows that need it.
        at = 4 * (row[r, b] + b)
        known = four(y, r, b)
        for c in range(1, 4):
            line = block[r, at + c]
            for d in range(3):
                if d < c:
                    known[c] = known[c] - line[d] * known[d]
        for i in range(group, last[r, b] - b, groups):
            p = b + 1 + i
            if first[r, p] <= b:
                for c in range(part, 4, parts):
                    a = 4 * p + c
                    y[r, a] = y[r, a] - wp.dot(block[r, 4 * (row[r, p] + b) + c], known)
        wait_for_lanes()
        if lane == 0:
            for c in range(4):
                y[r, 4 * b + c] = known[c] / block[r, at + c][c]
    wait_for_lanes()
    for back in range(n):
        p = n - 1 - back
        at = 4 * (row[r, p] + p)
        known = four(y, r, p)
        for k in range(3):
            line = block[r, at + 3 - k]
            for d in range(3):
                if d < 3 - k:
                    known[d] = known[d] - line[d] * known[3 - k]
        for b in range(first[r, p] + group, p, groups):
            at_b = 4 * (row[r, p] + b)
            for c in range(part, 4, parts):
                value = y[r, 4 * b + c]
                for k in range(4):
                    value -= block[r, at_b + k][c] * known[k]
                y[r, 4 * b + c] = value
        wait_for_lanes()
        if lane == 0:
            v = order[r, p]
            for c in range(4):
                if 4 * v + c < x.shape[2]:
                    x[r, 0, 4 * v + c] = known[c]
