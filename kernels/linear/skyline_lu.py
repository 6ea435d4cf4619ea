"""Direct solution of a row's unsymmetric matrix with the coupling of contacts: skyline L U.

Nodes are in the order of `wrod.kernels.linear.skyline_order`, and blocks of 4 x 4 where
`wrod.kernels.linear.skyline` has them: block (p, b) at `row[p] + b` of `lower`, on whose diagonal
are inverses once it is factorised, and (b, p) at the same place of `upper`. There is no pivoting,
as in `wrod.kernels.linear.banded_lu`. One row a thread.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.linear.coupling import free_of
from wrod.kernels.linear.skyline_order import Skyline, is_solved


def make_filling(matrix: type, entry: wp.Function) -> wp.Kernel:
    """What writes a struct's matrix, as `wrod.kernels.linear.banded_lu.make_assembly` does."""

    @wp.func
    def block_of(m: matrix, free: wp.array2d(dtype=wp.int32), r: int, v: int, u: int):
        out = wp.mat44d()
        for c in range(4):
            for d in range(4):
                a = 4 * v + c
                b = 4 * u + d
                if free_of(free, r, v, c) > ZERO and free_of(free, r, u, d) > ZERO:
                    if wp.abs(a - b) <= HALF_BANDWIDTH:
                        out[c, d] = entry(m, r, a, b)
                elif a == b:
                    out[c, d] = ONE
        return out

    # Unrolled, `entry` is written out 32 times, which takes a GPU's compiler 40 s.
    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def fill(
        # State in:
        skyline: Skyline,
        free: wp.array2d(dtype=wp.int32),
        m: matrix,
        # Out:
        lower_out: wp.array2d(dtype=wp.mat44d),
        upper_out: wp.array2d(dtype=wp.mat44d),
    ):
        """Blocks of the rods themselves, those of what is not free as of the identity, and zero
        elsewhere. Launched over (rod, node)."""
        r, v = wp.tid()
        if not is_solved(skyline, r):
            return
        p = skyline.rank[r, v]
        at = skyline.row[r, p]
        for b in range(skyline.first[r, p], p + 1):
            u = skyline.order[r, b]
            lower = wp.mat44d()
            upper = wp.mat44d()
            if wp.abs(u - v) <= 2:
                lower = block_of(m, free, r, v, u)
                upper = block_of(m, free, r, u, v)
            lower_out[r, at + b] = lower
            upper_out[r, at + b] = upper

    return fill


@wp.func
def inverse_of(m: wp.mat44d) -> wp.mat44d:
    """By elimination without pivoting, which keeps what is soft beside what is stiff."""
    a = m
    out = wp.identity(4, dtype=wp.float64)
    for c in range(4):
        pivot = ONE / a[c, c]
        for x in range(4):
            a[c, x] = a[c, x] * pivot
            out[c, x] = out[c, x] * pivot
        for y in range(4):
            if y != c:
                factor = a[y, c]
                for x in range(4):
                    a[y, x] = a[y, x] - factor * a[c, x]
                    out[y, x] = out[y, x] - factor * out[c, x]
    return out


@wp.kernel
def factorise(
    # State in:
    skyline: Skyline,
    # State in and out:
    lower: wp.array2d(dtype=wp.mat44d),
    upper: wp.array2d(dtype=wp.mat44d),
):
    """L U in place, U with the diagonal's blocks."""
    r = wp.tid()
    if not is_solved(skyline, r):
        return
    for p in range(skyline.first.shape[1]):
        start = skyline.first[r, p]
        at = skyline.row[r, p]
        diagonal = lower[r, at + p]
        for b in range(start, p):
            there = skyline.row[r, b]
            left = lower[r, at + b]
            above = upper[r, at + b]
            for c in range(wp.max(start, skyline.first[r, b]), b):
                left = left - lower[r, at + c] * upper[r, there + c]
                above = above - lower[r, there + c] * upper[r, at + c]
            left = left * lower[r, there + b]
            lower[r, at + b] = left
            upper[r, at + b] = above
            diagonal = diagonal - left * above
        lower[r, at + p] = inverse_of(diagonal)


@wp.kernel
def solve(
    # State in:
    skyline: Skyline,
    free: wp.array2d(dtype=wp.int32),
    lower: wp.array2d(dtype=wp.mat44d),
    upper: wp.array2d(dtype=wp.mat44d),
    # Scratch:
    y: wp.array3d(dtype=wp.vec4d),
    # State in and out:
    x: wp.array3d(dtype=ALONE),
):
    """Solve in place; what is not free comes out as zero. Launched over (rod, right-hand side)."""
    r, j = wp.tid()
    if not is_solved(skyline, r):
        return
    n = skyline.first.shape[1]
    for p in range(n):
        v = skyline.order[r, p]
        value = wp.vec4d()
        for c in range(4):
            if 4 * v + c < x.shape[2]:
                value[c] = x[r, j, 4 * v + c][0] * free_of(free, r, v, c)
        at = skyline.row[r, p]
        for b in range(skyline.first[r, p], p):
            value = value - lower[r, at + b] * y[r, j, b]
        y[r, j, p] = value
    for back in range(n):
        p = n - 1 - back
        at = skyline.row[r, p]
        value = lower[r, at + p] * y[r, j, p]
        y[r, j, p] = value
        for b in range(skyline.first[r, p], p):
            y[r, j, b] = y[r, j, b] - upper[r, at + b] * value
        v = skyline.order[r, p]
        for c in range(4):
            if 4 * v + c < x.shape[2]:
                x[r, j, 4 * v + c] = ALONE(value[c])
