"""Bending of a rod that softens as it bends, as a cable does whose strands begin to slip.

It keeps the share r of its stiffness and loses the rest: E = 1/2 l B (r Q + (1 - r) ln(1 + c Q) /
c), with the excess curvatures e_k of `wrod.kernels.elastic.bending`, Q = sum_k B_k e_k^2 / B, B the
mean of B_1 and B_2. In a plane the moment is B e (r + (1 - r) / (1 + c e^2)). `softening` holds (c,
r), c >= 0 [length^2]; c = 0 is a linear rod. What the invariant K of `bending` adds in a rod that
is twisted does not soften.
"""

import warp as wp
from wrod.kernels.elastic.bending import BendingResponse, make_elasticity
from wrod.kernels.elastic.curvature import (
    add_component_rate,
    add_invariant_rate,
    component,
    excess_curvature,
    stencil,
)
from wrod.kernels.elastic.frames import HALF, ONE, TWO

wp.set_module_options({"enable_backward": False})

THREE = wp.constant(wp.float64(3.0))
SMALL = wp.constant(wp.float64(1.0e-5))


@wp.func
def softening_law(excess: wp.vec2d, stiffness: wp.vec2d, softening: wp.vec2d) -> BendingResponse:
    mean = HALF * (stiffness[0] + stiffness[1])
    squares = stiffness[0] * excess[0] * excess[0] + stiffness[1] * excess[1] * excess[1]
    kept = softening[1]
    x = softening[0] * squares / mean
    secant = kept + (ONE - kept) / (ONE + x)
    # ln(1 + x) / x loses its digits near 0.
    logarithm = ONE - HALF * x + x * x / THREE
    if x > SMALL:
        logarithm = wp.log(ONE + x) / x
    slope = -TWO * (ONE - kept) * softening[0] / (mean * (ONE + x) * (ONE + x))
    linear = wp.vec2d(stiffness[0] * excess[0], stiffness[1] * excess[1])
    law = BendingResponse()
    law.energy = HALF * squares * (kept + (ONE - kept) * logarithm)
    law.moment = secant * linear
    law.tangent = secant * wp.diag(stiffness) + slope * wp.outer(linear, linear)
    return law


softened_elasticity = make_elasticity(softening_law)


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
    stiffness = bending_stiffness[r, i]
    stiffness_rate = bending_stiffness_rate[r, i]
    natural = natural_curvature[r, i]
    excess = excess_curvature(s, rest, natural)
    excess_rate = -(rest_rate / rest) * (excess + natural) - natural_curvature_rate[r, i]
    kept = softening[r, i][1]
    kept_rate = softening_rate[r, i][1]
    # Q and its rate, for x = c Q.
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
    one = ONE + softening[r, i][0] * q
    x_rate = softening_rate[r, i][0] * q + softening[r, i][0] * q_rate
    secant = kept + (ONE - kept) / one
    secant_rate = kept_rate * (ONE - ONE / one) - (ONE - kept) * x_rate / (one * one)
    for k in range(2):
        rate = stiffness_rate[k] * excess[k] + stiffness[k] * excess_rate[k]
        rate = rate * secant + stiffness[k] * excess[k] * secant_rate
        add_component_rate(gradient_rate_out, r, i, s, component(s, k), rate)
    add_invariant_rate(gradient_rate_out, r, i, s, (mean_rate - mean * rest_rate / rest) / rest)
