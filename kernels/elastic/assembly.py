"""Adding the derivatives of one stencil to a rod's gradient and banded Hessian.

`hessian[r, a, k]` holds H[a, a - k] for k = 0...10: the lower band, row by row, a rod's numbers one
after the other (as those of its gradient are). A stencil is two
edges e, f around node i; its degrees of freedom are (q_(i-1), theta^(i-1), q_i, theta^i, q_(i+1)),
eleven neighbouring columns, so the half-bandwidth is 10. Energies depend on nodes through edges,
e = q_i - q_(i-1) and f = q_(i+1) - q_i, so derivatives are given with respect to e and f.
"""

import warp as wp

HALF_BANDWIDTH = wp.constant(10)

# Additions that nobody waits for: Warp's own return what was there, and ask what memory it is in.
_ADD = """
#if defined(__CUDA_ARCH__)
    asm volatile("red.global.add.f64 [%0], %1;" ::"l"(__cvta_generic_to_global(place)), "d"(value));
#else
    *place += value;
#endif
"""


@wp.func_native("double* place = (double*)energy.data + r;" + _ADD)
def add_number(energy: wp.array(dtype=wp.float64), r: int, value: wp.float64): ...


@wp.func_native(
    "double* place = (double*)((char*)gradient.data + (size_t)r * gradient.strides[0]) + a;" + _ADD
)
def add_component(gradient: wp.array2d(dtype=wp.float64), r: int, a: int, value: wp.float64): ...


@wp.func_native(
    "double* row = (double*)((char*)hessian.data + (size_t)r * hessian.strides[0]);"
    "double* place = row + (a * 11 + k);" + _ADD
)
def add_entry(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, k: int, value: wp.float64): ...


# Derivatives of one stencil. On a GPU lanes of a warp that have neighbouring nodes add theirs up in
# shared memory, first to the rows of their node, then of the one after, then of the one before. All
# but the first and the last of these nodes then have what they get: warps overlap by two.
_PARTS = """
#define WROD_UNROLL _Pragma("unroll")
    double g[11];
    WROD_UNROLL for (int c = 0; c < 3; ++c) {
        g[c] = -g_e[c];
        g[4 + c] = g_e[c] - g_f[c];
        g[8 + c] = g_f[c];
    }
    g[3] = g_te;
    g[7] = g_tf;
    // Lower triangle; a and b are known when this is compiled.
    auto h = [&](int a, int b) {
        const int m = a / 4, n = b / 4, c = a % 4, d = b % 4;
        if (c == 3 && d == 3) return m == 0 ? te_te : n == 0 ? te_tf : tf_tf;
        if (c == 3) return m == 0 ? -e_te[d] : n == 0 ? -e_tf[d] : e_tf[d] - f_tf[d];
        if (d == 3) return n == 1 ? f_tf[c] : m == 1 ? e_te[c] - f_te[c] : f_te[c];
        const double e_e = ee.data[c][d], f_e = ef.data[d][c], f_f = ff.data[c][d];
        if (m == 2) return n == 2 ? f_f : n == 1 ? f_e - f_f : -f_e;
        if (m == 1) return n == 1 ? e_e - ef.data[c][d] - f_e + f_f : f_e - e_e;
        return e_e;
    };
    double* gradients = (double*)((char*)gradient.data + (size_t)r * gradient.strides[0]);
    double* hessians = (double*)((char*)hessian.data + (size_t)r * hessian.strides[0]);
#if defined(__CUDA_ARCH__)
    auto add = [](double* place, double value) {
        asm volatile("red.global.add.f64 [%0], %1;"
                     ::"l"(__cvta_generic_to_global(place)), "d"(value));
    };
    if (together) {
        // Of the node before the first lane's to that after the last's, an odd number apart.
        const int NODES = 34, ROW = 45, SIDE = 5;
        __shared__ double rows[NODES * ROW];
        __shared__ double sides[NODES * SIDE];
        const int lane = threadIdx.x % 32;
        double* own = rows + ROW * (lane + 1);
        double* side = sides + SIDE * (lane + 1);
        WROD_UNROLL for (int c = 0; c < 4; ++c) {
            side[c] = there ? g[4 + c] : 0.0;
            if (order == 2) {
                WROD_UNROLL for (int k = 0; k < 11; ++k)
                    own[11 * c + k] = k <= 4 + c && there ? h(4 + c, 4 + c - k) : 0.0;
            }
        }
        __syncwarp();
        if (there) {
            WROD_UNROLL for (int c = 0; c < 3; ++c) {
                side[SIDE + c] += g[8 + c];
                if (order == 2) {
                    WROD_UNROLL for (int k = 0; k <= 8 + c; ++k)
                        own[ROW + 11 * c + k] += h(8 + c, 8 + c - k);
                }
            }
        }
        __syncwarp();
        if (there) {
            WROD_UNROLL for (int c = 0; c < 4; ++c) {
                side[c - SIDE] += g[c];
                if (order == 2) {
                    WROD_UNROLL for (int k = 0; k <= c; ++k) own[11 * c + k - ROW] += h(c, c - k);
                }
            }
        }
        __syncwarp();
        // A row's first warp has the first node whole as well; the last node has no angle.
        const int first = i - lane - 1, from = i == lane ? 1 : 2, dofs = hessian.shape[1];
        for (int k = 4 * from + lane; k < 4 * (NODES - 2) && 4 * first + k < dofs; k += 32) {
            double* place = gradients + 4 * first + k;
            const double value = sides[SIDE * (k / 4) + k % 4];
            *place = fresh ? value : *place + value;
        }
        if (order == 2) {
            const int stop = 11 * dofs - 44 * first;
            for (int k = 44 * from + lane; k < 44 * (NODES - 2) && k < stop; k += 32) {
                double* place = hessians + 44 * first + k;
                const double value = rows[ROW * (k / 44) + k % 44];
                *place = fresh ? value : *place + value;
            }
        }
        return;
    }
#else
    auto add = [](double* place, double value) { *place += value; };
#endif
    if (!there) return;
    WROD_UNROLL for (int c = 0; c < 11; ++c) {
        add(gradients + 4 * i - 4 + c, g[c]);
        if (order == 2) {
            WROD_UNROLL for (int k = 0; k <= c; ++k)
                add(hessians + 11 * (4 * i - 4 + c) + k, h(c, c - k));
        }
    }
"""


@wp.func_native(_PARTS)
def add_parts(
    r: int,
    i: int,
    there: bool,
    together: bool,
    fresh: bool,
    order: int,
    # With respect to the edges before (e) and after (f) node i, and to their angles; `ef` has rows
    # of e, and of mixed derivatives the first letter is the edge, the second that of the angle.
    g_e: wp.vec3d,
    g_f: wp.vec3d,
    g_te: wp.float64,
    g_tf: wp.float64,
    ee: wp.mat33d,
    ef: wp.mat33d,
    ff: wp.mat33d,
    e_te: wp.vec3d,
    f_te: wp.vec3d,
    e_tf: wp.vec3d,
    f_tf: wp.vec3d,
    te_te: wp.float64,
    te_tf: wp.float64,
    tf_tf: wp.float64,
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Add derivatives of the stencil of node i to a rod's gradient, and to its Hessian if `order`
    is 2; where it is not `there` nothing of its own. With `together` a whole warp comes here, each
    lane with the node after that of the lane before; where that is `fresh`, nothing is there yet
    that would have to be added to."""
    ...


@wp.func
def add_vector(gradient: wp.array2d(dtype=wp.float64), r: int, a: int, v: wp.vec3d):
    for c in range(3):
        add_component(gradient, r, a + c, v[c])


@wp.func
def add_diagonal_block(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, m: wp.mat33d):
    for c in range(3):
        for d in range(c + 1):
            add_entry(hessian, r, a + c, c - d, m[c, d])


@wp.func
def add_block(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, b: int, m: wp.mat33d):
    """Block of rows a... and columns b... below the diagonal, a >= b + 3."""
    for c in range(3):
        for d in range(3):
            add_entry(hessian, r, a + c, a + c - b - d, m[c, d])


@wp.func
def add_row(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, b: int, v: wp.vec3d):
    """Row a, columns b... below the diagonal."""
    for d in range(3):
        add_entry(hessian, r, a, a - b - d, v[d])


@wp.func
def add_column(hessian: wp.array3d(dtype=wp.float64), r: int, a: int, b: int, v: wp.vec3d):
    """Rows a..., column b below the diagonal."""
    for c in range(3):
        add_entry(hessian, r, a + c, a + c - b, v[c])


@wp.func
def add_edge_vector(gradient: wp.array2d(dtype=wp.float64), r: int, i: int, v: wp.vec3d):
    """Gradient with respect to the edge after node i."""
    add_vector(gradient, r, 4 * i, -v)
    add_vector(gradient, r, 4 * i + 4, v)


@wp.func
def add_edge_gradient(
    gradient: wp.array2d(dtype=wp.float64), r: int, i: int, g_e: wp.vec3d, g_f: wp.vec3d
):
    """Gradient with respect to the edges before (e) and after (f) node i."""
    add_vector(gradient, r, 4 * i - 4, -g_e)
    add_vector(gradient, r, 4 * i, g_e - g_f)
    add_vector(gradient, r, 4 * i + 4, g_f)
