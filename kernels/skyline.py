"""Direct solution of a rod's banded system with the coupling of contacts: skyline L D L^T.

Contacts couple nodes that are far apart along the rod. Nodes are renumbered breadth first over the
graph of rod and contacts (reverse Cuthill-McKee), which keeps a row's entries close to the diagonal
even in a knot: its width is that of a few strands. Blocks of 4 x 4 (a node and the angle of the
edge after it) are stored from the first one of each row on; without pivoting, as in
`wrod.kernels.banded`, so that negative pivots count the negative eigenvalues of the whole free
matrix. One rod a thread.
"""

import warp as wp
from wrod.kernels.banded import SMALLEST_PIVOT, banded_entry
from wrod.kernels.frames import ONE, ZERO
from wrod.kernels.rod_contact import Law, Pair, edge_motion, pair_contact

wp.set_module_options({"enable_backward": False})


@wp.kernel
def collect(
    # State in:
    active: wp.array(dtype=wp.int32),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    depth: wp.array3d(dtype=wp.float64),
    # State out:
    count_out: wp.array(dtype=wp.int32),
    touching_out: wp.array2d(dtype=wp.vec3i),
    overflow_out: wp.array(dtype=wp.int32),
    banded_out: wp.array(dtype=wp.int32),
    coupled_out: wp.array(dtype=wp.int32),
):
    """List the touching pairs (i, j, slot), and tell rods with some from rods without."""
    r = wp.tid()
    banded_out[r] = 0
    coupled_out[r] = 0
    if active[r] == 0:
        return
    found = int(0)
    for i in range(partner_count.shape[1]):
        for k in range(partner_count[r, i]):
            if depth[r, i, k] > ZERO:
                if found < touching_out.shape[1]:
                    touching_out[r, found] = wp.vec3i(i, partner[r, i, k], k)
                    found += 1
                else:
                    overflow_out[r] = 1
    count_out[r] = found
    if found == 0:
        banded_out[r] = 1
    else:
        coupled_out[r] = 1


@wp.func
def enqueue(
    rank: wp.array2d(dtype=wp.int32), order: wp.array2d(dtype=wp.int32), r: int, v: int, tail: int
) -> int:
    if rank[r, v] < 0:
        rank[r, v] = tail
        order[r, tail] = v
        return tail + 1
    return tail


@wp.func
def bonded(cut: wp.array2d(dtype=wp.int32), r: int, first: int, last: int) -> bool:
    """Whether both are nodes, with no cut between them."""
    if first < 0 or last > cut.shape[1]:
        return False
    cuts = int(0)
    for e in range(first, last):
        cuts += cut[r, e]
    return cuts == 0


@wp.kernel
def renumber(
    # Model:
    cut: wp.array2d(dtype=wp.int32),
    # State in:
    coupled: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    capacity: int,
    # Scratch: pairs of every edge as chains, links two for every pair.
    head: wp.array2d(dtype=wp.int32),
    link: wp.array2d(dtype=wp.int32),
    # State out:
    rank_out: wp.array2d(dtype=wp.int32),
    order_out: wp.array2d(dtype=wp.int32),
    first_out: wp.array2d(dtype=wp.int32),
    row_out: wp.array2d(dtype=wp.int32),
    overflow_out: wp.array(dtype=wp.int32),
):
    """Order the nodes; row p starts at column `first` and at block `row` of the storage."""
    r = wp.tid()
    if coupled[r] == 0:
        return
    n = rank_out.shape[1]
    for v in range(n):
        rank_out[r, v] = -1
    for e in range(n - 1):
        head[r, e] = -1
    for c in range(count[r]):
        pair = touching[r, c]
        link[r, 2 * c] = head[r, pair[0]]
        head[r, pair[0]] = 2 * c
        link[r, 2 * c + 1] = head[r, pair[1]]
        head[r, pair[1]] = 2 * c + 1
    tail = int(0)
    for seed in range(n):
        # One search for every connected part; the queue is the order itself.
        at = int(tail)
        tail = enqueue(rank_out, order_out, r, seed, tail)
        while at < tail:
            v = order_out[r, at]
            for e in range(wp.max(v - 1, 0), wp.min(v + 1, n - 1)):
                k = int(head[r, e])
                while k >= 0:
                    other = touching[r, k // 2]
                    o = wp.where(k % 2 == 0, other[1], other[0])
                    tail = enqueue(rank_out, order_out, r, o, tail)
                    tail = enqueue(rank_out, order_out, r, o + 1, tail)
                    k = link[r, k]
            for step in range(1, 3):
                if bonded(cut, r, v, v + step):
                    tail = enqueue(rank_out, order_out, r, v + step, tail)
                if bonded(cut, r, v - step, v):
                    tail = enqueue(rank_out, order_out, r, v - step, tail)
            at += 1
    # Backwards: the same profile or a smaller one.
    for v in range(n):
        rank_out[r, v] = n - 1 - rank_out[r, v]
    for v in range(n):
        order_out[r, rank_out[r, v]] = v
        first_out[r, rank_out[r, v]] = rank_out[r, v]
    for v in range(n):
        p = rank_out[r, v]
        for u in range(wp.max(v - 2, 0), wp.min(v + 3, n)):
            first_out[r, p] = wp.min(first_out[r, p], rank_out[r, u])
    for c in range(count[r]):
        pair = touching[r, c]
        lowest = wp.min(
            wp.min(rank_out[r, pair[0]], rank_out[r, pair[0] + 1]),
            wp.min(rank_out[r, pair[1]], rank_out[r, pair[1] + 1]),
        )
        for corner in range(4):
            p = rank_out[r, pair[corner // 2] + corner % 2]
            first_out[r, p] = wp.min(first_out[r, p], lowest)
    size = int(0)
    for p in range(n):
        row_out[r, p] = size
        size += p - first_out[r, p] + 1
    if size > capacity:
        overflow_out[r] = 1


@wp.func
def free_of(free: wp.array2d(dtype=wp.int32), r: int, v: int, c: int) -> wp.float64:
    """1 if degree of freedom c of node v is free; the last node has no edge after it."""
    a = 4 * v + c
    if a >= free.shape[1]:
        return ZERO
    return wp.float64(free[r, a])


@wp.func
def band_block(hessian: wp.array3d(dtype=wp.float64), r: int, v: int, u: int) -> wp.mat44d:
    out = wp.mat44d()
    for c in range(4):
        for d in range(4):
            a = 4 * v + c
            b = 4 * u + d
            if a < hessian.shape[1] and b < hessian.shape[1]:
                out[c, d] = banded_entry(hessian, r, a, b)
    return out


@wp.func
def masked(free: wp.array2d(dtype=wp.int32), block: wp.mat44d, r: int, v: int, u: int) -> wp.mat44d:
    """Rows and columns of prescribed degrees of freedom as those of the identity."""
    out = block
    for c in range(4):
        for d in range(4):
            out[c, d] = block[c, d] * free_of(free, r, v, c) * free_of(free, r, u, d)
    if v == u:
        for c in range(4):
            out[c, c] = out[c, c] + ONE - free_of(free, r, v, c)
    return out


@wp.kernel
def fill_band(
    # State in:
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    rank: wp.array2d(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    # State out:
    block_out: wp.array2d(dtype=wp.mat44d),
):
    """Row of node v: zero, and the blocks of the rod itself."""
    r, v = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    p = rank[r, v]
    for b in range(first[r, p], p + 1):
        block_out[r, row[r, p] + b - first[r, p]] = wp.mat44d()
    for u in range(wp.max(v - 2, 0), wp.min(v + 3, rank.shape[1])):
        b = rank[r, u]
        if b <= p:
            m = band_block(hessian, r, v, u)
            if b == p:
                m = m + shift[r] * wp.identity(4, dtype=wp.float64)
            block_out[r, row[r, p] + b - first[r, p]] = masked(free, m, r, v, u)


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


@wp.func
def with_zero(v: wp.vec3d) -> wp.vec4d:
    return wp.vec4d(v[0], v[1], v[2], ZERO)


@wp.func
def share(c: Pair, radius_first: wp.float64, radius_second: wp.float64, k: int) -> Share:
    """Nodes k = 0, 1 of the first edge, 2, 3 of the second."""
    out = Share()
    near = c.near
    if k == 0:
        out.weight = ONE - near.s
    elif k == 1:
        out.weight = near.s
    elif k == 2:
        out.weight = near.t - ONE
    else:
        out.weight = -near.t
    out.distance = (out.weight / near.distance) * with_zero(near.gap)
    first = out.weight * near.first
    second = -out.weight * near.second
    if k == 0:
        first = first - near.gap
    elif k == 1:
        first = first + near.gap
    elif k == 2:
        second = second + near.gap
    else:
        second = second - near.gap
    out.first = near.free_s * with_zero(first)
    out.second = near.free_t * with_zero(second)
    m = edge_motion(near.first, near.s, -radius_first, c.normal)
    sign = ONE
    if k >= 2:
        m = edge_motion(near.second, near.t, radius_second, c.normal)
        sign = -ONE
    part = m.head
    spin = m.spin
    if k % 2 == 1:
        part = m.tail
        spin = wp.vec3d(ZERO, ZERO, ZERO)
    out.x = sign * wp.vec4d(part[0, 0], part[0, 1], part[0, 2], spin[0])
    out.y = sign * wp.vec4d(part[1, 0], part[1, 1], part[1, 2], spin[1])
    out.z = sign * wp.vec4d(part[2, 0], part[2, 1], part[2, 2], spin[2])
    return out


@wp.func
def pair_block(
    c: Pair, force: wp.float64, a: Share, b: Share, inverse_ss: wp.float64,
    inverse_st: wp.float64, inverse_tt: wp.float64,
) -> wp.mat44d:  # fmt: skip
    """Block (a, b) of the pair's matrix: Hessian of its energy, with `force` in the part that comes
    from the turning of the normal, and stiffness of the bristle."""
    d = c.near.distance
    w = a.weight * b.weight
    curving = wp.diag(wp.vec4d(w, w, w, ZERO))
    curving = curving - wp.outer(a.first, inverse_ss * b.first + inverse_st * b.second)
    curving = curving - wp.outer(a.second, inverse_st * b.first + inverse_tt * b.second)
    out = (c.slope + force / d) * wp.outer(a.distance, b.distance) - (force / d) * curving
    g = c.grip
    out = out + wp.outer(a.x, g[0, 0] * b.x + g[0, 1] * b.y + g[0, 2] * b.z)
    out = out + wp.outer(a.y, g[1, 0] * b.x + g[1, 1] * b.y + g[1, 2] * b.z)
    out = out + wp.outer(a.z, g[2, 0] * b.x + g[2, 1] * b.y + g[2, 2] * b.z)
    return out


@wp.kernel
def add_pairs(
    # Model:
    law: wp.array(dtype=Law),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    smoothing: wp.float64,
    # State in:
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle: wp.array3d(dtype=wp.vec2d),
    load: wp.array3d(dtype=wp.float64),
    sliding: wp.array3d(dtype=wp.int32),
    sticking: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    rank: wp.array2d(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    # State in and out:
    block: wp.array2d(dtype=wp.mat44d),
):
    """Add the matrices of all touching pairs of a rod, one after the other.

    They turn with at most the force of the last step: that of a predictor which is deep inside
    would make the matrix indefinite and lead Newton astray.
    """
    r = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    for n in range(count[r]):
        pair = touching[r, n]
        i = pair[0]
        j = pair[1]
        slot = pair[2]
        c = pair_contact(
            law[r], radius, rest_length, dof, dof_before, bristle[r, i, slot], load[r, i, slot],
            sliding[r, i, slot], sticking[r], r, i, j,
        )  # fmt: skip
        held = wp.min(c.force, load[r, i, slot])
        e = c.near.first
        f = c.near.second
        ss = wp.dot(e, e) + smoothing * rest_length[r, i] * rest_length[r, i]
        tt = wp.dot(f, f) + smoothing * rest_length[r, j] * rest_length[r, j]
        st = c.near.free_s * c.near.free_t * wp.dot(e, f)
        det = ss * tt - st * st
        for k in range(4):
            v = pair[k // 2] + k % 2
            a = share(c, radius[r, i], radius[r, j], k)
            for m in range(4):
                u = pair[m // 2] + m % 2
                p = rank[r, v]
                q = rank[r, u]
                if q <= p:
                    b = share(c, radius[r, i], radius[r, j], m)
                    new = pair_block(c, held, a, b, tt / det, st / det, ss / det)
                    for x in range(4):
                        for y in range(4):
                            new[x, y] = new[x, y] * free_of(free, r, v, x) * free_of(free, r, u, y)
                    at = row[r, p] + q - first[r, p]
                    block[r, at] = block[r, at] + new


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
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    # State in and out:
    block: wp.array2d(dtype=wp.mat44d),
    # State out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """L D L^T in place, block row by block row from left to right."""
    r = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    negative = int(0)
    for p in range(first.shape[1]):
        start = first[r, p]
        at = row[r, p] - start
        diagonal = block[r, at + p]
        size = wp.vec4d(diagonal[0, 0], diagonal[1, 1], diagonal[2, 2], diagonal[3, 3])
        # Until the second loop the entries are those of L D.
        for b in range(start, p):
            value = block[r, at + b]
            there = row[r, b] - first[r, b]
            for c in range(wp.max(start, first[r, b]), b):
                value = value - block[r, at + c] * wp.transpose(block[r, there + c])
            block[r, at + b] = unit_lower_solve(value, block[r, there + b])
        for b in range(start, p):
            value = block[r, at + b]
            scaled = over_pivots(value, block[r, row[r, b] - first[r, b] + b])
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
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    order: wp.array2d(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    block: wp.array2d(dtype=wp.mat44d),
    # Scratch:
    y: wp.array2d(dtype=wp.vec4d),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Solve in place for the right-hand side [rod, 0, :]; prescribed ones come out as zero."""
    r = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    n = first.shape[1]
    for p in range(n):
        v = order[r, p]
        value = wp.vec4d()
        for c in range(4):
            if 4 * v + c < x.shape[2]:
                value[c] = x[r, 0, 4 * v + c] * free_of(free, r, v, c)
        at = row[r, p] - first[r, p]
        for b in range(first[r, p], p):
            value = value - block[r, at + b] * y[r, b]
        diagonal = block[r, at + p]
        for c in range(1, 4):
            for d in range(4):
                if d < c:
                    value[c] = value[c] - diagonal[c, d] * value[d]
        y[r, p] = value
    for p in range(n):
        diagonal = block[r, row[r, p] - first[r, p] + p]
        value = y[r, p]
        for c in range(4):
            value[c] = value[c] / diagonal[c, c]
        y[r, p] = value
    for back in range(n):
        p = n - 1 - back
        at = row[r, p] - first[r, p]
        diagonal = block[r, at + p]
        value = y[r, p]
        for k in range(4):
            c = 3 - k
            for d in range(4):
                if d > c:
                    value[c] = value[c] - diagonal[d, c] * value[d]
        y[r, p] = value
        for b in range(first[r, p], p):
            y[r, b] = y[r, b] - wp.transpose(block[r, at + b]) * value
        v = order[r, p]
        for c in range(4):
            if 4 * v + c < x.shape[2]:
                x[r, 0, 4 * v + c] = value[c]


@wp.kernel
def limit_motion(
    # Model:
    limit: wp.array(dtype=wp.float64),
    # State in:
    overflow: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
    # State out:
    sticking_out: wp.array(dtype=wp.int32),
):
    """Shorten a Newton step that moves some node by more than `limit`."""
    r = wp.tid()
    if active[r] == 0:
        return
    sticking_out[r] = 0
    largest = wp.float64(0.0)
    for v in range((x.shape[2] + 1) // 4):
        move = wp.vec3d(x[r, 0, 4 * v], x[r, 0, 4 * v + 1], x[r, 0, 4 * v + 2])
        largest = wp.max(largest, wp.length(move))
    fraction = wp.min(ONE, limit[r] / wp.max(largest, limit[r]))
    if overflow[r] != 0:
        fraction = ZERO  # nothing was solved
    if fraction < ONE:
        for a in range(x.shape[2]):
            x[r, 0, a] = x[r, 0, a] * fraction
