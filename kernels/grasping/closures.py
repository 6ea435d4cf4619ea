"""Closures: how the one freedom that mechanics leaves a grasp is used."""

import warp as wp
from wrod.kernels.elastic.frames import ZERO

ZERO_TENSION = wp.constant(0)
MIN_FORCE = wp.constant(1)
MIN_FRICTION = wp.constant(2)

# What a grasp is doing.
RUNNING = wp.constant(0)
CONVERGED = wp.constant(1)
FAILED = wp.constant(2)


@wp.func
def counted(closure: int, force: wp.vec3d) -> wp.vec3d:
    """The part of the force at the contact that the closure makes small."""
    if closure == MIN_FORCE:
        return force
    return wp.vec3d(force[0], force[1], ZERO)
