"""Banded factorisation and solution on a GPU, one rod a warp: the same L and D as `banded`.

Rods that share a row are segments of it, (first degree of freedom, how many), which nothing in the
band couples.

Both sweep over the rows in chunks of 32, a window of the band in shared memory. A pivot updates the
55 entries of the triangle below it at once, two a lane. In a solution each lane has one unknown of
the chunk, which the others learn by a shuffle. Kernels are launched over (rod, ..., lane) in blocks
of one warp; arrays are contiguous.

Compiled for a CPU the same source loops over the 32 lanes, so that it can be tested without a GPU.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

LANES = """
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_LANES for (int lane = threadIdx.x % 32, once = 1; once; once = 0)
#define WROD_SYNC() __syncwarp()
#define WROD_LANE_VALUE(type, name) type name = 0
#define WROD_OWN(name) name
#define WROD_LANE_ARRAY(type, name, size) type name[size] = {}
#define WROD_OWN_ENTRY(name, m) name[m]
#define WROD_FROM(name, source) __shfl_sync(0xffffffffu, name, source)
#define WROD_TOUCH(pointer) asm volatile("prefetch.global.L1 [%0];" ::"l"(pointer))
#else
#define WROD_SHARED
#define WROD_LANES for (int lane = 0; lane < 32; ++lane)
#define WROD_SYNC()
#define WROD_LANE_VALUE(type, name) type name[32] = {}
#define WROD_OWN(name) name[lane]
#define WROD_LANE_ARRAY(type, name, size) type name[size][32] = {}
#define WROD_OWN_ENTRY(name, m) name[m][lane]
#define WROD_FROM(name, source) name[source]
#define WROD_TOUCH(pointer) (void)(pointer)
#endif
    const int BAND = 11, REACH = 10, STRIDE = 12, CHUNK = 32;
    // Row `at` of the window holds entries (a, a - k), k = 0...10; lanes that walk along a column
    // or a row meet no bank conflicts.
    WROD_SHARED double window[42 * 12];
#define WROD_AT(at, k) window[(at) * STRIDE + (k)]
    // In a substitution each lane has one unknown of a chunk of 32, which the others learn by a
    // shuffle; first the chunk before takes off what it knows. Going back, `beyond` and `here` are
    // the rows of the window that have the entries of the chunk before and of this one.
#define WROD_FORWARD() \\
    for (int t = CHUNK - REACH; t < CHUNK; ++t) { \\
        const double other = WROD_FROM(known, t); \\
        WROD_LANES { \\
            const int k = lane + CHUNK - t; \\
            if (k <= REACH) WROD_OWN(value) -= WROD_AT(lane, k) * other; \\
        } \\
    } \\
    _Pragma("unroll 4") for (int t = 0; t < CHUNK; ++t) { \\
        const double other = WROD_FROM(value, t); \\
        WROD_LANES { \\
            const int k = lane - t; \\
            if (k > 0 && k <= REACH) WROD_OWN(value) -= WROD_AT(lane, k) * other; \\
        } \\
    }
#define WROD_BACKWARD(beyond, here, pivot) \\
    for (int t = 0; t < REACH; ++t) { \\
        const double other = WROD_FROM(known, t); \\
        WROD_LANES { \\
            const int k = CHUNK + t - lane; \\
            if (k <= REACH) WROD_OWN(value) -= WROD_AT(beyond, k) * other; \\
        } \\
    } \\
    _Pragma("unroll 4") for (int t = CHUNK - 1; t >= 0; --t) { \\
        const double other = WROD_FROM(value, t) * (pivot); \\
        WROD_LANES { \\
            const int k = t - lane; \\
            if (k > 0 && k <= REACH) WROD_OWN(value) -= WROD_AT(here, k) * other; \\
        } \\
    }
"""

_FACTORISE = (
    LANES
    + """
    const double smallest = 1.0e-14;
    const size_t begin = (size_t)r * hessian.shape[1] + first;
    const double* band = hessian.data + begin * BAND;
    const int* open = free.data + begin;
    double* factor = factor_out.data + begin * BAND;
    const double shifted = shift.data[r];
    // Rows that have been sent for, entry lane + 32 m in place m: they arrive while others are
    // worked on. Outside the matrix entries are zero.
    WROD_LANE_ARRAY(double, ahead, 11);
#define WROD_FETCH(array, first) \\
    _Pragma("unroll") for (int m = 0; m < BAND; ++m) { \\
        const int k = (lane + 32 * m) % BAND, a = (first) + (lane + 32 * m) / BAND; \\
        const bool inside = a >= k && a < n; \\
        WROD_OWN_ENTRY(ahead, m) = inside ? (array)[a * BAND + k] : 0.0; \\
    }
    // The window holds the 32 rows whose pivots are due and the 10 below them. Entries right of the
    // present pivot are those of what is left to factorise; left of it they are those of L D.
    // Reciprocals of the pivots of the 10 rows before the window and of its first 32:
    WROD_SHARED double inverses[42];
    WROD_SHARED double pivots[32];

    // Rows and columns that are not free are the identity's. Column 11 of the window keeps the
    // diagonal, against which pivots that cancel are measured.
#define WROD_PUT(at, first) \\
    _Pragma("unroll") for (int m = 0; m < BAND; ++m) { \\
        const int k = (lane + 32 * m) % BAND, row = (lane + 32 * m) / BAND, a = (first) + row; \\
        double entry = k == 0 ? 1.0 : 0.0; \\
        if (a >= k && a < n && open[a] * open[a - k] != 0) \\
            entry = WROD_OWN_ENTRY(ahead, m) + (k == 0 ? shifted : 0.0); \\
        if ((at) + row >= 0) WROD_AT((at) + row, k) = entry; \\
        if ((at) + row >= 0 && k == 0) WROD_AT((at) + row, 11) = entry; \\
    }

    // Entries lane + 1 and lane + 33 of the triangle: row i >= column j, both from 1 on. The first
    // is the next pivot, which every lane finds for itself.
    WROD_LANE_VALUE(int, row);
    WROD_LANE_VALUE(int, column);
    WROD_LANE_VALUE(int, other_row);
    WROD_LANE_VALUE(int, other_column);
    WROD_LANES {
        int i = 1;
        while (i * (i + 1) / 2 <= lane + 1) ++i;
        WROD_OWN(row) = i;
        WROD_OWN(column) = lane + 2 - i * (i - 1) / 2;
        const int last = lane < 22 ? lane + 33 : 54;
        while (i * (i + 1) / 2 <= last) ++i;
        WROD_OWN(other_row) = i;
        WROD_OWN(other_column) = last + 1 - i * (i - 1) / 2;
    }

    WROD_SYNC();
    WROD_LANES {
        WROD_FETCH(band, REACH - CHUNK)
        WROD_PUT(REACH - CHUNK, REACH - CHUNK)
        WROD_FETCH(band, REACH)
        WROD_PUT(REACH, REACH)
        for (int m = lane; m < 42; m += 32) inverses[m] = 0.0;
    }
    WROD_SYNC();
    int negative = 0;
    double due = WROD_AT(0, 0);
    for (int base = 0; base < n; base += CHUNK) {
        WROD_LANES { WROD_FETCH(band, base + CHUNK + REACH) }
        const int count = n - base < CHUNK ? n - base : CHUNK;
        for (int t = 0; t < count; ++t) {
            // A pivot that cancels to nothing would end as infinity; keep its sign, give it a size.
            double pivot = due;
            double inverse = 1.0 / pivot;
            const double least = smallest * (fabs(WROD_AT(t, 11)) + smallest);
            if (fabs(pivot) < least) {
                pivot = pivot < 0.0 ? -least : least;
                inverse = 1.0 / pivot;
            }
            negative += pivot < 0.0;
            // Early, so that the next division need not wait for the window.
            const double next = WROD_AT(t + 1, 1);
            due = WROD_AT(t + 1, 0) - next * next * inverse;
            WROD_LANES {
                const int i = WROD_OWN(row), j = WROD_OWN(column);
                const int p = WROD_OWN(other_row), q = WROD_OWN(other_column);
                const double change = WROD_AT(t + i, i) * WROD_AT(t + j, j);
                const double other_change = WROD_AT(t + p, p) * WROD_AT(t + q, q);
                const double value = WROD_AT(t + i, i - j) - change * inverse;
                const double other_value = WROD_AT(t + p, p - q) - other_change * inverse;
                WROD_AT(t + i, i - j) = value;
                if (lane < 22) WROD_AT(t + p, p - q) = other_value;
                if (lane == 31) {
                    pivots[t] = pivot;
                    inverses[REACH + t] = inverse;
                }
            }
            WROD_SYNC();
        }
        WROD_LANES {
            _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32) {
                const int k = m % BAND, t = m / BAND;
                const double value = k == 0 ? pivots[t] : WROD_AT(t, k) * inverses[REACH + t - k];
                if (t < count) factor[base * BAND + m] = value;
            }
        }
        WROD_SYNC();
        WROD_LANES {
            for (int m = lane; m < REACH * STRIDE; m += 32) window[m] = window[CHUNK * STRIDE + m];
            if (lane < REACH) inverses[lane] = inverses[CHUNK + lane];
        }
        WROD_SYNC();
        WROD_LANES { WROD_PUT(REACH, base + CHUNK + REACH) }
        WROD_SYNC();
    }
    WROD_LANES {
        if (lane == 0 && n == hessian.shape[1]) negative_pivots_out.data[r] = negative;
        if (lane == 0 && n < hessian.shape[1])
            wp::atomic_add(negative_pivots_out.data + r, negative);
    }
"""
)


@wp.func_native(_FACTORISE)
def factorise_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    r: int,
    first: int,
    n: int,
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


_SOLVE = (
    LANES
    + """
    const size_t begin = (size_t)r * factor_in.shape[1] + first;
    const double* factor = factor_in.data + begin * BAND;
    const int* open = free.data + begin;
    double* solution = x.data + ((size_t)r * x.shape[1] + j) * x.shape[2] + at;
    // The window holds 32 rows of L and D and, going backwards, the 10 below them. The unknowns of
    // this chunk, and of the one before:
    WROD_LANE_VALUE(double, value);
    WROD_LANE_VALUE(double, known);

    // Start fetching a chunk of the band, 22 cache lines of 16 numbers.
#define WROD_PREFETCH(first) \\
    if ((first) >= 0 && lane < 22 && (first) * BAND + 16 * lane < n * BAND) \\
        WROD_TOUCH(factor + (first) * BAND + 16 * lane);
    // Entries left of the first column, and rows below the last, are zero.
#define WROD_LOAD_FACTOR(at, first, count) \\
    _Pragma("unroll") for (int m = lane; m < (count) * BAND; m += 32) { \\
        const int k = m % BAND, row = m / BAND, a = (first) + row; \\
        WROD_AT((at) + row, k) = a < n && k <= a ? factor[a * BAND + k] : 0.0; \\
    }

    for (int base = 0; base < n; base += CHUNK) {
        WROD_SYNC();
        WROD_LANES {
            const int a = base + lane;
            WROD_OWN(value) = a < n && open[a] != 0 ? solution[a] : 0.0;
            WROD_LOAD_FACTOR(0, base, CHUNK)
        }
        WROD_SYNC();
        WROD_LANES { WROD_PREFETCH(base + CHUNK) }
        WROD_FORWARD()
        WROD_LANES {
            WROD_OWN(known) = WROD_OWN(value);
            if (base + lane < n) solution[base + lane] = WROD_OWN(value) / WROD_AT(lane, 0);
        }
    }
    WROD_LANES { WROD_OWN(known) = 0.0; }
    for (int base = (n - 1) / CHUNK * CHUNK; base >= 0; base -= CHUNK) {
        WROD_SYNC();
        WROD_LANES {
            WROD_OWN(value) = base + lane < n ? solution[base + lane] : 0.0;
            WROD_LOAD_FACTOR(0, base, CHUNK)
            WROD_LOAD_FACTOR(CHUNK, base + CHUNK, REACH)
        }
        WROD_SYNC();
        WROD_LANES { WROD_PREFETCH(base - CHUNK) }
        WROD_BACKWARD(CHUNK + t, t, 1.0)
        WROD_LANES {
            WROD_OWN(known) = WROD_OWN(value);
            if (base + lane < n) solution[base + lane] = WROD_OWN(value);
        }
    }
"""
)


@wp.func_native(_SOLVE)
def solve_rod(
    free: wp.array2d(dtype=wp.int32),
    factor_in: wp.array3d(dtype=wp.float64),
    r: int,
    j: int,
    first: int,
    n: int,
    at: int,
    x: wp.array3d(dtype=wp.float64),
): ...


@wp.kernel
def clear_pivots(
    # In:
    active: wp.array(dtype=wp.int32),
    # Out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """Start counting, for rows of several segments."""
    r = wp.tid()
    if active[r] != 0:
        negative_pivots_out[r] = 0


@wp.kernel
def factorise(
    # In:
    segment: wp.array(dtype=wp.vec2i),
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """`banded.factorise`, launched over (rod, segment, lane)."""
    r, s, _lane = wp.tid()
    if active[r] != 0:
        part = segment[s]
        factorise_rod(free, hessian, shift, r, part[0], part[1], factor_out, negative_pivots_out)


@wp.kernel
def solve(
    # In:
    segment: wp.array(dtype=wp.vec2i),
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    # In and out:
    x: wp.array3d(dtype=wp.float64),
):
    """`banded.solve`, launched over (rod, right-hand side, segment, lane)."""
    r, j, s, _lane = wp.tid()
    if active[r] != 0:
        part = segment[s]
        solve_rod(free, factor, r, j, part[0], part[1], part[0], x)
