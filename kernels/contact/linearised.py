"""Derivatives of a rod's contact with a plane over one time step, of stick and of slip."""

import warp as wp
from wrod.kernels.contact.planes import Shape, touch
from wrod.kernels.elastic.frames import ZERO

wp.set_module_options({"enable_backward": False})


@wp.kernel
def linearise_contact(
    # Model:
    shapes: wp.array2d(dtype=Shape),
    radius: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.float64),
    skin: wp.array2d(dtype=wp.float64),
    static_friction: wp.array2d(dtype=wp.float64),
    kinetic_friction: wp.array2d(dtype=wp.float64),
    rolling: wp.array(dtype=wp.float64),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle: wp.array3d(dtype=wp.vec3d),
    sliding: wp.array3d(dtype=wp.int32),
    # Out:
    friction_out: wp.array2d(dtype=wp.mat33d),
    coupling_out: wp.array2d(dtype=wp.mat33d),
    by_coefficient_out: wp.array2d(dtype=wp.vec3d),
    push_out: wp.array2d(dtype=wp.vec3d),
):
    """Of each node: friction's derivative by the bristle, by the normal displacement, by the
    coefficient; and the residual of contact."""
    r, i = wp.tid()
    if accepted[r] == 0:
        return
    friction = wp.mat33d()
    coupling = wp.mat33d()
    by_coefficient = wp.vec3d()
    push = wp.vec3d()
    c = touch(
        shapes[r, 0], radius[r, i], rolling[r], stiffness[r, i], skin[r, i], dof,
        dof_before, bristle[r, 0, i], r, i,
    )  # fmt: skip
    if c.force > ZERO:
        mu = wp.where(sliding[r, 0, i] != 0, kinetic_friction[r, 0], static_friction[r, 0])
        size = wp.length(c.bristle)
        across = wp.identity(3, dtype=wp.float64) - wp.outer(c.normal, c.normal)
        k_t = wp.float64(stiffness[r, i])
        if k_t * size > mu * c.force:
            k_t = mu * c.force / size
            way = c.bristle / size
            across = across - wp.outer(way, way)
            coupling = -mu * c.slope * wp.outer(way, c.normal)
            by_coefficient = c.force * way
        friction = k_t * across
        push = k_t * c.bristle - c.force * c.normal
    friction_out[r, i] = friction
    coupling_out[r, i] = coupling
    by_coefficient_out[r, i] = by_coefficient
    push_out[r, i] = push
