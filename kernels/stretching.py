"""Stretching: E = 1/2 k_s (|e|/l - 1)^2 l for each edge of rest length l (Eq. stretching)."""

import warp as wp
from wrod.kernels.assembly import add_vector
from wrod.kernels.frames import HALF, ONE, edge

wp.set_module_options({"enable_backward": False})


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


@wp.kernel
def stretching_rate(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stretching_stiffness: wp.array2d(dtype=wp.float64),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    stretching_stiffness_rate: wp.array2d(dtype=wp.float64),
    # State in:
    dof_in: wp.array2d(dtype=wp.float64),
    # Out:
    gradient_rate_out: wp.array2d(dtype=wp.float64),
):
    """Add the derivative of the gradient along a change of rest lengths and stiffnesses."""
    r, i = wp.tid()
    e = edge(dof_in, r, i)
    length = wp.length(e)
    rest = rest_length[r, i]
    strain = length / rest - ONE
    strain_rate = -length / (rest * rest) * rest_length_rate[r, i]
    rate = stretching_stiffness_rate[r, i] * strain + stretching_stiffness[r, i] * strain_rate
    g = (rate / length) * e
    add_vector(gradient_rate_out, r, 4 * i, -g)
    add_vector(gradient_rate_out, r, 4 * i + 4, g)
