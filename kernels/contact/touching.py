"""Which pairs of edges touch, and how far that lets a step go. Launched over (rod, lane)."""

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO, node
from wrod.kernels.lanes import count_of_lanes, count_of_lanes_before, largest_of_lanes

# Part of the way that nodes may move in a step which they do by their present speed.
WAY = wp.constant(wp.float64(0.95))


@wp.kernel
def collect(
    # State in:
    active: wp.array(dtype=wp.int32),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    depth: wp.array3d(dtype=wp.float64),
    # State in and out:
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    # State out:
    overflow_out: wp.array(dtype=wp.int32),
    banded_out: wp.array(dtype=wp.int32),
    coupled_out: wp.array(dtype=wp.int32),
    changed_out: wp.array(dtype=wp.int32),
):
    """List the touching pairs (i, j, slot), and tell rods with some from rods without.

    `changed` tells where the pairs are not those of the last list with some.
    """
    r, lane = wp.tid()
    if active[r] == 0:
        if lane == 0:
            banded_out[r] = 0
            coupled_out[r] = 0
        return
    found = int(0)
    news = int(0)
    for start in range(0, partner_count.shape[1], wp.block_dim()):
        i = start + lane
        mine = int(0)
        if i < partner_count.shape[1]:
            for k in range(partner_count[r, i]):
                if depth[r, i, k] > ZERO:
                    mine += 1
        at = found + count_of_lanes_before(mine)
        if mine > 0:
            for k in range(partner_count[r, i]):
                if depth[r, i, k] > ZERO:
                    if at < touching.shape[1]:
                        j = partner[r, i, k]
                        old = touching[r, at]
                        if at >= count[r] or old[0] != i or old[1] != j:
                            news += 1
                        touching[r, at] = wp.vec3i(i, j, k)
                    else:
                        overflow_out[r] = 1
                    at += 1
        found += count_of_lanes(mine)
    news = count_of_lanes(news)
    found = wp.min(found, touching.shape[1])
    if lane > 0:
        return
    banded_out[r] = wp.where(found == 0, 1, 0)
    coupled_out[r] = wp.where(found == 0, 0, 1)
    if found > 0:
        changed_out[r] = wp.where(news > 0 or found != count[r], 1, 0)
        count[r] = found


@wp.kernel
def bound_steps(
    # Model:
    reach: wp.array(dtype=wp.float64),
    # State in:
    starting: wp.array(dtype=wp.int32),
    velocity: wp.array2d(dtype=wp.float64),
    # State in and out:
    wanted_step: wp.array(dtype=wp.float64),
):
    """Begin no step in which a node would move by more than `reach`."""
    r, lane = wp.tid()
    if starting[r] == 0:
        return
    fastest = wp.float64(0.0)
    for v in range(lane, (velocity.shape[1] + 1) // 4, wp.block_dim()):
        fastest = wp.max(fastest, wp.length(node(velocity, r, v)))
    fastest = largest_of_lanes(fastest)
    if lane == 0 and fastest * wanted_step[r] > WAY * reach[r]:
        wanted_step[r] = WAY * reach[r] / fastest


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
    shortened_out: wp.array(dtype=wp.float64),
):
    """Shorten a Newton step that moves some node by more than `limit`."""
    r, lane = wp.tid()
    if active[r] == 0:
        return
    largest = wp.float64(0.0)
    for v in range(lane, (x.shape[2] + 1) // 4, wp.block_dim()):
        move = wp.vec3d(x[r, 0, 4 * v], x[r, 0, 4 * v + 1], x[r, 0, 4 * v + 2])
        largest = wp.max(largest, wp.length(move))
    largest = largest_of_lanes(largest)
    fraction = wp.min(ONE, limit[r] / wp.max(largest, limit[r]))
    if overflow[r] != 0:
        fraction = ZERO  # nothing was solved
    if lane == 0:
        shortened_out[r] = fraction
    for a in range(lane, x.shape[2], wp.block_dim()):
        x[r, 0, a] = x[r, 0, a] * fraction


@wp.kernel
def refuse_large_steps(
    # Model:
    radius: wp.array2d(dtype=wp.float64),
    reach: wp.array(dtype=wp.float64),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    depth: wp.array3d(dtype=wp.float64),
    overflow: wp.array(dtype=wp.int32),
    # State in and out:
    renewed: wp.array(dtype=wp.int32),
    renewals: wp.array(dtype=wp.int32),
    converged: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
):
    """No tunnelling: a step stands only if no node moved by more than half a radius, for which the
    lists of partners were made, and no pair is deeper than half a radius: then centrelines that
    were apart cannot have crossed. Nor does one in which a pair met too fast (2 in `renewed`)."""
    r, lane = wp.tid()
    if converged[r] == 0:
        if lane == 0 and renewed[r] != 0:
            if renewed[r] == 2:
                active[r] = 0  # before more is done for a step that cannot stand
            renewals[r] = renewals[r] + 1
            renewed[r] = 0
        return
    bad = int(0)
    for i in range(lane, partner_count.shape[1] + 1, wp.block_dim()):
        if wp.length(node(dof, r, i) - node(dof_before, r, i)) > reach[r]:
            bad = int(1)
    for i in range(lane, partner_count.shape[1], wp.block_dim()):
        for k in range(partner_count[r, i]):
            limit = wp.float64(0.25) * (radius[r, i] + radius[r, partner[r, i, k]])
            if depth[r, i, k] > limit:
                bad = int(1)
    bad = count_of_lanes(bad)
    if lane > 0:
        return
    stale = renewed[r] == 1
    fast = renewed[r] == 2
    renewed[r] = 0
    if stale:
        renewals[r] = renewals[r] + 1
    if fast:
        converged[r] = 0
    elif stale:
        # In balance only under loads of before: iterate.
        converged[r] = 0
        active[r] = 1
    elif bad > 0 or overflow[r] != 0:
        converged[r] = 0
