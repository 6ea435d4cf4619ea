"""Stretching: E = 1/2 k_s (|e|/l - 1)^2 l for each edge of rest length l (Eq. stretching)."""

import warp as wp
from wrod.kernels.assembly import add_block, add_diagonal_block, add_vector
from wrod.kernels.frames import HALF, ONE, ZERO, edge

wp.set_module_options({"enable_backward": False})


@wp.kernel
def stretching(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stretching_stiffness: wp.array2d(dtype=wp.float64),
    # State in:
    active: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    order: int,
    # Out:
    energy_out: wp.array(dtype=wp.float64),
    gradient_out: wp.array2d(dtype=wp.float64),
    hessian_out: wp.array3d(dtype=wp.float64),
):
    """Add energy and gradient, and the exact Hessian if `order` is 2."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    if stretching_stiffness[r, i] == ZERO:  # a cut, of any length
        return
    e = edge(dof_in, r, i)
    length = wp.length(e)
    t = e / length
    rest = rest_length[r, i]
    k = stretching_stiffness[r, i]
    strain = length / rest - ONE

    wp.atomic_add(energy_out, r, HALF * k * strain * strain * rest)
    g = (k * strain) * t
    a = 4 * i
    add_vector(gradient_out, r, a, -g)
    add_vector(gradient_out, r, a + 4, g)

    if order == 2:
        tt = wp.outer(t, t)
        # Material stiffness along the edge, geometric stiffness across it.
        h = (k / rest) * tt + (k * strain / length) * (wp.identity(3, dtype=wp.float64) - tt)
        add_diagonal_block(hessian_out, r, a, h)
        add_block(hessian_out, r, a + 4, a, -h)
        add_diagonal_block(hessian_out, r, a + 4, h)


@wp.kernel
def stretching_rate(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stretching_stiffness: wp.array2d(dtype=wp.float64),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    stretching_stiffness_rate: wp.array2d(dtype=wp.float64),
    # State in:
    dof_in: wp.array2d(dtype=wp.float64),
    # Out:
    gradient_rate_out: wp.array2d(dtype=wp.float64),
):
    """Add the derivative of the gradient along a change of rest lengths and stiffnesses."""
    r, i = wp.tid()
    e = edge(dof_in, r, i)
    length = wp.length(e)
    rest = rest_length[r, i]
    strain = length / rest - ONE
    strain_rate = -length / (rest * rest) * rest_length_rate[r, i]
    rate = stretching_stiffness_rate[r, i] * strain + stretching_stiffness[r, i] * strain_rate
    g = (rate / length) * e
    add_vector(gradient_rate_out, r, 4 * i, -g)
    add_vector(gradient_rate_out, r, 4 * i + 4, g)
