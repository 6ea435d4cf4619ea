"""Twisting: E = 1/2 C l (tau / l - tau0)^2 at each inner node (Eq. twisting).

tau = theta^i - theta^(i-1) + the reference twist. Derivatives of the reference twist after Bergou
et al. 2010; the symmetric parts of its blocks are the exact Hessian for frames that are
parallel-transported in time from the state at which they are evaluated.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_component, add_edge_gradient
from wrod.kernels.elastic.curvature import Stencil
from wrod.kernels.elastic.frames import HALF, ONE, edge

wp.set_module_options({"enable_backward": False})


@wp.struct
class Twisting:
    """Energy of the twist at one node, and its derivatives.

    The gradient is `moment` times that of the twist: `e` and `f` by the edges before and after the
    node, -1 and 1 by their angles. `stiffness` multiplies the twist's own products.
    """

    energy: wp.float64
    moment: wp.float64
    stiffness: wp.float64
    e: wp.vec3d
    f: wp.vec3d


@wp.func
def twisting(
    # Model:
    stiffness: wp.float64,
    natural_twist: wp.float64,
    rest: wp.float64,
    # State in:
    s: Stencil,
    tau: wp.float64,
) -> Twisting:
    """At the twist `tau` across the node [rad]."""
    excess = tau / rest - natural_twist
    moment = stiffness * excess
    return twisting_moment(HALF * moment * excess * rest, moment, stiffness / rest, s)


@wp.func
def twisting_moment(
    energy: wp.float64, moment: wp.float64, stiffness: wp.float64, s: Stencil
) -> Twisting:
    """What has this energy, moment, and derivative of the moment by the twist across the node."""
    # Half the curvature binormal.
    turn = (ONE / (ONE + wp.dot(s.t, s.u))) * wp.cross(s.t, s.u)
    out = Twisting()
    out.energy = energy
    out.moment = moment
    out.stiffness = stiffness
    out.e = (ONE / s.length_e) * turn
    out.f = (ONE / s.length_f) * turn
    return out


@wp.func
def twisting_hessian(s: Stencil, twist: Twisting):
    """(ee, ef, ff): second derivatives by the edges."""
    per_chi = ONE / (ONE + wp.dot(s.t, s.u))
    mean = per_chi * (s.t + s.u)
    b = twist.stiffness
    half = HALF * twist.moment
    pe = s.t + mean
    pf = s.u + mean
    ee = b * wp.outer(twist.e, twist.e) - (half / s.length_e) * (
        wp.outer(twist.e, pe) + wp.outer(pe, twist.e)
    )
    ff = b * wp.outer(twist.f, twist.f) - (half / s.length_f) * (
        wp.outer(twist.f, pf) + wp.outer(pf, twist.f)
    )
    ef = b * wp.outer(twist.e, twist.f) + (twist.moment / s.length_f) * (
        (per_chi / s.length_e) * wp.skew(s.t) - wp.outer(twist.e, mean)
    )
    return ee, ef, ff


@wp.kernel
def twisting_rate(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    twisting_stiffness: wp.array2d(dtype=wp.float64),
    natural_twist: wp.array2d(dtype=wp.float64),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    twisting_stiffness_rate: wp.array2d(dtype=wp.float64),
    natural_twist_rate: wp.array2d(dtype=wp.float64),
    # State in:
    dof_in: wp.array2d(dtype=wp.float64),
    reference_twist_in: wp.array2d(dtype=wp.float64),
    # Out:
    gradient_rate_out: wp.array2d(dtype=wp.float64),
):
    """Add the derivative of the gradient along a change of the model."""
    r, j = wp.tid()
    i = j + 1
    e = edge(dof_in, r, i - 1)
    f = edge(dof_in, r, i)
    t = wp.normalize(e)
    u = wp.normalize(f)
    rest = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    rest_rate = HALF * (rest_length_rate[r, i - 1] + rest_length_rate[r, i])
    twist = (dof_in[r, 4 * i + 3] - dof_in[r, 4 * i - 1] + reference_twist_in[r, i]) / rest
    excess_rate = -twist * rest_rate / rest - natural_twist_rate[r, i]
    rate = twisting_stiffness_rate[r, i] * (twist - natural_twist[r, i])
    rate += twisting_stiffness[r, i] * excess_rate
    binormal = (rate / (ONE + wp.dot(t, u))) * wp.cross(t, u)
    add_edge_gradient(gradient_rate_out, r, i, binormal / wp.length(e), binormal / wp.length(f))
    add_component(gradient_rate_out, r, 4 * i - 1, -rate)
    add_component(gradient_rate_out, r, 4 * i + 3, rate)
