"""Derivatives of a grasp by its inputs, from the factorisation that solved it."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node
from wrod.kernels.grasping.straight import (
    border_forcing,
    border_matrix,
    contact_hessian_block,
    first_direction,
    half_turn,
    mat66d,
    vec6d,
    write_step,
)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def grasp_rate(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    curvature_rate: wp.float64,
    weight_rate: wp.float64,
    # State in:
    free: wp.array2d(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    condensed: wp.array(dtype=mat66d),
    reaction_rate: wp.array(dtype=vec6d),
    # State in and out: column 0 comes in as the gradient's rate, solved, and leaves as the dofs'.
    solution: wp.array3d(dtype=wp.float64),
    # Out:
    force_rate_out: wp.array(dtype=wp.vec3d),
):
    """Rate of every degree of freedom and of the contact force along a change of the inputs.

    The inputs act on the free nodes through the gradient's own rate (`reaction_rate` is that,
    condensed) and through the ghost and node 2, which turn with the curvature and with the length
    of the first edge.
    """
    r = wp.tid()
    length = rest_length[r, 1]
    length_rate = rest_length_rate[r, 1]
    half = HALF * curvature[r] * length
    half_rate = HALF * (curvature_rate * length + curvature[r] * length_rate)
    turn_rate = half_rate / (ONE + half * half)
    d = first_direction(half_turn(curvature[r], length))
    across = wp.vec3d(-d[1], d[0], ZERO)
    node_2 = (turn_rate * wp.length(node(dof, r, 2))) * across
    ghost = wp.vec3d(
        -length_rate * d[0] + length * turn_rate * d[1],
        length_rate * d[1] + length * turn_rate * d[0],
        ZERO,
    )
    s = condensed[r]
    g = reaction_rate[r]
    forcing = border_forcing(s, node_2, contact_hessian_block(hessian, r) * ghost)
    for i in range(4):
        forcing[i] += g[i]
    v = -(wp.inverse(border_matrix(s, d)) * forcing)
    node_2 = node_2 + v[0] * d
    grip = wp.vec3d(v[1], v[2], v[3])
    force = wp.vec3d(-g[3], -g[4], weight_rate - g[5])
    for i in range(3):
        for j in range(3):
            force[i] -= s[3 + i, j] * node_2[j] + s[3 + i, 3 + j] * grip[j]
    force_rate_out[r] = force
    write_step(solution, free, r, ONE, node_2, grip)
    for c in range(3):
        solution[r, 0, c] = ghost[c]
