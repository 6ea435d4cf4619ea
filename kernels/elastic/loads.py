"""Dead loads: gravity on lumped masses and forces at nodes, E = -a sum_i (m_i g + f_i) . q_i.

The load factor a, 1 by default, is what a load continuation ramps.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_number, add_vector
from wrod.kernels.elastic.frames import node


@wp.kernel
def dead_loads(
    # Model:
    node_mass: wp.array2d(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d),
    point_load: wp.array2d(dtype=wp.vec3d),
    load_factor: wp.array(dtype=wp.float64),
    # State in:
    active: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    # Out:
    energy_out: wp.array(dtype=wp.float64),
    gradient_out: wp.array2d(dtype=wp.float64),
):
    """Add energy and gradient; the Hessian is zero."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    load = load_factor[r] * (node_mass[r, i] * gravity[r] + point_load[r, i])
    if energy_out.shape[0] > 0:
        add_number(energy_out, r, -wp.dot(load, node(dof_in, r, i)))
    add_vector(gradient_out, r, 4 * i, -load)
