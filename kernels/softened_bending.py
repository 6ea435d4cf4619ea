"""Bending: E = 1/2 l sum_k B_k (kappa_k / l - kappa0_k)^2 at each inner node (Eq. bending).

A rod that softens as it bends, as a cable does whose strands begin to slip, keeps the share r of
its stiffness and loses the rest: E = l B (r Q / 2 + (1 - r) (sqrt(1 + c Q) - 1) / c), with the
excess curvatures e_k = kappa_k / l - kappa0_k, Q = sum_k B_k e_k^2 / B, B the mean of B_1 and B_2.
In a plane the moment is B e (r + (1 - r) / sqrt(1 + c e^2)). `softening` holds (c, r), c >= 0
[length^2]; c = 0 is a linear rod.

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
from wrod.kernels.frames import HALF, ONE, TWO, ZERO, edge, rotate

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


@wp.func
def excess_curvature(s: Stencil, rest: wp.float64, natural: wp.vec2d) -> wp.vec2d:
    chi = ONE + wp.dot(s.t, s.u)
    return wp.vec2d(
        (wp.dot(s.m1e, s.u) - wp.dot(s.m1f, s.t)) / (chi * rest) - natural[0],
        (wp.dot(s.m2e, s.u) - wp.dot(s.m2f, s.t)) / (chi * rest) - natural[1],
    )


@wp.func
def softened(stiffness: wp.vec2d, softening: wp.float64, excess: wp.vec2d) -> wp.float64:
    """sqrt(1 + c Q): what divides the part of the moment that softens."""
    squares = stiffness[0] * excess[0] * excess[0] + stiffness[1] * excess[1] * excess[1]
    return wp.sqrt(ONE + softening * TWO * squares / (stiffness[0] + stiffness[1]))


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


@wp.kernel
def softened_bending(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    bending_stiffness: wp.array2d(dtype=wp.vec2d),
    natural_curvature: wp.array2d(dtype=wp.vec2d),
    softening: wp.array2d(dtype=wp.vec2d),
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
    s = stencil(dof_in, director_in, r, i)
    rest = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    cosine = wp.dot(s.t, s.u)
    chi = ONE + cosine
    grad_chi_e = perpendicular(s.u, s.t)
    grad_chi_f = perpendicular(s.t, s.u)

    strain = excess_curvature(s, rest, natural_curvature[r, i])
    root = softened(bending_stiffness[r, i], softening[r, i][0], strain)
    kept = softening[r, i][1]
    secant = kept + (ONE - kept) / root
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
    # Derivatives of Q / 2 times B, which couple the two curvatures of a rod that softens.
    q_e = wp.vec3d(ZERO, ZERO, ZERO)
    q_f = wp.vec3d(ZERO, ZERO, ZERO)
    q_te = ZERO
    q_tf = ZERO

    for k in range(2):
        # Director k of each edge, and its derivative by the edge's angle.
        m_e = s.m1e
        m_f = s.m1f
        dm_e = s.m2e
        dm_f = s.m2f
        if k == 1:
            m_e = s.m2e
            m_f = s.m2f
            dm_e = -s.m1e
            dm_f = -s.m1f
        e_u = wp.dot(m_e, s.u)
        f_t = wp.dot(m_f, s.t)
        kappa = (e_u - f_t) / chi
        linear = bending_stiffness[r, i][k] * strain[k]
        stiffness = bending_stiffness[r, i][k] * secant
        moment = linear * secant
        # (root - 1) / c without the cancellation, for c = 0 as well.
        energy += linear * strain[k] * rest * (HALF * kept + (ONE - kept) / (ONE + root))

        # Gradients of kappa: by the turning of t and u, and by the angles.
        k_e = (-cosine * m_e - perpendicular(m_f, s.t) - kappa * grad_chi_e) / chi
        k_f = (perpendicular(m_e, s.u) + cosine * m_f - kappa * grad_chi_f) / chi
        k_te = wp.dot(dm_e, s.u) / chi
        k_tf = -wp.dot(dm_f, s.t) / chi
        g_e += moment * k_e
        g_f += moment * k_f
        g_te += moment * k_te
        g_tf += moment * k_tf

        if order == 2:
            b = stiffness / rest
            eye = wp.identity(3, dtype=wp.float64)
            h = (f_t + kappa * cosine) * eye - HALF * symmetric(m_e, s.u)
            h = (project(h, s.t, s.t) - symmetric(k_e, grad_chi_e)) / chi
            # The unit tangent's own second derivative by the edge vector.
            h = h - symmetric(k_e, s.t)
            ee += b * wp.outer(k_e, k_e) + moment * h
            h = (kappa * cosine - e_u) * eye + HALF * symmetric(m_f, s.t)
            h = (project(h, s.u, s.u) - symmetric(k_f, grad_chi_f)) / chi
            h = h - symmetric(k_f, s.u)
            ff += b * wp.outer(k_f, k_f) + moment * h
            h = wp.outer(s.u, m_f) - wp.outer(m_e, s.t) - kappa * eye
            h = project(h, s.t, s.u) - wp.outer(k_e, grad_chi_f) - wp.outer(grad_chi_e, k_f)
            ef += b * wp.outer(k_e, k_f) + moment / chi * h

            m = moment / chi
            e_te += b * k_te * k_e + m * (-cosine * dm_e - k_te * grad_chi_e)
            f_te += b * k_te * k_f + m * (perpendicular(dm_e, s.u) - k_te * grad_chi_f)
            e_tf += b * k_tf * k_e - m * (perpendicular(dm_f, s.t) + k_tf * grad_chi_e)
            f_tf += b * k_tf * k_f + m * (cosine * dm_f - k_tf * grad_chi_f)
            te_te += b * k_te * k_te - m * e_u
            te_tf += b * k_te * k_tf
            tf_tf += b * k_tf * k_tf + m * f_t
            q_e += linear * k_e
            q_f += linear * k_f
            q_te += linear * k_te
            q_tf += linear * k_tf

    if order == 2 and softening[r, i][0] > ZERO:
        mean = HALF * (bending_stiffness[r, i][0] + bending_stiffness[r, i][1])
        c = -(ONE - kept) * softening[r, i][0] / (mean * root * root * root * rest)
        ee += c * wp.outer(q_e, q_e)
        ef += c * wp.outer(q_e, q_f)
        ff += c * wp.outer(q_f, q_f)
        e_te += c * q_te * q_e
        f_te += c * q_te * q_f
        e_tf += c * q_tf * q_e
        f_tf += c * q_tf * q_f
        te_te += c * q_te * q_te
        te_tf += c * q_te * q_tf
        tf_tf += c * q_tf * q_tf

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
def softened_bending_rate(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    bending_stiffness: wp.array2d(dtype=wp.vec2d),
    natural_curvature: wp.array2d(dtype=wp.vec2d),
    softening: wp.array2d(dtype=wp.vec2d),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    bending_stiffness_rate: wp.array2d(dtype=wp.vec2d),
    natural_curvature_rate: wp.array2d(dtype=wp.vec2d),
    softening_rate: wp.array2d(dtype=wp.vec2d),
    # State in:
    dof_in: wp.array2d(dtype=wp.float64),
    director_in: wp.array2d(dtype=wp.vec3d),
    # Out:
    gradient_rate_out: wp.array2d(dtype=wp.float64),
):
    """Add the derivative of the gradient along a change of the model."""
    r, j = wp.tid()
    i = j + 1
    s = stencil(dof_in, director_in, r, i)
    rest = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    rest_rate = HALF * (rest_length_rate[r, i - 1] + rest_length_rate[r, i])
    cosine = wp.dot(s.t, s.u)
    chi = ONE + cosine
    stiffness = bending_stiffness[r, i]
    stiffness_rate = bending_stiffness_rate[r, i]
    natural = natural_curvature[r, i]
    excess = excess_curvature(s, rest, natural)
    excess_rate = -(rest_rate / rest) * (excess + natural) - natural_curvature_rate[r, i]
    root = softened(stiffness, softening[r, i][0], excess)
    kept = softening[r, i][1]
    kept_rate = softening_rate[r, i][1]
    secant = kept + (ONE - kept) / root
    # Q and its rate, for root^2 = 1 + c Q.
    mean = HALF * (stiffness[0] + stiffness[1])
    mean_rate = HALF * (stiffness_rate[0] + stiffness_rate[1])
    squares = wp.float64(0.0)
    squares_rate = wp.float64(0.0)
    for k in range(2):
        squares += stiffness[k] * excess[k] * excess[k]
        squares_rate += stiffness_rate[k] * excess[k] * excess[k]
        squares_rate += TWO * stiffness[k] * excess[k] * excess_rate[k]
    q = squares / mean
    q_rate = (squares_rate - q * mean_rate) / mean
    root_rate = HALF * (softening_rate[r, i][0] * q + softening[r, i][0] * q_rate) / root
    secant_rate = kept_rate * (ONE - ONE / root) - (ONE - kept) * root_rate / (root * root)
    for k in range(2):
        m_e = s.m1e
        m_f = s.m1f
        dm_e = s.m2e
        dm_f = s.m2f
        if k == 1:
            m_e = s.m2e
            m_f = s.m2f
            dm_e = -s.m1e
            dm_f = -s.m1f
        kappa = (wp.dot(m_e, s.u) - wp.dot(m_f, s.t)) / chi
        k_e = (-cosine * m_e - perpendicular(m_f, s.t) - kappa * perpendicular(s.u, s.t)) / chi
        k_f = (perpendicular(m_e, s.u) + cosine * m_f - kappa * perpendicular(s.t, s.u)) / chi
        rate = stiffness_rate[k] * excess[k] + stiffness[k] * excess_rate[k]
        rate = rate * secant + stiffness[k] * excess[k] * secant_rate
        add_edge_gradient(
            gradient_rate_out, r, i, (rate / s.length_e) * k_e, (rate / s.length_f) * k_f
        )
        wp.atomic_add(gradient_rate_out, r, 4 * i - 1, rate * wp.dot(dm_e, s.u) / chi)
        wp.atomic_add(gradient_rate_out, r, 4 * i + 3, -rate * wp.dot(dm_f, s.t) / chi)
