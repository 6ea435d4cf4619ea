"""Twisting: E = 1/2 C l (tau / l - tau0)^2 at each inner node (Eq. twisting).

tau = theta^i - theta^(i-1) + the reference twist. Derivatives of the reference twist after Bergou
et al. 2010; the symmetric parts of its blocks are the exact Hessian for frames that are
parallel-transported in time from the state at which they are evaluated.
"""

import warp as wp
from wrod.kernels.assembly import add_angle_hessian, add_edge_gradient, add_edge_hessian
from wrod.kernels.frames import HALF, ONE, TWO, ZERO, edge

wp.set_module_options({"enable_backward": False})


@wp.kernel
def twisting(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    twisting_stiffness: wp.array2d(dtype=wp.float64),
    natural_twist: wp.array2d(dtype=wp.float64),
    # State in:
    active: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    reference_twist_in: wp.array2d(dtype=wp.float64),
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
    if twisting_stiffness[r, i] == ZERO:  # at a cut
        return
    e = edge(dof_in, r, i - 1)
    f = edge(dof_in, r, i)
    length_e = wp.length(e)
    length_f = wp.length(f)
    t = e / length_e
    u = f / length_f
    rest = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    stiffness = twisting_stiffness[r, i]
    tau = dof_in[r, 4 * i + 3] - dof_in[r, 4 * i - 1] + reference_twist_in[r, i]
    excess = tau / rest - natural_twist[r, i]
    moment = stiffness * excess

    chi = ONE + wp.dot(t, u)
    binormal = (TWO / chi) * wp.cross(t, u)
    tau_e = (HALF / length_e) * binormal
    tau_f = (HALF / length_f) * binormal
    wp.atomic_add(energy_out, r, HALF * moment * excess * rest)
    add_edge_gradient(gradient_out, r, i, moment * tau_e, moment * tau_f)
    wp.atomic_add(gradient_out, r, 4 * i - 1, -moment)
    wp.atomic_add(gradient_out, r, 4 * i + 3, moment)

    if order == 2:
        mean = (t + u) / chi
        b = stiffness / rest
        pe = t + mean
        pf = u + mean
        quarter = HALF * HALF * moment
        ee = b * wp.outer(tau_e, tau_e) - (quarter / (length_e * length_e)) * (
            wp.outer(binormal, pe) + wp.outer(pe, binormal)
        )
        ff = b * wp.outer(tau_f, tau_f) - (quarter / (length_f * length_f)) * (
            wp.outer(binormal, pf) + wp.outer(pf, binormal)
        )
        ef = b * wp.outer(tau_e, tau_f) + (HALF * moment / (length_e * length_f)) * (
            (TWO / chi) * wp.skew(t) - wp.outer(binormal, mean)
        )
        add_edge_hessian(hessian_out, r, i, ee, ef, ff)
        add_angle_hessian(hessian_out, r, i, -b * tau_e, -b * tau_f, b * tau_e, b * tau_f, b, -b, b)


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
    wp.atomic_add(gradient_rate_out, r, 4 * i - 1, -rate)
    wp.atomic_add(gradient_rate_out, r, 4 * i + 3, rate)
