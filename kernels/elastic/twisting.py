"""Twisting: E = 1/2 C l (tau / l - tau0)^2 at each inner node (Eq. twisting).

tau = theta^i - theta^(i-1) + the reference twist. Derivatives of the reference twist after Bergou
et al. 2010; the symmetric parts of its blocks are the exact Hessian for frames that are
parallel-transported in time from the state at which they are evaluated.
"""

import warp as wp
from wrod.kernels.elastic.curvature import Stencil
from wrod.kernels.elastic.frames import HALF, ONE


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
