"""Adding the derivatives of one stencil to a rod's gradient and banded Hessian.

`hessian[r, a, k]` holds H[a, a - k] for k = 0...10: the lower band, row by row, a rod's numbers one
after the other (as those of its gradient are). A stencil is two
edges e, f around node i; its degrees of freedom are (q_(i-1), theta^(i-1), q_i, theta^i, q_(i+1)),
eleven neighbouring columns, so the half-bandwidth is 10. Energies depend on nodes through edges,
e = q_i - q_(i-1) and f = q_(i+1) - q_i, so derivatives are given with respect to e and f.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

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
def add_edge_gradient(
    gradient: wp.array2d(dtype=wp.float64), r: int, i: int, g_e: wp.vec3d, g_f: wp.vec3d
):
    """Gradient with respect to the edges before (e) and after (f) node i."""
    add_vector(gradient, r, 4 * i - 4, -g_e)
    add_vector(gradient, r, 4 * i, g_e - g_f)
    add_vector(gradient, r, 4 * i + 4, g_f)


@wp.func
def add_edge_hessian(
    hessian: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    ee: wp.mat33d,
    ef: wp.mat33d,
    ff: wp.mat33d,
):
    """Hessian with respect to the edges before (e) and after (f) node i; `ef` has rows of e."""
    fe = wp.transpose(ef)
    a = 4 * i - 4
    add_diagonal_block(hessian, r, a, ee)
    add_block(hessian, r, a + 4, a, fe - ee)
    add_diagonal_block(hessian, r, a + 4, ee - ef - fe + ff)
    add_block(hessian, r, a + 8, a, -fe)
    add_block(hessian, r, a + 8, a + 4, fe - ff)
    add_diagonal_block(hessian, r, a + 8, ff)


@wp.func
def add_angle_hessian(
    hessian: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    # Mixed derivatives: first letter the edge, second the angle of the edge before (e), after (f).
    e_te: wp.vec3d,
    f_te: wp.vec3d,
    e_tf: wp.vec3d,
    f_tf: wp.vec3d,
    te_te: wp.float64,
    te_tf: wp.float64,
    tf_tf: wp.float64,
):
    """Hessian of the angles of the edges around node i, with the edges and among themselves."""
    a = 4 * i - 4
    add_row(hessian, r, a + 3, a, -e_te)
    add_column(hessian, r, a + 4, a + 3, e_te - f_te)
    add_column(hessian, r, a + 8, a + 3, f_te)
    add_row(hessian, r, a + 7, a, -e_tf)
    add_row(hessian, r, a + 7, a + 4, e_tf - f_tf)
    add_column(hessian, r, a + 8, a + 7, f_tf)
    add_entry(hessian, r, a + 3, 0, te_te)
    add_entry(hessian, r, a + 7, 4, te_tf)
    add_entry(hessian, r, a + 7, 0, tf_tf)
