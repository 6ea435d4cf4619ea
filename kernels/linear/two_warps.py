"""Elimination in a banded system, by one warp (`factor_lanes`) or by two from its two ends
(`banded_ends`).

Snippets of device code: words for what lanes of a warp do, which on a GPU are instructions and on a
CPU loops over ends and lanes; the windows of the band that are looked at; the sweep itself.
"""

# Threads of a block: a warp for each end.
ENDS = 64

# Two steps of Newton's from a GPU's estimate; what is not normal is nobody's pivot.
RECIPROCAL = """
#if defined(__CUDA_ARCH__)
    auto reciprocal = [](double value) {
        double guess;
        asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(guess) : "d"(value));
        guess = fma(guess, fma(-value, guess, 1.0), guess);
        return fma(guess, fma(-value, guess, 1.0), guess);
    };
#else
    auto reciprocal = [](double value) { return 1.0 / value; };
#endif
"""

# What lanes of a warp do.
LANES = """
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
#define WROD_TOUCH(pointer) asm volatile("prefetch.global.L1 [%0];" ::"l"(pointer))
#define WROD_SEND(to, from) \\
    asm volatile("cp.async.ca.shared.global [%0], [%1], 8;" \\
                 ::"r"((unsigned)__cvta_generic_to_shared(to)), "l"(from))
#define WROD_ARRIVE() \\
    asm volatile("cp.async.wait_all;" ::: "memory"); \\
    __syncwarp()
#else
#define WROD_SHARED
#define WROD_ENDS for (int end = 0; end < SIDES; ++end)
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
#define WROD_TOUCH(pointer) (void)(pointer)
#define WROD_SEND(to, from) *(to) = *(from)
#define WROD_ARRIVE()
#endif
"""

# Eliminates rows, and the right-hand side where there is one, from as many SIDES as its user says.
ELIMINATE = (
    RECIPROCAL
    + LANES
    + """
    const int BAND = 11, REACH = 10, CHUNK = 32, ROWS = CHUNK + REACH;
    // A window holds rows of the entries (a, a - k), k = 0...10, of what is left, then of L and D;
    // then the rows' diagonal as it was, against which pivots that cancel are measured; then their
    // right side.
    const int SIZE = ROWS * BAND, RIGHT = SIZE + ROWS;
    WROD_SHARED double windows[SIDES][RIGHT + ROWS];
    WROD_SHARED double arrivals[SIDES][ROWS * BAND];
    // Four columns of L D and of L below their diagonal block, and of the right-hand side.
    WROD_SHARED double products[SIDES][44];
    WROD_SHARED double scaleds[SIDES][44];
    WROD_SHARED int counts[SIDES];
    const double smallest = 1.0e-14;
    const double* band = hessian.data + begin * BAND;
    const int* open = free.data + begin;
    double* factor = factor_out.data + begin * BAND;
    const double shifted = shift.data[r];
    // Rows that either end eliminates before they meet: whole windows of the first, four at a time
    // of the second, and at least as many between them as each reaches over.
    const int meet = SIDES == 1 ? 0 : CHUNK * ((n + CHUNK - REACH) / (2 * CHUNK));
    const int other = SIDES == 2 && n - REACH - meet > 0 ? (n - REACH - meet) / 4 * 4 : 0;
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
        WROD_OWN(coming) = inside && right ? right[WROD_PLACE(end, a)] : 0.0; \\
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
        if (SIDES == 2 || b != 0.0) c = determinant * inverse[0];
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
                        if (lane < count && solution)
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
                                    windows[SIDES - 1][(from + 9 - i + k) * BAND + k];
                        }
                        if (lane < REACH)
                            windows[0][RIGHT + to + lane] +=
                                windows[SIDES - 1][RIGHT + from + 9 - lane];
                    }
                    WROD_SYNC();
                }
            }
        }
    }

"""
)

# Says how many pivots were negative.
COUNT = """
    WROD_ENDS {
        WROD_LANES {
            if (lane == 0 && end == 0) {
                const int negative = counts[0] + (SIDES == 2 ? counts[SIDES - 1] : 0);
                if (n == hessian.shape[1]) negative_pivots_out.data[r] = negative;
                else wp::atomic_add(negative_pivots_out.data + r, negative);
            }
        }
    }
"""
