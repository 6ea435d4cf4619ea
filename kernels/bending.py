"""Bending: E = 1/2 l sum_k B_k (kappa_k / l - kappa0_k)^2 at each inner node (Eq. bending).

l is half the rest length of the two edges around the node. The curvature components in the
material frames of the edges before (e) and after (f) the node are (Bergou et al. 2010, rewritten)

    kappa_k = (m_k^e . u - m_k^f . t) / (1 + t . u),    k = 1, 2,

t and u the unit tangents of e and f; without twist their norm is 2 tan(phi/2), phi the turning
angle. Second derivatives are exact for frames that are parallel-transported in time from the state
at which they are evaluated (Panetta et al. 2019): turning a tangent by a, perpendicular to it,
changes t by a - |a|^2 t / 2 and m_k by -a_k t - a_k a / 2 to second order, a_k = a . m_k.
"""

import warp as wp
from wrod.kernels.assembly import add_angle_hessian, add_edge_gradient, add_edge_hessian
from wrod.kernels.frames import HALF, ONE, ZERO, edge, rotate

wp.set_module_options({"enable_backward": False})


@wp.struct
class Stencil:
    """Tangents, edge lengths and material directors around one node."""

    t: wp.vec3d
    u: wp.vec3d
    length_e: wp.float64
    length_f: wp.float64
    m1e: wp.vec3d
    m2e: wp.vec3d
    m1f: wp.vec3d
    m2f: wp.vec3d


@wp.func
def stencil(
    dof: wp.array2d(dtype=wp.float64), director: wp.array2d(dtype=wp.vec3d), r: int, i: int
) -> Stencil:
    s = Stencil()
    e = edge(dof, r, i - 1)
    f = edge(dof, r, i)
    s.length_e = wp.length(e)
    s.length_f = wp.length(f)
    s.t = e / s.length_e
    s.u = f / s.length_f
    s.m1e = rotate(director[r, i - 1], s.t, dof[r, 4 * i - 1])
    s.m2e = wp.cross(s.t, s.m1e)
    s.m1f = rotate(director[r, i], s.u, dof[r, 4 * i + 3])
    s.m2f = wp.cross(s.u, s.m1f)
    return s


@wp.struct
class Component:
    """One component of the curvature, and its gradient."""

    # Director of each edge, and its derivative by the edge's angle.
    m_e: wp.vec3d
    m_f: wp.vec3d
    dm_e: wp.vec3d
    dm_f: wp.vec3d
    kappa: wp.float64
    # Gradient by the turning of t and of u, and by the angles.
    e: wp.vec3d
    f: wp.vec3d
    te: wp.float64
    tf: wp.float64


@wp.func
def perpendicular(v: wp.vec3d, t: wp.vec3d) -> wp.vec3d:
    return v - wp.dot(v, t) * t


@wp.func
def project(m: wp.mat33d, t: wp.vec3d, u: wp.vec3d) -> wp.mat33d:
    """(1 - t t^T) m (1 - u u^T)."""
    mu = m * u
    tm = wp.transpose(m) * t
    return m - wp.outer(t, tm) - wp.outer(mu, u) + wp.dot(t, mu) * wp.outer(t, u)


@wp.func
def symmetric(v: wp.vec3d, w: wp.vec3d) -> wp.mat33d:
    return wp.outer(v, w) + wp.outer(w, v)


@wp.func
def component(s: Stencil, k: int) -> Component:
    c = Component()
    c.m_e = s.m1e
    c.m_f = s.m1f
    c.dm_e = s.m2e
    c.dm_f = s.m2f
    if k == 1:
        c.m_e = s.m2e
        c.m_f = s.m2f
        c.dm_e = -s.m1e
        c.dm_f = -s.m1f
    cosine = wp.dot(s.t, s.u)
    chi = ONE + cosine
    c.kappa = (wp.dot(c.m_e, s.u) - wp.dot(c.m_f, s.t)) / chi
    c.e = (-cosine * c.m_e - perpendicular(c.m_f, s.t) - c.kappa * perpendicular(s.u, s.t)) / chi
    c.f = (perpendicular(c.m_e, s.u) + cosine * c.m_f - c.kappa * perpendicular(s.t, s.u)) / chi
    c.te = wp.dot(c.dm_e, s.u) / chi
    c.tf = -wp.dot(c.dm_f, s.t) / chi
    return c


@wp.kernel
def bending(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    bending_stiffness: wp.array2d(dtype=wp.vec2d),
    natural_curvature: wp.array2d(dtype=wp.vec2d),
    # State in:
    active: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    director_in: wp.array2d(dtype=wp.vec3d),
    order: int,
    # Out:
    energy_out: wp.array(dtype=wp.float64),
    gradient_out: wp.array2d(dtype=wp.float64),
    hessian_out: wp.array3d(dtype=wp.float64),
):
    """Add energy and gradient, and the exact Hessian if `order` is 2."""
    r, j = wp.tid()
    if active[r] == 0:
        return
    i = j + 1
    if bending_stiffness[r, i][0] == ZERO:  # at a cut
        return
    s = stencil(dof_in, director_in, r, i)
    rest = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    cosine = wp.dot(s.t, s.u)
    chi = ONE + cosine
    grad_chi_e = perpendicular(s.u, s.t)
    grad_chi_f = perpendicular(s.t, s.u)
    eye = wp.identity(3, dtype=wp.float64)

    energy = ZERO
    g_e = wp.vec3d(ZERO, ZERO, ZERO)
    g_f = wp.vec3d(ZERO, ZERO, ZERO)
    g_te = ZERO
    g_tf = ZERO
    ee = wp.mat33d()
    ef = wp.mat33d()
    ff = wp.mat33d()
    e_te = wp.vec3d(ZERO, ZERO, ZERO)
    f_te = wp.vec3d(ZERO, ZERO, ZERO)
    e_tf = wp.vec3d(ZERO, ZERO, ZERO)
    f_tf = wp.vec3d(ZERO, ZERO, ZERO)
    te_te = ZERO
    te_tf = ZERO
    tf_tf = ZERO

    for k in range(2):
        c = component(s, k)
        stiffness = bending_stiffness[r, i][k]
        excess = c.kappa / rest - natural_curvature[r, i][k]
        moment = stiffness * excess
        energy += HALF * moment * excess * rest
        g_e += moment * c.e
        g_f += moment * c.f
        g_te += moment * c.te
        g_tf += moment * c.tf

        if order == 2:
            b = stiffness / rest
            m = moment / chi
            e_u = wp.dot(c.m_e, s.u)
            f_t = wp.dot(c.m_f, s.t)
            h = (f_t + c.kappa * cosine) * eye - HALF * symmetric(c.m_e, s.u)
            h = (project(h, s.t, s.t) - symmetric(c.e, grad_chi_e)) / chi
            # The unit tangent's own second derivative by the edge vector.
            h = h - symmetric(c.e, s.t)
            ee += b * wp.outer(c.e, c.e) + moment * h
            h = (c.kappa * cosine - e_u) * eye + HALF * symmetric(c.m_f, s.t)
            h = (project(h, s.u, s.u) - symmetric(c.f, grad_chi_f)) / chi
            h = h - symmetric(c.f, s.u)
            ff += b * wp.outer(c.f, c.f) + moment * h
            h = wp.outer(s.u, c.m_f) - wp.outer(c.m_e, s.t) - c.kappa * eye
            h = project(h, s.t, s.u) - wp.outer(c.e, grad_chi_f) - wp.outer(grad_chi_e, c.f)
            ef += b * wp.outer(c.e, c.f) + m * h

            e_te += b * c.te * c.e + m * (-cosine * c.dm_e - c.te * grad_chi_e)
            f_te += b * c.te * c.f + m * (perpendicular(c.dm_e, s.u) - c.te * grad_chi_f)
            e_tf += b * c.tf * c.e - m * (perpendicular(c.dm_f, s.t) + c.tf * grad_chi_e)
            f_tf += b * c.tf * c.f + m * (cosine * c.dm_f - c.tf * grad_chi_f)
            te_te += b * c.te * c.te - m * e_u
            te_tf += b * c.te * c.tf
            tf_tf += b * c.tf * c.tf + m * f_t

    inv_e = ONE / s.length_e
    inv_f = ONE / s.length_f
    wp.atomic_add(energy_out, r, energy)
    add_edge_gradient(gradient_out, r, i, inv_e * g_e, inv_f * g_f)
    wp.atomic_add(gradient_out, r, 4 * i - 1, g_te)
    wp.atomic_add(gradient_out, r, 4 * i + 3, g_tf)
    if order == 2:
        add_edge_hessian(
            hessian_out, r, i, (inv_e * inv_e) * ee, (inv_e * inv_f) * ef, (inv_f * inv_f) * ff
        )
        add_angle_hessian(
            hessian_out,
            r,
            i,
            inv_e * e_te,
            inv_f * f_te,
            inv_e * e_tf,
            inv_f * f_tf,
            te_te,
            te_tf,
            tf_tf,
        )


@wp.kernel
def bending_rate(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    bending_stiffness: wp.array2d(dtype=wp.vec2d),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    # State in:
    dof_in: wp.array2d(dtype=wp.float64),
    director_in: wp.array2d(dtype=wp.vec3d),
    # Out:
    gradient_rate_out: wp.array2d(dtype=wp.float64),
):
    """Add the derivative of the gradient along a change of rest lengths."""
    r, j = wp.tid()
    i = j + 1
    s = stencil(dof_in, director_in, r, i)
    rest = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    rest_rate = HALF * (rest_length_rate[r, i - 1] + rest_length_rate[r, i])
    for k in range(2):
        c = component(s, k)
        rate = -bending_stiffness[r, i][k] * c.kappa / (rest * rest) * rest_rate
        add_edge_gradient(
            gradient_rate_out, r, i, (rate / s.length_e) * c.e, (rate / s.length_f) * c.f
        )
        wp.atomic_add(gradient_rate_out, r, 4 * i - 1, rate * c.te)
        wp.atomic_add(gradient_rate_out, r, 4 * i + 3, rate * c.tf)
