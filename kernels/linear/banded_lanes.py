"""Solution with banded factors on a GPU, one rod a warp.

Rods that share a row are segments of it, (first degree of freedom, how many), which nothing in the
band couples.

It sweeps over the rows in chunks of 32, a window of the band in shared memory. Each lane has one
unknown of the chunk, which the others learn by a shuffle. Kernels are launched over (rod, ...,
lane) in blocks of one warp; arrays are contiguous.

Compiled for a CPU the same source loops over the 32 lanes, so that it can be tested without a GPU.
"""

import warp as wp
from wrod.kernels.linear.two_warps import LANES

SWEEP = (
    LANES
    + """
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
)

_SOLVE = (
    SWEEP
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
