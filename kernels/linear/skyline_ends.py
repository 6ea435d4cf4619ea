"""Skyline elimination on a GPU from both ends of a rod's order at once, and the way back.

The same solution as that of `skyline`, for rods none of whose columns reaches farther than `REACH`
rows down. One block of lanes eliminates columns from the first on, another from the last, until
they meet: nothing couples those before the middle rows with those behind them. What both leave of
the middle is added up and eliminated by each, which then goes back its own way. That takes half as
many columns in a row as one block would.
"""

import warp as wp
from wrod.kernels.linear.skyline_order import Skyline, is_solved
from wrod.kernels.linear.skyline_window import BACK, COLUMN, ELIMINATE, REACH, ROWS, STRIDE, WINDOW

# Numbers of what an end leaves of the middle: blocks; right-hand sides; diagonals at first.
_LEFT = 16 * REACH * (REACH + 1) // 2 + 8 * REACH


def reach_of(nodes: int) -> int:
    """How far columns of rods of so many nodes may reach; -1 where their solution does not fit."""
    return REACH if 4 * nodes <= STRIDE * ROWS * (ROWS + 1) // 2 else -1


def scratch_of(nodes: int) -> int:
    """Numbers that a rod's elimination needs: columns of L, what is left, columns of the middle."""
    return COLUMN * (nodes + 2 * REACH) + 2 * _LEFT


# Rows are counted from the block's own end: its q-th is the rod's (n - 1 - q)-th from the other.
_MEETING = (
    f"const int LEFT = {_LEFT}, SIDES = LEFT - 8 * {REACH}, SIZES = LEFT - 4 * {REACH};"
    + WINDOW
    + """
    const int n = skyline.last.shape[1];
    const int* ends = skyline.last.data + (size_t)r * n;
    const int width = ends[n / 2] - n / 2, before = width < n ? (n - width) / 2 : 0;
    const int behind = before > 0 ? ends[before - 1] + 1 : 0, middle = behind - before;
    double* scratch = factor.data + (size_t)r * factor.shape[1];
    double* left_of_middle = scratch + (size_t)COLUMN * n;
"""
)

_FROM_AN_END = (
    _MEETING
    + """
    const int dofs = gradient.shape[1];
    const double* lines = (double*)(block.data) + (size_t)r * block.shape[1] * 4;
    const int* starts = skyline.first.data + (size_t)r * n;
    const int* rows = skyline.row.data + (size_t)r * n;
    const int* open = free.data + (size_t)r * dofs;
    const int* nodes = skyline.order.data + (size_t)r * n;
    const double* load = gradient.data + (size_t)r * dofs;
    double* far = y.data + (size_t)r * 4 * n;
    int* mine = reached.data + (size_t)r * n;
    const bool turned = side == 1;
    const int stop = turned ? n - behind : before, count = stop + middle;
    double* columns = scratch + (turned ? (size_t)COLUMN * behind : 0);
    auto reaches = [&](int b) { return turned ? mine[b] : ends[b]; };
    // What a lane brings next: a line of a row, k = lane / 4 blocks before its diagonal; and the
    // profile for the row after that.
    WROD_LANE_ARRAY(double, line, 4);
    WROD_LANE_ARRAY(double, right, 1);
    WROD_LANE_ARRAY(int, spot, 1);
    WROD_LANE_ARRAY(int, start, 1);
    WROD_LANE_ARRAY(int, base, 1);
#define WROD_FETCH_PROFILE(q) \\
    { \\
        const int p = turned ? n - 1 - (q) + lane / 4 : (q); \\
        if ((q) < count && p < n) { \\
            WROD_OWN(start, 0) = starts[p]; \\
            WROD_OWN(base, 0) = rows[p]; \\
        } \\
    }
    // Line e of block (q, q - k) of a row that starts at `start`; from behind it is transposed, and
    // what couples middle rows is left to the other end.
    auto fetch = [&](int q, int k, int e, int start, int base, double* line) {
        WROD_UNROLL for (int c = 0; c < 4; ++c) line[c] = 0.0;
        if (q >= count || k > q) return;
        const int p = turned ? n - 1 - q : q - k;
        if (p < start || (turned && q - k >= stop)) return;
        const bool over = turned && k > 0;
        const double* from = lines + 16 * (base + p) + (over ? e : 4 * e);
        WROD_UNROLL for (int c = 0; c < 4; ++c) line[c] = from[over ? 4 * c : c];
    };
    auto right_side = [&](int q, int c) {
        return turned ? (q < stop ? far[4 * (n - 1 - q) + c] : 0.0) : far[4 * q + c];
    };
#define WROD_FETCH_ROW(q) \\
    if (lane < 4 * W) { \\
        double fetched[4]; \\
        fetch(q, lane / 4, lane % 4, WROD_OWN(start, 0), WROD_OWN(base, 0), fetched); \\
        WROD_UNROLL for (int c = 0; c < 4; ++c) WROD_OWN(line, c) = fetched[c]; \\
        if (lane < 4 && (q) < count) WROD_OWN(right, 0) = right_side(q, lane); \\
    }
#define WROD_BRING_ROW \\
    WROD_TEAM { \\
        if (b + W < count && lane < 4 * W) { \\
            double* there = window + STRIDE * WROD_OWN(spot, 0) + 4 * (lane % 4); \\
            WROD_UNROLL for (int c = 0; c < 4; ++c) there[c] = WROD_OWN(line, c); \\
            if (lane < 4) { \\
                WROD_UNROLL for (int c = 0; c < 4; ++c) \\
                    if (c == lane) size[4 * here + c] = WROD_OWN(line, c); \\
                value[4 * here + lane] = WROD_OWN(right, 0); \\
            } \\
        } \\
        if (++WROD_OWN(spot, 0) == WROD_RING(lane / 4 + 1)) \\
            WROD_OWN(spot, 0) = WROD_RING(lane / 4); \\
        WROD_FETCH_ROW(b + W + 1) \\
        WROD_FETCH_PROFILE(b + W + 2) \\
    }

    WROD_TEAM {
        for (int q = lane; q < (turned ? stop : count); q += TEAM) {
            const int p = turned ? n - 1 - q : q;
            WROD_UNROLL for (int c = 0; c < 4; ++c) {
                const int a = 4 * nodes[p] + c;
                far[4 * p + c] = a < dofs && open[a] != 0 ? load[a] : 0.0;
            }
            if (turned) {
                int lowest = p;
                for (int t = p; t < n && t <= p + REACH; ++t)
                    if (starts[t] < lowest) lowest = starts[t];
                mine[q] = n - 1 - lowest;
            }
        }
        WROD_OWN(spot, 0) = WROD_RING(lane / 4);
        WROD_OWN(start, 0) = WROD_OWN(base, 0) = 0;
    }
    WROD_WAIT();
    WROD_TEAM {
        // Line e of block (q, q - k), whose column is its place in the ring.
        for (int t = lane; t < 4 * W * W; t += TEAM) {
            const int q = t / (4 * W), k = t / 4 % W, e = t % 4;
            if (q >= count || k > q) continue;
            const int p = turned ? n - 1 - q + k : q;
            double fetched[4];
            fetch(q, k, e, starts[p], rows[p], fetched);
            double* there = window + STRIDE * (WROD_RING(k) + q - k) + 4 * e;
            WROD_UNROLL for (int c = 0; c < 4; ++c) there[c] = fetched[c];
            if (k > 0) continue;
            WROD_UNROLL for (int c = 0; c < 4; ++c)
                if (c == e) size[4 * q + c] = fetched[c];
            value[4 * q + e] = right_side(q, e);
        }
        WROD_FETCH_PROFILE(W)
        WROD_FETCH_ROW(W)
        WROD_FETCH_PROFILE(W + 1)
    }
"""
    + ELIMINATE
    + """
    const int* at = place + W * (stop % 2);
    double* left = left_of_middle + side * LEFT;
    WROD_TEAM {
        if (lane == 0) negative_out.data[2 * r + side] = negative;
        for (int t = lane; t < 4 * middle * middle; t += TEAM) {
            const int i = t / (4 * middle), j = t / 4 % middle, k = i - j, e = t % 4;
            if (k < 0) continue;
            int from = at[k] + j;
            if (from >= WROD_RING(k + 1)) from -= W - k;
            WROD_UNROLL for (int c = 0; c < 4; ++c)
                left[16 * (i * (i + 1) / 2 + j) + 4 * e + c] = window[STRIDE * from + 4 * e + c];
            if (k > 0) continue;
            left[SIDES + 4 * i + e] = value[4 * ((stop + i) % W) + e];
            left[SIZES + 4 * i + e] = size[4 * ((stop + i) % W) + e];
        }
    }
"""
)


@wp.func_native(_FROM_AN_END)
def eliminate_from_an_end(
    free: wp.array2d(dtype=wp.int32),
    skyline: Skyline,
    gradient: wp.array2d(dtype=wp.float64),
    block: wp.array2d(dtype=wp.vec4d),
    r: int,
    side: int,
    reached: wp.array2d(dtype=wp.int32),
    y: wp.array2d(dtype=wp.float64),
    factor: wp.array2d(dtype=wp.float64),
    negative_out: wp.array2d(dtype=wp.int32),
): ...


_BACK_TO_AN_END = (
    _MEETING
    + """
    const int dofs = x.shape[2], stop = middle, own = side == 1 ? n - behind : before;
    const int* nodes = skyline.order.data + (size_t)r * n;
    double* solution = x.data + (size_t)r * x.shape[1] * dofs;
    double* columns = left_of_middle + 2 * LEFT + (size_t)COLUMN * REACH * side;
    auto reaches = [&](int b) { return middle - 1; };
#define WROD_BRING_ROW
    WROD_TEAM {
        // The other end counts rows backwards, and has its blocks transposed.
        const double* near = left_of_middle;
        const double* other = left_of_middle + LEFT;
        for (int t = lane; t < 4 * middle * middle; t += TEAM) {
            const int i = t / (4 * middle), j = t / 4 % middle, e = t % 4;
            if (j > i) continue;
            const int u = middle - 1 - j, v = middle - 1 - i;
            const double* mine = near + 16 * (i * (i + 1) / 2 + j) + 4 * e;
            const double* theirs = other + 16 * (u * (u + 1) / 2 + v);
            double* there = window + STRIDE * (WROD_RING(i - j) + j) + 4 * e;
            WROD_UNROLL for (int c = 0; c < 4; ++c)
                there[c] = mine[c] + theirs[i == j ? 4 * e + c : 4 * c + e];
            if (j < i) continue;
            value[4 * i + e] = near[SIDES + 4 * i + e] + other[SIDES + 4 * u + e];
            size[4 * i + e] = near[SIZES + 4 * i + e];
        }
    }
"""
    + ELIMINATE
    + BACK
    + """
    // The window is free now, and so are diagonals at first.
    double* known_middle = size;
    WROD_WAIT();
    go_back(columns, middle, middle, known_middle);
    WROD_TEAM {
        for (int k = lane; k < 4 * middle; k += TEAM) {
            const int i = k / 4;
            window[4 * (own + (side == 1 ? middle - 1 - i : i)) + k % 4] = known_middle[k];
        }
    }
    go_back(scratch + (side == 1 ? (size_t)COLUMN * behind : 0), own, own + middle, window);
    WROD_TEAM {
        // The first end tells what the middle is.
        for (int k = lane; k < 4 * (side == 1 ? own : own + middle); k += TEAM) {
            const int a = 4 * nodes[side == 1 ? n - 1 - k / 4 : k / 4] + k % 4;
            if (a < dofs) solution[a] = window[k];
        }
        if (side == 0 && lane == 0)
            negative_pivots_out.data[r] =
                negative_of.data[2 * r] + negative_of.data[2 * r + 1] + negative;
    }
"""
)


@wp.func_native(_BACK_TO_AN_END)
def go_back_to_an_end(
    skyline: Skyline,
    negative_of: wp.array2d(dtype=wp.int32),
    r: int,
    side: int,
    factor: wp.array2d(dtype=wp.float64),
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.kernel
def eliminate(
    # State in:
    m: Skyline,
    most_reach: int,
    free: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    block: wp.array2d(dtype=wp.vec4d),
    # Scratch: (rod, node); (rod, 4 node), in the new order.
    reached: wp.array2d(dtype=wp.int32),
    y: wp.array2d(dtype=wp.float64),
    # State out: (rod, `scratch_of`); (rod, end).
    factor: wp.array2d(dtype=wp.float64),
    negative_out: wp.array2d(dtype=wp.int32),
):
    """Eliminate what is before and what is behind the middle rows, with the gradient on the right,
    of rods none of whose columns reaches farther than `most_reach` rows, which `reach_of` tells.

    Launched over (rod, end, lane).
    """
    r, side, _lane = wp.tid()
    if is_solved(m, r) and m.reach[r] <= most_reach:
        eliminate_from_an_end(free, m, gradient, block, r, side, reached, y, factor, negative_out)


@wp.kernel
def go_back(
    # State in:
    m: Skyline,
    most_reach: int,
    gradient: wp.array2d(dtype=wp.float64),
    negative_of: wp.array2d(dtype=wp.int32),
    # State in and out:
    factor: wp.array2d(dtype=wp.float64),
    # State out:
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """The solution from what `eliminate` left; of rods that reach farther the gradient becomes the
    right-hand side."""
    r, side, lane = wp.tid()
    if not is_solved(m, r):
        return
    if m.reach[r] <= most_reach:
        go_back_to_an_end(m, negative_of, r, side, factor, x, negative_pivots_out)
    elif side == 0:
        for a in range(lane, gradient.shape[1], wp.block_dim()):
            x[r, 0, a] = gradient[r, a]
