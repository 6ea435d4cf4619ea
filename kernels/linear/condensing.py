"""Contacts of many rods condensed to their own unknowns: (B + W^T W) x = g by

    S = 1 + W B^-1 W^T,    S t = W B^-1 g,    x = B^-1 (g - W^T t),

where B has the rods without their contacts, a banded matrix each, and three rows of W belong to
each pair that touches: the root of its stiffness times the motion of its surfaces. S couples pairs
that share a rod. B + W^T W has as many negative eigenvalues as B less those of S (Haynsworth).

Left out of W is how the normal turns, with the pair's force over the distance of its centrelines;
it vanishes where rods cross. Ends of pairs are counted 2 pair + (0, 1), rows of W end by end, three
nodes each: the last is empty for edges.
"""

import warp as wp
from wrod.kernels.contact.pair_contact import Pair, Pieces, Rubbing
from wrod.kernels.contact.segments import piece_size
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO
from wrod.kernels.linear.banded_lanes import solve_rod
from wrod.kernels.linear.coupling import free_of, pair_matrix, share
from wrod.kernels.linear.dense_lanes import TILE

NODES = wp.constant(3)
TILE_SIZE = wp.constant(TILE)


@wp.func
def stiffness_root(c: Pair) -> wp.mat33d:
    """Root of normal and tangential stiffness."""
    n = c.normal
    out = wp.sqrt(wp.max(c.slope, ZERO)) * wp.outer(n, n)
    trace = wp.trace(c.tangential)
    if trace > ZERO:
        # By Cayley and Hamilton, in the plane of contact.
        double = wp.max(trace * trace - wp.ddot(c.tangential, c.tangential), ZERO)
        root = wp.sqrt(HALF * double)
        plane = wp.identity(3, dtype=wp.float64) - wp.outer(n, n)
        out = out + (c.tangential + root * plane) / wp.sqrt(trace + TWO * root)
    return out


@wp.kernel
def weigh_pairs(
    # Model:
    pieces: Pieces,
    # State in:
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    rubbing: Rubbing,
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    # State out:
    weight_out: wp.array2d(dtype=wp.vec4d),
    tiles_out: wp.array(dtype=wp.int32),
    arrived_out: wp.array(dtype=wp.int32),
):
    """W, and how many tiles S has; nobody has begun on them. Launched over (row, pair)."""
    r, n = wp.tid()
    chosen = coupled[r] != 0 and overflow[r] == 0
    if n == 0:
        arrived_out[r] = 0
        tiles_out[r] = wp.where(chosen, (3 * count[r] + TILE_SIZE - 1) // TILE_SIZE, 0)
    if not chosen or n >= count[r]:
        return
    pair = touching[r, n]
    m = pair_matrix(pieces, rubbing, step[r], dof, dof_before, r, pair)
    root = stiffness_root(m.pair)
    size = piece_size(pieces.kind[r, pair[0]])
    for end in range(2):
        first = pair[end]
        nodes = piece_size(pieces.kind[r, first])
        for k in range(NODES):
            at = 3 * (NODES * (2 * n + end) + k)
            if k < nodes:
                s = share(m.pair, pieces, r, pair, end * size + k)
                for b in range(3):
                    row = root[b, 0] * s.x + root[b, 1] * s.y + root[b, 2] * s.z
                    for c in range(4):
                        row[c] = row[c] * free_of(free, r, first + k, c)
                    weight_out[r, at + b] = row
            else:
                for b in range(3):
                    weight_out[r, at + b] = wp.vec4d(ZERO, ZERO, ZERO, ZERO)


@wp.kernel
def solve_pairs(
    # Model:
    segment: wp.array(dtype=wp.vec2i),
    segment_of: wp.array(dtype=wp.int32),
    # State in:
    tiles: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    weight: wp.array2d(dtype=wp.vec4d),
    stride: int,
    # State out:
    z_out: wp.array3d(dtype=wp.float64),
):
    """B^-1 W^T, a column for each row of each end over the degrees of freedom of its rod. Launched
    over (row, columns in turns of `stride`, lane)."""
    r, begin, lane = wp.tid()
    if tiles[r] == 0:
        return
    for column in range(begin, 6 * count[r], stride):
        end = column // 3
        first = touching[r, end // 2][end % 2]
        part = segment[segment_of[first]]
        at = 4 * first - part[0]
        for a in range(lane, part[1], wp.block_dim()):
            value = wp.float64(0.0)
            k = (a - at) // 4
            if a >= at and k < NODES:
                value = weight[r, 3 * (NODES * end + k) + column % 3][a - at - 4 * k]
            z_out[r, column, a] = value
        solve_rod(free, factor, r, column, part[0], part[1], 0, z_out)


@wp.func
def weighed(
    weight: wp.array2d(dtype=wp.vec4d),
    z: wp.array3d(dtype=wp.float64),
    r: int,
    at: int,
    b: int,
    column: int,
    first: int,
    count: int,
) -> wp.float64:
    """Row b of the end that W has at `at`, times a column that begins `first` before its nodes."""
    value = wp.float64(0.0)
    for k in range(NODES):
        w = weight[r, at + 3 * k + b]
        for c in range(4):
            a = first + 4 * k + c
            if a < count:
                value += w[c] * z[r, column, a]
    return value


@wp.kernel
def condense(
    # Model:
    segment: wp.array(dtype=wp.vec2i),
    segment_of: wp.array(dtype=wp.int32),
    # State in:
    tiles: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    weight: wp.array2d(dtype=wp.vec4d),
    z: wp.array3d(dtype=wp.float64),
    stride: int,
    # State out:
    matrix_out: wp.array3d(dtype=wp.float64),
    size_out: wp.array2d(dtype=wp.float64),
):
    """S below its diagonal, filled up to whole tiles. Launched over (row, entries in turns of
    `stride`)."""
    r, begin = wp.tid()
    if tiles[r] == 0:
        return
    n = 3 * count[r]
    for e in range(begin, n * n, stride):
        p = e // n
        q = e % n
        if q <= p:
            value = wp.where(p == q, ONE, ZERO)
            for x in range(2):
                first = touching[r, p // 3][x]
                s = segment_of[first]
                for y in range(2):
                    if segment_of[touching[r, q // 3][y]] == s:
                        at = 4 * first - segment[s][0]
                        row = 3 * NODES * (2 * (p // 3) + x)
                        column = 6 * (q // 3) + 3 * y + q % 3
                        value += weighed(weight, z, r, row, p % 3, column, at, segment[s][1])
            matrix_out[r, p, q] = value
            if p == q:
                size_out[r, p] = value
    last = TILE_SIZE * tiles[r]
    for e in range(begin, (last - n) * last, stride):
        p = n + e // last
        q = e % last
        if q <= p:
            matrix_out[r, p, q] = wp.where(p == q, ONE, ZERO)
            size_out[r, p] = ONE


@wp.kernel
def gather(
    # State in:
    tiles: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    weight: wp.array2d(dtype=wp.vec4d),
    x: wp.array3d(dtype=wp.float64),
    # State out:
    t_out: wp.array3d(dtype=wp.float64),
):
    """W x. Launched over (row, right-hand side, unknown of S)."""
    r, j, a = wp.tid()
    if a >= TILE_SIZE * tiles[r]:
        return
    value = wp.float64(0.0)
    n = a // 3
    if n < count[r]:
        for end in range(2):
            first = 4 * touching[r, n][end]
            at = 3 * NODES * (2 * n + end)
            for k in range(NODES):
                w = weight[r, at + 3 * k + a % 3]
                for c in range(4):
                    if first + 4 * k + c < x.shape[2]:
                        value += w[c] * x[r, j, first + 4 * k + c]
    t_out[r, j, a] = value


@wp.kernel
def scatter(
    # State in:
    tiles: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    weight: wp.array2d(dtype=wp.vec4d),
    t: wp.array3d(dtype=wp.float64),
    # State in and out:
    push: wp.array3d(dtype=wp.float64),
):
    """Add W^T t to zeros. Launched over (row, right-hand side, end)."""
    r, j, end = wp.tid()
    if tiles[r] == 0 or end >= 2 * count[r]:
        return
    n = end // 2
    first = 4 * touching[r, n][end % 2]
    for k in range(NODES):
        at = 3 * (NODES * end + k)
        sum = t[r, j, 3 * n] * weight[r, at]
        sum = sum + t[r, j, 3 * n + 1] * weight[r, at + 1]
        sum = sum + t[r, j, 3 * n + 2] * weight[r, at + 2]
        for c in range(4):
            if sum[c] != ZERO:
                wp.atomic_add(push, r, j, first + 4 * k + c, sum[c])


@wp.kernel
def clear(
    # State in:
    tiles: wp.array(dtype=wp.int32),
    # State out:
    push_out: wp.array3d(dtype=wp.float64),
):
    """Zeros, in rows that touch."""
    r, j, a = wp.tid()
    if tiles[r] != 0:
        push_out[r, j, a] = ZERO


@wp.kernel
def take_off(
    # State in:
    tiles: wp.array(dtype=wp.int32),
    change: wp.array3d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Subtract what contacts change of the solutions."""
    r, j, a = wp.tid()
    if tiles[r] != 0:
        x[r, j, a] = x[r, j, a] - change[r, j, a]
