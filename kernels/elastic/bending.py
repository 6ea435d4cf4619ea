"""Bending: E = 1/2 l sum_k B_k (kappa_k / l - kappa0_k)^2 at each inner node (Eq. bending).

l is half the rest length of the two edges around the node, kappa_k are the components of
`wrod.kernels.elastic.curvature`. Those are means of two material frames, and their squares add up
to K cos^2(d / 2), where K = 4 tan^2(phi / 2) is the edges' own and d the twist between the frames:
a rod would soften as it is twisted. So the energy has K for the isotropic part of its square,

    E + 1/2 (B / l) (K - kappa_1^2 - kappa_2^2),    B the mean of B_1 and B_2.

Second derivatives are exact for frames that are
parallel-transported in time from the state at which they are evaluated (Panetta et al. 2019):
turning a tangent by a, perpendicular to it, changes t by a - |a|^2 t / 2 and m_k by -a_k t - a_k a
/ 2 to second order, a_k = a . m_k.

The kernels add up stretching and twisting as well: they live on the same stencil, and adding costs
as much as computing.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_number, add_parts
from wrod.kernels.elastic.curvature import (
    Component,
    Stencil,
    at_cut,
    component,
    excess_curvature,
    perpendicular,
    project,
    stencil,
    symmetric,
)
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.elastic.stretching import stretching
from wrod.kernels.elastic.twisting import Twisting, twisting, twisting_hessian

FOUR = wp.constant(wp.float64(4.0))


@wp.struct
class BendingResponse:
    """What a moment-curvature law says at an excess curvature: energy per length, the moments along
    the two principal directions, and their derivatives by the excess curvatures."""

    energy: wp.float64
    moment: wp.vec2d
    tangent: wp.mat22d


@wp.struct
class Bending:
    """Energy of the bending at one node and its derivatives.

    Letters e and f are the turning of the tangents before and after the node, te and tf the angles
    of these edges; two letters are second derivatives, in that order.
    """

    energy: wp.float64
    g_e: wp.vec3d
    g_f: wp.vec3d
    g_te: wp.float64
    g_tf: wp.float64
    ee: wp.mat33d
    ef: wp.mat33d
    ff: wp.mat33d
    e_te: wp.vec3d
    f_te: wp.vec3d
    e_tf: wp.vec3d
    f_tf: wp.vec3d
    te_te: wp.float64
    te_tf: wp.float64
    tf_tf: wp.float64


def make_bending(law: wp.Function | None = None, numbers: type = wp.vec2d) -> wp.Function:
    """Bending at a node by the linear law, or by a `law`: (excess, stiffness, its numbers) to
    `BendingResponse`.

    What only a law needs is left out of the linear one when it is built.
    """

    @wp.func
    def bending(
        s: Stencil,
        rest: wp.float64,
        principal: wp.vec2d,
        natural: wp.vec2d,
        parameter: numbers,
        invariant: wp.vec2d,
        order: int,
    ) -> Bending:
        """Of stiffnesses `principal`, curvature `natural` at rest; `invariant` are the stiffnesses
        whose mean the invariant K has. Second derivatives if `order` is 2."""
        cosine = wp.dot(s.t, s.u)
        chi = ONE + cosine
        per_chi = ONE / chi
        per_rest = ONE / rest
        grad_chi_e = perpendicular(s.u, s.t)
        grad_chi_f = perpendicular(s.t, s.u)
        eye = wp.identity(3, dtype=wp.float64)

        out = Bending()
        if wp.static(law is not None):
            excesses = excess_curvature(s, rest, natural)
            here = law(excesses, principal, parameter)
            out.energy = rest * here.energy
            first = Component()

        average = HALF * (invariant[0] + invariant[1])
        mean = average * per_rest
        for k in range(2):
            stiffness = principal[k]
            isotropic = stiffness == average and natural[k] == ZERO
            if wp.static(law is not None):
                isotropic = False
            if not isotropic:  # all is in the invariant
                c = component(s, k)
                excess = c.kappa * per_rest - natural[k]
                moment = stiffness * excess
                work = HALF * moment * excess * rest
                if wp.static(law is not None):
                    stiffness = here.tangent[k, k]
                    moment = here.moment[k]
                    work = ZERO
                b = stiffness * per_rest - mean
                moment = moment - mean * c.kappa
                out.energy += work - HALF * mean * c.kappa * c.kappa
                out.g_e += moment * c.e
                out.g_f += moment * c.f
                out.g_te += moment * c.te
                out.g_tf += moment * c.tf

                if order == 2:
                    m = moment * per_chi
                    e_u = wp.dot(c.m_e, s.u)
                    f_t = wp.dot(c.m_f, s.t)
                    h = (f_t + c.kappa * cosine) * eye - HALF * symmetric(c.m_e, s.u)
                    h = per_chi * (project(h, s.t, s.t) - symmetric(c.e, grad_chi_e))
                    # The unit tangent's own second derivative by the edge vector.
                    h = h - symmetric(c.e, s.t)
                    out.ee += b * wp.outer(c.e, c.e) + moment * h
                    h = (c.kappa * cosine - e_u) * eye + HALF * symmetric(c.m_f, s.t)
                    h = per_chi * (project(h, s.u, s.u) - symmetric(c.f, grad_chi_f))
                    h = h - symmetric(c.f, s.u)
                    out.ff += b * wp.outer(c.f, c.f) + moment * h
                    h = wp.outer(s.u, c.m_f) - wp.outer(c.m_e, s.t) - c.kappa * eye
                    h = project(h, s.t, s.u) - wp.outer(c.e, grad_chi_f)
                    h = h - wp.outer(grad_chi_e, c.f)
                    out.ef += b * wp.outer(c.e, c.f) + m * h

                    out.e_te += b * c.te * c.e + m * (-cosine * c.dm_e - c.te * grad_chi_e)
                    out.f_te += b * c.te * c.f + m * (
                        perpendicular(c.dm_e, s.u) - c.te * grad_chi_f
                    )
                    out.e_tf += b * c.tf * c.e - m * (
                        perpendicular(c.dm_f, s.t) + c.tf * grad_chi_e
                    )
                    out.f_tf += b * c.tf * c.f + m * (cosine * c.dm_f - c.tf * grad_chi_f)
                    out.te_te += b * c.te * c.te - m * e_u
                    out.te_tf += b * c.te * c.tf
                    out.tf_tf += b * c.tf * c.tf + m * f_t

                    if wp.static(law is not None):
                        if k == 0:
                            first = c
                        else:
                            # A law of both curvatures couples them.
                            b = here.tangent[0, 1] * per_rest
                            out.ee += b * symmetric(first.e, c.e)
                            out.ef += b * (wp.outer(first.e, c.f) + wp.outer(c.e, first.f))
                            out.ff += b * symmetric(first.f, c.f)
                            out.e_te += b * (first.te * c.e + c.te * first.e)
                            out.f_te += b * (first.te * c.f + c.te * first.f)
                            out.e_tf += b * (first.tf * c.e + c.tf * first.e)
                            out.f_tf += b * (first.tf * c.f + c.tf * first.f)
                            out.te_te += TWO * b * first.te * c.te
                            out.te_tf += b * (first.te * c.tf + c.te * first.tf)
                            out.tf_tf += TWO * b * first.tf * c.tf

        # The invariant: K = 8 / chi - 4.
        out.energy += mean * (FOUR * per_chi - TWO)
        slope = -FOUR * mean * per_chi * per_chi
        out.g_e += slope * grad_chi_e
        out.g_f += slope * grad_chi_f
        if order == 2:
            b = -TWO * slope * per_chi
            out.ee += b * wp.outer(grad_chi_e, grad_chi_e) - slope * (
                symmetric(grad_chi_e, s.t) + cosine * (eye - wp.outer(s.t, s.t))
            )
            out.ff += b * wp.outer(grad_chi_f, grad_chi_f) - slope * (
                symmetric(grad_chi_f, s.u) + cosine * (eye - wp.outer(s.u, s.u))
            )
            out.ef += b * wp.outer(grad_chi_e, grad_chi_f) + slope * project(eye, s.t, s.u)

        return out

    return bending


@wp.func
def add_stencil(
    r: int,
    i: int,
    s: Stencil,
    bend: Bending,
    twist: Twisting,
    # Beside them, by the edges before (e) and after (f) the node:
    e: wp.vec3d,
    f: wp.vec3d,
    e_e: wp.mat33d,
    f_f: wp.mat33d,
    there: bool,
    together: bool,
    fresh: bool,
    order: int,
    # Out:
    gradient_out: wp.array2d(dtype=wp.float64),
    hessian_out: wp.array3d(dtype=wp.float64),
):
    """Add bending and twisting at node i to the rod's derivatives; nothing where it is not `there`.
    `together` and `fresh`: see `add_parts`."""
    inv_e = ONE / s.length_e
    inv_f = ONE / s.length_f
    g_e = inv_e * bend.g_e + twist.moment * twist.e + e
    g_f = inv_f * bend.g_f + twist.moment * twist.f + f
    b = twist.stiffness
    ee = wp.mat33d()
    ef = wp.mat33d()
    ff = wp.mat33d()
    if order == 2:
        twist_ee, twist_ef, twist_ff = twisting_hessian(s, twist)
        ee = (inv_e * inv_e) * bend.ee + e_e + twist_ee
        ef = (inv_e * inv_f) * bend.ef + twist_ef
        ff = (inv_f * inv_f) * bend.ff + f_f + twist_ff
    add_parts(
        r, i, there, together, fresh, order,
        g_e, g_f, bend.g_te - twist.moment, bend.g_tf + twist.moment,
        ee, ef, ff,
        inv_e * bend.e_te - b * twist.e, inv_f * bend.f_te - b * twist.f,
        inv_e * bend.e_tf + b * twist.e, inv_f * bend.f_tf + b * twist.f,
        bend.te_te + b, bend.te_tf - b, bend.tf_tf + b,
        gradient_out, hessian_out,
    )  # fmt: skip


def make_elasticity(law: wp.Function | None = None) -> wp.Kernel:
    """The kernel of the linear law, or that of a `law`; see `make_bending`.

    What only a law needs is left out of the linear kernel when it is built, which grasps notice.
    """

    bending = make_bending(law)

    # Of a module of its own: the laws are compiled side by side, and only those that are launched.
    @wp.kernel(module="unique", enable_backward=False)
    def elasticity(
        model: ElasticModel,
        # State in:
        active: wp.array(dtype=wp.int32),
        dof_in: wp.array2d(dtype=wp.float64),
        director_in: wp.array2d(dtype=wp.vec3d),
        reference_twist_in: wp.array2d(dtype=wp.float64),
        order: int,
        owned: int,
        fresh: bool,
        # Out:
        energy_out: wp.array(dtype=wp.float64),
        gradient_out: wp.array2d(dtype=wp.float64),
        hessian_out: wp.array3d(dtype=wp.float64),
    ):
        """Add energy and gradient, and the exact Hessian if `order` is 2.

        The invariant K has the mean of `model.invariant`.

        Every inner node adds the stretching of the edge before it, the last that after it as well.
        Launched over (rod, inner node) with 0 nodes `owned`; on a GPU over (rod, warp, lane), in
        blocks of a warp, of whose lanes so many own theirs: a first and a last one help them.
        There, if `fresh`, gradient and Hessian are written anew.
        """
        r, j = wp.tid()
        if active[r] == 0:
            return
        last = model.stretching.shape[1] - 1
        at, owns = j + 1, True
        if owned > 0:
            lane = j % (owned + 2)
            at = j / (owned + 2) * owned + lane
            owns = lane > 0 and lane <= owned
        i = wp.clamp(at, 1, last)
        there = at == i
        s = stencil(dof_in, director_in, r, i)
        tau = dof_in[r, 4 * i + 3] - dof_in[r, 4 * i - 1] + reference_twist_in[r, i]
        if model.bending[r, i][0] == ZERO:
            s = at_cut(s, model.stretching[r, i - 1], model.stretching[r, i])
            tau = ZERO
        rest_e = model.rest_length[r, i - 1]
        rest_f = model.rest_length[r, i]
        rest = HALF * (rest_e + rest_f)
        bend = bending(
            s,
            rest,
            model.bending[r, i],
            model.natural_curvature[r, i],
            model.softening[r, i],
            model.invariant[r, i],
            order,
        )
        twist = twisting(model.twisting[r, i], model.natural_twist[r, i], rest, s, tau)
        before = stretching(model.stretching[r, i - 1], rest_e, s.length_e, s.t)
        energy = before.energy
        g_f = wp.vec3d(ZERO, ZERO, ZERO)
        ff = wp.mat33d()
        if i == last:
            after = stretching(model.stretching[r, i], rest_f, s.length_f, s.u)
            energy += after.energy
            g_f += after.gradient
            ff += after.hessian
        if there and owns and energy_out.shape[0] > 0:
            add_number(energy_out, r, bend.energy + energy + twist.energy)
        add_stencil(
            r, at, s, bend, twist, before.gradient, g_f, before.hessian, ff,
            there, owned > 0, fresh, order, gradient_out, hessian_out,
        )  # fmt: skip

    return elasticity


elasticity = make_elasticity()
