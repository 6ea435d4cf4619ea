"""Bending that remembers: plasticity, a standard linear solid, and Dahl's hysteresis.

Each is the linear rod and a part whose own curvature z lags behind the excess curvature e:

    M_k = B_k e_k + g B_k z_k                    standard linear solid,  dz/dt = de/dt - z / T
    M_k = B_k (r e_k + (1 - r) z_k)              plastic,  |z| <= k_y, what is beyond flows off
    M_k = B_k (r e_k + (1 - r) z_k)              Dahl,  dz = de - (z / k_s) |de|

The plastic one is linear kinematic hardening: B is the stiffness before the curvature k_y, r B that
after it. In two directions |v| is sqrt(sum_k B_k v_k^2 / B), B the mean of B_1 and B_2. Over a step
the excess goes straight from where it was; for that way z is exact (Dahl 1968; Simo & Hughes 1998,
ch. 1 and 10), but for the plastic one where its direction changes: there it is the closest point.
Energies are what z stores at the start of the step and the potential of the step's moments from
there, which Dahl's law only has along one direction: its tangent is made symmetric.
"""

import warp as wp
from wrod.kernels.elastic.curvature import excess_curvature, stencil
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.elastic.section import Response, make_section_energy

ELASTIC = wp.constant(0)
PLASTIC = wp.constant(1)
STANDARD_LINEAR_SOLID = wp.constant(2)
DAHL = wp.constant(3)
SMALL = wp.constant(wp.float64(1.0e-4))
SIXTH = wp.constant(wp.float64(1.0 / 6.0))


@wp.struct
class Inelastic:
    """A node: its law, `share` (g or 1 - r), `scale` (k_y or k_s), relaxation `time`; and its
    state: excess curvature and z at the start of the step, and the step's duration."""

    law: wp.int32
    share: wp.float64
    scale: wp.float64
    time: wp.float64
    span: wp.float64
    excess: wp.vec2d
    lagging: wp.vec2d


@wp.struct
class Flow:
    """z at the end, its derivatives by the excess, and the work of z done over B."""

    z: wp.vec2d
    tangent: wp.mat22d
    work: wp.float64


@wp.func
def weight_of(stiffness: wp.vec2d) -> wp.vec2d:
    """B_k / B."""
    return stiffness / (HALF * (stiffness[0] + stiffness[1]))


@wp.func
def cell(model: ElasticModel, r: int, i: int) -> wp.float64:
    """Length that a node's curvature is over."""
    return HALF * (model.rest_length[r, i - 1] + model.rest_length[r, i])


@wp.func
def one_less_exp_over(x: wp.float64) -> wp.float64:
    """(1 - exp(-x)) / x."""
    if x < SMALL:
        return ONE - x * (HALF - SIXTH * x)
    return (ONE - wp.exp(-x)) / x


@wp.func
def flow(node: Inelastic, excess: wp.vec2d, weight: wp.vec2d) -> Flow:
    """To the excess curvature `excess`; `weight` is B_k / B."""
    before = node.lagging
    change = excess - node.excess
    eye = wp.identity(2, dtype=wp.float64)
    stored = HALF * wp.dot(before, wp.cw_mul(weight, before))
    out = Flow()
    if node.law == STANDARD_LINEAR_SOLID:
        x = node.span / node.time
        kept = wp.exp(-x)
        share = one_less_exp_over(x)
        out.z = kept * before + share * change
        out.tangent = share * eye
        out.work = stored + wp.dot(wp.cw_mul(weight, change), kept * before + HALF * share * change)
        return out
    if node.law == PLASTIC:
        z = before + change
        weighted = wp.cw_mul(weight, z)
        size = wp.sqrt(wp.dot(z, weighted))
        if size <= node.scale:
            out.z = z
            out.tangent = eye
            out.work = HALF * size * size
        else:
            shrink = node.scale / size
            out.z = shrink * z
            out.tangent = shrink * (eye - wp.outer(z, weighted) / (size * size))
            out.work = node.scale * (size - HALF * node.scale)
        return out
    weighted = wp.cw_mul(weight, change)
    size = wp.sqrt(wp.dot(change, weighted))
    x = size / node.scale
    kept = wp.exp(-x)
    share = one_less_exp_over(x)
    out.z = kept * before + share * change
    out.tangent = share * eye
    out.work = stored + share * wp.dot(weighted, before)
    out.work += node.scale * node.scale * (x - x * share)
    if size > ZERO:
        # The derivatives of exp(-x) and of (1 - exp(-x)) / x.
        fall = (kept - share) / size
        out.tangent += wp.outer(fall * change - (kept / node.scale) * before, weighted / size)
    return out


@wp.func
def by_lagging(node: Inelastic, excess: wp.vec2d, weight: wp.vec2d, now: Flow) -> wp.mat22d:
    """Derivatives of z at the end by that at the start."""
    eye = wp.identity(2, dtype=wp.float64)
    if node.law == STANDARD_LINEAR_SOLID:
        return wp.exp(-node.span / node.time) * eye
    if node.law == DAHL:
        change = excess - node.excess
        size = wp.sqrt(wp.dot(change, wp.cw_mul(weight, change)))
        return wp.exp(-size / node.scale) * eye
    return now.tangent


@wp.func
def inelastic(excess: wp.vec3d, stiffness: wp.vec3d, node: Inelastic) -> Response:
    out = Response()
    if node.law == ELASTIC:
        return out
    b = wp.vec2d(stiffness[0], stiffness[1])
    mean = HALF * (b[0] + b[1])
    e = wp.vec2d(excess[0], excess[1])
    now = flow(node, e, weight_of(b))
    linear = wp.where(node.law == STANDARD_LINEAR_SOLID, ZERO, -node.share)
    out.energy = node.share * mean * now.work + HALF * linear * wp.dot(e, wp.cw_mul(b, e))
    moment = wp.cw_mul(b, node.share * now.z + linear * e)
    out.moment = wp.vec3d(moment[0], moment[1], ZERO)
    across = HALF * node.share * (b[0] * now.tangent[0, 1] + b[1] * now.tangent[1, 0])
    first = b[0] * (node.share * now.tangent[0, 0] + linear)
    second = b[1] * (node.share * now.tangent[1, 1] + linear)
    out.tangent = wp.mat33d(first, across, ZERO, across, second, ZERO, ZERO, ZERO, ZERO)
    return out


inelastic_energy = make_section_energy(inelastic, Inelastic)


@wp.kernel
def set_inelastic_laws(
    # In: law, share, scale, time
    number: wp.array2d(dtype=wp.vec4d),
    # Out:
    node_out: wp.array2d(dtype=Inelastic),
):
    """Give every node its law; it has never been bent, and has all the time there is."""
    r, i = wp.tid()
    n = number[r, i]
    node = Inelastic()
    node.law = int(n[0])
    node.share = n[1]
    node.scale = n[2]
    node.time = n[3]
    node.span = wp.float64(wp.inf)
    node_out[r, i] = node


@wp.kernel
def begin_flow(
    # State in:
    starting: wp.array(dtype=wp.int32),
    span: wp.array(dtype=wp.float64),
    # State in and out:
    node: wp.array2d(dtype=Inelastic),
):
    r, i = wp.tid()
    if starting[r] != 0:
        node[r, i].span = span[r]


@wp.kernel
def forget_flow(
    chosen: wp.array(dtype=wp.int32),
    # State in and out:
    node: wp.array2d(dtype=Inelastic),
):
    """The chosen rods have never been bent."""
    r, i = wp.tid()
    if chosen[r] != 0:
        node[r, i].span = wp.float64(wp.inf)
        node[r, i].excess = wp.vec2d(ZERO, ZERO)
        node[r, i].lagging = wp.vec2d(ZERO, ZERO)


@wp.kernel
def finish_flow(
    # Model:
    model: ElasticModel,
    # State in:
    accepted: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    node: wp.array2d(dtype=Inelastic),
):
    """Let the chosen rods remember where they are after a `step`."""
    r, j = wp.tid()
    i = j + 1
    b = model.bending[r, i]
    here = node[r, i]
    if accepted[r] == 0 or here.law == ELASTIC or b[0] == ZERO:
        return
    s = stencil(dof, director, r, i)
    excess = excess_curvature(s, cell(model, r, i), model.natural_curvature[r, i])
    here.span = step[r]
    now = flow(here, excess, weight_of(b))
    here.excess = excess
    here.lagging = now.z
    # At rest from here on; a step says how long it lasts.
    here.span = ZERO
    node[r, i] = here
