"""The first edge and its ghost: how they hold the pattern's curvature at the contact.

The contact is node 0, at the origin; a ghost stands before it. Both edges are turned by half the
turning angle to either side of the pattern's tangent x, kappa = 2 tan(phi / 2) / l.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO


@wp.func
def half_turn(curvature: wp.float64, length: wp.float64) -> wp.float64:
    """Half the turning angle of an edge of that rest length."""
    return wp.atan(HALF * curvature * length)


@wp.func
def half_turn_rate(
    curvature: wp.float64,
    length: wp.float64,
    curvature_rate: wp.float64,
    length_rate: wp.float64,
) -> wp.float64:
    x = HALF * curvature * length
    return HALF * (curvature_rate * length + curvature * length_rate) / (ONE + x * x)


@wp.func
def first_direction(angle: wp.float64) -> wp.vec3d:
    """Of the first edge."""
    return wp.vec3d(wp.cos(angle), wp.sin(angle), ZERO)


@wp.func
def ghost_direction(angle: wp.float64) -> wp.vec3d:
    """Of the edge from the ghost to the contact."""
    return wp.vec3d(wp.cos(angle), -wp.sin(angle), ZERO)


@wp.func
def ghost_motion(
    angle: wp.float64, length: wp.float64, angle_rate: wp.float64, length_rate: wp.float64
) -> wp.vec3d:
    """Of the ghost, which stands `length` before the contact."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    turned = length * angle_rate
    return wp.vec3d(-length_rate * c + turned * s, length_rate * s + turned * c, ZERO)


@wp.func
def ghost_load(stiffness: wp.array3d(dtype=wp.float64), slot: int, ghost: wp.vec3d) -> wp.vec3d:
    """Rate of the first free node's gradient when the ghost moves."""
    # Rows of the edge before the contact, columns of that after it.
    rate = wp.vec3d(ZERO, ZERO, ZERO)
    for b in range(3):
        rate[b] = -(
            stiffness[slot, 0, 3 + b] * ghost[0]
            + stiffness[slot, 0, 8 + b] * ghost[1]
            + stiffness[slot, 0, 12 + b] * ghost[2]
        )
    return rate
