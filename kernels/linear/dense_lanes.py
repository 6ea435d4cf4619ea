"""Dense factorisation and solution by a whole GPU: A = L D L^T of rows' symmetric matrices, no
pivoting.

A panel of 32 columns takes one round. Each of its tiles is a block's: it takes off the panel
before, factorises the tile on the diagonal for itself, eight columns at a time, and finds its part
of L; meanwhile other blocks take the panel before off what is to the right of this one, by tiles of
64 x 64. Blocks of one launch wait for each other after a round, for which there may be no more of
them than the device has multiprocessors. By Sylvester's law the number of negative D is that of the
negative eigenvalues. Matrices are stored by rows and read below their diagonal; above it L^T is
left for those who solve, and tiles on the diagonal of L are inverted for them. Kernels are launched
in blocks of `BLOCK`, to solve of `SOLVE_BLOCK`.

Compiled for a CPU the same source loops over the lanes, so that it can be tested without a GPU.
"""

import warp as wp

BLOCK, SOLVE_BLOCK = 256, 512
TILE = 32

_LANES = f"""
    const int T = {TILE}, STRIDE = {TILE} + 1;
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_BLOCK for (int lane = threadIdx.x, once = 1; once; once = 0)
#define WROD_WAIT() __syncthreads()
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
#define WROD_WAIT_FAR()
#endif
"""

_FACTORISE = (
    _LANES
    + """
    const double smallest = 1.0e-14;
    const int BLOCK = BLOCK_OF_FACTOR, WIDE = 2 * T, LINE = WIDE + 1, PART = 8;
    const int n = matrix.shape[1], end = T * tiles;
    double* a = matrix.data + (size_t)r * n * n;
    double* products = panel.data + (size_t)r * 2 * n * T;
    WROD_SHARED double pool[T * LINE + T * STRIDE + WIDE * STRIDE];
    WROD_SHARED double pivots[T];
    WROD_SHARED double inverses[T];
    double* upper = pool;
    double* lower = pool + T * LINE;
    double* work = lower + T * STRIDE;
    for (int k = 0; k < tiles; ++k) {
        // L D of the panel before and of this one.
        const double* last = products + (size_t)(1 - k % 2) * n * T;
        double* now = products + (size_t)(k % 2) * n * T;
        const double* sizes = size.data + (size_t)r * n + T * k;
        for (int i = k + block; i < tiles; i += blocks) {
            // Rows of the tile on the diagonal, then of the one below.
            WROD_WAIT();
            WROD_BLOCK {
                for (int e = lane; e < WIDE * T; e += BLOCK) {
                    const int p = e / T, c = e % T;
                    const size_t row = p < T ? T * k + p : T * (i - 1) + p;
                    work[p * STRIDE + c] = a[row * n + T * k + c];
                    if (k == 0) continue;
                    upper[c * LINE + p] = last[row * T + c];
                    if (p < T) lower[c * STRIDE + p] = a[row * n + T * (k - 1) + c];
                }
            }
            WROD_WAIT();
            WROD_BLOCK {
                const int y = lane / 16, z = lane % 16;
                double sum[4][2] = {};
                for (int c = 0; c < (k > 0 ? T : 0); ++c) {
                    double u[4], v[2];
                    _Pragma("unroll") for (int m = 0; m < 4; ++m)
                        u[m] = upper[c * LINE + y + 16 * m];
                    _Pragma("unroll") for (int l = 0; l < 2; ++l)
                        v[l] = lower[c * STRIDE + z + 16 * l];
                    _Pragma("unroll") for (int m = 0; m < 4; ++m)
                        _Pragma("unroll") for (int l = 0; l < 2; ++l) sum[m][l] += u[m] * v[l];
                }
                _Pragma("unroll") for (int m = 0; m < 4; ++m)
                    _Pragma("unroll") for (int l = 0; l < 2; ++l)
                        work[(y + 16 * m) * STRIDE + z + 16 * l] -= sum[m][l];
            }
            int negative = 0;
            for (int s = 0; s < T; s += PART) {
                WROD_WAIT();
                // A lane a row; each factorises the corner for itself, so that none waits.
                WROD_BLOCK {
                    if (lane < WIDE) {
                        double l[PART][PART], inverse[PART], entry[PART];
                        _Pragma("unroll") for (int p = 0; p < PART; ++p)
                            _Pragma("unroll") for (int c = 0; c <= p; ++c)
                                l[p][c] = work[(s + p) * STRIDE + s + c];
                        _Pragma("unroll") for (int c = 0; c < PART; ++c)
                            entry[c] = work[lane * STRIDE + s + c];
                        _Pragma("unroll") for (int j = 0; j < PART; ++j) {
                            double pivot = l[j][j];
                            const double least = smallest * (fabs(sizes[s + j]) + smallest);
                            if (fabs(pivot) < least) pivot = pivot < 0.0 ? -least : least;
                            inverse[j] = 1.0 / pivot;
                            if (lane == 0) {
                                negative += pivot < 0.0;
                                pivots[s + j] = pivot;
                                inverses[s + j] = inverse[j];
                            }
                            _Pragma("unroll") for (int c = j + 1; c < PART; ++c) {
                                const double factor = l[c][j] * inverse[j];
                                _Pragma("unroll") for (int p = c; p < PART; ++p)
                                    l[p][c] -= l[p][j] * factor;
                                entry[c] -= entry[j] * factor;
                            }
                        }
                        _Pragma("unroll") for (int c = 0; c < PART; ++c)
                            upper[(s + c) * LINE + lane] = entry[c];
                    }
                }
                WROD_WAIT();
                WROD_BLOCK {
                    const int p = lane % WIDE;
                    double factor[PART];
                    _Pragma("unroll") for (int j = 0; j < PART; ++j)
                        factor[j] = upper[(s + j) * LINE + p] * inverses[s + j];
                    for (int c = s + PART + lane / WIDE; c < T; c += BLOCK / WIDE) {
                        double sum = 0.0;
                        _Pragma("unroll") for (int j = 0; j < PART; ++j)
                            sum += factor[j] * upper[(s + j) * LINE + c];
                        work[p * STRIDE + c] -= sum;
                    }
                }
            }
            WROD_BLOCK {
                for (int e = lane; e < T * T; e += BLOCK) {
                    const int p = e / T, c = e % T;
                    const double entry = upper[c * LINE + T + p];
                    if (i == k) {
                        const double below = c < p ? entry * inverses[c] : 0.0;
                        diagonal.data[((size_t)r * n + T * k) * T + e] = c == p ? pivots[c] : below;
                    } else {
                        now[(size_t)T * T * i + e] = entry;
                        a[(size_t)(T * i + p) * n + T * k + c] = entry * inverses[c];
                        // What is solved for reads it by columns: p and c change places.
                        a[(size_t)(T * k + p) * n + T * i + c] =
                            upper[p * LINE + T + c] * inverses[p];
                    }
                }
                if (i == k && lane == 0) wp::atomic_add(negatives.data + r, -negative);
            }
        }
        // The panel before is taken off what is to the right of this one; a part of this panel
        // takes about as long as two tiles.
        const int begin = T * (k + 1), wide = k > 0 ? (tiles - k) / 2 : 0;
        const int idle = blocks > tiles - k ? blocks - (tiles - k) : 0, ahead = idle > 0 ? 2 : 0;
        for (int turn = 0;; ++turn) {
            if (turn < ahead && block < blocks - idle) continue;
            const int item = turn < ahead ? block - (blocks - idle) + turn * idle
                                          : ahead * idle + block + (turn - ahead) * blocks;
            if (item >= wide * (wide + 1) / 2) break;
            int i = (int)((sqrt(8.0 * item + 1.0) - 1.0) / 2.0);
            while (i * (i + 1) / 2 > item) --i;
            while ((i + 1) * (i + 2) / 2 <= item) ++i;
            const int top = begin + WIDE * i, left = begin + WIDE * (item - i * (i + 1) / 2);
            WROD_WAIT();
            WROD_BLOCK {
                for (int e = lane; e < WIDE * T; e += BLOCK) {
                    const int p = e / T, c = e % T;
                    const size_t row = top + p, other = left + p;
                    upper[c * LINE + p] = top + p < end ? last[row * T + c] : 0.0;
                    lower[c * LINE + p] = left + p < end ? a[other * n + T * (k - 1) + c] : 0.0;
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
    // Corners of L are inverted for those who solve.
    for (int k = block; k < tiles; k += blocks) {
        double* corner = diagonal.data + ((size_t)r * n + T * k) * T;
        WROD_WAIT();
        WROD_BLOCK {
            for (int e = lane; e < T * T; e += BLOCK) {
                const int p = e / T, c = e % T;
                work[p * STRIDE + c] = corner[e];
                upper[p * STRIDE + c] = p == c ? 1.0 : 0.0;
            }
        }
        for (int j = 0; j < T; ++j) {
            WROD_WAIT();
            WROD_BLOCK {
                for (int e = lane; e < T * T; e += BLOCK) {
                    const int p = e / T, c = e % T;
                    if (p > j && c <= j)
                        upper[p * STRIDE + c] -= work[p * STRIDE + j] * upper[j * STRIDE + c];
                }
            }
        }
        WROD_WAIT();
        WROD_BLOCK {
            for (int e = lane; e < T * T; e += BLOCK) {
                const int p = e / T, c = e % T;
                if (c < p) corner[e] = upper[p * STRIDE + c];
            }
        }
    }
"""
).replace("BLOCK_OF_FACTOR", str(BLOCK))


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
    const int BLOCK = BLOCK_OF_SOLVE;
    const int n = matrix.shape[1];
    const double* a = matrix.data + (size_t)r * n * n;
    const double* corner = diagonal.data + (size_t)r * n * T;
    double* y = x.data + ((size_t)r * x.shape[1] + column) * n;
    WROD_SHARED double corners[2 * T * STRIDE];
    WROD_SHARED double given[T];
    WROD_SHARED double value[T];
    // There, by L and D, and back, by L^T. The next corner is fetched meanwhile.
    for (int turn = 0; turn < 2 * tiles; ++turn) {
        const bool back = turn >= tiles;
        const int k = back ? 2 * tiles - 1 - turn : turn;
        const int next = turn + 1 < tiles ? turn + 1 : 2 * tiles - 2 - turn;
        const double* d = corners + turn % 2 * T * STRIDE;
        double* other = corners + (turn + 1) % 2 * T * STRIDE;
        WROD_WAIT();
        WROD_BLOCK {
            if (lane < T) given[lane] = y[T * k + lane];
            if (turn == 0)
                for (int e = lane; e < T * T; e += BLOCK)
                    corners[e / T * STRIDE + e % T] = corner[e];
        }
        WROD_WAIT();
        WROD_BLOCK {
            if (lane < T) {
                double sum[4] = {given[lane]};
                _Pragma("unroll") for (int c = 0; c < T; ++c) {
                    const bool below = back ? c > lane : c < lane;
                    const double entry = back ? d[c * STRIDE + lane] : d[lane * STRIDE + c];
                    if (below) sum[c % 4] += entry * given[c];
                }
                value[lane] = sum[0] + sum[1] + (sum[2] + sum[3]);
            }
        }
        WROD_WAIT();
        WROD_BLOCK {
            if (next >= 0)
                for (int e = lane; e < T * T; e += BLOCK)
                    other[e / T * STRIDE + e % T] = corner[(size_t)T * T * next + e];
            const int first = back ? 0 : T * (k + 1), end = back ? T * k : T * tiles;
            for (int p = first + lane; p < end; p += BLOCK) {
                double sum = 0.0;
                _Pragma("unroll") for (int c = 0; c < T; ++c)
                    sum += a[(size_t)(T * k + c) * n + p] * value[c];
                y[p] -= sum;
            }
            if (lane < T) y[T * k + lane] = value[lane] / (back ? 1.0 : d[lane * STRIDE + lane]);
        }
    }
"""
).replace("BLOCK_OF_SOLVE", str(SOLVE_BLOCK))


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
    """L D L^T in place; negative pivots are subtracted from the count. `arrived` begins at zero,
    `panel` has room for two panels; what is on the diagonal of L comes out inverted.

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
