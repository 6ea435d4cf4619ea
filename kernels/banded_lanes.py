"""Banded factorisation and solution on a GPU, one rod a warp: the same L and D as `banded`.

A sweep keeps 64 rows of the band in shared memory: the 32 whose pivots are due and the next 32.
Each pivot updates the 55 entries of the triangle below it at once, two a lane. Kernels are launched
over (rod, ..., lane) in blocks of one warp; arrays are contiguous.

Compiled for a CPU the same source loops over the 32 lanes, so that it can be tested without a GPU.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

_LANES = """
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_LANES for (int lane = threadIdx.x % 32, once = 1; once; once = 0)
#define WROD_SYNC() __syncwarp()
#else
#define WROD_SHARED
#define WROD_LANES for (int lane = 0; lane < 32; ++lane)
#define WROD_SYNC()
#endif
    // Entry (a, a - k) of the band; the odd stride between diagonals avoids bank conflicts.
    const int BAND = 11, STRIDE = 12, CHUNK = 32, RING = 64;
#define WROD_AT(a, k) window[((a) % RING) * STRIDE + (k)]
"""

_FACTORISE = (
    _LANES
    + """
    const double smallest = 1.0e-14;
    const int n = hessian.shape[1];
    const double* band = hessian.data + (size_t)r * n * BAND;
    const int* open = free.data + (size_t)r * n;
    double* factor = factor_out.data + (size_t)r * n * BAND;
    WROD_SHARED double window[64 * 12];
    WROD_SHARED double pivots[32];
    const double shifted = shift.data[r];

    // Column 11 keeps the diagonal, against which pivots that cancel are measured.
#define WROD_LOAD(first) \\
    _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32) { \\
        const int k = m % BAND, a = (first) + m / BAND; \\
        double value = k == 0 ? 1.0 : 0.0; \\
        if (a < n && k <= a && open[a] != 0 && open[a - k] != 0) \\
            value = band[a * BAND + k] + (k == 0 ? shifted : 0.0); \\
        WROD_AT(a, k) = value; \\
        if (k == 0) WROD_AT(a, 11) = value; \\
    }

    WROD_SYNC();
    WROD_LANES {
        WROD_LOAD(0)
        WROD_LOAD(CHUNK)
    }
    WROD_SYNC();
    int negative = 0;
    double inverse_before = 0.0;
    for (int base = 0; base < n; base += CHUNK) {
        const int end = base + CHUNK < n ? base + CHUNK : n;
        for (int a = base; a < end; ++a) {
            // A pivot that cancels to nothing would end as infinity; keep its sign, give it a size.
            double pivot = WROD_AT(a, 0);
            const double least = smallest * (fabs(WROD_AT(a, 11)) + smallest);
            if (fabs(pivot) < least) pivot = pivot < 0.0 ? -least : least;
            negative += pivot < 0.0;
            const double inverse = 1.0 / pivot;
            WROD_LANES {
                for (int m = lane; m < 55; m += 32) {
                    // Row i >= column j of the triangle, both from 1 on.
                    const int i = (int)(0.5f * (sqrtf(8.0f * m + 1.0f) + 1.0f));
                    const int j = m - i * (i - 1) / 2 + 1;
                    WROD_AT(a + i, i - j) -= WROD_AT(a + i, i) * inverse * WROD_AT(a + j, j);
                }
                // Nothing reads the column before any more: turn it from L D into L.
                const int k = 32 - lane;
                if (k <= 10) WROD_AT(a - 1 + k, k) *= inverse_before;
                if (lane == 0) pivots[a % CHUNK] = pivot;
            }
            WROD_SYNC();
            inverse_before = inverse;
        }
        WROD_LANES {
            _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32) {
                const int k = m % BAND, a = base + m / BAND;
                if (a < n) factor[a * BAND + k] = k == 0 ? pivots[a % CHUNK] : WROD_AT(a, k);
            }
            WROD_LOAD(base + RING)
        }
        WROD_SYNC();
    }
    WROD_LANES {
        if (lane == 0) negative_pivots_out.data[r] = negative;
    }
"""
)


@wp.func_native(_FACTORISE)
def factorise_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    r: int,
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


_SOLVE = (
    _LANES
    + """
    const int n = factor_in.shape[1];
    const double* factor = factor_in.data + (size_t)r * n * BAND;
    const int* open = free.data + (size_t)r * n;
    double* solution = x.data + ((size_t)r * x.shape[1] + j) * n;
    WROD_SHARED double window[64 * 12];
    WROD_SHARED double value[64];

#define WROD_LOAD_FACTOR(first) \\
    _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32) { \\
        const int k = m % BAND, a = (first) + m / BAND; \\
        WROD_AT(a, k) = a < n && k <= a ? factor[a * BAND + k] : (k == 0 ? 1.0 : 0.0); \\
    }
#define WROD_LOAD_RIGHT(first) { \\
        const int a = (first) + lane; \\
        value[a % RING] = a < n && open[a] != 0 ? solution[a] : 0.0; \\
    }

    WROD_SYNC();
    WROD_LANES {
        WROD_LOAD_FACTOR(0)
        WROD_LOAD_RIGHT(0)
        WROD_LOAD_FACTOR(CHUNK)
        WROD_LOAD_RIGHT(CHUNK)
    }
    WROD_SYNC();
    for (int base = 0; base < n; base += CHUNK) {
        const int end = base + CHUNK < n ? base + CHUNK : n;
        for (int a = base; a < end; ++a) {
            const double known = value[a % RING];
            WROD_LANES {
                const int k = lane + 1;
                if (k <= 10) value[(a + k) % RING] -= WROD_AT(a + k, k) * known;
            }
            WROD_SYNC();
        }
        WROD_LANES {
            const int a = base + lane;
            if (a < n) solution[a] = value[a % RING] / WROD_AT(a, 0);
        }
        WROD_SYNC();
        WROD_LANES {
            WROD_LOAD_FACTOR(base + RING)
            WROD_LOAD_RIGHT(base + RING)
        }
        WROD_SYNC();
    }

    // Backwards; the chunk below the present one receives what its last rows owe to it.
    const int last = (n - 1) / CHUNK * CHUNK;
    WROD_LANES {
        WROD_LOAD_FACTOR(last)
        WROD_LOAD_RIGHT(last)
    }
    WROD_SYNC();
    for (int base = last; base >= 0; base -= CHUNK) {
        WROD_LANES {
            if (base > 0) {
                WROD_LOAD_FACTOR(base - CHUNK)
                WROD_LOAD_RIGHT(base - CHUNK)
            }
        }
        WROD_SYNC();
        const int end = base + CHUNK < n ? base + CHUNK : n;
        for (int a = end - 1; a >= base; --a) {
            const double known = value[a % RING];
            WROD_LANES {
                const int k = lane + 1;
                if (k <= 10 && k <= a) value[(a - k) % RING] -= WROD_AT(a, k) * known;
            }
            WROD_SYNC();
        }
        WROD_LANES {
            const int a = base + lane;
            if (a < n) solution[a] = value[a % RING];
        }
        WROD_SYNC();
    }
"""
)


@wp.func_native(_SOLVE)
def solve_rod(
    free: wp.array2d(dtype=wp.int32),
    factor_in: wp.array3d(dtype=wp.float64),
    r: int,
    j: int,
    x: wp.array3d(dtype=wp.float64),
): ...


@wp.kernel
def factorise(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """`banded.factorise`, launched over (rod, lane)."""
    r, _lane = wp.tid()
    if active[r] != 0:
        factorise_rod(free, hessian, shift, r, factor_out, negative_pivots_out)


@wp.kernel
def solve(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    # In and out:
    x: wp.array3d(dtype=wp.float64),
):
    """`banded.solve`, launched over (rod, right-hand side, lane)."""
    r, j, _lane = wp.tid()
    if active[r] != 0:
        solve_rod(free, factor, r, j, x)
