"""Tangents of bends that remember (`wrod.kernels.elastic.inelastic`), beside their steps'.

Over a step a node's z goes to F(z, e - e_0), e its excess curvatures and e_0 those at its start;
its moments have share B of it. Tangents carry the rates of e_0 and z. A step is solved by its
symmetric Hessian, so that of Dahl's law they lack what is not symmetric in F where the direction of
bending changes.
"""

from typing import Any

import warp as wp
from wrod.kernels.elastic.curvature import excess_curvature, stencil
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.elastic.inelastic import (
    ELASTIC,
    STANDARD_LINEAR_SOLID,
    Inelastic,
    by_lagging,
    cell,
    flow,
    weight_of,
)
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.stepping.flow_tangents import Strains, is_under_way, strain_rate
from wrod.kernels.stepping.pace import Pace


@wp.struct
class Memory:
    """A node's z at the end of a step, by the excess curvature there and by z at the start; its
    moments by z, the length of its cell, and the share of it that is bent at rest."""

    by_excess: wp.mat22d
    by_z: wp.mat22d
    moment: wp.vec2d
    length: wp.float64
    share: wp.float64


@wp.func
def share_bent(model: ElasticModel, r: int, i: int) -> wp.float64:
    """Share of a node's cell that is not beyond the grip."""
    if i == model.rest_length.shape[1] - 1:
        return HALF * model.rest_length[r, i - 1] / cell(model, r, i)
    return ONE


@wp.kernel
def linearise_memory(
    # Model:
    model: ElasticModel,
    node: wp.array2d(dtype=Inelastic),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    # In and out:
    strains: wp.array2d(dtype=Strains),
    # Out:
    memory_out: wp.array2d(dtype=Memory),
):
    """Of inner nodes, and what natural curvature does to moments that remember."""
    r, j = wp.tid()
    i = j + 1
    if pace.accepted[r] == 0:
        return
    out = Memory()
    here = node[r, i]
    b = model.bending[r, i]
    length = cell(model, r, i)
    share = share_bent(model, r, i)
    out.length = length
    out.share = share
    if here.law != ELASTIC and b[0] != ZERO:
        s = stencil(dof, director, r, i)
        excess = excess_curvature(s, length, model.natural_curvature[r, i])
        weight = weight_of(b)
        to = flow(here, excess, weight)
        out.by_excess = to.tangent
        out.by_z = by_lagging(here, excess, weight, to)
        linear = wp.where(here.law == STANDARD_LINEAR_SOLID, ZERO, -here.share)
        out.moment = here.share * b
        rates = strains[r, i]
        rates.natural -= share * (wp.diag(out.moment) * to.tangent + linear * wp.diag(b))
        strains[r, i] = rates
    memory_out[r, i] = out


@wp.kernel
def begin_memory(
    # Model:
    model: ElasticModel,
    natural_rate: wp.array3d(dtype=Any),
    # State in:
    node: wp.array2d(dtype=Inelastic),
    # Out: (rod, pack, 4 i + k), excess curvatures and z
    kept_out: wp.array3d(dtype=Any),
):
    """Of rods that went straight from their natural shape to where they are."""
    r, p, j = wp.tid()
    i = j + 1
    here = node[r, i]
    b = model.bending[r, i]
    if here.law == ELASTIC or b[0] == ZERO:
        return
    excess = here.excess
    here.excess = wp.vec2d(ZERO, ZERO)
    here.lagging = wp.vec2d(ZERO, ZERO)
    here.span = wp.float64(wp.inf)
    t = flow(here, excess, weight_of(b)).tangent
    share = share_bent(model, r, i)
    a = 4 * i
    for k in range(2):
        n_1 = natural_rate[r, p, 0]
        n_2 = natural_rate[r, p, 1]
        kept_out[r, p, a + k] = -share * natural_rate[r, p, k]
        kept_out[r, p, a + 2 + k] = -share * (t[k, 0] * n_1 + t[k, 1] * n_2)


@wp.kernel
def remembered_moments(
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    memory: wp.array2d(dtype=Memory),
    kept: wp.array3d(dtype=Any),
    # Out: (rod, pack, 2 i + k)
    moment_out: wp.array3d(dtype=Any),
):
    """Rates of moments by what is remembered."""
    r, p, j = wp.tid()
    i = j + 1
    if not is_under_way(pace, begin, r, p):
        return
    m = memory[r, i]
    a = 4 * i
    for k in range(2):
        rate = m.by_z[k, 0] * kept[r, p, a + 2] + m.by_z[k, 1] * kept[r, p, a + 3]
        rate -= m.by_excess[k, 0] * kept[r, p, a] + m.by_excess[k, 1] * kept[r, p, a + 1]
        moment_out[r, p, 2 * i + k] = m.moment[k] * rate


@wp.kernel
def carry_memory(
    begin: wp.array2d(dtype=wp.float64),
    natural_rate: wp.array3d(dtype=Any),
    # State in:
    pace: Pace,
    strains: wp.array2d(dtype=Strains),
    memory: wp.array2d(dtype=Memory),
    x: wp.array3d(dtype=Any),
    # State in and out:
    kept: wp.array3d(dtype=Any),
):
    """Rates of what nodes remember at the end of the step."""
    r, p, j = wp.tid()
    i = j + 1
    if not is_under_way(pace, begin, r, p):
        return
    m = memory[r, i]
    s = strains[r, i]
    a = 4 * i
    e_1 = (ONE / m.length) * strain_rate(s, x, r, p, i, 0) - m.share * natural_rate[r, p, 0]
    e_2 = (ONE / m.length) * strain_rate(s, x, r, p, i, 1) - m.share * natural_rate[r, p, 1]
    d_1 = e_1 - kept[r, p, a]
    d_2 = e_2 - kept[r, p, a + 1]
    z_1 = kept[r, p, a + 2]
    z_2 = kept[r, p, a + 3]
    kept[r, p, a] = e_1
    kept[r, p, a + 1] = e_2
    for k in range(2):
        z = m.by_excess[k, 0] * d_1 + m.by_excess[k, 1] * d_2
        kept[r, p, a + 2 + k] = z + m.by_z[k, 0] * z_1 + m.by_z[k, 1] * z_2
