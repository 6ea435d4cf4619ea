"""Stretching: E = 1/2 k_s (|e|/l - 1)^2 l for each edge of rest length l (Eq. stretching)."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE


@wp.struct
class Stretching:
    """Energy of one edge, its gradient and its exact Hessian by the edge's vector."""

    energy: wp.float64
    gradient: wp.vec3d
    hessian: wp.mat33d


@wp.func
def stretching(
    stiffness: wp.float64, rest: wp.float64, length: wp.float64, t: wp.vec3d
) -> Stretching:
    """Of an edge of that stiffness, rest length, length and unit tangent."""
    strain = length / rest - ONE
    force = stiffness * strain
    tt = wp.outer(t, t)
    out = Stretching()
    out.energy = HALF * force * strain * rest
    out.gradient = force * t
    # Material stiffness along the edge, geometric stiffness across it.
    out.hessian = (stiffness / rest) * tt + (force / length) * (
        wp.identity(3, dtype=wp.float64) - tt
    )
    return out
