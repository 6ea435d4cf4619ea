"""Frontal elimination of one rod with a border at both ends, assembled as it is eliminated.

A rod is a chain of blocks of `size` degrees of freedom: a node's position, and before it, where the
rod twists (`size` 4), the angle of the edge that leads to the node. Block 0 and what lies before it
are held. Stencil j, around node j, couples the three nodes j - 1, j, j + 1 through the variables of
its two edges: (angle before, edge before, angle after, edge after), `2 size` of them. `stiffness`
holds the upper triangle of its second derivatives, row by row; `load` the gradient of every block.

`eliminate` brings the blocks 2...edges - 1 to balance, so that a small system is left of the first
free block and the last, the border: `condensed` holds its matrix (2 size, 2 size), row by row, then
its right-hand side (2 size). `recover` gives the motion of the blocks between for one of these, and
`condense` the border's right-hand side for another load.

All take a rod a thread. Three blocks at a time are in the front, in turn at three fixed places. A
front's row is its own, the border's and the right-hand side's entries in one run, which a CPU
updates as a whole; a GPU keeps the front in registers and updates one triangle. No entry depends on
other rods, so that neither does the last digit of a result.
"""

import warp as wp


def row_width(size: int) -> int:
    """Numbers that `eliminate` keeps per degree of freedom: a row of the front and its pivot."""
    return 4 * size + 2


def stencil_entries(size: int) -> int:
    """Numbers in the upper triangle of a stencil's second derivatives."""
    return size * (2 * size + 1)


_COMMON = """
    enum {{ D = {size}, A = D - 3, F = 3 * D, C = F, RHS = F + D, W = F + D + 2 }};
    enum {{ WIDE = (W + 7) / 8 * 8 }};
#if defined(__CUDA_ARCH__)
#define WROD_UNROLL _Pragma("unroll")
#define WROD_FROM(m) (m)
#define WROD_AT(m, k) front[(m) < (k) ? (m) : (k)][(m) < (k) ? (k) : (m)]
#else
#define WROD_UNROLL _Pragma("clang loop unroll(full)")
#define WROD_FROM(m) 0
#define WROD_AT(m, k) front[m][k]
#endif
"""

_ELIMINATE = (
    _COMMON
    + """
    // Entry (p, q), p <= q, of stencil j.
    const char* base = (const char*)stiffness.data + (size_t)slot * stiffness.strides[0];
    const size_t stencil_stride = stiffness.strides[1], entry_stride = stiffness.strides[2];
#define WROD_K(j, p, q) (*(const double*)(base + (size_t)(j) * stencil_stride + \\
        (size_t)((p) * (4 * D - 1 - (p)) / 2 + (q)) * entry_stride))
    const char* loads = (const char*)load.data + (size_t)slot * load.strides[0];
#define WROD_G(j, a) (*(const double*)(loads + (size_t)(j) * load.strides[1] + \\
        (size_t)(a) * load.strides[2]))
    char* out = (char*)factor_out.data + (size_t)slot * factor_out.strides[0];
#define WROD_OUT(j, a, k) (*(double*)(out + (size_t)(D * (j) + (a)) * factor_out.strides[1] + \\
        (size_t)(k) * factor_out.strides[2]))
    const int n = edges;

    double front[F][WIDE];
    // The first free block: its matrix, and its right-hand side in column D.
    double corner[D][D + 1];
    WROD_UNROLL for (int a = 0; a < D; ++a) {{
        WROD_UNROLL for (int b = 0; b < D; ++b) {{
            const int p = a < b ? a : b, q = a < b ? b : a;
            // Stencil 0 after its node, stencil 1 around its own, stencil 2 before it.
            double value = WROD_K(0, D + p, D + q) + WROD_K(1, p, q);
            if (q >= A) value -= WROD_K(1, p, D + q);
            if (p >= A) value += WROD_K(1, D + p, D + q) - WROD_K(1, q, D + p);
            if (n > 2 && p >= A) value += WROD_K(2, p, q);
            corner[a][b] = value;
        }}
        corner[a][D] = WROD_G(1, a);
    }}
    // Blocks 2 and 3 and what couples them to the first.
    WROD_UNROLL for (int m = 0; m < F; ++m)
        WROD_UNROLL for (int k = 0; k < WIDE; ++k) front[m][k] = 0.0;
    WROD_UNROLL for (int a = 0; a < D; ++a) {{
        front[a][RHS] = WROD_G(2, a);
        front[D + a][RHS] = n > 2 ? WROD_G(3, a) : 0.0;
        WROD_UNROLL for (int b = 0; b < D; ++b) {{
            const int p = a < b ? a : b, q = a < b ? b : a;
            double own = WROD_K(1, D + p, D + q), next = 0.0, with_first = WROD_K(1, b, D + a);
            if (b >= A) with_first -= WROD_K(1, D + (a < b ? a : b), D + (a < b ? b : a));
            if (n > 2) {{
                own += WROD_K(2, p, q);
                if (q >= A) own -= WROD_K(2, p, D + q);
                if (p >= A) own += WROD_K(2, D + p, D + q) - WROD_K(2, q, D + p);
                next = WROD_K(2, a, D + b);
                if (a >= A) next -= WROD_K(2, D + p, D + q);
                if (b >= A) {{
                    with_first -= WROD_K(2, p, q);
                    if (a >= A) with_first += WROD_K(2, b, D + a);
                    front[D + a][C + b] = -WROD_K(2, b, D + a);
                }}
                if (a <= b) WROD_AT(D + a, D + b) = WROD_K(2, D + a, D + b);
                if (a < b) WROD_AT(D + b, D + a) = WROD_K(2, D + a, D + b);
            }}
            if (a <= b) WROD_AT(a, b) = own;
            if (a < b) WROD_AT(b, a) = own;
            WROD_AT(a, D + b) = next;
            WROD_AT(D + b, a) = next;
            front[a][C + b] = with_first;
        }}
    }}
    int negative = 0;
    for (int first = 2; first < n; first += 3) {{
        WROD_UNROLL for (int turn = 0; turn < 3; ++turn) {{
            // Places of this block, the next and the one after it.
            const int x = turn * D, y = (turn + 1) % 3 * D, z = (turn + 2) % 3 * D;
            const int j = first + turn;
            if (j < n) {{
                // Stencil j + 1, around the next block; the block after it is new.
                if (j + 1 < n) {{
                    WROD_UNROLL for (int a = 0; a < D; ++a) {{
                        WROD_UNROLL for (int b = 0; b < D; ++b) {{
                            const int p = a < b ? a : b, q = a < b ? b : a;
                            const double ee = WROD_K(j + 1, p, q), ef = WROD_K(j + 1, a, D + b);
                            const double ff = WROD_K(j + 1, D + p, D + q);
                            WROD_AT(z + a, z + b) = ff;
                            double around = ee;
                            if (a >= A) around -= WROD_K(j + 1, b, D + a);
                            if (b >= A) around -= ef;
                            if (a >= A && b >= A) around += ff;
                            if (a <= b) WROD_AT(y + a, y + b) += around;
#if !defined(__CUDA_ARCH__)
                            if (a > b) WROD_AT(y + a, y + b) += around;
#endif
                            const double across = a >= A ? ef - ff : ef;
                            WROD_AT(y + a, z + b) = across;
#if !defined(__CUDA_ARCH__)
                            WROD_AT(z + b, y + a) = across;
#endif
                            double back = 0.0, far = 0.0;
                            if (a >= A) {{
                                back = b >= A ? ef - ee : -ee;
                                far = -ef;
                                if (b >= a) WROD_AT(x + a, x + b) += ee;
#if !defined(__CUDA_ARCH__)
                                if (b >= A && b < a) WROD_AT(x + a, x + b) += ee;
#endif
                            }}
                            WROD_AT(x + a, y + b) += back;
                            WROD_AT(x + a, z + b) = far;
#if !defined(__CUDA_ARCH__)
                            WROD_AT(y + b, x + a) += back;
                            WROD_AT(z + b, x + a) = far;
#endif
                            front[z + a][C + b] = 0.0;
                        }}
                        front[z + a][RHS] = WROD_G(j + 2, a);
                    }}
                }} else {{
                    WROD_UNROLL for (int a = 0; a < D; ++a) {{
                        WROD_UNROLL for (int k = 0; k < F; ++k)
                            WROD_AT(z + a, k) = WROD_AT(k, z + a) = 0.0;
                        WROD_UNROLL for (int k = C; k <= RHS; ++k) front[z + a][k] = 0.0;
                    }}
                }}
                WROD_UNROLL for (int t = 0; t < D; ++t) {{
                    const int p = x + t;
                    double pivot = WROD_AT(p, p);
                    negative += pivot < 0.0;
                    // A pivot that cancels to nothing would end as infinity.
                    if (fabs(pivot) < 1.0e-200) pivot = 1.0e-200;
                    const double inverse = 1.0 / pivot;
                    front[p][RHS + 1] = inverse;
                    WROD_UNROLL for (int k = 0; k < W; ++k)
                        if (k >= C || (k >= x && k < x + D && k > p) || k / D * D != x)
                            WROD_OUT(j, t, k) = k < F ? WROD_AT(p, k) : front[p][k];
                    WROD_UNROLL for (int m = 0; m < F; ++m) {{
                        if (m / D * D == x && m <= p) continue;
                        const double share = WROD_AT(p, m) * inverse;
                        WROD_UNROLL for (int k = WROD_FROM(m); k < WIDE; ++k) {{
#if defined(__CUDA_ARCH__)
                            if (k > RHS || (k / D * D == x && k <= p)) continue;
                            front[m][k] -= share * (k < F ? WROD_AT(p, k) : front[p][k]);
#else
                            front[m][k] -= share * front[p][k];
#endif
                        }}
                    }}
                    WROD_UNROLL for (int b = 0; b < D; ++b) {{
                        const double share = front[p][C + b] * inverse;
                        WROD_UNROLL for (int k = WROD_FROM(b); k <= D; ++k)
                            corner[b][k] -= share * front[p][C + k];
                    }}
                }}
            }}
        }}
    }}
    // What is left: the first free block, and the last in the place after the one before it.
    double* small = condensed_out.data;
    const size_t step = condensed_out.strides[1] / sizeof(double);
    small += (size_t)slot * (condensed_out.strides[0] / sizeof(double));
#define WROD_SMALL(i) small[(size_t)(i) * step]
    WROD_UNROLL for (int turn = 0; turn < 3; ++turn) {{
        const int x = turn * D;
        if (turn == (n - 2) % 3) {{
            WROD_UNROLL for (int a = 0; a < D; ++a) {{
                WROD_UNROLL for (int b = 0; b < D; ++b) {{
                    const int p = a < b ? a : b, q = a < b ? b : a;
                    WROD_SMALL(a * 2 * D + b) = corner[p][q];
                    WROD_SMALL((D + a) * 2 * D + D + b) = WROD_AT(x + p, x + q);
                    WROD_SMALL((D + a) * 2 * D + b) = front[x + a][C + b];
                    WROD_SMALL(b * 2 * D + D + a) = front[x + a][C + b];
                }}
                WROD_SMALL(4 * D * D + a) = corner[a][D];
                WROD_SMALL(4 * D * D + D + a) = front[x + a][RHS];
            }}
        }}
    }}
    return negative;
"""
)

_RECOVER = (
    _COMMON
    + """
    const char* in = (const char*)factor.data + (size_t)slot * factor.strides[0];
#define WROD_IN(j, a, k) (*(const double*)(in + (size_t)(D * (j) + (a)) * factor.strides[1] + \\
        (size_t)(k) * factor.strides[2]))
    char* out = (char*)motion.data + (size_t)slot * motion.strides[0];
#define WROD_X(j, a) (*(double*)(out + (size_t)(j) * motion.strides[1] + \\
        (size_t)(a) * motion.strides[2]))
    const int n = edges;
    double x[W];
    WROD_UNROLL for (int k = 0; k < W; ++k) x[k] = 0.0;
    WROD_UNROLL for (int a = 0; a < D; ++a) x[C + a] = WROD_X(1, a);
    x[RHS] = weight;
    WROD_UNROLL for (int turn = 0; turn < 3; ++turn)
        if (turn == (n - 2) % 3)
            WROD_UNROLL for (int a = 0; a < D; ++a) x[turn * D + a] = WROD_X(n, a);
    for (int first = (n - 3) / 3 * 3 + 2; first >= 2; first -= 3) {{
        WROD_UNROLL for (int turn = 2; turn >= 0; --turn) {{
            const int j = first + turn;
            if (j < n && j >= 2) {{
                WROD_UNROLL for (int t = D - 1; t >= 0; --t) {{
                    const int p = turn * D + t;
                    double value = 0.0;
                    WROD_UNROLL for (int k = 0; k <= RHS; ++k)
                        if (k >= C || (k >= turn * D && k < turn * D + D && k > p) || k / D != turn)
                            value += WROD_IN(j, t, k) * x[k];
                    x[p] = -value * WROD_IN(j, t, RHS + 1);
                    WROD_X(j, t) = x[p];
                }}
            }}
        }}
    }}
"""
)

_CONDENSE = (
    _COMMON
    + """
    const char* in = (const char*)factor.data + (size_t)slot * factor.strides[0];
#define WROD_IN(j, a, k) (*(const double*)(in + (size_t)(D * (j) + (a)) * factor.strides[1] + \\
        (size_t)(k) * factor.strides[2]))
    char* loads = (char*)load.data + (size_t)slot * load.strides[0];
#define WROD_G(j, a) (*(double*)(loads + (size_t)(j) * load.strides[1] + \\
        (size_t)(a) * load.strides[2]))
    const int n = edges;
    double rest[F], corner[D];
    WROD_UNROLL for (int a = 0; a < D; ++a) {{
        corner[a] = WROD_G(1, a);
        rest[a] = WROD_G(2, a);
        rest[D + a] = n > 2 ? WROD_G(3, a) : 0.0;
        rest[2 * D + a] = 0.0;
    }}
    for (int first = 2; first < n; first += 3) {{
        WROD_UNROLL for (int turn = 0; turn < 3; ++turn) {{
            const int x = turn * D, z = (turn + 2) % 3 * D;
            const int j = first + turn;
            if (j < n) {{
                WROD_UNROLL for (int a = 0; a < D; ++a)
                    rest[z + a] = j + 1 < n ? WROD_G(j + 2, a) : 0.0;
                WROD_UNROLL for (int t = 0; t < D; ++t) {{
                    if (j == n - 1) WROD_G(j, t) = rest[x + t];
                    const double value = rest[x + t] * WROD_IN(j, t, RHS + 1);
                    WROD_UNROLL for (int m = 0; m < F; ++m)
                        if (m / D != turn || m > x + t) rest[m] -= WROD_IN(j, t, m) * value;
                    WROD_UNROLL for (int b = 0; b < D; ++b)
                        corner[b] -= WROD_IN(j, t, C + b) * value;
                }}
            }}
        }}
    }}
    double* small = condensed_out.data;
    const size_t step = condensed_out.strides[1] / sizeof(double);
    small += (size_t)slot * (condensed_out.strides[0] / sizeof(double));
    WROD_UNROLL for (int turn = 0; turn < 3; ++turn) {{
        if (turn == (n - 2) % 3) {{
            WROD_UNROLL for (int a = 0; a < D; ++a) {{
                small[(size_t)(4 * D * D + a) * step] = corner[a];
                small[(size_t)(4 * D * D + D + a) * step] = rest[turn * D + a];
            }}
        }}
    }}
"""
)

_cache: dict = {}


def make_elimination(size: int):
    """The functions (eliminate, recover, condense) for blocks of `size`, 3 or 4."""
    if size in _cache:
        return _cache[size]

    @wp.func_native(_ELIMINATE.format(size=size))
    def eliminate(
        stiffness: wp.array3d(dtype=wp.float64),
        load: wp.array3d(dtype=wp.float64),
        slot: int,
        edges: int,
        factor_out: wp.array3d(dtype=wp.float64),
        condensed_out: wp.array2d(dtype=wp.float64),
    ) -> int:
        """Eliminate; the number of negative pivots, which is that of negative eigenvalues."""
        ...

    @wp.func_native(_RECOVER.format(size=size))
    def recover(
        factor: wp.array3d(dtype=wp.float64),
        slot: int,
        edges: int,
        weight: wp.float64,
        motion: wp.array3d(dtype=wp.float64),
    ):
        """Fill `motion` of blocks 2...edges - 1 by those of block 1 and of the last; `weight` times
        the right-hand side is brought to balance."""
        ...

    @wp.func_native(_CONDENSE.format(size=size))
    def condense(
        factor: wp.array3d(dtype=wp.float64),
        load: wp.array3d(dtype=wp.float64),
        slot: int,
        edges: int,
        condensed_out: wp.array2d(dtype=wp.float64),
    ):
        """Replace the border's right-hand side by that of another `load`, of which block edges - 1
        is left as it was eliminated; `factor` stays."""
        ...

    _cache[size] = (eliminate, recover, condense)
    return _cache[size]
