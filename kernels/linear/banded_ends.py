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

wp.set_module_options({"enable_backward": False})

# Threads of a block: a warp for each end.
ENDS = 64

_SOLVE = """
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_ENDS for (int end = threadIdx.x / 32, once = 1; once; once = 0)
#define WROD_LANES for (int lane = threadIdx.x % 32, once_ = 1; once_; once_ = 0)
#define WROD_SYNC() __syncwarp()
#define WROD_MEET() __syncthreads()
#define WROD_LANE_VALUE(type, name) type name = 0
#define WROD_OWN(name) name
#define WROD_LANE_ARRAY(type, name, size) type name[size] = {}
#define WROD_OWN_ENTRY(name, m) name[m]
#define WROD_FROM(name, source) __shfl_sync(0xffffffffu, name, source)
#define WROD_BALLOT(bits, name) bits = __ballot_sync(0xffffffffu, name)
    auto reciprocal = [](double value) {
        double guess;
        asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(guess) : "d"(value));
        guess = fma(guess, fma(-value, guess, 1.0), guess);
        return fma(guess, fma(-value, guess, 1.0), guess);
    };
#else
#define WROD_SHARED
#define WROD_ENDS for (int end = 0; end < 2; ++end)
#define WROD_LANES for (int lane = 0; lane < 32; ++lane)
#define WROD_SYNC()
#define WROD_MEET()
#define WROD_LANE_VALUE(type, name) type name[32] = {}
#define WROD_OWN(name) name[lane]
#define WROD_LANE_ARRAY(type, name, size) type name[size][32] = {}
#define WROD_OWN_ENTRY(name, m) name[m][lane]
#define WROD_FROM(name, source) name[source]
#define WROD_BALLOT(bits, name) \\
    bits = 0; \\
    for (int lane = 0; lane < 32; ++lane) bits |= (unsigned)(name[lane] != 0) << lane
    auto reciprocal = [](double value) { return 1.0 / value; };
#endif
    const int BAND = 11, REACH = 10, CHUNK = 32, ROWS = CHUNK + REACH;
    // Row `at` of a window holds the entries (a, a - k), k = 0...10, of what is left, then of L and
    // D; the diagonal as it was, against which pivots that cancel are measured; the right side.
    const int STRIDE = 13, SIZE = 11, RIGHT = 12;
    WROD_SHARED double windows[2][ROWS * STRIDE];
    // Four columns of L D and of L below their diagonal block, and of the right-hand side.
    WROD_SHARED double products[2][44];
    WROD_SHARED double scaleds[2][44];
    WROD_SHARED int counts[2];
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
    // Row a of an end, and entry (a, a - k) of its matrix.
#define WROD_PLACE(end, a) ((end) ? n - 1 - (a) : (a))
#define WROD_ENTRY(end, a, k) ((size_t)((end) ? n - 1 - (a) + (k) : (a)) * BAND + (k))
    // Send for rows from `from` on, entry lane + 32 m in place m.
#define WROD_FETCH(end, from) \\
    _Pragma("unroll") for (int m = 0; m < BAND; ++m) { \\
        const int k = (lane + 32 * m) % BAND, a = (from) + (lane + 32 * m) / BAND; \\
        const bool inside = a >= k && a < n; \\
        WROD_OWN_ENTRY(ahead, m) = inside ? band[WROD_ENTRY(end, a, k)] : 0.0; \\
    } \\
    { \\
        const int a = (from) + lane; \\
        const bool inside = a >= 0 && a < n; \\
        WROD_OWN(opened) = inside ? open[WROD_PLACE(end, a)] : 0; \\
        WROD_OWN(coming) = inside ? right[WROD_PLACE(end, a)] : 0.0; \\
    }
    // They arrive. Rows and columns that are not free are the identity's. Of what lies between the
    // ends the first has all, the second what it changes.
#define WROD_PUT(end, at, from) \\
    _Pragma("unroll") for (int m = 0; m < BAND; ++m) { \\
        const int k = (lane + 32 * m) % BAND, row = (lane + 32 * m) / BAND, a = (from) + row; \\
        double entry = k == 0 ? 1.0 : 0.0; \\
        const bool both = (bits >> (row + 32) & 1) && (bits >> (row + 32 - k) & 1); \\
        if (a >= k && a < ((end) ? n : n - other) && both) \\
            entry = WROD_OWN_ENTRY(ahead, m) + (k == 0 ? shifted : 0.0); \\
        if ((end) && a - k >= other) entry = 0.0; \\
        if ((at) + row >= 0) { \\
            window[((at) + row) * STRIDE + k] = entry; \\
            if (k == 0) window[((at) + row) * STRIDE + SIZE] = entry; \\
        } \\
    } \\
    if ((at) + lane >= 0) { \\
        const bool due = (from) + lane < ((end) ? other : n - other); \\
        window[((at) + lane) * STRIDE + RIGHT] = \\
            due && (bits >> (lane + 32) & 1) ? WROD_OWN(coming) : 0.0; \\
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
                WROD_LANE_ARRAY(double, ahead, 11);
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
                    WROD_LANES { WROD_PUT(end, REACH - CHUNK, REACH - CHUNK) }
                    WROD_LANES { WROD_FETCH(end, REACH) }
                    WROD_BALLOT(now, opened);
                    bits = bits >> 32 | (unsigned long long)now << 32;
                    WROD_LANES { WROD_PUT(end, REACH, REACH) }
                } else {
                    WROD_LANES {
                        const int a = start + REACH + lane;
                        WROD_OWN(opened) = a < n ? open[a] : 0;
                    }
                    WROD_BALLOT(now, opened);
                }
                // Entries lane, lane + 32 and lane + 64 of what four columns change: where the
                // factors are, and where it stands; last the ten of the right-hand side.
                WROD_LANE_ARRAY(int, left_at, 3);
                WROD_LANE_ARRAY(int, right_at, 3);
                WROD_LANE_ARRAY(int, stands, 3);
                WROD_LANES {
                    _Pragma("unroll") for (int m = 0; m < 3; ++m) {
                        const int e = lane + 32 * m;
                        int i = 0;
                        while ((i + 1) * (i + 2) / 2 <= e) ++i;
                        const int j = e - i * (i + 1) / 2;
                        WROD_OWN_ENTRY(left_at, m) = 4 * i;
                        WROD_OWN_ENTRY(right_at, m) = 4 * j;
                        WROD_OWN_ENTRY(stands, m) =
                            i < 10 ? (4 + i) * STRIDE + i - j : (4 + j) * STRIDE + RIGHT;
                    }
                }
                WROD_SYNC();
                for (int base = start; base < stop; base += CHUNK) {
                    WROD_LANES { WROD_FETCH(end, base + ROWS) }
                    const int count = stop - base < CHUNK ? stop - base : CHUNK;
                    for (int t = 0; t < count; t += 4) {
                        double* rows = window + t * STRIDE;
                        double d[4][4], inverse[4], l[4][4];
                        _Pragma("unroll") for (int i = 0; i < 4; ++i)
                            _Pragma("unroll") for (int j = 0; j <= i; ++j)
                                d[i][j] = rows[i * STRIDE + i - j];
                        negative += pivots(
                            d[0][0], d[1][0], d[1][1], rows[SIZE], rows[STRIDE + SIZE], inverse
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
                            d[2][2], d[3][2], d[3][3], rows[2 * STRIDE + SIZE],
                            rows[3 * STRIDE + SIZE], inverse + 2
                        );
                        l[3][2] = d[3][2] * inverse[2];
                        WROD_LANES {
                            if (lane < 11) {
                                // A row below, or the right-hand side.
                                double m[4];
                                _Pragma("unroll") for (int c = 0; c < 4; ++c) {
                                    const int k = 4 + lane - c;
                                    const int at = lane < 10 ? (4 + lane) * STRIDE + k
                                                             : c * STRIDE + RIGHT;
                                    m[c] = lane < 10 && k > REACH ? 0.0 : rows[at];
                                    _Pragma("unroll") for (int e = 0; e < c; ++e)
                                        m[c] -= m[e] * l[c][e];
                                    const double entry = m[c] * inverse[c];
                                    product[4 * lane + c] = m[c];
                                    scaled[4 * lane + c] = entry;
                                    if (lane == 10 || k <= REACH) rows[at] = entry;
                                }
                            }
                            if (lane == 11) {
                                _Pragma("unroll") for (int i = 0; i < 4; ++i) {
                                    rows[i * STRIDE] = d[i][i];
                                    _Pragma("unroll") for (int j = 0; j < i; ++j)
                                        rows[i * STRIDE + i - j] = l[i][j];
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
                                    rows[WROD_OWN_ENTRY(stands, m)] -= change;
                                }
                            }
                        }
                        WROD_SYNC();
                    }
                    WROD_LANES {
                        _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32) {
                            const int k = m % BAND, t = m / BAND;
                            if (t < count)
                                factor[(size_t)WROD_PLACE(end, base + t) * BAND + k] =
                                    window[t * STRIDE + k];
                        }
                        if (lane < count)
                            solution[WROD_PLACE(end, base + lane)] = window[lane * STRIDE + RIGHT];
                    }
                    // The last window stays for the way back.
                    if (base + CHUNK < stop || (end == 0 && phase == 0)) {
                        WROD_SYNC();
                        WROD_LANES {
                            for (int m = lane; m < REACH * STRIDE; m += 32)
                                window[m] = window[CHUNK * STRIDE + m];
                        }
                        bits = now;
                        WROD_BALLOT(now, opened);
                        bits |= (unsigned long long)now << 32;
                        WROD_SYNC();
                        WROD_LANES { WROD_PUT(end, REACH, base + ROWS) }
                        WROD_SYNC();
                    }
                }
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
                                windows[0][(to + i) * STRIDE + k] +=
                                    windows[1][(from + 9 - i + k) * STRIDE + k];
                        }
                        if (lane < REACH)
                            windows[0][(to + lane) * STRIDE + RIGHT] +=
                                windows[1][(from + 9 - lane) * STRIDE + RIGHT];
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
    WROD_LANE_ARRAY(double, ahead, 11);
    for (int phase = 0; phase < 2; ++phase) {
        WROD_ENDS {
            double* window = windows[end];
            const bool begins = phase == 0 || end == 1;
            const int stop = phase == 0 ? n - other : end ? other : meet;
            const int least = phase == 0 ? meet : 0;
            if (phase == 1 || end == 0) {
                for (int base = (stop - 1) / CHUNK * CHUNK; base >= least && stop > 0;
                     base -= CHUNK) {
                    const bool there = begins && base + CHUNK >= stop;
                    if (there) {
                        WROD_LANES {
                            // Beyond `stop` the second end knows what the first has found.
                            const int a = base + lane, b = a + CHUNK;
                            WROD_OWN(value) = a < stop ? window[lane * STRIDE + RIGHT]
                                : end && a < stop + REACH ? solution[WROD_PLACE(1, a)] : 0.0;
                            WROD_OWN(known) =
                                end && b < stop + REACH ? solution[WROD_PLACE(1, b)] : 0.0;
                        }
                    } else {
                        WROD_LANES {
                            WROD_OWN(value) = solution[WROD_PLACE(end, base + lane)];
                            for (int m = lane; m < REACH * BAND; m += 32)
                                window[(CHUNK + m / BAND) * STRIDE + m % BAND] =
                                    window[m / BAND * STRIDE + m % BAND];
                        }
                        WROD_SYNC();
                        WROD_LANES {
                            _Pragma("unroll") for (int m = 0; m < BAND; ++m)
                                window[(lane + 32 * m) / BAND * STRIDE + (lane + 32 * m) % BAND] =
                                    WROD_OWN_ENTRY(ahead, m);
                        }
                        WROD_SYNC();
                    }
                    const int next = base - CHUNK;
                    WROD_LANES {
                        if (next >= 0) {
                            _Pragma("unroll") for (int m = 0; m < BAND; ++m)
                                WROD_OWN_ENTRY(ahead, m) =
                                    factor[(size_t)WROD_PLACE(end, next + (lane + 32 * m) / BAND)
                                           * BAND + (lane + 32 * m) % BAND];
                        }
                    }
                    const int count = stop - base < CHUNK ? stop - base : CHUNK;
                    _Pragma("unroll") for (int t = 0; t < REACH; ++t) {
                        const double found = WROD_FROM(known, t);
                        WROD_LANES {
                            const int k = CHUNK + t - lane;
                            const double entry =
                                k <= REACH && lane < count ? window[(CHUNK + t) * STRIDE + k] : 0.0;
                            WROD_OWN(value) -= entry * found;
                        }
                    }
                    _Pragma("unroll 8") for (int t = CHUNK - 1; t > 0; --t) {
                        const double found = WROD_FROM(value, t);
                        WROD_LANES {
                            const int k = t - lane;
                            const double entry = k > 0 && k <= REACH && lane < count
                                                     ? window[t * STRIDE + k] : 0.0;
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


@wp.kernel(launch_bounds=(64, 10))
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
