"""The adjoint of bending that remembers (`wrod.kernels.elastic.inelastic`), node by node.

A node's own curvature goes from z_n to z_(n+1) = F(z_n, e_(n+1) - e_n; w), e its excess curvatures
and w = B_k / B, and the moment of the same z is in the step's balance. With M the moment's share of
that balance, -x . dkappa/dy, all goes back through F from Z = dL/dz_(n+1) + share B M: to z_n, to
e_(n+1) (what the moment wants of it is in A_n), to e_n, and to the stiffnesses.
"""

import warp as wp
from wrod.kernels.elastic.curvature import Component, Stencil, component, excess_curvature, stencil
from wrod.kernels.elastic.frames import HALF, ZERO
from wrod.kernels.elastic.inelastic import (
    DAHL,
    ELASTIC,
    PLASTIC,
    STANDARD_LINEAR_SOLID,
    Inelastic,
    by_lagging,
    cell,
    flow,
    one_less_exp_over,
    weight_of,
)  # fmt: skip
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import OneStep, Wanted

STENCIL = wp.constant(11)


@wp.func
def rate_by(s: Stencil, c: Component, m: int) -> wp.float64:
    """Derivative of a component of curvature by the m-th of the degrees of freedom around it."""
    if m == 3:
        return c.te
    if m == 7:
        return c.tf
    k = m % 4
    e = c.e[k] / s.length_e
    f = c.f[k] / s.length_f
    if m < 3:
        return -e
    return wp.where(m > 7, f, e - f)


@wp.func
def want_excess(
    rod: ElasticModel, model: WantedModel, r: int, i: int, excess: wp.vec2d, wanted: wp.vec2d
):
    """Of the natural curvature and the lengths that an excess curvature is over."""
    length = cell(rod, r, i)
    kappa = excess + rod.natural_curvature[r, i]
    model.natural_curvature[r, i] = model.natural_curvature[r, i] - wanted
    by_length = -HALF * wp.dot(wanted, kappa) / length
    wp.atomic_add(model.rest_length, r, i - 1, by_length)
    wp.atomic_add(model.rest_length, r, i, by_length)


@wp.func
def by_weight(node: Inelastic, change: wp.vec2d, weight: wp.vec2d, wanted: wp.vec2d) -> wp.vec2d:
    """What is wanted of z, wanted of the weights."""
    v = change
    if node.law == PLASTIC:
        v = node.lagging + change
    size = wp.sqrt(wp.dot(v, wp.cw_mul(weight, v)))
    by_size = wp.vec2d(ZERO, ZERO)
    if node.law == PLASTIC and size > node.scale:
        by_size = (-node.scale / (size * size)) * v
    if node.law == DAHL and size > ZERO:
        x = size / node.scale
        kept = wp.exp(-x)
        by_size = (kept - one_less_exp_over(x)) / size * change - (kept / node.scale) * node.lagging
    if size == ZERO:
        return wp.vec2d(ZERO, ZERO)
    return (HALF * wp.dot(wanted, by_size) / size) * wp.cw_mul(v, v)


@wp.func
def want_weights(wanted: wp.vec2d, stiffness: wp.vec2d) -> wp.vec2d:
    """Of weights, wanted of the stiffnesses that they are of."""
    mean = HALF * (stiffness[0] + stiffness[1])
    common = HALF * wp.dot(wanted, stiffness) / (mean * mean)
    return wanted / mean - wp.vec2d(common, common)


@wp.func
def excess_of(step: OneStep, rod: ElasticModel, r: int, i: int) -> wp.vec2d:
    s = stencil(step.dof, step.director, r, i)
    return excess_curvature(s, cell(rod, r, i), rod.natural_curvature[r, i])


@wp.kernel
def want_flowed(
    # Model:
    rod: ElasticModel,
    node: wp.array2d(dtype=Inelastic),
    # State in:
    step: OneStep,
    # State in and out:
    now: Wanted,
    model: WantedModel,
):
    """What later steps want of z, wanted of the end of the step. Launched over (rod, inner
    node)."""
    r, j = wp.tid()
    i = j + 1
    here = node[r, i]
    if step.active[r] == 0 or here.law == ELASTIC or rod.bending[r, i][0] == ZERO:
        return
    excess = excess_of(step, rod, r, i)
    to = flow(here, excess, weight_of(rod.bending[r, i]))
    wanted = wp.transpose(to.tangent) * now.lagging[r, i]
    want_excess(rod, model, r, i, excess, wanted)
    wanted = wanted / cell(rod, r, i)
    now.strain[r, i] = now.strain[r, i] + wp.vec4d(wanted[0], wanted[1], ZERO, ZERO)


@wp.kernel
def want_remembered(
    # Model:
    rod: ElasticModel,
    node: wp.array2d(dtype=Inelastic),
    # State in:
    step: OneStep,
    x: wp.array3d(dtype=ALONE),
    now: Wanted,
    # State in and out:
    before: Wanted,
    model: WantedModel,
):
    """From the end of the step to its start. Launched over (rod, inner node)."""
    r, j = wp.tid()
    i = j + 1
    here = node[r, i]
    b = rod.bending[r, i]
    if step.active[r] == 0 or here.law == ELASTIC or b[0] == ZERO:
        return
    s = stencil(step.dof, step.director, r, i)
    excess = excess_of(step, rod, r, i)
    weight = weight_of(b)
    to = flow(here, excess, weight)
    linear = wp.where(here.law == STANDARD_LINEAR_SOLID, ZERO, -here.share)
    by_moment = wp.vec2d()
    for k in range(2):
        c = component(s, k)
        value = wp.float64(0.0)
        for m in range(STENCIL):
            value -= rate_by(s, c, m) * x[r, 0, 4 * (i - 1) + m][0]
        by_moment[k] = value
    by_z = now.lagging[r, i] + here.share * wp.cw_mul(b, by_moment)
    by_change = wp.transpose(to.tangent) * by_z
    # That of `want_flowed` is there already.
    late = by_change - wp.transpose(to.tangent) * now.lagging[r, i]
    want_excess(rod, model, r, i, excess, late + linear * wp.cw_mul(b, by_moment))
    want_excess(rod, model, r, i, here.excess, -by_change)
    early = by_change / cell(rod, r, i)
    before.strain[r, i] = before.strain[r, i] - wp.vec4d(early[0], early[1], ZERO, ZERO)
    kept = wp.transpose(by_lagging(here, excess, weight, to)) * by_z
    before.lagging[r, i] = before.lagging[r, i] + kept
    model.bending[r, i] = (
        model.bending[r, i]
        + wp.cw_mul(by_moment, here.share * to.z + linear * excess)
        + want_weights(by_weight(here, excess - here.excess, weight, by_z), b)
    )


@wp.kernel
def want_begun(
    # Model:
    rod: ElasticModel,
    node: wp.array2d(dtype=Inelastic),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    # State in and out:
    now: Wanted,
    model: WantedModel,
):
    """Rods that have never been elsewhere went straight to where they start. Launched over
    (rod, inner node)."""
    r, j = wp.tid()
    i = j + 1
    here = node[r, i]
    b = rod.bending[r, i]
    if chosen[r] == 0 or here.law == ELASTIC or b[0] == ZERO:
        return
    excess = here.excess
    here.span = wp.float64(wp.inf)
    here.excess = wp.vec2d(ZERO, ZERO)
    here.lagging = wp.vec2d(ZERO, ZERO)
    to = flow(here, excess, weight_of(b))
    by_z = now.lagging[r, i]
    wanted = wp.transpose(to.tangent) * by_z
    want_excess(rod, model, r, i, excess, wanted)
    of_weight = by_weight(here, excess, weight_of(b), by_z)
    model.bending[r, i] = model.bending[r, i] + want_weights(of_weight, b)
    wanted = wanted / cell(rod, r, i)
    now.strain[r, i] = now.strain[r, i] + wp.vec4d(wanted[0], wanted[1], ZERO, ZERO)
    now.lagging[r, i] = wp.vec2d(ZERO, ZERO)


@wp.kernel
def measure_skew(
    # Model:
    rod: ElasticModel,
    node: wp.array2d(dtype=Inelastic),
    # State in:
    step: OneStep,
    # Out:
    skew_out: wp.array2d(dtype=wp.float64),
    rate_out: wp.array3d(dtype=wp.vec2d),
):
    """What Dahl's tangent is not symmetric by, and how both components of curvature change with
    the node's stencil. Launched over (rod, inner node)."""
    r, j = wp.tid()
    i = j + 1
    here = node[r, i]
    b = rod.bending[r, i]
    if step.active[r] == 0 or here.law == ELASTIC or b[0] == ZERO:
        return
    to = flow(here, excess_of(step, rod, r, i), weight_of(b))
    between = b[0] * to.tangent[0, 1] - b[1] * to.tangent[1, 0]
    skew_out[r, i] = HALF * here.share * between / cell(rod, r, i)
    s = stencil(step.dof, step.director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    for m in range(STENCIL):
        rate_out[r, i, m] = wp.vec2d(rate_by(s, first, m), rate_by(s, second, m))
