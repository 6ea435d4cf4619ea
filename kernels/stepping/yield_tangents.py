"""Tangents of bends that yield, of the law `PLASTIC` of `wrod.kernels.elastic.inelastic`, by every
number of the rod.

Beside `motion_tangents`: over a step a node's z goes to F(z_0, e - e_0), e its excess curvatures
and e_0 those at its start. Columns carry the rates of e_0 and z_0.
"""

import warp as wp
from wrod.kernels.elastic.curvature import (
    Stencil,
    add_component_rate,
    component,
    excess_curvature,
    stencil,
)
from wrod.kernels.elastic.frames import HALF, TWO
from wrod.kernels.elastic.inelastic import ELASTIC, Flow, Inelastic, cell, flow, weight_of
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.stepping.pace import Pace


@wp.struct
class Rates:
    """Of a column: of the length of a node's cell and of the edges' own, of stiffnesses, natural
    strains and the numbers of laws (law, share, scale, time)."""

    rest_length: wp.array2d(dtype=wp.float64)
    stiffness: wp.array2d(dtype=wp.vec3d)
    rest_strain: wp.array2d(dtype=wp.vec3d)
    inelastic: wp.array2d(dtype=wp.vec4d)


@wp.struct
class Bend:
    """At the end of a step: excess curvatures, the z that they would have led to without flow, and
    what flow makes of it."""

    excess: wp.vec2d
    trial: wp.vec2d
    now: Flow


@wp.func
def bend_of(model: ElasticModel, node: Inelastic, s: Stencil, r: int, i: int) -> Bend:
    out = Bend()
    out.excess = excess_curvature(s, cell(model, r, i), model.natural_curvature[r, i])
    out.trial = node.lagging + out.excess - node.excess
    out.now = flow(node, out.excess, weight_of(model.bending[r, i]))
    return out


@wp.func
def excess_rate(
    model: ElasticModel, rates: Rates, curved: wp.vec2d, excess: wp.vec2d, r: int, j: int, i: int
) -> wp.vec2d:
    """Of integrated curvatures that change by `curved`."""
    length = cell(model, r, i)
    longer = HALF * (rates.rest_length[j, i - 1] + rates.rest_length[j, i])
    bent = excess + model.natural_curvature[r, i]
    rest = rates.rest_strain[j, i]
    return (curved - longer * bent) / length - wp.vec2d(rest[0], rest[1])


@wp.func
def lagging_rate(
    node: Inelastic,
    bend: Bend,
    b: wp.vec2d,
    rates: Rates,
    excess_change: wp.vec2d,
    kept: wp.vec4d,
    j: int,
    i: int,
) -> wp.vec2d:
    """Of z at the end of a step; `kept`: rates of e_0 and z_0."""
    change = excess_change - wp.vec2d(kept[0], kept[1]) + wp.vec2d(kept[2], kept[3])
    out = bend.now.tangent * change
    trial = bend.trial
    weight = weight_of(b)
    square = wp.dot(trial, wp.cw_mul(weight, trial))
    if square > node.scale * node.scale:
        s = rates.stiffness[j, i]
        mean = HALF * (b[0] + b[1])
        stiffer = (wp.vec2d(s[0], s[1]) - HALF * (s[0] + s[1]) * weight) / mean
        turned = wp.dot(trial, wp.cw_mul(stiffer, trial)) / (TWO * square)
        size = wp.sqrt(square)
        out += (rates.inelastic[j, i][2] - node.scale * turned) / size * trial
    return out


@wp.kernel
def yield_tangents(
    # Model:
    model: ElasticModel,
    rates: Rates,
    # State in: what nodes remember at the step's start, and its rates
    node: wp.array2d(dtype=Inelastic),
    kept: wp.array3d(dtype=wp.vec4d),
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    per_thread: int,
    # In and out: (rod x column, dof)
    right_hand_side: wp.array2d(dtype=wp.float64),
):
    """Minus the rate of the moments that yield add, at a fixed configuration at the step's end."""
    r, n, group = wp.tid()
    i = n + 1
    here = node[r, i]
    if pace.accepted[r] == 0 or here.law == ELASTIC:
        return
    b = model.bending[r, i]
    s = stencil(dof, director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    bend = bend_of(model, here, s, r, i)
    still = wp.vec2d()
    for j in range(group * per_thread, wp.min(kept.shape[1], (group + 1) * per_thread)):
        change = excess_rate(model, rates, still, bend.excess, r, j, i)
        z = lagging_rate(here, bend, b, rates, change, kept[r, j, i], j, i)
        stiffer = rates.stiffness[j, i]
        more = rates.inelastic[j, i][1] * b + here.share * wp.vec2d(stiffer[0], stiffer[1])
        moment = wp.cw_mul(more, bend.now.z - bend.excess) + here.share * wp.cw_mul(b, z - change)
        row = r * kept.shape[1] + j
        add_component_rate(right_hand_side, row, i, s, first, -moment[0])
        add_component_rate(right_hand_side, row, i, s, second, -moment[1])


@wp.kernel
def carry_yield_tangents(
    # Model:
    model: ElasticModel,
    rates: Rates,
    # State in: as above, and rates of the strains at the step's end
    node: wp.array2d(dtype=Inelastic),
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    strain_rate: wp.array3d(dtype=wp.vec4d),
    per_thread: int,
    # State in and out:
    kept: wp.array3d(dtype=wp.vec4d),
):
    """Rates of what nodes remember at the end of the step: excess curvatures and z."""
    r, n, group = wp.tid()
    i = n + 1
    here = node[r, i]
    if pace.accepted[r] == 0 or here.law == ELASTIC:
        return
    b = model.bending[r, i]
    s = stencil(dof, director, r, i)
    bend = bend_of(model, here, s, r, i)
    for j in range(group * per_thread, wp.min(kept.shape[1], (group + 1) * per_thread)):
        strain = strain_rate[r, j, i]
        change = excess_rate(model, rates, wp.vec2d(strain[0], strain[1]), bend.excess, r, j, i)
        z = lagging_rate(here, bend, b, rates, change, kept[r, j, i], j, i)
        kept[r, j, i] = wp.vec4d(change[0], change[1], z[0], z[1])
