"""Bending of a rod that softens as it bends, as a cable does whose strands begin to slip.

It keeps the share r of its stiffness and loses the rest: E = 1/2 l B (r Q + (1 - r) ln(1 + c Q) /
c), with the excess curvatures e_k of `wrod.kernels.elastic.bending`, Q = sum_k B_k e_k^2 / B, B the
mean of B_1 and B_2. In a plane the moment is B e (r + (1 - r) / (1 + c e^2)). `softening` holds (c,
r), c >= 0 [length^2]; c = 0 is a linear rod. What the invariant K of `bending` adds in a rod that
is twisted does not soften.
"""

import warp as wp
from wrod.kernels.elastic.bending import BendingResponse, make_elasticity
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO

THREE = wp.constant(wp.float64(3.0))
SMALL = wp.constant(wp.float64(1.0e-5))


@wp.func
def softening_law(excess: wp.vec2d, stiffness: wp.vec2d, softening: wp.vec2d) -> BendingResponse:
    mean = HALF * (stiffness[0] + stiffness[1])
    if mean == ZERO:  # at a cut
        mean = ONE
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
