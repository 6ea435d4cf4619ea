"""Skyline elimination on a GPU that keeps what it works on close at hand: columns of one block.

At column b the rows b...b + REACH + 1 lie in shared memory, and only columns of L go back to global
memory. Block (q + k, q) has a place in the ring of the k-th diagonal, which has room for as many as
can be there at a time; row b + ROWS takes the places of column b when that is done. Forward
substitution goes along with the factorisation.

A column of L lies in scratch memory: its diagonal block, with what is known of the solution on the
diagonal, then the REACH blocks below that. How blocks of lanes share the work, and that the source
can be compiled for a CPU: `skyline_lanes`. Who calls this: `skyline_ends`.
"""

from wrod.kernels.lanes import TEAMWORK
from wrod.kernels.linear.two_warps import RECIPROCAL

# Rows of the window, and rows below a column's diagonal that fit: the newest is not looked at yet.
ROWS = 25
REACH = ROWS - 2
# Numbers of a block in the window: one more than it has, against bank conflicts.
STRIDE = 17
# Numbers of a column of L in scratch memory.
COLUMN = 16 * (REACH + 1)
_AHEAD = 4

# What its user defines: `stop` columns are eliminated, `reaches(b)` is the last row that column b
# reaches, and WROD_BRING_ROW brings row b + ROWS.
WINDOW = (
    TEAMWORK + f"const int W = {ROWS}, REACH = {REACH}, STRIDE = {STRIDE}, COLUMN = {COLUMN};\n"
    f"#define WROD_AHEAD {_AHEAD}\n"
    + RECIPROCAL
    + """
#define WROD_UNROLL _Pragma("unroll")
    // Where the ring of a diagonal begins.
#define WROD_RING(k) ((k) * W - (k) * ((k) - 1) / 2)
    const double smallest = 1.0e-14;
    WROD_SHARED double window[STRIDE * (W * (W + 1) / 2)];
    // Of the rows in the window: right-hand side, and diagonal at first.
    WROD_SHARED double value[4 * W];
    WROD_SHARED double size[4 * W];
    // Of the diagonal block of even and odd columns: L and D, 1 / D, and what is known of y.
    const int PIVOTS = 24;
    WROD_SHARED double pivots_of[2 * PIVOTS];
    // Places of the column's blocks, for even and odd columns.
    WROD_SHARED int place[2 * W];
    // A lane's first blocks (i, j), i >= j, of a triangle, four lanes each.
    WROD_LANE_ARRAY(int, first_i, 1);
    WROD_LANE_ARRAY(int, first_j, 1);
    WROD_TEAM {
        if (lane < W) place[lane] = WROD_RING(lane);
        // The first warp has none.
        int i = lane < 32 ? W : 0, j = lane < 32 ? 0 : lane / 4 - 7;
        while (j > i) j -= ++i;
        WROD_OWN(first_i, 0) = i;
        WROD_OWN(first_j, 0) = j;
    }
    int negative = 0;
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
"""
)

ELIMINATE = """
    int end = stop > 0 ? reaches(0) : 0;
    WROD_WAIT();
    WROD_FIRST_WARP if (stop > 0) {
        double d[4][4];
        WROD_UNROLL for (int c = 0; c < 4; ++c)
            WROD_UNROLL for (int e = 0; e <= c; ++e) d[c][e] = window[4 * c + e];
        factorise(d, 0, pivots_of);
    }
    WROD_WAIT();
    for (int b = 0; b < stop; ++b) {
        const int below = end - b, here = b % W;
        const int* at = place + W * (b % 2);
        int* at_next = place + W * ((b + 1) % 2);
        if (b + 1 < stop) end = reaches(b + 1);
        const double* pivots = pivots_of + PIVOTS * (b % 2);
        double d[4][4], inverse[4], known[4];
        WROD_UNROLL for (int c = 0; c < 4; ++c) {
            WROD_UNROLL for (int e = 0; e < c; ++e) d[c][e] = pivots[4 * c + e];
            inverse[c] = pivots[16 + c];
            known[c] = pivots[20 + c];
        }
        double* column = columns + (size_t)COLUMN * b;
        WROD_TEAM {
            // Lines of the column: of L D in the window, of L in memory.
            if (lane < 4 * REACH) {
                double m[4] = {0.0, 0.0, 0.0, 0.0};
                if (lane < 4 * below) {
                    int slot = here + 1 + lane / 4;
                    if (slot >= W) slot -= W;
                    double* own = window + STRIDE * at[1 + lane / 4] + 4 * (lane % 4);
                    double change = 0.0;
                    WROD_UNROLL for (int c = 0; c < 4; ++c) {
                        m[c] = own[c];
                        WROD_UNROLL for (int f = 0; f < c; ++f) m[c] -= m[f] * d[c][f];
                    }
                    WROD_UNROLL for (int c = 0; c < 4; ++c) {
                        own[c] = m[c];
                        m[c] *= inverse[c];
                        change += m[c] * known[c];
                    }
                    value[4 * slot + lane % 4] -= change;
                }
                WROD_UNROLL for (int c = 0; c < 4; ++c) column[16 + 4 * lane + c] = m[c];
            }
            if (lane < W) {
                const int next = at[lane] + 1;
                at_next[lane] = next < WROD_RING(lane + 1) ? next : WROD_RING(lane);
            }
            if (lane == TEAM - 1) {
                WROD_UNROLL for (int c = 0; c < 4; ++c) {
                    WROD_UNROLL for (int e = 0; e < c; ++e) column[4 * c + e] = d[c][e];
                    column[5 * c] = known[c] * inverse[c];
                }
            }
        }
        WROD_WAIT();
        // One warp has the next diagonal block, all others the rest of the triangle.
        WROD_FIRST_WARP if (below > 0) {
            double* diagonal = window + STRIDE * at_next[0];
            const double* left = window + STRIDE * at[1];
            WROD_UNROLL for (int c = 0; c < 4; ++c)
                WROD_UNROLL for (int e = 0; e <= c; ++e) {
                    d[c][e] = diagonal[4 * c + e];
                    WROD_UNROLL for (int f = 0; f < 4; ++f)
                        d[c][e] -= left[4 * c + f] * inverse[f] * left[4 * e + f];
                }
            if (b + 1 < stop) {
                factorise(d, here + 1 < W ? here + 1 : 0, pivots_of + PIVOTS * ((b + 1) % 2));
            } else {
                WROD_WARP_WAIT();
                WROD_TEAM {
                    if (lane == 0) {
                        WROD_UNROLL for (int c = 0; c < 4; ++c)
                            WROD_UNROLL for (int e = 0; e <= c; ++e) diagonal[4 * c + e] = d[c][e];
                    }
                }
            }
        } else if (b + 1 < stop) {
            WROD_UNROLL for (int c = 0; c < 4; ++c)
                WROD_UNROLL for (int e = 0; e <= c; ++e)
                    d[c][e] = window[STRIDE * at_next[0] + 4 * c + e];
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
        WROD_BRING_ROW
    }
#undef WROD_BRING_ROW
"""

# x of `rows` rows below whose first `count` are the columns at `from`; of the others it is known.
BACK = """
    auto go_back = [&](const double* from, int count, int rows, double* back) {
        // What a lane needs next: a row of a block of L^T, and which unknown it changes.
        WROD_LANE_ARRAY(double, line, 4 * WROD_AHEAD);
        WROD_LANE_ARRAY(int, target, WROD_AHEAD);
        double l[WROD_AHEAD][6];
#define WROD_FETCH_BACK(s, p) \\
        if ((p) >= 0 && (p) < count) { \\
            const double* block = from + (size_t)COLUMN * (p); \\
            l[s][0] = block[4]; \\
            l[s][1] = block[8]; \\
            l[s][2] = block[9]; \\
            l[s][3] = block[12]; \\
            l[s][4] = block[13]; \\
            l[s][5] = block[14]; \\
        } \\
        WROD_TEAM { \\
            WROD_OWN(target, s) = -1; \\
            const int b = (p) - 1 - lane / 4; \\
            if (b >= 0 && b < count && lane < 4 * REACH) { \\
                WROD_OWN(target, s) = 4 * b + lane % 4; \\
                const double* block = from + (size_t)COLUMN * b + 16 * ((p) - b) + lane % 4; \\
                WROD_UNROLL for (int c = 0; c < 4; ++c) WROD_OWN(line, 4 * s + c) = block[4 * c]; \\
            } \\
        }
        WROD_TEAM {
            for (int k = lane; k < 4 * count; k += TEAM)
                back[k] = from[(size_t)COLUMN * (k / 4) + 5 * (k % 4)];
        }
        WROD_UNROLL for (int s = 0; s < WROD_AHEAD; ++s) { WROD_FETCH_BACK(s, rows - 1 - s) }
        WROD_WAIT();
        for (int top = rows - 1; top >= 0; top -= WROD_AHEAD) {
            WROD_UNROLL for (int s = 0; s < WROD_AHEAD; ++s) {
                const int p = top - s;
                if (p >= 0) {
                    double known[4];
                    WROD_UNROLL for (int c = 0; c < 4; ++c) known[c] = back[4 * p + c];
                    if (p < count) {
                        known[2] -= l[s][5] * known[3];
                        known[1] -= l[s][4] * known[3] + l[s][2] * known[2];
                        known[0] -= l[s][3] * known[3] + l[s][1] * known[2] + l[s][0] * known[1];
                    }
                    WROD_TEAM {
                        if (WROD_OWN(target, s) >= 0) {
                            double change = 0.0;
                            WROD_UNROLL for (int c = 0; c < 4; ++c)
                                change += WROD_OWN(line, 4 * s + c) * known[c];
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
    };
"""
