"""In which order a rod's nodes are eliminated, and which blocks of its matrix that fills.

Contacts couple nodes that are far apart along the rod. Nodes are numbered by their distance from
the rod's end in the graph of rod and contacts (after Cuthill and McKee), which keeps the entries of
a row close to the diagonal even in a knot: its width is that of a few strands. From which end it is
narrower hangs on the knot.
"""

import warp as wp
from wrod.kernels.contact.segments import EDGE, piece_size
from wrod.kernels.lanes import (
    count_of_lanes,
    count_of_lanes_before,
    largest_of_lanes,
    wait_for_lanes,
)


@wp.struct
class Skyline:
    """Rods that are solved with their contacts, and where the blocks of their matrices are.

    Attributes:
        coupled, overflow: (rod,) whether contacts couple a rod's nodes, and whether its blocks are
            more than there is room for.
        reach: (rod,) no column reaches farther below its diagonal.
        rank, order: (rod, node) place of each node, and the node at each place.
        first, last: (rod, node) column at which a row begins; last row that reaches a column, or
            one before it.
        row: (rod, node) where the blocks of a row are: that of column b at `row + b`.
    """

    coupled: wp.array(dtype=wp.int32)
    overflow: wp.array(dtype=wp.int32)
    reach: wp.array(dtype=wp.int32)
    rank: wp.array2d(dtype=wp.int32)
    order: wp.array2d(dtype=wp.int32)
    first: wp.array2d(dtype=wp.int32)
    last: wp.array2d(dtype=wp.int32)
    row: wp.array2d(dtype=wp.int32)


@wp.func
def is_solved(m: Skyline, r: int) -> bool:
    """Whether a rod is solved with its contacts."""
    return m.coupled[r] != 0 and m.overflow[r] == 0


# Distances lie close at hand on a GPU for rods of so many nodes.
_NODES = 1024

# Farthest first, and among equals the last along the rod: a counting sort, or many lanes count.
_NUMBER = (
    f"const int NODES = {_NODES}, EDGE = {int(EDGE)};"
    + """
    const int n = skyline.rank.shape[1], pairs = count.data[r];
    const int* pieces = piece.data + (size_t)r * piece.shape[1];
    const int* pair = (const int*)(touching.data) + (size_t)r * touching.shape[1] * 3;
    int* ranks = skyline.rank.data + (size_t)r * n;
    int* nodes = skyline.order.data + (size_t)r * n;
    int* tallies = tally.data + (size_t)r * n;
    int* far = distance.data + (size_t)r * n;
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x, lanes = blockDim.x;
    __shared__ int near[NODES];
    if (n <= NODES) far = near;
#define WROD_LOWER(place, value) atomicMin(&(place), value)
#define WROD_WAIT() __syncthreads()
#define WROD_ANY(flag) __syncthreads_or(flag)
#else
    const int lane = 0, lanes = 1;
#define WROD_LOWER(place, value) (place) = value
#define WROD_WAIT()
#define WROD_ANY(flag) flag
#endif
    // Two nodes a step, without contacts.
    for (int v = lane; v < n; v += lanes) {
        far[v] = from_last ? (n - v) / 2 : (v + 1) / 2;
        tallies[v] = 0;
    }
    WROD_WAIT();
    for (int turn = 0, going = 1; going; ++turn) {
        going = 0;
        for (int w = lane; w < n; w += lanes) {
            // To and fro, which lets one lane come to an end in a few turns.
            const int v = turn % 2 ? n - 1 - w : w;
            int best = far[v];
            for (int u = v < 2 ? 0 : v - 2; u < v + 3 && u < n; ++u)
                if (far[u] + 1 < best) best = far[u] + 1;
            if (best < far[v]) {
                WROD_LOWER(far[v], best);
                going = 1;
            }
        }
        for (int c = lane; c < pairs; c += lanes) {
            const int i = pair[3 * c], j = pair[3 * c + 1];
            const int size = pieces[i] == EDGE ? 2 : 3, all = size + (pieces[j] == EDGE ? 2 : 3);
            int best = n;
            for (int k = 0; k < all; ++k) {
                const int there = far[k < size ? i + k : j + k - size] + 1;
                if (there < best) best = there;
            }
            for (int k = 0; k < all; ++k) {
                const int v = k < size ? i + k : j + k - size;
                if (best < far[v]) {
                    WROD_LOWER(far[v], best);
                    going = 1;
                }
            }
        }
        going = WROD_ANY(going);
    }
#if defined(__CUDA_ARCH__)
    for (int v = lane; v < n; v += lanes) far[v] = far[v] * n + v;
    WROD_WAIT();
    for (int v = lane; v < n; v += lanes) {
        const int key = far[v];
        int p = 0;
        _Pragma("unroll 8") for (int w = 0; w < n; ++w) p += far[w] > key;
        ranks[v] = p;
        nodes[p] = v;
    }
#else
    for (int v = 0; v < n; ++v) ++tallies[far[v]];
    for (int d = n - 1, before = 0; d >= 0; --d) {
        const int size = tallies[d];
        tallies[d] = before;
        before += size;
    }
    for (int v = n - 1; v >= 0; --v) {
        ranks[v] = tallies[far[v]]++;
        nodes[ranks[v]] = v;
    }
#endif
    WROD_WAIT();
"""
)


@wp.func_native(_NUMBER)
def number_nodes(
    from_last: int,
    piece: wp.array2d(dtype=wp.int32),
    r: int,
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    distance: wp.array2d(dtype=wp.int32),
    tally: wp.array2d(dtype=wp.int32),
    skyline: Skyline,
): ...


@wp.func
def arrange(
    from_last: int,
    piece: wp.array2d(dtype=wp.int32),
    r: int,
    lane: int,
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    distance: wp.array2d(dtype=wp.int32),
    tally: wp.array2d(dtype=wp.int32),
    m: Skyline,
) -> wp.vec2i:
    """Order a rod's nodes by their distance from its first or last; how far columns reach then, and
    how many blocks there are."""
    n = m.rank.shape[1]
    number_nodes(from_last, piece, r, count, touching, distance, tally, m)
    for v in range(lane, n, wp.block_dim()):
        p = m.rank[r, v]
        lowest = int(p)
        for u in range(wp.max(v - 2, 0), wp.min(v + 3, n)):
            lowest = wp.min(lowest, m.rank[r, u])
        m.first[r, p] = lowest
        m.last[r, p] = p
    wait_for_lanes()
    for c in range(lane, count[r], wp.block_dim()):
        i = touching[r, c][0]
        j = touching[r, c][1]
        size = piece_size(piece[r, i])
        all = size + piece_size(piece[r, j])
        lowest = wp.min(m.rank[r, i], m.rank[r, j])
        for corner in range(all):
            lowest = wp.min(lowest, m.rank[r, wp.where(corner < size, i, j - size) + corner])
        for corner in range(all):
            v = wp.where(corner < size, i, j - size) + corner
            wp.atomic_min(m.first, r, m.rank[r, v], lowest)
    wait_for_lanes()
    for p in range(lane, n, wp.block_dim()):
        wp.atomic_max(m.last, r, m.first[r, p], p)
    wait_for_lanes()
    size = int(0)
    for start in range(0, n, wp.block_dim()):
        p = start + lane
        mine = int(0)
        if p < n:
            mine = p - m.first[r, p] + 1
        before = size + count_of_lanes_before(mine)
        size += count_of_lanes(mine)
        if p < n:
            m.row[r, p] = before - m.first[r, p]
    # Running maxima; many lanes look twice as far back every turn.
    jump = int(1)
    while jump < n and wp.block_dim() > 1:
        for p in range(lane, n, wp.block_dim()):
            tally[r, p] = wp.max(m.last[r, p], m.last[r, wp.max(p - jump, 0)])
        wait_for_lanes()
        for p in range(lane, n, wp.block_dim()):
            m.last[r, p] = tally[r, p]
        wait_for_lanes()
        jump *= 2
    reach = int(0)
    for p in range(lane, n, wp.block_dim()):
        last = int(m.last[r, p])
        if wp.block_dim() == 1:
            last = wp.max(last, m.last[r, wp.max(p - 1, 0)])
            m.last[r, p] = last
        reach = wp.max(reach, last - p)
    return wp.vec2i(int(largest_of_lanes(wp.float64(reach))), size)


@wp.kernel
def renumber(
    # State in:
    changed: wp.array(dtype=wp.int32),
    piece: wp.array2d(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    touching: wp.array2d(dtype=wp.vec3i),
    capacity: int,
    most_reach: int,
    # Scratch:
    distance: wp.array2d(dtype=wp.int32),
    tally: wp.array2d(dtype=wp.int32),
    # State in and out:
    m: Skyline,
):
    """Order the nodes of rods whose contacts have changed: from the first node, or from the last
    where only then no column reaches farther than `most_reach`."""
    r, lane = wp.tid()
    if m.coupled[r] == 0 or changed[r] == 0:
        return
    attempt = int(0)
    found = wp.vec2i(most_reach + 1, 0)
    while attempt < 3 and found[0] > most_reach:
        found = arrange(attempt % 2, piece, r, lane, count, touching, distance, tally, m)
        attempt += 1
    if lane == 0:
        m.reach[r] = found[0]
        if found[1] > capacity:
            m.overflow[r] = 1
