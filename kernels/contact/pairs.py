"""Which edges may touch in a step: lists of partners, by boxes around groups of edges.

Edge i lists the partners j > i that are within reach of it at the start of the step; a step in
which a node moves farther than that is refused. Bristles stay with the pairs that stay.
"""

import warp as wp
from wrod.kernels.contact.pair_contact import Pieces, Rubbing, nearest_of_edges, piece_nodes
from wrod.kernels.elastic.frames import HALF, ZERO, node

GROUP = wp.constant(8)


@wp.kernel
def bound_groups(
    # Model:
    splines: int,
    # State in:
    starting: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    lower_out: wp.array2d(dtype=wp.vec3d),
    upper_out: wp.array2d(dtype=wp.vec3d),
):
    """Boxes around the centrelines of every `GROUP` edges, or pieces of splines."""
    r, g = wp.tid()
    if starting[r] == 0:
        return
    last = (dof.shape[1] + 1) // 4 - 1
    over = wp.where(splines != 0, 1, 0)
    lower = node(dof, r, g * GROUP)
    upper = node(dof, r, g * GROUP)
    for i in range(g * GROUP + 1, wp.min((g + 1) * GROUP + over, last) + 1):
        lower = wp.min(lower, node(dof, r, i))
        upper = wp.max(upper, node(dof, r, i))
    lower_out[r, g] = lower
    upper_out[r, g] = upper


@wp.func
def apart(p: wp.mat33d, lower: wp.vec3d, upper: wp.vec3d, reach: wp.float64) -> bool:
    """Whether the box around the columns of p and the given one are farther apart than `reach`."""
    out = bool(False)
    for c in range(3):
        least = wp.min(wp.min(p[c, 0], p[c, 1]), p[c, 2])
        most = wp.max(wp.max(p[c, 0], p[c, 1]), p[c, 2])
        if least > upper[c] + reach or most < lower[c] - reach:
            out = bool(True)
    return out


@wp.func
def column(p: wp.mat33d, c: int) -> wp.vec3d:
    return wp.vec3d(p[0, c], p[1, c], p[2, c])


@wp.func
def half_length(p: wp.mat33d) -> wp.float64:
    """Radius of a ball around the middle of a piece's first and last node that holds it."""
    first = column(p, 0)
    last = column(p, 2)
    reach = HALF * wp.length(last - first)
    return wp.max(reach, wp.length(column(p, 1) - HALF * (first + last)))


@wp.func
def centres_apart(p: wp.mat33d, q: wp.mat33d) -> wp.float64:
    """What two pieces are at least apart: cheaper than what they are."""
    between = column(p, 0) + column(p, 2) - column(q, 0) - column(q, 2)
    return HALF * wp.length(between) - half_length(p) - half_length(q)


@wp.kernel
def list_partners(
    # Model:
    m: Pieces,
    arc: wp.array2d(dtype=wp.float64),
    skip: wp.float64,
    reach: wp.array(dtype=wp.float64),
    largest_radius: wp.array(dtype=wp.float64),
    # State in:
    starting: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    lower: wp.array2d(dtype=wp.vec3d),
    upper: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    bristle: wp.array3d(dtype=wp.vec2d),
    load: wp.array3d(dtype=wp.float64),
    sliding: wp.array3d(dtype=wp.int32),
    # Scratch:
    new_partner: wp.array3d(dtype=wp.int32),
    new_bristle: wp.array3d(dtype=wp.vec2d),
    new_load: wp.array3d(dtype=wp.float64),
    new_sliding: wp.array3d(dtype=wp.int32),
    # State out:
    overflow_out: wp.array(dtype=wp.int32),
):
    """Partners j > i of edge i, closer than the radii and the way both can move in a step.

    Left out: edges of radius 0 (cuts), and pairs whose nearer ends are closer along the rod than
    `skip` mean radii.
    """
    r, i = wp.tid()
    if starting[r] == 0:
        return
    found = int(0)
    margin = reach[r] + reach[r]
    far = m.radius[r, i] + largest_radius[r] + margin
    if m.radius[r, i] > ZERO:
        p = piece_nodes(dof, m.kind[r, i], r, i)
        for g in range((i + 1) // GROUP, lower.shape[1]):
            if not apart(p, lower[r, g], upper[r, g], far):
                for j in range(
                    wp.max(g * GROUP, i + 1), wp.min((g + 1) * GROUP, m.radius.shape[1])
                ):
                    sum = m.radius[r, i] + m.radius[r, j]
                    near_along = arc[r, j] - arc[r, i + 1] < wp.float64(0.5) * skip * sum
                    if m.radius[r, j] > ZERO and not near_along:
                        least = centres_apart(p, piece_nodes(dof, m.kind[r, j], r, j))
                        if least < sum + margin:
                            c = nearest_of_edges(m, dof, r, i, j)
                            if wp.length(c.gap) < sum + margin:
                                if found < partner.shape[2]:
                                    new_partner[r, i, found] = j
                                found += 1
    if found > partner.shape[2]:
        overflow_out[r] = 1
        found = partner.shape[2]
    before = int(0)
    for k in range(found):
        j = new_partner[r, i, k]
        pull = wp.vec2d(ZERO, ZERO)
        pressed = wp.float64(0.0)
        slid = int(0)
        # Both lists go along the rod.
        for o in range(before, partner_count[r, i]):
            if partner[r, i, o] >= j:
                if partner[r, i, o] == j:
                    pull = bristle[r, i, o]
                    pressed = load[r, i, o]
                    slid = sliding[r, i, o]
                break
            before = o + 1
        new_bristle[r, i, k] = pull
        new_load[r, i, k] = pressed
        new_sliding[r, i, k] = slid
    for k in range(found):
        partner[r, i, k] = new_partner[r, i, k]
        bristle[r, i, k] = new_bristle[r, i, k]
        load[r, i, k] = new_load[r, i, k]
        sliding[r, i, k] = new_sliding[r, i, k]
    partner_count[r, i] = found


@wp.kernel
def forget_partners(
    # In:
    chosen: wp.array(dtype=wp.int32),
    # State out:
    partner_count_out: wp.array2d(dtype=wp.int32),
):
    """Empty the lists of the chosen rows, and with them the friction that they carry over."""
    r, i = wp.tid()
    if chosen[r] != 0:
        partner_count_out[r, i] = 0


@wp.kernel
def keep_pairs(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    depth: wp.array3d(dtype=wp.float64),
    rubbing: Rubbing,
    # Out:
    partner_out: wp.array3d(dtype=wp.int32),
    kept_out: Rubbing,
    touching_out: wp.array(dtype=wp.int32),
):
    """Put the pairs that touch at the end of an accepted step into slots, 0 for none; say of rods
    whether there are more. Launched over (rod, edge)."""
    r, i = wp.tid()
    if accepted[r] == 0:
        return
    found = int(0)
    for k in range(partner_count[r, i]):
        if depth[r, i, k] > ZERO:
            if found < partner_out.shape[2]:
                partner_out[r, i, found] = partner[r, i, k]
                kept_out.bristle[r, i, found] = rubbing.bristle[r, i, k]
                kept_out.load[r, i, found] = rubbing.load[r, i, k]
                kept_out.sliding[r, i, found] = rubbing.sliding[r, i, k]
            else:
                touching_out[r] = 1
            found += 1
    for k in range(found, partner_out.shape[2]):
        partner_out[r, i, k] = 0
