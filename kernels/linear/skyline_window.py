"""Skyline elimination on a GPU that keeps what it works on close at hand, one rod a block.

The same L and D as `skyline`, and the solution for one right-hand side along with them, for rods
none of whose columns reaches farther than `REACH` rows down. At column b the rows b...b + REACH + 1
lie in shared memory, the next one is on its way there, and only columns of L go back to where they
came from. Block (q + k, q) has a place in the ring of the k-th diagonal, which has room for as many
as can be there at a time; row b + ROWS takes the places of column b when that is done.

Forward substitution goes along with the factorisation. On the way back the lines for the next
`AHEAD` rows are fetched while one is at work. Kernels are launched over (rod, lane) in blocks of
`TEAM`; how blocks are stored, and that the source can be compiled for a CPU: `skyline_lanes`.
"""

import warp as wp
from wrod.kernels.lanes import TEAM
from wrod.kernels.linear.two_warps import RECIPROCAL

wp.set_module_options({"enable_backward": False})

# Rows of the window, and rows below a column's diagonal that fit: the newest is not looked at yet.
ROWS = 25
REACH = ROWS - 2
# Numbers of a block in the window: one more than it has, against bank conflicts.
_STRIDE = 17
_AHEAD = 4


def reach_of(nodes: int) -> int:
    """How far columns of rods of so many nodes may reach; -1 where their solution does not fit."""
    return REACH if 4 * nodes <= _STRIDE * ROWS * (ROWS + 1) // 2 else -1


_ELIMINATE = (
    f"const int TEAM = {TEAM}, W = {ROWS}, STRIDE = {_STRIDE};\n#define WROD_AHEAD {_AHEAD}\n"
    + RECIPROCAL
    + """
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_TEAM for (int lane = threadIdx.x, once = 1; once; once = 0)
#define WROD_FIRST_WARP if (threadIdx.x < 32)
#define WROD_WAIT() __syncthreads()
#define WROD_LANE_ARRAY(type, name, size) type name[size]
#define WROD_OWN(name, m) name[m]
#else
#define WROD_SHARED
#define WROD_TEAM for (int lane = 0; lane < TEAM; ++lane)
#define WROD_FIRST_WARP
#define WROD_WAIT()
#define WROD_LANE_ARRAY(type, name, size) type name[size][TEAM]
#define WROD_OWN(name, m) name[m][lane]
#endif
#define WROD_UNROLL _Pragma("unroll")
    // Where the ring of a diagonal begins.
#define WROD_RING(k) ((k) * W - (k) * ((k) - 1) / 2)
    const int n = first.shape[1], dofs = x.shape[2], ROOM = STRIDE * (W * (W + 1) / 2);
    double* lines = (double*)(block.data) + (size_t)r * block.shape[1] * 4;
    const int* starts = first.data + (size_t)r * n;
    const int* ends = last.data + (size_t)r * n;
    const int* rows = row.data + (size_t)r * n;
    const int* open = free.data + (size_t)r * dofs;
    const int* nodes = order.data + (size_t)r * n;
    double* solution = x.data + (size_t)r * x.shape[1] * dofs;
    const double* load = gradient.data + (size_t)r * dofs;
    double* far = y.data + (size_t)r * 4 * n;
    const double smallest = 1.0e-14;

    WROD_SHARED double window[ROOM];
    // Of the rows in the window: right-hand side, diagonal at first, where they start and lie.
    WROD_SHARED double value[4 * W];
    WROD_SHARED double size[4 * W];
    WROD_SHARED int start_of[W];
    WROD_SHARED int row_of[W];
    // Of the diagonal block of even and odd columns: L and D, 1 / D, and what is known of y.
    const int PIVOTS = 24;
    WROD_SHARED double pivots_of[2 * PIVOTS];
    // Places of the column's blocks, for even and odd columns.
    WROD_SHARED int place[2 * W];
    // What a lane brings next: a line of a row, k = lane / 4 blocks before its diagonal.
    WROD_LANE_ARRAY(double, line, 4);
    WROD_LANE_ARRAY(double, right, 1);
    WROD_LANE_ARRAY(int, spot, 1);
    // Its first blocks (i, j), i >= j, of a triangle, four lanes each.
    WROD_LANE_ARRAY(int, first_i, 1);
    WROD_LANE_ARRAY(int, first_j, 1);
    // Of the row after that.
    int coming_start = 0, coming_row = 0, next_start = 0, next_row = 0;
#define WROD_FETCH_PROFILE(p) \\
    if ((p) < n) { \\
        next_start = starts[p]; \\
        next_row = rows[p]; \\
    }
#define WROD_FETCH_ROW(p, start, at) \\
    WROD_UNROLL for (int c = 0; c < 4; ++c) WROD_OWN(line, c) = 0.0; \\
    if ((p) < n && lane < 4 * W) { \\
        const int q = (p) - lane / 4; \\
        if (q >= (start)) { \\
            const double* from = lines + 16 * ((at) + q) + 4 * (lane % 4); \\
            WROD_UNROLL for (int c = 0; c < 4; ++c) WROD_OWN(line, c) = from[c]; \\
        } \\
        if (lane < 4) WROD_OWN(right, 0) = far[4 * (p) + lane]; \\
    }
#define WROD_BRING(p, start, at) \\
    if ((p) < n && lane < 4 * W) { \\
        double* there = window + STRIDE * WROD_OWN(spot, 0) + 4 * (lane % 4); \\
        WROD_UNROLL for (int c = 0; c < 4; ++c) there[c] = WROD_OWN(line, c); \\
        const int slot = (p) % W; \\
        if (lane < 4) { \\
            WROD_UNROLL for (int c = 0; c < 4; ++c) \\
                if (c == lane) size[4 * slot + c] = WROD_OWN(line, c); \\
            value[4 * slot + lane] = WROD_OWN(right, 0); \\
        } \\
        if (lane == 0) { \\
            start_of[slot] = start; \\
            row_of[slot] = at; \\
        } \\
    }

    WROD_TEAM {
        for (int k = lane; k < 4 * n; k += TEAM) {
            const int a = 4 * nodes[k / 4] + k % 4;
            far[k] = a < dofs && open[a] != 0 ? load[a] : 0.0;
        }
        if (lane < W) place[lane] = WROD_RING(lane);
        WROD_OWN(spot, 0) = WROD_RING(lane / 4);
        // The first warp has none.
        int i = lane < 32 ? W : 0, j = lane < 32 ? 0 : lane / 4 - 7;
        while (j > i) j -= ++i;
        WROD_OWN(first_i, 0) = i;
        WROD_OWN(first_j, 0) = j;
    }
    WROD_WAIT();
    WROD_TEAM {
        if (lane < W && lane < n) {
            start_of[lane] = starts[lane];
            row_of[lane] = rows[lane];
        }
    }
    WROD_WAIT();
    WROD_TEAM {
        // Line t % 4 of block (p, q), which is the q-th of its ring; before the first is none.
        for (int t = lane; t < 4 * W * W; t += TEAM) {
            const int p = t / (4 * W), q = t / 4 % W, k = p - q, e = t % 4;
            if (p >= n || k < 0) continue;
            double* there = window + STRIDE * (WROD_RING(k) + q) + 4 * e;
            const double* from = lines + 16 * (row_of[p] + q) + 4 * e;
            const bool is_there = q >= start_of[p];
            WROD_UNROLL for (int c = 0; c < 4; ++c) there[c] = is_there ? from[c] : 0.0;
            if (k > 0) continue;
            size[4 * p + e] = from[e];
            value[4 * p + e] = far[4 * p + e];
        }
    }
    WROD_FETCH_PROFILE(W)
    WROD_TEAM { WROD_FETCH_ROW(W, next_start, next_row) }
    coming_start = next_start;
    coming_row = next_row;
    WROD_FETCH_PROFILE(W + 1)
    int negative = 0, end = ends[0];
    auto factorise = [&](double (&d)[4][4], int here, double* to) {
        double inverse[4], known[4];
        // Two pivots at a time, so that their reciprocals do not wait for each other.
        WROD_UNROLL for (int c = 0; c < 4; c += 2) {
            // One that cancels to nothing would end as infinity; keep its sign, give it a size.
            const double least = smallest * (fabs(size[4 * here + c]) + smallest);
            const double second = smallest * (fabs(size[4 * here + c + 1]) + smallest);
            if (fabs(d[c][c]) < least) d[c][c] = d[c][c] < 0.0 ? -least : least;
            const double pivot = d[c][c], beside = d[c + 1][c];
            double both = pivot * d[c + 1][c + 1] - beside * beside;
            const bool falls = both != 0.0 && (both < 0.0) != (pivot < 0.0);
            if (fabs(both) < second * fabs(pivot)) both = falls ? -second * pivot : second * pivot;
            negative += (pivot < 0.0) + falls;
            inverse[c] = reciprocal(pivot);
            inverse[c + 1] = pivot * reciprocal(both);
            d[c + 1][c] = beside * inverse[c];
            d[c + 1][c + 1] = both * inverse[c];
            WROD_UNROLL for (int e = c + 2; e < 4; ++e) {
                const double left = d[e][c], next = d[e][c + 1] - left * d[c + 1][c];
                d[e][c] = left * inverse[c];
                d[e][c + 1] = next * inverse[c + 1];
                WROD_UNROLL for (int f = c + 2; f <= e; ++f) {
                    d[e][f] -= d[e][c] * (f < e ? d[f][c] * pivot : left);
                    d[e][f] -= d[e][c + 1] * (f < e ? d[f][c + 1] * d[c + 1][c + 1] : next);
                }
            }
        }
        WROD_UNROLL for (int c = 0; c < 4; ++c) {
            known[c] = value[4 * here + c];
            WROD_UNROLL for (int e = 0; e < c; ++e) known[c] -= d[c][e] * known[e];
        }
        WROD_TEAM {
            if (lane == 0) {
                WROD_UNROLL for (int c = 0; c < 4; ++c) {
                    WROD_UNROLL for (int e = 0; e <= c; ++e) to[4 * c + e] = d[c][e];
                    to[16 + c] = inverse[c];
                    to[20 + c] = known[c];
                }
            }
        }
    };
    WROD_WAIT();
    WROD_FIRST_WARP {
        double d[4][4];
        WROD_UNROLL for (int c = 0; c < 4; ++c)
            WROD_UNROLL for (int e = 0; e <= c; ++e) d[c][e] = window[4 * c + e];
        factorise(d, 0, pivots_of);
    }
    WROD_WAIT();
    for (int b = 0; b < n; ++b) {
        const int below = end - b, here = b % W;
        const int* at = place + W * (b % 2);
        int* at_next = place + W * ((b + 1) % 2);
        if (b + 1 < n) end = ends[b + 1];
        const double* pivots = pivots_of + PIVOTS * (b % 2);
        double d[4][4], inverse[4], known[4];
        WROD_UNROLL for (int c = 0; c < 4; ++c) {
            WROD_UNROLL for (int e = 0; e < c; ++e) d[c][e] = pivots[4 * c + e];
            inverse[c] = pivots[16 + c];
            known[c] = pivots[20 + c];
        }
        WROD_TEAM {
            // Lines of the column: of L D in the window, of L where they came from.
            if (lane < 4 * below) {
                const int i = lane / 4, e = lane % 4;
                int slot = here + 1 + i;
                if (slot >= W) slot -= W;
                double* own = window + STRIDE * at[1 + i] + 4 * e;
                double m[4], change = 0.0;
                WROD_UNROLL for (int c = 0; c < 4; ++c) {
                    m[c] = own[c];
                    WROD_UNROLL for (int f = 0; f < c; ++f) m[c] -= m[f] * d[c][f];
                }
                WROD_UNROLL for (int c = 0; c < 4; ++c) {
                    own[c] = m[c];
                    m[c] *= inverse[c];
                    change += m[c] * known[c];
                }
                value[4 * slot + e] -= change;
                if (start_of[slot] <= b) {
                    double* to = lines + 16 * (row_of[slot] + b) + 4 * e;
                    WROD_UNROLL for (int c = 0; c < 4; ++c) to[c] = m[c];
                }
            }
            if (lane < W) {
                const int next = at[lane] + 1;
                at_next[lane] = next < WROD_RING(lane + 1) ? next : WROD_RING(lane);
            }
            if (lane == TEAM - 1) {
                double* to = lines + 16 * (row_of[here] + b);
                WROD_UNROLL for (int c = 0; c < 4; ++c) {
                    far[4 * b + c] = known[c] * inverse[c];
                    WROD_UNROLL for (int e = 0; e < c; ++e) to[4 * c + e] = d[c][e];
                    to[5 * c] = pivots[5 * c];
                }
            }
        }
        WROD_WAIT();
        // One warp has the next diagonal block, all others the rest of the triangle.
        WROD_FIRST_WARP if (b + 1 < n) {
            const double* diagonal = window + STRIDE * at_next[0];
            const double* left = window + STRIDE * at[1];
            WROD_UNROLL for (int c = 0; c < 4; ++c)
                WROD_UNROLL for (int e = 0; e <= c; ++e) {
                    double entry = diagonal[4 * c + e];
                    WROD_UNROLL for (int f = 0; f < 4; ++f)
                        if (below > 0) entry -= left[4 * c + f] * inverse[f] * left[4 * e + f];
                    d[c][e] = entry;
                }
            factorise(d, here + 1 < W ? here + 1 : 0, pivots_of + PIVOTS * ((b + 1) % 2));
        }
        WROD_TEAM {
            int i = WROD_OWN(first_i, 0), j = WROD_OWN(first_j, 0);
            const int e = lane % 4;
            while (i < below) {
                const int k = i - j;
                int to = at[k] + j + 1;
                if (to >= WROD_RING(k + 1)) to -= W - k;
                double* own = window + STRIDE * to + 4 * e;
                const double* left = window + STRIDE * at[i + 1] + 4 * e;
                const double* other = window + STRIDE * at[j + 1];
                // All is read before anything is written, which might be the same for a compiler.
                double scaled[4], entries[16], result[4];
                WROD_UNROLL for (int c = 0; c < 16; ++c) entries[c] = other[c];
                WROD_UNROLL for (int c = 0; c < 4; ++c) {
                    scaled[c] = left[c] * inverse[c];
                    result[c] = own[c];
                }
                WROD_UNROLL for (int c = 0; c < 4; ++c)
                    WROD_UNROLL for (int f = 0; f < 4; ++f)
                        result[f] -= scaled[c] * entries[4 * f + c];
                WROD_UNROLL for (int f = 0; f < 4; ++f) own[f] = result[f];
                j += TEAM / 4 - 8;
                while (j > i) j -= ++i;
            }
        }
        WROD_WAIT();
        // Nobody asks for the newest row until the next wait.
        WROD_TEAM {
            WROD_BRING(b + W, coming_start, coming_row)
            if (++WROD_OWN(spot, 0) == WROD_RING(lane / 4 + 1))
                WROD_OWN(spot, 0) = WROD_RING(lane / 4);
            WROD_FETCH_ROW(b + W + 1, next_start, next_row)
        }
        coming_start = next_start;
        coming_row = next_row;
        WROD_FETCH_PROFILE(b + W + 2)
    }
    // The way back. The window is free now.
    double* back = window;
    WROD_TEAM {
        if (lane == 0) negative_pivots_out.data[r] = negative;
        for (int k = lane; k < 4 * n; k += TEAM) back[k] = far[k];
    }
    // What a lane needs next: a row of a block of L^T, and which unknown it changes; and where the
    // rows after those start and lie.
    WROD_LANE_ARRAY(double, column, 4 * WROD_AHEAD);
    WROD_LANE_ARRAY(int, target, WROD_AHEAD);
    double l[WROD_AHEAD][6];
    int begin[WROD_AHEAD], base[WROD_AHEAD];
#define WROD_FETCH_BACK(s, p) \\
    if ((p) >= 0) { \\
        const double* from = lines + 16 * (base[s] + (p)); \\
        l[s][0] = from[4]; \\
        l[s][1] = from[8]; \\
        l[s][2] = from[9]; \\
        l[s][3] = from[12]; \\
        l[s][4] = from[13]; \\
        l[s][5] = from[14]; \\
    } \\
    WROD_TEAM { \\
        WROD_OWN(target, s) = -1; \\
        if ((p) >= 0 && begin[s] + lane / 4 < (p)) { \\
            WROD_OWN(target, s) = 4 * begin[s] + lane; \\
            const double* from = lines + 16 * (base[s] + begin[s] + lane / 4) + lane % 4; \\
            WROD_UNROLL for (int c = 0; c < 4; ++c) WROD_OWN(column, 4 * s + c) = from[4 * c]; \\
        } \\
    } \\
    if ((p) >= WROD_AHEAD) { \\
        begin[s] = starts[(p) - WROD_AHEAD]; \\
        base[s] = rows[(p) - WROD_AHEAD]; \\
    }
    WROD_UNROLL for (int s = 0; s < WROD_AHEAD; ++s) {
        if (n - 1 >= s) {
            begin[s] = starts[n - 1 - s];
            base[s] = rows[n - 1 - s];
        }
        WROD_FETCH_BACK(s, n - 1 - s)
    }
    WROD_WAIT();
    for (int top = n - 1; top >= 0; top -= WROD_AHEAD) {
        WROD_UNROLL for (int s = 0; s < WROD_AHEAD; ++s) {
            const int p = top - s;
            if (p >= 0) {
                double known[4];
                WROD_UNROLL for (int c = 0; c < 4; ++c) known[c] = back[4 * p + c];
                known[2] -= l[s][5] * known[3];
                known[1] -= l[s][4] * known[3] + l[s][2] * known[2];
                known[0] -= l[s][3] * known[3] + l[s][1] * known[2] + l[s][0] * known[1];
                WROD_TEAM {
                    if (WROD_OWN(target, s) >= 0) {
                        double change = 0.0;
                        WROD_UNROLL for (int c = 0; c < 4; ++c)
                            change += WROD_OWN(column, 4 * s + c) * known[c];
                        back[WROD_OWN(target, s)] -= change;
                    }
                }
                WROD_FETCH_BACK(s, p - WROD_AHEAD)
                WROD_WAIT();
                WROD_TEAM {
                    if (lane == 0) {
                        WROD_UNROLL for (int c = 0; c < 3; ++c) back[4 * p + c] = known[c];
                    }
                }
            }
        }
    }
    WROD_WAIT();
    WROD_TEAM {
        for (int k = lane; k < 4 * n; k += TEAM) {
            const int a = 4 * nodes[k / 4] + k % 4;
            if (a < dofs) solution[a] = back[k];
        }
    }
"""
)


@wp.func_native(_ELIMINATE)
def eliminate_rod(
    free: wp.array2d(dtype=wp.int32),
    order: wp.array2d(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    last: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    y: wp.array2d(dtype=wp.float64),
    r: int,
    block: wp.array2d(dtype=wp.vec4d),
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.kernel
def eliminate(
    # State in:
    coupled: wp.array(dtype=wp.int32),
    overflow: wp.array(dtype=wp.int32),
    reach: wp.array(dtype=wp.int32),
    most_reach: int,
    free: wp.array2d(dtype=wp.int32),
    order: wp.array2d(dtype=wp.int32),
    first: wp.array2d(dtype=wp.int32),
    last: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    # Scratch (rod, 4 node), in the new order:
    y: wp.array2d(dtype=wp.float64),
    # State in and out:
    block: wp.array2d(dtype=wp.vec4d),
    x: wp.array3d(dtype=wp.float64),
    # State out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """`skyline.factorise`, then `skyline.solve` for the gradient, of rods none of whose columns
    reaches farther than `most_reach` rows, which `reach_of` tells; of others the gradient becomes
    the right-hand side."""
    r, lane = wp.tid()
    if coupled[r] == 0 or overflow[r] != 0:
        return
    if reach[r] <= most_reach:
        eliminate_rod(free, order, first, last, row, gradient, y, r, block, x, negative_pivots_out)
    else:
        for a in range(lane, gradient.shape[1], wp.block_dim()):
            x[r, 0, a] = gradient[r, a]
