"""In which order a rod's nodes are eliminated, and which blocks of its matrix that fills.

Contacts couple nodes that are far apart along the rod. Nodes are numbered by their distance from
the rod's end in the graph of rod and contacts (after Cuthill and McKee), which keeps the entries of
a row close to the diagonal even in a knot: its width is that of a few strands.
"""

import warp as wp
from wrod.kernels.contact.segments import piece_size
from wrod.kernels.lanes import (
    any_lane,
    count_of_lanes,
    count_of_lanes_before,
    largest_of_lanes,
    wait_for_lanes,
)

wp.set_module_options({"enable_backward": False})


@wp.func
def nearer(distance: wp.array2d(dtype=wp.int32), r: int, v: int, best: int) -> int:
    if v < 0 or v >= distance.shape[1]:
        return best
    return wp.min(best, distance[r, v] + 1)


@wp.kernel
def renumber(
    # State in:
    coupled: wp.array(dtype=wp.int32),
    changed: wp.array(dtype=wp.int32),
    piece: wp.array2d(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    capacity: int,
    # Scratch:
    distance: wp.array2d(dtype=wp.int32),
    tally: wp.array2d(dtype=wp.int32),
    # State out:
    rank_out: wp.array2d(dtype=wp.int32),
    order_out: wp.array2d(dtype=wp.int32),
    first_out: wp.array2d(dtype=wp.int32),
    last_out: wp.array2d(dtype=wp.int32),
    row_out: wp.array2d(dtype=wp.int32),
    reach_out: wp.array(dtype=wp.int32),
    overflow_out: wp.array(dtype=wp.int32),
):
    """Order the nodes of rods whose contacts have changed.

    Row p starts at column `first`; the last row that reaches column p, or one before it, is `last`,
    no column farther than `reach` below its diagonal.
    """
    r, lane = wp.tid()
    if coupled[r] == 0 or changed[r] == 0:
        return
    n = rank_out.shape[1]
    for v in range(lane, n, wp.block_dim()):
        distance[r, v] = (v + 1) // 2  # two nodes a step, without contacts
        tally[r, v] = 0
        last_out[r, v] = v
    wait_for_lanes()
    going = int(1)
    turn = int(0)
    while going != 0:
        going = int(0)
        for w in range(lane, n, wp.block_dim()):
            # To and fro, which lets one lane come to an end in a few turns.
            v = wp.where(turn % 2 == 0, w, n - 1 - w)
            best = int(distance[r, v])
            for step in range(1, 3):
                best = nearer(distance, r, v - step, best)
                best = nearer(distance, r, v + step, best)
            if best < distance[r, v]:
                wp.atomic_min(distance, r, v, best)
                going = int(1)
        for c in range(lane, count[r], wp.block_dim()):
            i = touching[r, c][0]
            j = touching[r, c][1]
            size = piece_size(piece[r, i])
            all = size + piece_size(piece[r, j])
            best = wp.min(distance[r, i], distance[r, j])
            for corner in range(all):
                best = wp.min(best, distance[r, wp.where(corner < size, i, j - size) + corner])
            best += 1
            for corner in range(all):
                v = wp.where(corner < size, i, j - size) + corner
                if best < distance[r, v]:
                    wp.atomic_min(distance, r, v, best)
                    going = int(1)
        going = any_lane(going)
        turn += 1
    # Farthest first, and among equals the last along the rod: a counting sort, or many lanes count.
    if wp.block_dim() == 1:
        for v in range(n):
            tally[r, distance[r, v]] = tally[r, distance[r, v]] + 1
        before = int(0)
        for d in range(n):
            at = n - 1 - d
            size = tally[r, at]
            tally[r, at] = before
            before += size
        for w in range(n):
            v = n - 1 - w
            p = tally[r, distance[r, v]]
            tally[r, distance[r, v]] = p + 1
            rank_out[r, v] = p
            order_out[r, p] = v
    else:
        for v in range(lane, n, wp.block_dim()):
            far = distance[r, v]
            p = int(0)
            for w in range(n):
                d = distance[r, w]
                if d > far or (d == far and w > v):
                    p += 1
            rank_out[r, v] = p
            order_out[r, p] = v
    wait_for_lanes()
    for v in range(lane, n, wp.block_dim()):
        p = rank_out[r, v]
        lowest = int(p)
        for u in range(wp.max(v - 2, 0), wp.min(v + 3, n)):
            lowest = wp.min(lowest, rank_out[r, u])
        first_out[r, p] = lowest
    wait_for_lanes()
    for c in range(lane, count[r], wp.block_dim()):
        i = touching[r, c][0]
        j = touching[r, c][1]
        size = piece_size(piece[r, i])
        all = size + piece_size(piece[r, j])
        lowest = wp.min(rank_out[r, i], rank_out[r, j])
        for corner in range(all):
            lowest = wp.min(lowest, rank_out[r, wp.where(corner < size, i, j - size) + corner])
        for corner in range(all):
            v = wp.where(corner < size, i, j - size) + corner
            wp.atomic_min(first_out, r, rank_out[r, v], lowest)
    wait_for_lanes()
    for p in range(lane, n, wp.block_dim()):
        wp.atomic_max(last_out, r, first_out[r, p], p)
    wait_for_lanes()
    size = int(0)
    for start in range(0, n, wp.block_dim()):
        p = start + lane
        mine = int(0)
        if p < n:
            mine = p - first_out[r, p] + 1
        before = size + count_of_lanes_before(mine)
        size += count_of_lanes(mine)
        if p < n:
            row_out[r, p] = before - first_out[r, p]
    # Running maxima; many lanes look twice as far back every turn.
    jump = int(1)
    while jump < n and wp.block_dim() > 1:
        for p in range(lane, n, wp.block_dim()):
            tally[r, p] = wp.max(last_out[r, p], last_out[r, wp.max(p - jump, 0)])
        wait_for_lanes()
        for p in range(lane, n, wp.block_dim()):
            last_out[r, p] = tally[r, p]
        wait_for_lanes()
        jump *= 2
    reach = int(0)
    for p in range(lane, n, wp.block_dim()):
        last = int(last_out[r, p])
        if wp.block_dim() == 1:
            last = wp.max(last, last_out[r, wp.max(p - 1, 0)])
            last_out[r, p] = last
        reach = wp.max(reach, last - p)
    reach = int(largest_of_lanes(wp.float64(reach)))
    if lane == 0:
        reach_out[r] = reach
        if size > capacity:
            overflow_out[r] = 1
