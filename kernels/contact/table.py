"""A frictionless table at z = 0: E = 1/2 k sum_i l_i min(z_i, 0)^2, k per length of rod.

A penalty: the rod sinks in by its weight per length over k.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ZERO


@wp.kernel
def table(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    table_stiffness: wp.float64,
    # State in:
    active: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    order: int,
    # Out:
    energy_out: wp.array(dtype=wp.float64),
    gradient_out: wp.array2d(dtype=wp.float64),
    hessian_out: wp.array3d(dtype=wp.float64),
):
    """Add energy and gradient, and the Hessian if `order` is 2, of the inner nodes."""
    r, j = wp.tid()
    if active[r] == 0:
        return
    a = 4 * (j + 1) + 2
    z = dof_in[r, a]
    if z >= ZERO:
        return
    k = table_stiffness * HALF * (rest_length[r, j] + rest_length[r, j + 1])
    wp.atomic_add(energy_out, r, HALF * k * z * z)
    wp.atomic_add(gradient_out, r, a, k * z)
    if order == 2:
        wp.atomic_add(hessian_out, r, a, 0, k)
