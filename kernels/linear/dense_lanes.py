"""Dense factorisation and solution by a whole GPU: A = L D L^T of rows' symmetric matrices, no
pivoting.

A panel of 32 columns is taken off what is to its right, in two rounds: every tile of 32 rows finds
its part of L (each block factorises the tile on the diagonal for itself), then tiles of 64 x 64 are
updated. Blocks of one launch take the tiles in turns and wait for each other in between, for which
there may be no more of them than the device has multiprocessors. By Sylvester's law the number of
negative D is that of the negative eigenvalues. Matrices are stored by rows, and read below their
diagonal; kernels are launched in blocks of `BLOCK`.

Compiled for a CPU the same source loops over the lanes, so that it can be tested without a GPU.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

BLOCK = 256
TILE = 32

_LANES = f"""
    const int BLOCK = {BLOCK}, T = {TILE}, STRIDE = {TILE} + 1;
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_BLOCK for (int lane = threadIdx.x, once = 1; once; once = 0)
#define WROD_WAIT() __syncthreads()
#define WROD_WAIT_NEAR() __syncwarp()
    // Blocks of a row that have come here, in all.
#define WROD_WAIT_FAR() \\
    __syncthreads(); \\
    if (blocks > 1) {{ \\
        if (threadIdx.x == 0) {{ \\
            __threadfence(); \\
            const int mine = atomicAdd(arrived.data + r, 1); \\
            const int goal = (mine / blocks + 1) * blocks; \\
            while (*(volatile int*)(arrived.data + r) < goal) {{}} \\
            __threadfence(); \\
        }} \\
        __syncthreads(); \\
    }}
#else
#define WROD_SHARED
#define WROD_BLOCK for (int lane = 0; lane < BLOCK; ++lane)
#define WROD_WAIT()
#define WROD_WAIT_NEAR()
#define WROD_WAIT_FAR()
#endif
"""

_FACTORISE = (
    _LANES
    + """
    const double smallest = 1.0e-14;
    const int WIDE = 64, LINE = WIDE + 1;
    const int n = matrix.shape[1], end = T * tiles;
    double* a = matrix.data + (size_t)r * n * n;
    double* products = panel.data + (size_t)r * n * T;
    WROD_SHARED double pool[2 * T * LINE];
    double* d = pool;
    double* x = pool + T * STRIDE;
    double* pivots = pool + 2 * T * STRIDE;
    double* inverses = pivots + T;
    double* upper = pool;
    double* lower = pool + T * LINE;
    for (int k = 0; k < tiles; ++k) {
        const double* sizes = size.data + (size_t)r * n + T * k;
        for (int i = k + block; i < tiles; i += blocks) {
            WROD_WAIT();
            WROD_BLOCK {
                for (int e = lane; e < T * T; e += BLOCK) {
                    const int p = e / T, c = e % T;
                    d[p * STRIDE + c] = a[(size_t)(T * k + p) * n + T * k + c];
                    x[p * STRIDE + c] = a[(size_t)(T * i + p) * n + T * k + c];
                }
            }
            WROD_WAIT();
            // Left of the present pivot entries are those of L D.
            int negative = 0;
            for (int j = 0; j < T; ++j) {
                double pivot = d[j * STRIDE + j];
                const double least = smallest * (fabs(sizes[j]) + smallest);
                if (fabs(pivot) < least) pivot = pivot < 0.0 ? -least : least;
                negative += pivot < 0.0;
                const double inverse = 1.0 / pivot;
                WROD_BLOCK {
                    if (lane == 0) {
                        pivots[j] = pivot;
                        inverses[j] = inverse;
                    }
                    for (int e = lane; e < T * T; e += BLOCK) {
                        const int p = e / T, c = e % T;
                        if (c > j && p >= c)
                            d[p * STRIDE + c] -= d[p * STRIDE + j] * d[c * STRIDE + j] * inverse;
                    }
                }
                WROD_WAIT();
            }
            if (i == k) {
                double* out = diagonal.data + ((size_t)r * n + T * k) * T;
                WROD_BLOCK {
                    for (int e = lane; e < T * T; e += BLOCK) {
                        const int p = e / T, c = e % T;
                        double entry = 0.0;
                        if (c < p) entry = d[p * STRIDE + c] * inverses[c];
                        if (c == p) entry = pivots[c];
                        out[e] = entry;
                    }
                    if (lane == 0) wp::atomic_add(negatives.data + r, -negative);
                }
            } else {
                // Eight lanes take a row of the tile below: L D first.
                for (int j = 0; j < T; ++j) {
                    WROD_BLOCK {
                        const int p = lane / (BLOCK / T), part = lane % (BLOCK / T);
                        const double entry = x[p * STRIDE + j] * inverses[j];
                        for (int c = part; c < T; c += BLOCK / T)
                            if (c > j) x[p * STRIDE + c] -= entry * d[c * STRIDE + j];
                    }
                    WROD_WAIT_NEAR();
                }
                WROD_WAIT();
                WROD_BLOCK {
                    for (int e = lane; e < T * T; e += BLOCK) {
                        const int p = e / T, c = e % T;
                        const double entry = x[p * STRIDE + c];
                        products[(size_t)T * T * i + e] = entry;
                        a[(size_t)(T * i + p) * n + T * k + c] = entry * inverses[c];
                    }
                }
            }
        }
        WROD_WAIT_FAR();
        const int begin = T * (k + 1), wide = (tiles - k) / 2;
        int i = 0, j = block;
        while (j > i) j -= ++i;
        for (; i < wide; j += blocks) {
            while (j > i) j -= ++i;
            if (i >= wide) break;
            const int top = begin + WIDE * i, left = begin + WIDE * j;
            WROD_WAIT();
            WROD_BLOCK {
                for (int e = lane; e < WIDE * T; e += BLOCK) {
                    const int p = e / T, c = e % T;
                    const size_t row = top + p, other = left + p;
                    upper[c * LINE + p] = top + p < end ? products[row * T + c] : 0.0;
                    lower[c * LINE + p] = left + p < end ? a[other * n + T * k + c] : 0.0;
                }
            }
            WROD_WAIT();
            WROD_BLOCK {
                const int y = lane / 16, z = lane % 16;
                double sum[4][4] = {};
                for (int c = 0; c < T; ++c) {
                    double u[4], v[4];
                    _Pragma("unroll") for (int m = 0; m < 4; ++m) {
                        u[m] = upper[c * LINE + y + 16 * m];
                        v[m] = lower[c * LINE + z + 16 * m];
                    }
                    _Pragma("unroll") for (int m = 0; m < 4; ++m)
                        _Pragma("unroll") for (int l = 0; l < 4; ++l) sum[m][l] += u[m] * v[l];
                }
                _Pragma("unroll") for (int m = 0; m < 4; ++m) {
                    const int p = top + y + 16 * m;
                    _Pragma("unroll") for (int l = 0; l < 4; ++l) {
                        const int c = left + z + 16 * l;
                        if (p < end && c <= p) a[(size_t)p * n + c] -= sum[m][l];
                    }
                }
            }
        }
        WROD_WAIT_FAR();
    }
"""
)


@wp.func_native(_FACTORISE)
def factorise_row(
    size: wp.array2d(dtype=wp.float64),
    tiles: int,
    r: int,
    block: int,
    blocks: int,
    arrived: wp.array(dtype=wp.int32),
    matrix: wp.array3d(dtype=wp.float64),
    panel: wp.array3d(dtype=wp.float64),
    diagonal: wp.array3d(dtype=wp.float64),
    negatives: wp.array(dtype=wp.int32),
): ...


_SOLVE = (
    _LANES
    + """
    const int n = matrix.shape[1];
    const double* a = matrix.data + (size_t)r * n * n;
    const double* corner = diagonal.data + (size_t)r * n * T;
    double* y = x.data + ((size_t)r * x.shape[1] + column) * n;
    WROD_SHARED double d[T * STRIDE];
    WROD_SHARED double value[T];
#define WROD_LOAD_CORNER(k) \\
    for (int e = lane; e < T * T; e += BLOCK) \\
        d[(e / T) * STRIDE + e % T] = corner[(size_t)T * k * T + e]; \\
    if (lane < T) value[lane] = y[T * k + lane];
    for (int k = 0; k < tiles; ++k) {
        WROD_WAIT();
        WROD_BLOCK { WROD_LOAD_CORNER(k) }
        WROD_WAIT();
        for (int j = 0; j < T; ++j) {
            WROD_BLOCK {
                if (lane < T && lane > j) value[lane] -= d[lane * STRIDE + j] * value[j];
            }
            WROD_WAIT_NEAR();
        }
        WROD_WAIT();
        WROD_BLOCK {
            for (int p = T * (k + 1) + lane; p < T * tiles; p += BLOCK) {
                const double* line = a + (size_t)p * n + T * k;
                double sum = 0.0;
                _Pragma("unroll") for (int c = 0; c < T; ++c) sum += line[c] * value[c];
                y[p] -= sum;
            }
            if (lane < T) y[T * k + lane] = value[lane] / d[lane * STRIDE + lane];
        }
    }
    for (int k = tiles - 1; k >= 0; --k) {
        WROD_WAIT();
        WROD_BLOCK { WROD_LOAD_CORNER(k) }
        WROD_WAIT();
        for (int j = T - 1; j > 0; --j) {
            WROD_BLOCK {
                if (lane < j) value[lane] -= d[j * STRIDE + lane] * value[j];
            }
            WROD_WAIT_NEAR();
        }
        WROD_WAIT();
        WROD_BLOCK {
            for (int c = lane; c < T * k; c += BLOCK) {
                double sum = 0.0;
                _Pragma("unroll") for (int p = 0; p < T; ++p)
                    sum += a[(size_t)(T * k + p) * n + c] * value[p];
                y[c] -= sum;
            }
            if (lane < T) y[T * k + lane] = value[lane];
        }
    }
"""
)


@wp.func_native(_SOLVE)
def solve_row(
    matrix: wp.array3d(dtype=wp.float64),
    diagonal: wp.array3d(dtype=wp.float64),
    tiles: int,
    r: int,
    column: int,
    x: wp.array3d(dtype=wp.float64),
): ...


@wp.kernel
def factorise(
    # State in:
    tiles: wp.array(dtype=wp.int32),
    size: wp.array2d(dtype=wp.float64),
    blocks: int,
    # State in and out:
    arrived: wp.array(dtype=wp.int32),
    matrix: wp.array3d(dtype=wp.float64),
    panel: wp.array3d(dtype=wp.float64),
    negative_pivots: wp.array(dtype=wp.int32),
    # State out:
    diagonal_out: wp.array3d(dtype=wp.float64),
):
    """L D L^T in place; negative pivots are subtracted from the count. `arrived` begins at zero.

    Launched over (row, `blocks`, lane).
    """
    r, block, _lane = wp.tid()
    factorise_row(
        size, tiles[r], r, block, blocks, arrived, matrix, panel, diagonal_out, negative_pivots
    )


@wp.kernel
def solve(
    # State in:
    tiles: wp.array(dtype=wp.int32),
    matrix: wp.array3d(dtype=wp.float64),
    diagonal: wp.array3d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Overwrite right-hand sides (row, j, :) with solutions. Launched over (row, j, lane)."""
    r, j, _lane = wp.tid()
    solve_row(matrix, diagonal, tiles[r], r, j, x)
