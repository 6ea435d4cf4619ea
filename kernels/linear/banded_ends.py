"""Solution of a banded system on a GPU, two warps a rod: the same as `banded`'s, sooner.

The rows are eliminated from both ends at once (a twisted factorisation), one end by each warp, so
that half of them have to be waited for. What both leave of some rows between them is added up there
and eliminated as usual; then both go back to their ends. The right-hand side is eliminated with the
matrix. A warp takes four columns at a time: their pivots two by two, with one division's time for
both, and then all 65 numbers that these four columns change. A window of the band is in shared
memory; the rows after it are on their way meanwhile.

L and D are for these sweeps alone: those of the second end are of the reversed matrix. There are as
many negative pivots as in any factorisation.

Compiled for a CPU the same source loops over ends and lanes, to be tested without a GPU.
"""

import warp as wp
from wrod.kernels.linear.two_warps import WINDOWS

wp.set_module_options({"enable_backward": False})

_SOLVE = (
    WINDOWS
    + """
    const double smallest = 1.0e-14;
    const size_t begin = (size_t)r * hessian.shape[1] + first;
    const double* band = hessian.data + begin * BAND;
    const double* right = gradient.data + begin;
    const int* open = free.data + begin;
    double* factor = factor_out.data + begin * BAND;
    double* solution = x.data + (size_t)r * x.shape[1] * x.shape[2] + first;
    const double shifted = shift.data[r];
    // Rows that either end eliminates before they meet: whole windows of the first, four at a time
    // of the second, and at least as many between them as each reaches over.
    const int meet = CHUNK * ((n + CHUNK - REACH) / (2 * CHUNK));
    const int other = n - REACH - meet > 0 ? (n - REACH - meet) / 4 * 4 : 0;
    // Row a of an end, and where its rows from a on are kept.
#define WROD_PLACE(end, a) ((end) ? n - 1 - (a) : (a))
#define WROD_KEPT(end, a) (factor + ((end) ? n - other + (a) : (a)) * BAND)
    // Send for 32 rows from `from` on; of the second end these are parts of 42.
#define WROD_FETCH(end, from) \\
    { \\
        const int low = ((end) ? n - CHUNK - (from) : (from)) * BAND; \\
        _Pragma("unroll") for (int m = 0; m < 15; ++m) { \\
            const int e = lane + 32 * m; \\
            const bool wanted = m < 11 || ((end) && e < ROWS * BAND); \\
            if (wanted && low + e >= 0 && low + e < n * BAND) \\
                WROD_SEND(arrival + e, band + (low + e)); \\
        } \\
        const int a = (from) + lane; \\
        const bool inside = a >= 0 && a < n; \\
        WROD_OWN(opened) = inside ? open[WROD_PLACE(end, a)] : 0; \\
        WROD_OWN(coming) = inside ? right[WROD_PLACE(end, a)] : 0.0; \\
    }
    // They have arrived. Rows and columns that are not free are the identity's. Of what lies
    // between the ends the first has all, the second what it changes.
#define WROD_PUT(end, at, from) \\
    if ((at) + lane >= 0) { \\
        const int a = (from) + lane; \\
        const unsigned opens = (unsigned)(bits >> (lane + 32 - REACH)); \\
        const bool inside = a < ((end) ? n : n - other) && (opens >> REACH & 1); \\
        double* row = window + ((at) + lane) * BAND; \\
        const double* sent = arrival + ((end) ? 31 - lane : lane) * BAND; \\
        _Pragma("unroll") for (int k = 0; k < BAND; ++k) { \\
            double entry = k == 0 ? 1.0 : 0.0; \\
            if (a >= k && inside && (opens >> (REACH - k) & 1)) \\
                entry = sent[(end) ? k * (BAND + 1) : k] + (k == 0 ? shifted : 0.0); \\
            if ((end) && a - k >= other) entry = 0.0; \\
            row[k] = entry; \\
            if (k == 0) window[SIZE + (at) + lane] = entry; \\
        } \\
        const bool due = a < ((end) ? other : n - other) && (opens >> REACH & 1); \\
        window[RIGHT + (at) + lane] = due ? WROD_OWN(coming) : 0.0; \\
    }

    // Two pivots, of [[a, b], [b, c]], and their reciprocals; returns how many are negative.
    auto pivots = [&](double& a, double b, double& c, double size, double next, double* inverse) {
        // One that cancels to nothing would end as infinity; keep its sign, give it a size.
        const double least = smallest * (fabs(size) + smallest);
        if (fabs(a) < least) a = a < 0.0 ? -least : least;
        const double determinant = a * c - b * b;
        inverse[0] = reciprocal(a);
        inverse[1] = a * reciprocal(determinant);
        c = determinant * inverse[0];
        const double last = smallest * (fabs(next) + smallest);
        if (fabs(c) < last) {
            c = c < 0.0 ? -last : last;
            inverse[1] = 1.0 / c;
        }
        return (a < 0.0) + (c < 0.0);
    };

    WROD_MEET();
    for (int phase = 0; phase < 2; ++phase) {
        WROD_ENDS {
            if (phase == 0 || end == 0) {
                double* window = windows[end];
                double* product = products[end];
                double* scaled = scaleds[end];
                double* arrival = arrivals[end];
                WROD_LANE_VALUE(double, coming);
                WROD_LANE_VALUE(int, opened);
                int negative = 0;
                unsigned now = 0;
                unsigned long long bits = 0;
                const int start = phase == 0 ? 0 : meet;
                const int stop = phase == 1 ? n - other : end ? other : meet;
                if (phase == 0) {
                    WROD_LANES { WROD_FETCH(end, REACH - CHUNK) }
                    WROD_BALLOT(now, opened);
                    bits = (unsigned long long)now << 32;
                    WROD_ARRIVE();
                    WROD_LANES { WROD_PUT(end, REACH - CHUNK, REACH - CHUNK) }
                    WROD_SYNC();
                    WROD_LANES { WROD_FETCH(end, REACH) }
                    WROD_BALLOT(now, opened);
                    bits = bits >> 32 | (unsigned long long)now << 32;
                    WROD_ARRIVE();
                    WROD_LANES { WROD_PUT(end, REACH, REACH) }
                } else {
                    WROD_LANES {
                        const int a = start + REACH + lane;
                        WROD_OWN(opened) = a < n ? open[a] : 0;
                    }
                    WROD_BALLOT(now, opened);
                }
                // Entries lane, lane + 32 and lane + 64 of what four columns change: where the
                // factors are, where it stands and how far on four columns later; last the ten of
                // the right-hand side.
                WROD_LANE_ARRAY(int, left_at, 3);
                WROD_LANE_ARRAY(int, right_at, 3);
                WROD_LANE_ARRAY(int, stands, 3);
                WROD_LANE_ARRAY(int, moves, 3);
                WROD_LANES {
                    _Pragma("unroll") for (int m = 0; m < 3; ++m) {
                        const int e = lane + 32 * m;
                        int i = 0;
                        while ((i + 1) * (i + 2) / 2 <= e) ++i;
                        const int j = e - i * (i + 1) / 2;
                        WROD_OWN_ENTRY(left_at, m) = 4 * i;
                        WROD_OWN_ENTRY(right_at, m) = 4 * j;
                        WROD_OWN_ENTRY(stands, m) =
                            i < 10 ? (4 + i) * BAND + i - j : RIGHT + 4 + j;
                        WROD_OWN_ENTRY(moves, m) = i < 10 ? BAND : 1;
                    }
                }
                WROD_SYNC();
                for (int base = start; base < stop; base += CHUNK) {
                    WROD_LANES { WROD_FETCH(end, base + ROWS) }
                    const int count = stop - base < CHUNK ? stop - base : CHUNK;
                    for (int t = 0; t < count; t += 4) {
                        double* rows = window + t * BAND;
                        const double* sizes = window + SIZE + t;
                        double d[4][4], inverse[4], l[4][4];
                        _Pragma("unroll") for (int i = 0; i < 4; ++i)
                            _Pragma("unroll") for (int j = 0; j <= i; ++j)
                                d[i][j] = rows[i * BAND + i - j];
                        negative += pivots(
                            d[0][0], d[1][0], d[1][1], sizes[0], sizes[1], inverse
                        );
                        l[1][0] = d[1][0] * inverse[0];
                        _Pragma("unroll") for (int i = 2; i < 4; ++i) {
                            d[i][1] -= d[i][0] * l[1][0];
                            l[i][0] = d[i][0] * inverse[0];
                            l[i][1] = d[i][1] * inverse[1];
                        }
                        d[2][2] -= d[2][0] * l[2][0] + d[2][1] * l[2][1];
                        d[3][2] -= d[3][0] * l[2][0] + d[3][1] * l[2][1];
                        d[3][3] -= d[3][0] * l[3][0] + d[3][1] * l[3][1];
                        negative += pivots(
                            d[2][2], d[3][2], d[3][3], sizes[2], sizes[3],
                            inverse + 2
                        );
                        l[3][2] = d[3][2] * inverse[2];
                        WROD_LANES {
                            if (lane < 11) {
                                // A row below, or the right-hand side.
                                double* from = lane < 10 ? rows + (4 + lane) * (BAND + 1)
                                                         : window + RIGHT + t;
                                const int next = lane < 10 ? -1 : 1;
                                double m[4];
                                _Pragma("unroll") for (int c = 0; c < 4; ++c)
                                    m[c] = lane < 10 && 4 + lane - c > REACH ? 0.0 : from[c * next];
                                _Pragma("unroll") for (int c = 0; c < 4; ++c) {
                                    _Pragma("unroll") for (int e = 0; e < c; ++e)
                                        m[c] -= m[e] * l[c][e];
                                    const double entry = m[c] * inverse[c];
                                    product[4 * lane + c] = m[c];
                                    scaled[4 * lane + c] = entry;
                                    if (lane == 10 || 4 + lane - c <= REACH) from[c * next] = entry;
                                }
                            }
                            if (lane == 11) {
                                _Pragma("unroll") for (int i = 0; i < 4; ++i) {
                                    rows[i * BAND] = d[i][i];
                                    _Pragma("unroll") for (int j = 0; j < i; ++j)
                                        rows[i * BAND + i - j] = l[i][j];
                                }
                            }
                        }
                        WROD_SYNC();
                        WROD_LANES {
                            _Pragma("unroll") for (int m = 0; m < 3; ++m) {
                                const double* left = product + WROD_OWN_ENTRY(left_at, m);
                                const double* below = scaled + WROD_OWN_ENTRY(right_at, m);
                                if (m < 2 || lane == 0) {
                                    double change = 0.0;
                                    _Pragma("unroll") for (int c = 0; c < 4; ++c)
                                        change += left[c] * below[c];
                                    window[WROD_OWN_ENTRY(stands, m)
                                           + t * WROD_OWN_ENTRY(moves, m)] -= change;
                                }
                            }
                        }
                        WROD_SYNC();
                    }
                    WROD_LANES {
                        double* kept = WROD_KEPT(end, base);
                        _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32)
                            if (m < count * BAND) kept[m] = window[m];
                        if (lane < count)
                            solution[WROD_PLACE(end, base + lane)] = window[RIGHT + lane];
                    }
                    // The last window stays for the way back.
                    if (base + CHUNK < stop || (end == 0 && phase == 0)) {
                        WROD_SYNC();
                        WROD_LANES {
                            for (int m = lane; m < REACH * BAND; m += 32)
                                window[m] = window[CHUNK * BAND + m];
                            if (lane < REACH) {
                                window[SIZE + lane] = window[SIZE + CHUNK + lane];
                                window[RIGHT + lane] = window[RIGHT + CHUNK + lane];
                            }
                        }
                        bits = now;
                        WROD_BALLOT(now, opened);
                        bits |= (unsigned long long)now << 32;
                        WROD_ARRIVE();
                        WROD_LANES { WROD_PUT(end, REACH, base + ROWS) }
                        WROD_SYNC();
                    }
                }
                WROD_ARRIVE();  // what was sent for beyond the last window
                counts[end] = phase == 0 ? negative : counts[end] + negative;
            }
        }
        WROD_MEET();
        if (phase == 0 && other > 0) {
            // What the second end leaves of the ten rows before it.
            WROD_ENDS {
                if (end == 0) {
                    const int to = n - other - REACH - meet, from = (other - 1) % CHUNK + 1;
                    WROD_LANES {
                        for (int m = lane; m < REACH * BAND; m += 32) {
                            const int k = m % BAND, i = m / BAND;
                            if (k <= i)
                                windows[0][(to + i) * BAND + k] +=
                                    windows[1][(from + 9 - i + k) * BAND + k];
                        }
                        if (lane < REACH)
                            windows[0][RIGHT + to + lane] += windows[1][RIGHT + from + 9 - lane];
                    }
                    WROD_SYNC();
                }
            }
        }
    }

    // Back to the ends: the first to where it met the second, then both. Each lane has one unknown
    // of the chunk, and learns the others.
    WROD_LANE_VALUE(double, value);
    WROD_LANE_VALUE(double, known);
    // Which of its two windows an end is at.
    int turns[2] = {0, 0};
    for (int phase = 0; phase < 2; ++phase) {
        WROD_ENDS {
            const bool begins = phase == 0 || end == 1;
            const int stop = phase == 0 ? n - other : end ? other : meet;
            const int least = phase == 0 ? meet : 0;
            int turn = end == 0 ? turns[0] : turns[1];
            if (phase == 1 || end == 0) {
                for (int base = (stop - 1) / CHUNK * CHUNK; base >= least && stop > 0;
                     base -= CHUNK) {
                    if (begins && base + CHUNK >= stop) {
                        WROD_LANES {
                            // Beyond `stop` the second end knows what the first has found.
                            const int a = base + lane, b = a + CHUNK;
                            WROD_OWN(value) = a < stop ? windows[end][RIGHT + lane]
                                : end && a < stop + REACH ? solution[WROD_PLACE(1, a)] : 0.0;
                            WROD_OWN(known) =
                                end && b < stop + REACH ? solution[WROD_PLACE(1, b)] : 0.0;
                        }
                    } else {
                        const double* last = turn ? arrivals[end] : windows[end];
                        turn = 1 - turn;
                        double* here = turn ? arrivals[end] : windows[end];
                        WROD_LANES {
                            WROD_OWN(value) = solution[WROD_PLACE(end, base + lane)];
                            for (int m = lane; m < REACH * BAND; m += 32)
                                here[CHUNK * BAND + m] = last[m];
                        }
                        WROD_ARRIVE();
                    }
                    const double* window = turn ? arrivals[end] : windows[end];
                    WROD_LANES {
                        const double* kept = WROD_KEPT(end, base - CHUNK);
                        double* there = turn ? windows[end] : arrivals[end];
                        if (base >= CHUNK) {
                            _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32)
                                WROD_SEND(there + m, kept + m);
                        }
                    }
                    const int count = stop - base < CHUNK ? stop - base : CHUNK;
                    _Pragma("unroll") for (int t = 0; t < REACH; ++t) {
                        const double found = WROD_FROM(known, t);
                        WROD_LANES {
                            const int k = CHUNK + t - lane;
                            const double entry =
                                k <= REACH && lane < count ? window[(CHUNK + t) * BAND + k] : 0.0;
                            WROD_OWN(value) -= entry * found;
                        }
                    }
                    _Pragma("unroll 8") for (int t = CHUNK - 1; t > 0; --t) {
                        const double found = WROD_FROM(value, t);
                        WROD_LANES {
                            const int k = t - lane;
                            const double entry = k > 0 && k <= REACH && lane < count
                                                     ? window[t * BAND + k] : 0.0;
                            WROD_OWN(value) -= entry * found;
                        }
                    }
                    WROD_LANES {
                        WROD_OWN(known) = WROD_OWN(value);
                        if (lane < count)
                            solution[WROD_PLACE(end, base + lane)] = WROD_OWN(value);
                    }
                    WROD_SYNC();
                }
                if (end == 0) turns[0] = turn;
            }
        }
        WROD_MEET();
    }
    WROD_ENDS {
        WROD_LANES {
            if (lane == 0 && end == 0) {
                const int negative = counts[0] + counts[1];
                if (n == hessian.shape[1]) negative_pivots_out.data[r] = negative;
                else wp::atomic_add(negative_pivots_out.data + r, negative);
            }
        }
    }
"""
)


@wp.func_native(_SOLVE)
def solve_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    r: int,
    first: int,
    n: int,
    factor_out: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.kernel(launch_bounds=(64, 8))
def solve(
    # In:
    segment: wp.array(dtype=wp.vec2i),
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Scratch (rod, dof, 11):
    factor_out: wp.array3d(dtype=wp.float64),
    # Out:
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """Solve (hessian + shift) x = gradient for the free degrees of freedom, the first column of
    `x`, and count negative pivots; the others come out as zero.

    Launched over (rod, segment, thread) in blocks of `ENDS`.
    """
    r, s, _thread = wp.tid()
    if active[r] != 0:
        part = segment[s]
        solve_rod(
            free, hessian, gradient, shift, r, part[0], part[1],
            factor_out, x, negative_pivots_out,
        )  # fmt: skip
