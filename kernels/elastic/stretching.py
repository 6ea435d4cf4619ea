"""Stretching: E = 1/2 k_s (|e|/l - 1)^2 l for each edge of rest length l (Eq. stretching)."""

import warp as wp
from wrod.kernels.elastic.assembly import add_block, add_diagonal_block, add_number, add_vector
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, edge

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


@wp.func
def add_stretching(
    rest_length: wp.array2d(dtype=wp.float64),
    stretching_stiffness: wp.array2d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    r: int,
    i: int,
    order: int,
    energy: wp.array(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Add energy and gradient of edge i alone, and the exact Hessian if `order` is 2."""
    if stretching_stiffness[r, i] == ZERO:  # a cut, of any length
        return
    e = edge(dof, r, i)
    length = wp.length(e)
    s = stretching(stretching_stiffness[r, i], rest_length[r, i], length, e / length)
    a = 4 * i
    if energy.shape[0] > 0:
        add_number(energy, r, s.energy)
    add_vector(gradient, r, a, -s.gradient)
    add_vector(gradient, r, a + 4, s.gradient)
    if order == 2:
        add_diagonal_block(hessian, r, a, s.hessian)
        add_block(hessian, r, a + 4, a, -s.hessian)
        add_diagonal_block(hessian, r, a + 4, s.hessian)
