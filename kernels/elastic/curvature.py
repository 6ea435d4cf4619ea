"""Curvature at a node of a rod: its two components in the material frames, and their gradients.

In the material frames of the edges before (e) and after (f) the node they are (Bergou et al. 2010,
rewritten)

    kappa_k = (m_k^e . u - m_k^f . t) / (1 + t . u),    k = 1, 2,

t and u the unit tangents of e and f; without twist their norm is 2 tan(phi/2), phi the turning
angle.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_component, add_edge_gradient
from wrod.kernels.elastic.frames import ONE, ZERO, edge, rotate


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
    s.t = (ONE / s.length_e) * e
    s.u = (ONE / s.length_f) * f
    s.m1e = rotate(director[r, i - 1], s.t, dof[r, 4 * i - 1])
    s.m2e = wp.cross(s.t, s.m1e)
    s.m1f = rotate(director[r, i], s.u, dof[r, 4 * i + 3])
    s.m2f = wp.cross(s.u, s.m1f)
    return s


@wp.func
def at_cut(s: Stencil, before: wp.float64, after: wp.float64) -> Stencil:
    """The edge of a stencil that is none of a cut, whose stretching stiffness is 0 and which may
    have no length."""
    out = Stencil()
    out.length_e = ONE
    out.length_f = ONE
    if before != ZERO:
        out.t = s.t
        out.length_e = s.length_e
    if after != ZERO:
        out.u = s.u
        out.length_f = s.length_f
    return out


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
    per_chi = ONE / (ONE + cosine)
    c.kappa = per_chi * (wp.dot(c.m_e, s.u) - wp.dot(c.m_f, s.t))
    e = -cosine * c.m_e - perpendicular(c.m_f, s.t) - c.kappa * perpendicular(s.u, s.t)
    f = perpendicular(c.m_e, s.u) + cosine * c.m_f - c.kappa * perpendicular(s.t, s.u)
    c.e = per_chi * e
    c.f = per_chi * f
    c.te = per_chi * wp.dot(c.dm_e, s.u)
    c.tf = -per_chi * wp.dot(c.dm_f, s.t)
    return c


@wp.func
def excess_curvature(s: Stencil, rest: wp.float64, natural: wp.vec2d) -> wp.vec2d:
    """Both components of e = kappa / l - kappa0."""
    chi = ONE + wp.dot(s.t, s.u)
    return wp.vec2d(
        (wp.dot(s.m1e, s.u) - wp.dot(s.m1f, s.t)) / (chi * rest) - natural[0],
        (wp.dot(s.m2e, s.u) - wp.dot(s.m2f, s.t)) / (chi * rest) - natural[1],
    )


@wp.func
def add_component_rate(
    gradient_rate: wp.array2d(dtype=wp.float64),
    r: int,
    i: int,
    s: Stencil,
    c: Component,
    rate: wp.float64,
):
    """Add what a rate of the moment of one component contributes to that of the gradient."""
    add_edge_gradient(gradient_rate, r, i, (rate / s.length_e) * c.e, (rate / s.length_f) * c.f)
    add_component(gradient_rate, r, 4 * i - 1, rate * c.te)
    add_component(gradient_rate, r, 4 * i + 3, rate * c.tf)


@wp.func
def invariant_gradient(s: Stencil, k: Component, m: Component):
    """Gradient of (K - kappa_1^2 - kappa_2^2) / 2, K = 8 / (1 + t . u) - 4 (see
    `wrod.kernels.elastic.bending`): by the turning of t and of u, and by the angles."""
    chi = ONE + wp.dot(s.t, s.u)
    slope = -wp.float64(4.0) / (chi * chi)
    e = slope * perpendicular(s.u, s.t) - k.kappa * k.e - m.kappa * m.e
    f = slope * perpendicular(s.t, s.u) - k.kappa * k.f - m.kappa * m.f
    te = -k.kappa * k.te - m.kappa * m.te
    tf = -k.kappa * k.tf - m.kappa * m.tf
    return e, f, te, tf
