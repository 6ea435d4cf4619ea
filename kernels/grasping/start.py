"""Configurations that a grasp's solver starts from, and checks of those that it ends with."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge, node
from wrod.kernels.grasping.straight import first_direction, half_turn

wp.set_module_options({"enable_backward": False})

THREE = wp.constant(wp.float64(3.0))
SIX = wp.constant(wp.float64(6.0))


@wp.kernel
def refine_shape(
    # In:
    dof: wp.array2d(dtype=wp.float64),
    # Out:
    shape_out: wp.array2d(dtype=wp.vec3d),
):
    """Nodes from contact to grip on the mesh of half the edges, by cubics in the node index.

    Node 0 of `dof` is the ghost and stays behind.
    """
    r, i = wp.tid()
    coarse = (shape_out.shape[1] + 1) // 2
    j = i // 2 + 1
    if i % 2 == 0:
        shape_out[r, i] = node(dof, r, j)
    else:
        # Four neighbours around the middle; at the ends the nearest four.
        first = wp.clamp(j - 1, 1, coarse - 3)
        x = wp.float64(j - first) + HALF
        y = x - ONE
        z = x - TWO
        w = x - THREE
        value = (-y * z * w / SIX) * node(dof, r, first)
        value += (HALF * x * z * w) * node(dof, r, first + 1)
        value += (-HALF * x * y * w) * node(dof, r, first + 2)
        value += (x * y * z / SIX) * node(dof, r, first + 3)
        shape_out[r, i] = value


@wp.kernel
def place_ghost(
    # In:
    shape: wp.array2d(dtype=wp.vec3d),
    rest_length: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    # Out:
    position_out: wp.array2d(dtype=wp.vec3d),
):
    """Prepend the ghost node, and turn the first edge to the contact's curvature."""
    r, i = wp.tid()
    length = rest_length[r, 0]
    d = first_direction(half_turn(curvature[r], length))
    if i == 0:
        position_out[r, i] = length * wp.vec3d(-d[0], d[1], ZERO)
    elif i == 2:
        position_out[r, i] = wp.length(shape[r, 1]) * d
    else:
        position_out[r, i] = shape[r, i - 1]


@wp.kernel
def check_shape(
    # In:
    dof: wp.array2d(dtype=wp.float64),
    # Out:
    lowest_out: wp.array(dtype=wp.float64),
    turning_out: wp.array(dtype=wp.float64),
):
    """Lowest node of the suspended rod, and its total turning [rad]."""
    r = wp.tid()
    node_count = (dof.shape[1] + 1) // 4
    lowest = wp.float64(0.0)
    turning = wp.float64(0.0)
    for i in range(2, node_count):
        lowest = wp.min(lowest, dof[r, 4 * i + 2])
        if i < node_count - 1:
            e = edge(dof, r, i - 1)
            f = edge(dof, r, i)
            turning += wp.atan2(wp.length(wp.cross(e, f)), wp.dot(e, f))
    lowest_out[r] = lowest
    turning_out[r] = turning
