"""Bending and stretching of a straight isotropic rod without twist, by its edges alone.

Both bending stiffnesses are B and the rod is straight at rest, so that the energy of
`wrod.kernels.elastic.bending`, at the angles at which nothing is twisted, depends on the turning
angle alone: E = 2 B (1 - c) / (l (1 + c)), c the cosine between the edges. Angles and reference
frames drop out, and with them two thirds of the work. By Schur's complement the Hessian has as many
negative eigenvalues as that with the angles, whose own block is positive.
"""

import warp as wp
from wrod.kernels.elastic.frames import ONE, TWO
from wrod.kernels.elastic.stretching import stretching

FOUR = wp.constant(wp.float64(4.0))


@wp.struct
class EdgePair:
    """Derivatives of a stencil's energy by the edges before (e) and after (f) its node."""

    e: wp.vec3d
    f: wp.vec3d
    ee: wp.mat33d
    ef: wp.mat33d
    ff: wp.mat33d


@wp.func
def isotropic_bending(
    stiffness: wp.float64,
    t: wp.vec3d,
    length_e: wp.float64,
    u: wp.vec3d,
    length_f: wp.float64,
) -> EdgePair:
    """Bending at a node; `stiffness` is B over the length that the node stands for, t and u are the
    unit tangents before and after it."""
    c = wp.dot(t, u)
    inv = ONE / (ONE + c)
    first = -FOUR * stiffness * inv * inv  # dE/dc
    second = -TWO * first * inv
    inv_e = ONE / length_e
    inv_f = ONE / length_f
    eye = wp.identity(3, dtype=wp.float64)
    c_e = inv_e * (u - c * t)
    c_f = inv_f * (t - c * u)
    out = EdgePair()
    out.e = first * c_e
    out.f = first * c_f
    te = wp.outer(t, c_e)
    uf = wp.outer(u, c_f)
    out.ee = second * wp.outer(c_e, c_e) - first * (
        inv_e * (te + wp.transpose(te)) + (c * inv_e * inv_e) * (eye - wp.outer(t, t))
    )
    out.ff = second * wp.outer(c_f, c_f) - first * (
        inv_f * (uf + wp.transpose(uf)) + (c * inv_f * inv_f) * (eye - wp.outer(u, u))
    )
    out.ef = second * wp.outer(c_e, c_f) + (first * inv_e) * (
        inv_f * (eye - wp.outer(u, u)) - wp.outer(t, c_f)
    )
    return out


@wp.func
def isotropic_stencil(
    bending: wp.float64,
    stretching_stiffness: wp.float64,
    rest_e: wp.float64,
    rest_f: wp.float64,
    t: wp.vec3d,
    length_e: wp.float64,
    u: wp.vec3d,
    length_f: wp.float64,
) -> EdgePair:
    """Bending at a node and stretching of the edge after it."""
    out = isotropic_bending(TWO * bending / (rest_e + rest_f), t, length_e, u, length_f)
    after = stretching(stretching_stiffness, rest_f, length_f, u)
    out.f += after.gradient
    out.ff += after.hessian
    return out
