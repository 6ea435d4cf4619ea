"""Assembly of a rod's matrix with the coupling of its contacts, by blocks of 4 x 4: a node and the
angle of the edge after it. Where blocks are stored: see `wrod.kernels.linear.skyline`.
"""

import warp as wp
from wrod.kernels.contact.pair_contact import (
    EdgeMotion,
    Pair,
    Pieces,
    Rubbing,
    edge_motion,
    pair_contact,
)
from wrod.kernels.contact.segments import EDGE, Nearest, piece_chord, piece_size, turning
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ONE, TWO, ZERO
from wrod.kernels.linear.skyline_order import Skyline, is_solved


@wp.func
def free_of(free: wp.array2d(dtype=wp.int32), r: int, v: int, c: int) -> wp.float64:
    """1 if degree of freedom c of node v is free; the last node has no edge after it."""
    a = 4 * v + c
    if a >= free.shape[1]:
        return ZERO
    return wp.float64(free[r, a])


@wp.func_native(
    f"const int WIDTH = {HALF_BANDWIDTH + 1};"
    + """
    const int dofs = hessian.shape[1];
    const double* entries = hessian.data + (size_t)r * dofs * WIDTH;
    const int* open = free.data + (size_t)r * dofs;
    double* out = (double*)(block.data + (size_t)r * block.shape[1] + at);
    for (int c = 0; c < 4; ++c) {
        const int a = 4 * v + c;
        const bool opens = a < dofs && open[a] != 0;
        for (int d = 0; d < 4; ++d) {
            const int b = 4 * u + d, apart = a > b ? a - b : b - a;
            double value = a == b ? 1.0 : 0.0;
            if (opens && apart < WIDTH && b < dofs && open[b] != 0) {
                value = entries[(size_t)(a > b ? a : b) * WIDTH + apart];
                if (a == b) value += shift.data[r];
            }
            out[4 * c + d] = value;
        }
    }
"""
)
def store_block(
    hessian: wp.array3d(dtype=wp.float64),
    free: wp.array2d(dtype=wp.int32),
    shift: wp.array(dtype=wp.float64),
    r: int,
    v: int,
    u: int,
    at: int,
    block: wp.array2d(dtype=wp.mat44d),
):
    """Store block (v, u) of a shifted banded matrix; rows and columns of what is not free, and of
    the angle of the edge that the last node has not, as those of the identity."""
    ...


@wp.func_native("""
    for (int at = first; at < to; ++at)
        block.data[(size_t)r * block.shape[1] + at] = wp::mat_t<4, 4, wp::float64>();
""")
def clear_blocks(r: int, first: int, to: int, block: wp.array2d(dtype=wp.mat44d)): ...


@wp.kernel
def fill_band(
    # State in:
    m: Skyline,
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    lanes: int,
    # State out:
    block_out: wp.array2d(dtype=wp.mat44d),
):
    """Row of node v: blocks of the rod itself, and zero elsewhere. Launched over (rod, node, 5), or
    1: five lanes share a row, one for each node near v along the rod, or one takes all."""
    r, v, k = wp.tid()
    if not is_solved(m, r):
        return
    p = m.rank[r, v]
    at = m.row[r, p]
    if lanes == 1:
        clear_blocks(r, at + m.first[r, p], at + p, block_out)
    else:
        for b in range(m.first[r, p] + k, p, lanes):
            if wp.abs(m.order[r, b] - v) > 2:
                block_out[r, at + b] = wp.mat44d()
    for near in range(k, 5, lanes):
        u = v + near - 2
        if u >= 0 and u < m.rank.shape[1]:
            b = m.rank[r, u]
            if b <= p:
                store_block(hessian, free, shift, r, v, u, at + b, block_out)


@wp.struct
class Share:
    """One node's part in a pair: derivative of the distance, of the two closest points (halved),
    and of the surfaces' relative motion (rows x, y, z)."""

    distance: wp.vec4d
    first: wp.vec4d
    second: wp.vec4d
    x: wp.vec4d
    y: wp.vec4d
    z: wp.vec4d
    weight: wp.float64
    chord: wp.float64
    second_piece: int


@wp.func
def with_zero(v: wp.vec3d) -> wp.vec4d:
    return wp.vec4d(v[0], v[1], v[2], ZERO)


@wp.func
def share(c: Pair, pieces: Pieces, r: int, pair: wp.vec3i, k: int) -> Share:
    """Nodes of the first piece, and then those of the second."""
    out = Share()
    near = c.near
    kind = pieces.kind[r, pair[0]]
    size = piece_size(kind)
    m = EdgeMotion()
    sign = ONE
    n = k
    if k < size:
        m = edge_motion(kind, near.first, near.s, -pieces.radius[r, pair[0]], c.normal)
        turn = near.first_turn
        out.first = with_zero(m.weight[n] * near.first + m.slope[n] * near.gap)
        out.second = with_zero(-m.weight[n] * near.second)
    else:
        sign = -ONE
        out.second_piece = 1
        n = k - size
        kind = pieces.kind[r, pair[1]]
        m = edge_motion(kind, near.second, near.t, pieces.radius[r, pair[1]], c.normal)
        turn = near.second_turn
        out.first = with_zero(-m.weight[n] * near.first)
        out.second = with_zero(m.weight[n] * near.second - m.slope[n] * near.gap)
    out.weight = sign * m.weight[n]
    chord = piece_chord(kind)
    out.chord = chord[n]
    turn = out.chord * turn
    out.distance = with_zero((out.weight * near.gap + near.small * turn) / near.distance)
    out.first = near.free_s * (out.first + with_zero(TWO * near.small_s * turn))
    out.second = near.free_t * (out.second + with_zero(TWO * near.small_t * turn))
    part = m.slope[n] * m.swing + m.weight[n] * wp.identity(3, dtype=wp.float64)
    spin = wp.vec3d(ZERO, ZERO, ZERO)
    if n == 0:
        spin = (ONE - m.share) * m.spin
    if n == 1 and kind != EDGE:
        spin = m.share * m.spin
    out.x = sign * wp.vec4d(part[0, 0], part[0, 1], part[0, 2], spin[0])
    out.y = sign * wp.vec4d(part[1, 0], part[1, 1], part[1, 2], spin[1])
    out.z = sign * wp.vec4d(part[2, 0], part[2, 1], part[2, 2], spin[2])
    return out


@wp.func
def turning_block(near: Nearest, a: Share, b: Share) -> wp.mat44d:
    """Second derivative of half the small terms by the chords."""
    e = near.first_chord
    f = near.second_chord
    if a.second_piece != 0:
        e = near.second_chord
        f = near.first_chord
    m = (a.chord * b.chord * near.small) * turning(e, f, a.second_piece != b.second_piece)
    return wp.mat44d(
        m[0, 0], m[0, 1], m[0, 2], ZERO, m[1, 0], m[1, 1], m[1, 2], ZERO,
        m[2, 0], m[2, 1], m[2, 2], ZERO, ZERO, ZERO, ZERO, ZERO,
    )  # fmt: skip


@wp.struct
class PairMatrix:
    """A touching pair, the force that its matrix turns with, and the inverse of the 2 x 2 matrix of
    its closest points."""

    pair: Pair
    held: wp.float64
    inverse_ss: wp.float64
    inverse_st: wp.float64
    inverse_tt: wp.float64


@wp.func
def pair_matrix(
    m: Pieces,
    rubbing: Rubbing,
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    r: int,
    pair: wp.vec3i,
) -> PairMatrix:
    """It turns with at most the force of the last step: that of a predictor which is deep inside
    would make the matrix indefinite and lead Newton astray."""
    out = PairMatrix()
    # The number of an iteration rises before its matrix is made.
    begins = rubbing.iteration[r] <= 2
    load = rubbing.load[r, pair[0], pair[2]]
    c = pair_contact(m, rubbing, dt, dof, dof_before, begins, r, pair[0], pair[1], pair[2])
    out.pair = c
    out.held = wp.min(c.force, load)
    ss = c.near.ss
    tt = c.near.tt
    st = c.near.free_s * c.near.free_t * wp.dot(c.near.first, c.near.second)
    det = ss * tt - st * st
    out.inverse_ss = tt / det
    out.inverse_st = st / det
    out.inverse_tt = ss / det
    return out


@wp.func
def block_of(m: PairMatrix, pieces: Pieces, r: int, pair: wp.vec3i, k: int, n: int) -> wp.mat44d:
    """Block k, n of a pair's matrix: Hessian of its energy, with the force that is held in the part
    that comes from the turning of the normal, and stiffness of the bristle."""
    a = share(m.pair, pieces, r, pair, k)
    b = share(m.pair, pieces, r, pair, n)
    near = m.pair.near
    d = near.distance
    w = a.weight * b.weight
    curving = wp.diag(wp.vec4d(w, w, w, ZERO)) + turning_block(near, a, b)
    curving = curving - wp.outer(a.first, m.inverse_ss * b.first + m.inverse_st * b.second)
    curving = curving - wp.outer(a.second, m.inverse_st * b.first + m.inverse_tt * b.second)
    out = (m.pair.slope + m.held / d) * wp.outer(a.distance, b.distance) - (m.held / d) * curving
    g = m.pair.tangential
    out = out + wp.outer(a.x, g[0, 0] * b.x + g[0, 1] * b.y + g[0, 2] * b.z)
    out = out + wp.outer(a.y, g[1, 0] * b.x + g[1, 1] * b.y + g[1, 2] * b.z)
    out = out + wp.outer(a.z, g[2, 0] * b.x + g[2, 1] * b.y + g[2, 2] * b.z)
    return out


@wp.func
def node_of(pair: wp.vec3i, size: int, k: int) -> int:
    """Node k of a pair whose first piece has `size`."""
    return wp.where(k < size, pair[0] + k, pair[1] + k - size)


@wp.kernel
def add_pairs(
    # Model:
    pieces: Pieces,
    # State in:
    skyline: Skyline,
    free: wp.array2d(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    rubbing: Rubbing,
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    teams: int,
    # State in and out:
    block: wp.array2d(dtype=wp.mat44d),
):
    """Add the matrices of all touching pairs of a rod. Launched over (rod, team, lane)."""
    r, team, lane = wp.tid()
    if not is_solved(skyline, r):
        return
    # Sixteen lanes share a pair, where there are as many: one for each block of two edges.
    parts = wp.min(wp.block_dim(), 16)
    width = wp.block_dim() // parts
    for n in range(team * width + lane // parts, count[r], teams * width):
        pair = touching[r, n]
        m = pair_matrix(pieces, rubbing, step[r], dof, dof_before, r, pair)
        size = piece_size(pieces.kind[r, pair[0]])
        all = size + piece_size(pieces.kind[r, pair[1]])
        for k in range(lane % parts, all * all, parts):
            v = node_of(pair, size, k // all)
            u = node_of(pair, size, k % all)
            p = skyline.rank[r, v]
            q = skyline.rank[r, u]
            if q <= p:
                new = block_of(m, pieces, r, pair, k // all, k % all)
                for x in range(4):
                    for y in range(4):
                        new[x, y] = new[x, y] * free_of(free, r, v, x) * free_of(free, r, u, y)
                wp.atomic_add(block, r, skyline.row[r, p] + q, new)


@wp.kernel
def multiply_pairs(
    # Model:
    pieces: Pieces,
    # State in:
    active: wp.array(dtype=wp.int32),
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    rubbing: Rubbing,
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    vector: wp.array3d(dtype=wp.float64),
    # State in and out:
    product: wp.array3d(dtype=wp.float64),
):
    """Add the product of the matrices of all touching pairs with every vector [rod, j, :]."""
    r, lane = wp.tid()
    if active[r] == 0 or coupled[r] == 0 or overflow[r] != 0:
        return
    parts = wp.min(wp.block_dim(), 16)
    for n in range(lane // parts, count[r], wp.block_dim() // parts):
        pair = touching[r, n]
        m = pair_matrix(pieces, rubbing, step[r], dof, dof_before, r, pair)
        size = piece_size(pieces.kind[r, pair[0]])
        all = size + piece_size(pieces.kind[r, pair[1]])
        for k in range(lane % parts, all * all, parts):
            v = node_of(pair, size, k // all)
            u = node_of(pair, size, k % all)
            block = block_of(m, pieces, r, pair, k // all, k % all)
            for w in range(vector.shape[1]):
                for x in range(4):
                    value = wp.float64(0.0)
                    for y in range(4):
                        if 4 * u + y < vector.shape[2]:
                            value += block[x, y] * vector[r, w, 4 * u + y]
                    if value != ZERO:
                        wp.atomic_add(product, r, w, 4 * v + x, value)
