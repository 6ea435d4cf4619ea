"""Skyline factorisation and solution on a GPU, one rod a block: the same L and D as `skyline`.

The lanes take a block column of L at a time off what is to its right, each some lines (a row of a
block) of it, and wait for each other. In a solution every lane finds the four unknowns that are due
and takes them off some others; the lines for the next ones are fetched meanwhile. Kernels are
launched over (rod, lane) in blocks of `TEAM`; arrays are contiguous. Line x of block (p, b) is
`block[rod, 4 (row[p] + b) + x]`.

Compiled for a CPU the same source loops over the lanes, so that it can be tested without a GPU.
"""

import warp as wp
from wrod.kernels.lanes import TEAMWORK
from wrod.kernels.linear.skyline_order import Skyline, is_solved

# Numbers of a block in a column that is kept apart: one more than it has, against bank conflicts.
STRIDE = 17

_LANES = (
    TEAMWORK
    + f"const int STRIDE = {STRIDE};"
    + """
    const int n = skyline.first.shape[1];
    double* lines = (double*)(block.data) + (size_t)r * block.shape[1] * 4;
    // The profile is close at hand for rods of so many nodes; of longer ones it stays where it is.
    const int NODES = 1024;
    WROD_SHARED int near_first[NODES];
    WROD_SHARED int near_last[NODES];
    WROD_SHARED int near_row[NODES];
    const int* starts = skyline.first.data + (size_t)r * n;
    const int* ends = skyline.last.data + (size_t)r * n;
    const int* rows = skyline.row.data + (size_t)r * n;
    if (n <= NODES) {
        WROD_TEAM {
            for (int p = lane; p < n; p += TEAM) {
                near_first[p] = starts[p];
                near_last[p] = ends[p];
                near_row[p] = rows[p];
            }
        }
        starts = near_first;
        ends = near_last;
        rows = near_row;
    }
    WROD_WAIT();
"""
)

_FACTORISE = (
    _LANES
    + """
    const double smallest = 1.0e-14;
    double* sizes = size.data + (size_t)r * 4 * n;
    WROD_TEAM {
        for (int a = lane; a < 4 * n; a += TEAM)
            sizes[a] = lines[16 * (rows[a / 4] + a / 4) + 5 * (a % 4)];
    }
    // A block column of L D and of L, close at hand unless it is very long.
    const int LONGEST = 96;
    WROD_SHARED double near_product[LONGEST * 17];
    WROD_SHARED double near_column[LONGEST * 17];
    double* far_product = product.data + (size_t)r * STRIDE * n;
    double* far_column = column.data + (size_t)r * STRIDE * n;
    int negative = 0;
    WROD_WAIT();
    for (int b = 0; b < n; ++b) {
        const int below = ends[b] - b;
        double* products = below <= LONGEST ? near_product : far_product;
        double* scaled = below <= LONGEST ? near_column : far_column;
        // Every lane factorises the diagonal block.
        double* diagonal = lines + 16 * (rows[b] + b);
        double d[4][4], inverse[4];
        _Pragma("unroll") for (int x = 0; x < 4; ++x)
            _Pragma("unroll") for (int y = 0; y <= x; ++y) d[x][y] = diagonal[4 * x + y];
        _Pragma("unroll") for (int c = 0; c < 4; ++c) {
            // A pivot that cancels to nothing would end as infinity; keep its sign, give it a size.
            const double least = smallest * (fabs(sizes[4 * b + c]) + smallest);
            if (fabs(d[c][c]) < least) d[c][c] = d[c][c] < 0.0 ? -least : least;
            negative += d[c][c] < 0.0;
            inverse[c] = 1.0 / d[c][c];
            _Pragma("unroll") for (int x = c + 1; x < 4; ++x) {
                const double entry = d[x][c] * inverse[c];
                _Pragma("unroll") for (int y = c + 1; y <= x; ++y) d[x][y] -= entry * d[y][c];
            }
            _Pragma("unroll") for (int x = c + 1; x < 4; ++x) d[x][c] *= inverse[c];
        }
        WROD_TEAM {
            for (int k = lane; k < 4 * below; k += TEAM) {
                const int p = b + 1 + k / 4;
                if (starts[p] > b) continue;
                double* line = lines + 16 * (rows[p] + b) + 4 * (k % 4);
                double m[4];
                _Pragma("unroll") for (int c = 0; c < 4; ++c) {
                    m[c] = line[c];
                    _Pragma("unroll") for (int e = 0; e < c; ++e) m[c] -= m[e] * d[c][e];
                }
                const int at = STRIDE * (k / 4) + 4 * (k % 4);
                _Pragma("unroll") for (int c = 0; c < 4; ++c) {
                    const double entry = m[c] * inverse[c];
                    products[at + c] = m[c];
                    scaled[at + c] = entry;
                    line[c] = entry;
                }
            }
        }
        WROD_WAIT();
        WROD_TEAM {
            if (lane == 0) {
                _Pragma("unroll") for (int x = 0; x < 4; ++x)
                    _Pragma("unroll") for (int y = 0; y <= x; ++y) diagonal[4 * x + y] = d[x][y];
            }
            // Four lanes take the blocks (i, j) of a triangle, i >= j, in turn.
            int i = 0, j = lane / 4;
            while (j > i) j -= ++i;
            while (i < below) {
                const int p = b + 1 + i, q = b + 1 + j, x = lane % 4;
                if (starts[p] <= b && starts[q] <= b) {
                    double* line = lines + 16 * (rows[p] + q) + 4 * x;
                    const double* left = products + STRIDE * i + 4 * x;
                    const double* right = scaled + STRIDE * j;
                    _Pragma("unroll") for (int y = 0; y < 4; ++y) {
                        double change = 0.0;
                        _Pragma("unroll") for (int c = 0; c < 4; ++c)
                            change += left[c] * right[4 * y + c];
                        line[y] -= change;
                    }
                }
                j += TEAM / 4;
                while (j > i) j -= ++i;
            }
        }
        WROD_WAIT();
    }
    WROD_TEAM {
        if (lane == 0) negative_pivots_out.data[r] = negative;
    }
"""
)


@wp.func_native(_FACTORISE)
def factorise_rod(
    skyline: Skyline,
    size: wp.array2d(dtype=wp.float64),
    product: wp.array2d(dtype=wp.float64),
    column: wp.array2d(dtype=wp.float64),
    r: int,
    block: wp.array2d(dtype=wp.vec4d),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


_SOLVE = (
    _LANES
    + """
    const int dofs = x.shape[2];
    double* solution = x.data + (size_t)r * x.shape[1] * dofs;
    const int* open = free.data + (size_t)r * dofs;
    const int* nodes = skyline.order.data + (size_t)r * n;
    WROD_SHARED double near_y[4 * NODES];
    double* value = n <= NODES ? near_y : y.data + (size_t)r * 4 * n;
    WROD_TEAM {
        for (int k = lane; k < 4 * n; k += TEAM) {
            const int a = 4 * nodes[k / 4] + k % 4;
            value[k] = a < dofs && open[a] != 0 ? solution[a] : 0.0;
        }
    }
    // What a lane needs next: a line of L, or a row of a block, and which unknown it changes.
    WROD_LANE_ARRAY(double, line, 4);
    WROD_LANE_ARRAY(int, target, 1);
    double d[4][4];
#define WROD_FETCH_DIAGONAL(p) \\
    if ((p) >= 0 && (p) < n) { \\
        const double* from = lines + 16 * (rows[p] + (p)); \\
        _Pragma("unroll") for (int c = 1; c < 4; ++c) \\
            _Pragma("unroll") for (int e = 0; e < c; ++e) d[c][e] = from[4 * c + e]; \\
    }
#define WROD_FETCH_COLUMN(b) \\
    WROD_OWN(target, 0) = -1; \\
    if ((b) < n) { \\
        const int p = (b) + 1 + lane / 4; \\
        if (p <= ends[b] && starts[p] <= (b)) { \\
            WROD_OWN(target, 0) = 4 * p + lane % 4; \\
            const double* from = lines + 16 * (rows[p] + (b)) + 4 * (lane % 4); \\
            _Pragma("unroll") for (int c = 0; c < 4; ++c) WROD_OWN(line, c) = from[c]; \\
        } \\
    }
#define WROD_FETCH_ROW(p) \\
    WROD_OWN(target, 0) = -1; \\
    if ((p) >= 0) { \\
        const int b = starts[p] + lane / 4; \\
        if (b < (p)) { \\
            WROD_OWN(target, 0) = 4 * b + lane % 4; \\
            const double* from = lines + 16 * (rows[p] + b) + lane % 4; \\
            _Pragma("unroll") for (int c = 0; c < 4; ++c) WROD_OWN(line, c) = from[4 * c]; \\
        } \\
    }
#define WROD_TAKE_OFF() \\
    if (WROD_OWN(target, 0) >= 0) { \\
        double change = 0.0; \\
        _Pragma("unroll") for (int c = 0; c < 4; ++c) change += WROD_OWN(line, c) * known[c]; \\
        value[WROD_OWN(target, 0)] -= change; \\
    }

    WROD_FETCH_DIAGONAL(0)
    WROD_TEAM { WROD_FETCH_COLUMN(0) }
    WROD_WAIT();
    for (int b = 0; b < n; ++b) {
        double known[4];
        _Pragma("unroll") for (int c = 0; c < 4; ++c) {
            known[c] = value[4 * b + c];
            _Pragma("unroll") for (int e = 0; e < c; ++e) known[c] -= d[c][e] * known[e];
        }
        WROD_TEAM {
            WROD_TAKE_OFF()
            for (int k = lane + TEAM; k < 4 * (ends[b] - b); k += TEAM) {
                const int p = b + 1 + k / 4;
                if (starts[p] > b) continue;
                const double* from = lines + 16 * (rows[p] + b) + 4 * (k % 4);
                double change = 0.0;
                for (int c = 0; c < 4; ++c) change += from[c] * known[c];
                value[4 * (b + 1) + k] -= change;
            }
            WROD_FETCH_COLUMN(b + 1)
        }
        WROD_FETCH_DIAGONAL(b + 1)
        WROD_WAIT();
        WROD_TEAM {
            if (lane == 0) {
                _Pragma("unroll") for (int c = 1; c < 4; ++c) value[4 * b + c] = known[c];
            }
        }
    }
    WROD_WAIT();
    WROD_TEAM {
        for (int k = lane; k < 4 * n; k += TEAM)
            value[k] /= lines[16 * (rows[k / 4] + k / 4) + 5 * (k % 4)];
        WROD_FETCH_ROW(n - 1)
    }
    WROD_FETCH_DIAGONAL(n - 1)
    WROD_WAIT();
    for (int p = n - 1; p >= 0; --p) {
        double known[4];
        _Pragma("unroll") for (int c = 3; c >= 0; --c) {
            known[c] = value[4 * p + c];
            _Pragma("unroll") for (int e = c + 1; e < 4; ++e) known[c] -= d[e][c] * known[e];
        }
        WROD_TEAM {
            WROD_TAKE_OFF()
            for (int k = lane + TEAM; k < 4 * (p - starts[p]); k += TEAM) {
                const double* from = lines + 16 * (rows[p] + starts[p] + k / 4) + k % 4;
                double change = 0.0;
                for (int c = 0; c < 4; ++c) change += from[4 * c] * known[c];
                value[4 * starts[p] + k] -= change;
            }
            WROD_FETCH_ROW(p - 1)
        }
        WROD_FETCH_DIAGONAL(p - 1)
        WROD_WAIT();
        WROD_TEAM {
            if (lane == 0) {
                _Pragma("unroll") for (int c = 0; c < 3; ++c) value[4 * p + c] = known[c];
            }
        }
    }
    WROD_WAIT();
    WROD_TEAM {
        for (int k = lane; k < 4 * n; k += TEAM) {
            const int a = 4 * nodes[k / 4] + k % 4;
            if (a < dofs) solution[a] = value[k];
        }
    }
"""
)


@wp.func_native(_SOLVE)
def solve_rod(
    free: wp.array2d(dtype=wp.int32),
    skyline: Skyline,
    block: wp.array2d(dtype=wp.vec4d),
    y: wp.array2d(dtype=wp.float64),
    r: int,
    x: wp.array3d(dtype=wp.float64),
): ...


@wp.kernel
def factorise(
    # State in:
    m: Skyline,
    least_reach: int,
    # Scratch: diagonals at first (rod, 4 node); a column of L D and of L (rod, STRIDE node).
    size: wp.array2d(dtype=wp.float64),
    product: wp.array2d(dtype=wp.float64),
    column: wp.array2d(dtype=wp.float64),
    # State in and out:
    block: wp.array2d(dtype=wp.vec4d),
    # State out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """L D L^T in place; what is above the pivots of diagonal blocks stays as it was. Of rods of
    which some column reaches `least_reach` rows down."""
    r, _lane = wp.tid()
    if is_solved(m, r) and m.reach[r] >= least_reach:
        factorise_rod(m, size, product, column, r, block, negative_pivots_out)


@wp.kernel
def solve(
    # State in:
    m: Skyline,
    least_reach: int,
    free: wp.array2d(dtype=wp.int32),
    block: wp.array2d(dtype=wp.vec4d),
    # Scratch (rod, 4 node), in the new order:
    y: wp.array2d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
):
    """`skyline.solve`, of the same rods."""
    r, _lane = wp.tid()
    if is_solved(m, r) and m.reach[r] >= least_reach:
        solve_rod(free, m, block, y, r, x)
