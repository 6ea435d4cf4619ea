"""Banded direct factorisation, one rod a thread: A = L D L^T with half-bandwidth 10, no pivoting.

Rows and columns of prescribed degrees of freedom (`free` is 0) count as those of the identity.
L overwrites nothing: `factor[r, a, k]` holds L[a, a - k] for k = 1...10 and D[a] for k = 0.
By Sylvester's law the number of negative D is that of the negative eigenvalues of the free block.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ZERO

SMALLEST_PIVOT = wp.constant(wp.float64(1.0e-14))
_SIZES = f"""
    const int REACH = {HALF_BANDWIDTH}, BAND = REACH + 1;
    const double SMALLEST = {float(SMALLEST_PIVOT)};"""
_FACTORISE = """
    const int n = hessian.shape[1];
    const double* given = hessian.data + (size_t)r * n * BAND;
    double* factor = factor_out.data + (size_t)r * n * BAND;
    const int* moves = free.data + (size_t)r * n;
    int negative = 0;
    double below[2 * REACH] = {};
    for (int a = -REACH; a < n; ++a) {
        // One more row comes into reach; what pivots before it take is subtracted in place.
        const int next = a + REACH;
        if (next < n) {
            double* row = factor + (size_t)next * BAND;
            const double* from = given + (size_t)next * BAND;
            for (int k = 1; k <= REACH; ++k)
                row[k] = k <= next && moves[next] && moves[next - k] ? from[k] : 0.0;
            row[0] = moves[next] ? from[0] + shift : 1.0;
        }
        if (a < 0) continue;
        double* own = factor + (size_t)a * BAND;
        // A pivot that cancels to nothing would end as infinity; keep its sign and give it a size.
        double pivot = own[0];
        const double least =
            moves[a] ? SMALLEST * (fabs(given[(size_t)a * BAND] + shift) + SMALLEST) : 0.0;
        if (fabs(pivot) < least) pivot = pivot < 0.0 ? -least : least;
        own[0] = pivot;
        negative += pivot < 0.0;
        const double inverse = 1.0 / pivot;
        const int last = n - 1 - a < REACH ? n - 1 - a : REACH;
        // Column a of L D upside down, with nothing after it: so rows of the band run along it.
        for (int j = 1; j <= REACH; ++j)
            below[REACH - j] = j <= last ? own[(size_t)j * (BAND + 1)] : 0.0;
        for (int j = 1; j <= last; ++j) {
            double* row = own + (size_t)j * BAND;
            const double share = below[REACH - j] * inverse;
            for (int k = 0; k < REACH; ++k) row[k] -= share * below[REACH - j + k];
            row[j] = share;
        }
    }
    negative_pivots_out.data[r] = negative;
"""
_SOLVE = """
    const int n = factor.shape[1];
    const double* band = factor.data + (size_t)r * n * BAND;
    const int* moves = free.data + (size_t)r * n;
    double* own = x.data + ((size_t)r * x.shape[1] + column) * n;
    for (int a = 0; a < n; ++a) {
        const double* row = band + (size_t)a * BAND;
        double value = moves[a] ? own[a] : 0.0;
        // The nearest one last: it is known last.
        for (int k = a < REACH ? a : REACH; k > 0; --k) value -= row[k] * own[a - k];
        own[a] = value;
    }
    for (int a = 0; a < n; ++a) own[a] /= band[(size_t)a * BAND];
    for (int a = n - 1; a > 0; --a) {
        const double* row = band + (size_t)a * BAND;
        const double value = own[a];
        const int reach = a < REACH ? a : REACH;
        for (int k = 1; k <= reach; ++k) own[a - k] -= row[k] * value;
    }
"""


@wp.func_native(_SIZES + _FACTORISE)
def factorise_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.float64,
    r: int,
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.func_native(_SIZES + _SOLVE)
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


@wp.kernel
def multiply(
    # In:
    active: wp.array(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    vector: wp.array3d(dtype=wp.float64),
    # Out:
    product_out: wp.array3d(dtype=wp.float64),
):
    """Product of the whole banded matrix with every vector [rod, j, :]."""
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    n = hessian.shape[1]
    value = wp.float64(0.0)
    for b in range(wp.max(0, a - HALF_BANDWIDTH), wp.min(n, a + HALF_BANDWIDTH + 1)):
        value += banded_entry(hessian, r, a, b) * vector[r, j, b]
    product_out[r, j, a] = value


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
