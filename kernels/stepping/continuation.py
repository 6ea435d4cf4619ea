"""Continuation: each rod of a batch walks from where it stands to its target at its own pace."""

import warp as wp
from wrod.kernels.elastic.frames import node, put_node


@wp.kernel
def copy_configuration(
    stride: int,
    # In:
    chosen: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    tangent_in: wp.array2d(dtype=wp.vec3d),
    director_in: wp.array2d(dtype=wp.vec3d),
    twist_in: wp.array2d(dtype=wp.float64),
    # Out:
    dof_out: wp.array2d(dtype=wp.float64),
    tangent_out: wp.array2d(dtype=wp.vec3d),
    director_out: wp.array2d(dtype=wp.vec3d),
    twist_out: wp.array2d(dtype=wp.float64),
):
    """Copy the whole configuration of every chosen rod. Launched over (rod, thread), each for every
    `stride`th node."""
    r, first = wp.tid()
    if chosen[r] == 0:
        return
    for i in range(first, twist_in.shape[1], stride):
        put_node(dof_out, r, i, node(dof_in, r, i))
        twist_out[r, i] = twist_in[r, i]
        if i < tangent_in.shape[1]:
            dof_out[r, 4 * i + 3] = dof_in[r, 4 * i + 3]
            tangent_out[r, i] = tangent_in[r, i]
            director_out[r, i] = director_in[r, i]


@wp.kernel
def interpolate_prescribed(
    # In:
    chosen: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    start: wp.array2d(dtype=wp.float64),
    target: wp.array2d(dtype=wp.float64),
    progress: wp.array(dtype=wp.float64),
    # Out:
    dof_out: wp.array2d(dtype=wp.float64),
):
    """Put the prescribed degrees of freedom at `progress` between start and target."""
    r, a = wp.tid()
    if chosen[r] != 0 and free[r, a] == 0:
        dof_out[r, a] = start[r, a] + progress[r] * (target[r, a] - start[r, a])
