"""Banded direct factorisation, one rod a thread: A = L D L^T with half-bandwidth 10, no pivoting.

Rows and columns of prescribed degrees of freedom (`free` is 0) count as those of the identity.
Numbers come by nodes of four, and nodes are coupled with two before them: entries with
k > a % 4 + 8, which no stencil adds to (`wrod.kernels.elastic.assembly`), count as zero.
L overwrites nothing: `factor[r, a, k]` holds L[a, a - k] for k = 1...10 and D[a] for k = 0.
By Sylvester's law the number of negative D is that of the negative eigenvalues of the free block.
A CPU's, and a trap on a GPU, which has `wrod.kernels.linear.factor_lanes` and `banded_lanes`.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ZERO

SMALLEST_PIVOT = wp.constant(wp.float64(1.0e-14))
# Four numbers of a node together. Nodes are coupled with two before them, by blocks of 4 x 4 that
# lie along the band's rows backwards: four vectors, which are turned over. What of them is outside
# of the matrix, or above its diagonal, meets only what is so as well. A last node of fewer numbers
# is filled up in `last`, with those of the identity, as are nodes after it. Every entry is computed
# as it would be alone: pivot after pivot is taken off it.
_NODES = f"""
#if !defined(__CUDA_ARCH__)
    const int REACH = {HALF_BANDWIDTH}, BAND = REACH + 1, NODE = 4 * BAND;
    const double SMALLEST = {float(SMALLEST_PIVOT)};
    typedef double four __attribute__((vector_size(32), aligned(8)));
    const four zero = {{}};
    const int n = free.shape[1], whole = n / 4, rest = n % 4, nodes = whole + (rest > 0);
    const int* moves = free.data + (size_t)r * n;
    double spare[3 + 4 * NODE] = {{}};
    double* const last = spare + 3;
    for (int i = rest; i < 16; ++i) last[i * BAND] = 1.0;
#define WROD_UNROLL _Pragma("unroll")
#define WROD_NODE(node) \\
    ((node) < whole ? band + (size_t)(node) * NODE : last + ((node) - whole) * NODE)
#define WROD_COPY(from, to, count) for (int m = 0; m < (count); ++m) (to)[m] = (from)[m];
    auto load = [](const double* from) {{ return *(const four*)from; }};
    auto store = [](double* to, four value) {{ *(four*)to = value; }};
    // Columns out of rows that begin with the last of them, or such rows, the last first, out of
    // columns that are given so.
    auto turn = [](four* m) {{
        const four a = __builtin_shufflevector(m[0], m[1], 0, 4, 2, 6);
        const four b = __builtin_shufflevector(m[0], m[1], 1, 5, 3, 7);
        const four c = __builtin_shufflevector(m[2], m[3], 0, 4, 2, 6);
        const four d = __builtin_shufflevector(m[2], m[3], 1, 5, 3, 7);
        m[3] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
        m[2] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
        m[1] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
        m[0] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
    }};
    // What row i of a node has in the columns of the node `back` before, the last column first.
    auto part = [&](const double* rows, int i, int back) {{
        const double* row = rows + i * BAND;
        if (back == 0 && i == 0) return four{{row[0], row[0], row[0], row[0]}};
        if (back < 2 || i < 3) return load(row + 4 * back - 3 + i);
        return __builtin_shufflevector(load(row + REACH - 3), zero, 1, 2, 3, 4);
    }};
    auto columns = [&](const double* rows, int back, four* m) {{
        WROD_UNROLL for (int i = 0; i < 4; ++i) m[i] = part(rows, i, back);
        turn(m);
    }};
"""
_FACTORISE = r"""
    double* const band = factor_out.data + (size_t)r * n * BAND;
    const double* from = hessian.data + (size_t)r * n * BAND;
    double* row = band;
    int open = 0;  // so many neighbours up to this row are free
    for (int a = 0; a < n; ++a) {
        open = moves[a] ? open + 1 : 0;
        if (open > REACH) {
            store(row + 1, load(from + 1));
            store(row + 5, load(from + 5));
            row[REACH - 1] = from[REACH - 1];
            row[REACH] = from[REACH];
        } else {
            for (int k = 1; k <= REACH; ++k)
                row[k] = k <= a && moves[a] && moves[a - k] ? from[k] : 0.0;
        }
        row[0] = moves[a] ? from[0] + shift : 1.0;
        row += BAND;
        from += BAND;
    }
    WROD_COPY(band + whole * NODE, last, rest * BAND)
    // A pivot that cancels to nothing would end as infinity; keep its sign and give it a size.
#define WROD_PIVOT(p) { \
        double pivot = own[p][p]; \
        const double size = fabs(rows[p * BAND]); \
        const double least = SMALLEST * (size + SMALLEST); \
        if (__builtin_expect(fabs(pivot) < least, 0)) \
            pivot = pivot < 0.0 ? -least : least; \
        rows[p * BAND] = pivot; \
        negative += pivot < 0.0; \
        const double inverse = 1.0 / pivot; \
        const four share = own[p] * inverse, lower = below[p] * inverse; \
        const four lowest = under[p] * inverse; \
        WROD_UNROLL for (int q = 0; q < 4; ++q) { \
            if (q > p) { \
                rows[q * BAND + q - p] = share[q]; \
                own[q] -= share * own[p][q]; \
                below[q] -= lower * own[p][q]; \
                under[q] -= lowest * own[p][q]; \
            } \
            own_after[q] -= lower * below[p][q]; \
            below_after[q] -= lowest * below[p][q]; \
            own_last[q] -= lowest * under[p][q]; \
        } \
        below[p] = lower; \
        under[p] = lowest; \
    }
    // Columns of a node in its own rows, in those of the node after, and of the one after that.
    four own[4], below[4], under[4], own_after[4], below_after[4], own_last[4], lines[4];
    double *rows = WROD_NODE(0), *after = WROD_NODE(1);
    columns(rows, 0, own);
    columns(after, 1, below);
    columns(after, 0, own_after);
    int negative = 0;
    for (int node = 0; node < nodes; ++node) {
        double* const final = WROD_NODE(node + 2);
        columns(final, 2, under);
        columns(final, 1, below_after);
        columns(final, 0, own_last);
        WROD_PIVOT(0) WROD_PIVOT(1) WROD_PIVOT(2) WROD_PIVOT(3)
        WROD_UNROLL for (int q = 0; q < 4; ++q) lines[q] = below[3 - q];
        turn(lines);
        WROD_UNROLL for (int i = 0; i < 4; ++i) store(after + i * BAND + 1 + i, lines[3 - i]);
        WROD_UNROLL for (int q = 0; q < 4; ++q) lines[q] = under[3 - q];
        turn(lines);
        WROD_UNROLL for (int i = 0; i < 3; ++i) store(final + i * BAND + 5 + i, lines[3 - i]);
        WROD_UNROLL for (int k = 8; k <= REACH; ++k) final[3 * BAND + k] = lines[0][k - 8];
        WROD_UNROLL for (int q = 0; q < 4; ++q) {
            own[q] = own_after[q];
            below[q] = below_after[q];
            own_after[q] = own_last[q];
        }
        rows = after;
        after = final;
    }
    WROD_COPY(last, band + whole * NODE, rest * BAND)
    negative_pivots_out.data[r] = negative;
#else
    __trap();
#endif
"""
_SOLVE = r"""
    double* const band = factor.data + (size_t)r * n * BAND;
    double* const own = x.data + ((size_t)r * x.shape[1] + column) * n;
    double own_last[4] = {};
    WROD_COPY(band + whole * NODE, last, rest * BAND)
    for (int a = 0; a < n; ++a) own[a] = moves[a] ? own[a] : 0.0;
    WROD_COPY(own + 4 * whole, own_last, rest)
#define WROD_OWN(node) ((node) < whole ? own + 4 * (node) : own_last)
    // What is nearest is known last, and comes last.
#define WROD_TAKE_FOUR(known, back) { \
        four m[4]; \
        columns(rows, back, m); \
        WROD_UNROLL for (int c = 0; c < 4; ++c) value -= m[c] * known[c]; \
    }
    four before = zero, earlier = zero;
    for (int node = 0; node < nodes; ++node) {
        const double* rows = WROD_NODE(node);
        four value = load(WROD_OWN(node)), m[4];
        WROD_TAKE_FOUR(earlier, 2)
        WROD_TAKE_FOUR(before, 1)
        columns(rows, 0, m);
        value -= four{0.0, m[0][1], m[0][2], m[0][3]} * value[0];
        value -= four{0.0, 0.0, m[1][2], m[1][3]} * value[1];
        value -= four{0.0, 0.0, 0.0, m[2][3]} * value[2];
        earlier = before;
        before = value;
        store(WROD_OWN(node), value / four{rows[0], rows[BAND], rows[2 * BAND], rows[3 * BAND]});
    }
    // Going back, a node's last unknown is its first number, as in the rows.
    auto last_first = [&](int node) {
        return node < 0 ? zero : __builtin_shufflevector(load(WROD_OWN(node)), zero, 3, 2, 1, 0);
    };
    four value = last_first(nodes - 1);
    before = last_first(nodes - 2);
    for (int node = nodes - 1; node >= 0; --node) {
        const double* rows = WROD_NODE(node);
        earlier = last_first(node - 2);
#define WROD_GIVE(i) \
        before -= part(rows, i, 1) * value[3 - i]; \
        earlier -= part(rows, i, 2) * value[3 - i];
        WROD_GIVE(3)
        value -= __builtin_shufflevector(part(rows, 3, 0), zero, 4, 1, 2, 3) * value[0];
        WROD_GIVE(2)
        value -= __builtin_shufflevector(part(rows, 2, 0), zero, 4, 5, 2, 3) * value[1];
        WROD_GIVE(1)
        value -= __builtin_shufflevector(part(rows, 1, 0), zero, 4, 5, 6, 3) * value[2];
        WROD_GIVE(0)
        store(WROD_OWN(node), __builtin_shufflevector(value, zero, 3, 2, 1, 0));
        value = before;
        before = earlier;
    }
    WROD_COPY(own_last, own + 4 * whole, rest)
#else
    __trap();
#endif
"""


@wp.func_native(_NODES + _FACTORISE)
def factorise_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.float64,
    r: int,
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.func_native(_NODES + _SOLVE)
def solve_rod(
    free: wp.array2d(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    r: int,
    column: int,
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
    """Factorise the free block of `hessian + shift * identity` and count its negative pivots."""
    r = wp.tid()
    if active[r] != 0:
        factorise_rod(free, hessian, shift[r], r, factor_out, negative_pivots_out)


@wp.kernel
def eliminate(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """`factorise`, and `solve` for `gradient`, into the first column of `x`."""
    r = wp.tid()
    if active[r] != 0:
        factorise_rod(free, hessian, shift[r], r, factor_out, negative_pivots_out)
        for a in range(gradient.shape[1]):
            x[r, 0, a] = gradient[r, a]
        solve_rod(free, factor_out, r, 0, x)


@wp.kernel
def solve(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    # In and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Solve L D L^T x = x in place for every right-hand side [rod, j, :].

    Prescribed degrees of freedom come out as zero.
    """
    r, j = wp.tid()
    if active[r] != 0:
        solve_rod(free, factor, r, j, x)


@wp.func
def banded_entry(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, b: int) -> wp.float64:
    k = wp.abs(a - b)
    if k > HALF_BANDWIDTH:
        return ZERO
    return hessian[r, wp.max(a, b), k]


@wp.func_native("""
    const double* band = (const double*)((const char*)hessian.data + r * hessian.strides[0]);
    const double* own = &wp::index(vector, r, j, 0) + a;
    const double* row = band + (size_t)a * 11;
    const int n = hessian.shape[1], before = a < 10 ? a : 10, after = n - 1 - a;
    double value = 0.0;
    for (int k = before; k > 0; --k) value += row[k] * own[-k];
    for (int k = 0; k <= (after < 10 ? after : 10); ++k) value += row[12 * k] * own[k];
    return value;
""")
def row_times(
    hessian: wp.array3d(dtype=wp.float64),
    vector: wp.array3d(dtype=wp.float64),
    r: int,
    j: int,
    a: int,
) -> wp.float64: ...


@wp.kernel
def multiply(
    stride: int,
    # In:
    active: wp.array(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    vector: wp.array3d(dtype=wp.float64),
    # Out:
    product_out: wp.array3d(dtype=wp.float64),
):
    """Product of the whole banded matrix with every vector [rod, j, :]. Launched over (rod, vector,
    thread), each for every `stride`th row."""
    r, j, first = wp.tid()
    if active[r] == 0:
        return
    for a in range(first, hessian.shape[1], stride):
        product_out[r, j, a] = row_times(hessian, vector, r, j, a)


@wp.kernel
def load_border(
    # Model:
    border: wp.array(dtype=wp.int32),
    # In:
    active: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    # Out:
    rhs_out: wp.array3d(dtype=wp.float64),
):
    """Right-hand sides of systems with a border, degrees of freedom that are prescribed in the
    matrix and unknowns of a small system: the gradient, then the Hessian's columns of the border.
    """
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    if j == 0:
        rhs_out[r, 0, a] = gradient[r, a]
    else:
        rhs_out[r, j, a] = banded_entry(hessian, r, a, border[j - 1])


@wp.kernel
def shift_by_mass(
    # In:
    active: wp.array(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    mass: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    shifted_out: wp.array3d(dtype=wp.float64),
):
    """Diagonal of `hessian - shift * mass`, for eigenvalues by inverse iteration; the rest of
    `shifted_out` is left alone."""
    r, a = wp.tid()
    if active[r] != 0:
        shifted_out[r, a, 0] = hessian[r, a, 0] - shift[r] * mass[r, a]
