"""A rod whose properties vary along it, from contact to grip: its unbalanced forces and moments.

Every edge has a material director of its own, along the first principal direction of its section;
there are no angles but those of a step. `twist` at a node is the angle between the directors around
it, and may be more than a turn. `progress` 0 is a straight uniform rod of unit stiffness, 1 the
rod itself; in between properties change linearly.
"""

import warp as wp
from wrod.kernels.elastic.bending import Bending, make_bending
from wrod.kernels.elastic.curvature import Stencil
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, parallel_transport, rotate, signed_angle
from wrod.kernels.elastic.softened_bending import softening_law
from wrod.kernels.elastic.stretching import stretching
from wrod.kernels.elastic.twisting import Twisting, twisting, twisting_hessian
from wrod.kernels.grasping.contact_edge import first_direction, ghost_direction, half_turn
from wrod.kernels.grasping.straight_rod import WEIGHT, point, put_point, worse

bending = make_bending(softening_law)
TURN = wp.constant(wp.float64(6.283185307179586))


@wp.struct
class GeneralRod:
    """Properties on the mesh, as `RodBatch` has them; dimensionless. Edges and nodes count from the
    contact."""

    rest: wp.array2d(dtype=wp.float64)
    stretching: wp.array2d(dtype=wp.float64)
    bending: wp.array2d(dtype=wp.vec2d)
    twisting: wp.array2d(dtype=wp.float64)
    natural_curvature: wp.array2d(dtype=wp.vec2d)
    natural_twist: wp.array2d(dtype=wp.float64)
    softening: wp.array2d(dtype=wp.vec2d)
    weight: wp.array2d(dtype=wp.float64)
    # Of the uniform rod:
    stretch_ratio: wp.array(dtype=wp.float64)


@wp.func
def mixed(a: wp.float64, b: wp.float64, progress: wp.float64) -> wp.float64:
    return a + progress * (b - a)


@wp.func
def director(state: wp.array3d(dtype=wp.float64), r: int, j: int) -> wp.vec3d:
    """Of edge j."""
    return wp.vec3d(state[r, j, 3], state[r, j, 4], state[r, j, 5])


@wp.func
def before_contact(
    curvature: wp.float64, length: wp.float64, state: wp.array3d(dtype=wp.float64), r: int
) -> Stencil:
    """The contact's stencil as far as its ghost edge, which shares the first edge's roll."""
    s = Stencil()
    s.t = ghost_direction(half_turn(curvature, length))
    s.length_e = length
    first = wp.normalize(point(state, r, 1) - point(state, r, 0))
    s.m1e = parallel_transport(director(state, r, 0), first, s.t)
    s.m2e = wp.cross(s.t, s.m1e)
    return s


@wp.func
def put_second_derivatives(
    s: Stencil,
    q: Bending,
    twist: Twisting,
    stretching_after: wp.mat33d,
    spin: wp.vec3d,
    slot: int,
    j: int,
    # Out:
    stiffness: wp.array3d(dtype=wp.float64),
):
    """Of stencil j; the upper triangle by (te, e, tf, f), row by row. The edge after it spins by
    `spin` where it moves."""
    ie = ONE / s.length_e
    jf = ONE / s.length_f
    t_ee, t_ef, t_ff = twisting_hessian(s, twist)
    ee = (ie * ie) * q.ee + t_ee
    ef = (ie * jf) * q.ef + t_ef
    ff = (jf * jf) * q.ff + t_ff + stretching_after
    c = twist.stiffness
    e_te = ie * q.e_te - c * twist.e
    f_te = jf * q.f_te - c * twist.f
    e_tf = ie * q.e_tf + c * twist.e
    f_tf = jf * q.f_tf + c * twist.f
    te_tf = q.te_tf - c
    tf_tf = q.tf_tf + c
    ef += wp.outer(e_tf, spin)
    ff += wp.outer(f_tf, spin) + wp.outer(spin, f_tf + tf_tf * spin)
    f_te += te_tf * spin
    f_tf += tf_tf * spin
    stiffness[slot, j, 0] = q.te_te + c
    stiffness[slot, j, 4] = te_tf
    stiffness[slot, j, 26] = tf_tf
    at = int(8)
    for a in range(3):
        stiffness[slot, j, 1 + a] = e_te[a]
        stiffness[slot, j, 5 + a] = f_te[a]
        stiffness[slot, j, 27 + a] = f_tf[a]
        for d in range(a, 3):
            stiffness[slot, j, at] = ee[a, d]
            at += 1
        stiffness[slot, j, at] = e_tf[a]
        at += 1
        for d in range(3):
            stiffness[slot, j, at] = ef[a, d]
            at += 1
    at = int(30)
    for a in range(3):
        for d in range(a, 3):
            stiffness[slot, j, at] = ff[a, d]
            at += 1


@wp.func
def spin_at_grip(
    rod: GeneralRod, progress: wp.float64, state: wp.array3d(dtype=wp.float64), r: int, edges: int
) -> wp.vec3d:
    """c of `grip_torque`: the last edge's spin by its motion."""
    e = point(state, r, edges) - point(state, r, edges - 1)
    length = wp.length(e)
    m1 = director(state, r, edges - 1)
    m2 = wp.cross(e / length, m1)
    k = (progress * HALF * rod.rest[r, edges - 1] / length) * rod.natural_curvature[r, edges]
    return k[0] * m2 - k[1] * m1


@wp.func
def evaluate_general(
    rod: GeneralRod,
    progress: wp.float64,
    curvature: wp.float64,
    state: wp.array3d(dtype=wp.float64),
    r: int,
    slot: int,
    edges: int,
    # Out:
    stiffness: wp.array3d(dtype=wp.float64),
    load: wp.array3d(dtype=wp.float64),
) -> wp.float64:
    """Fill `stiffness` and `load` (see `kernels.linear.frontal`, blocks of 4); the largest
    unbalanced force or moment between contact and grip.

    `state` has the position of every node, and the director of the edge and the twist after it.
    """
    h = rod.rest[r, 0]
    s = before_contact(curvature, h, state, r)
    x = point(state, r, 0)
    before = wp.vec3d(ZERO, ZERO, ZERO)
    here = wp.vec3d(ZERO, ZERO, ZERO)
    moment = wp.float64(0.0)
    worst = wp.float64(0.0)
    uniform = wp.vec2d(ONE, ONE)
    for j in range(edges):
        y = point(state, r, j + 1)
        f = y - x
        s.length_f = wp.length(f)
        s.u = f / s.length_f
        s.m1f = director(state, r, j)
        s.m2f = wp.cross(s.u, s.m1f)
        g = rod.rest[r, j]
        rest = HALF * (h + g)
        b = uniform + progress * (rod.bending[r, j] - uniform)
        soft = rod.softening[r, j]
        soft = wp.vec2d(progress * soft[0], soft[1])
        q = bending(s, rest, b, progress * rod.natural_curvature[r, j], soft, b, 2)
        tau = wp.float64(0.0)
        if j > 0:
            tau = state[r, j, 6]
        twist = twisting(rod.twisting[r, j], progress * rod.natural_twist[r, j], rest, s, tau)
        k_s = mixed(rod.stretch_ratio[r], rod.stretching[r, j], progress)
        after = stretching(k_s, g, s.length_f, s.u)
        ie = ONE / s.length_e
        jf = ONE / s.length_f
        g_e = ie * q.g_e + twist.moment * twist.e
        g_f = jf * q.g_f + twist.moment * twist.f + after.gradient
        g_te = q.g_te - twist.moment
        g_tf = q.g_tf + twist.moment
        spin = wp.vec3d(ZERO, ZERO, ZERO)
        if j == edges - 1:
            spin = spin_at_grip(rod, progress, state, r, edges)
            g_f += g_tf * spin
        put_second_derivatives(s, q, twist, after.hessian, spin, slot, j, stiffness)
        # Loads; those of the node before are complete.
        before = before - g_e
        m = moment + g_te
        for a in range(3):
            load[slot, wp.max(j - 1, 0), 1 + a] = before[a]
        load[slot, j, 0] = m
        if j > 1:
            worst = worse(worst, before)
        if j > 0:
            worst = worse(worst, wp.vec3d(m, ZERO, ZERO))
        before = here + g_e - g_f + wp.vec3d(ZERO, ZERO, weight_of(rod, r, j, h, g, progress))
        here = g_f
        moment = g_tf
        s.t = s.u
        s.length_e = s.length_f
        s.m1e = s.m1f
        s.m2e = s.m2f
        h = g
        x = y
    worst = worse(worst, before)
    here = here + wp.vec3d(ZERO, ZERO, weight_of(rod, r, edges, h, ZERO, progress))
    for a in range(3):
        load[slot, edges - 1, 1 + a] = before[a]
        load[slot, edges, 1 + a] = here[a]
    load[slot, edges, 0] = moment
    return worst


@wp.func
def weight_of(
    rod: GeneralRod,
    r: int,
    i: int,
    before: wp.float64,
    after: wp.float64,
    progress: wp.float64,
) -> wp.float64:
    """Of node i, between edges of these rest lengths."""
    return mixed(HALF * WEIGHT * (before + after), rod.weight[r, i], progress)


@wp.func
def advance_general(
    state: wp.array3d(dtype=wp.float64),
    motion: wp.array3d(dtype=wp.float64),
    r: int,
    slot: int,
    edges: int,
    fraction: wp.float64,
):
    """Move the nodes; carry the directors to their edges' new tangents and turn them."""
    x = point(state, r, 0)
    new_x = wp.vec3d(x)
    u_before = wp.vec3d(ONE, ZERO, ZERO)
    m_before = wp.vec3d(ZERO, ZERO, ONE)
    turned_before = wp.float64(0.0)
    for j in range(edges):
        y = point(state, r, j + 1)
        d = wp.vec3d(motion[slot, j + 1, 1], motion[slot, j + 1, 2], motion[slot, j + 1, 3])
        new_y = y + fraction * d
        t = wp.normalize(y - x)
        u = wp.normalize(new_y - new_x)
        # The angle of the edge that leads to the first free node is held.
        turned = wp.float64(0.0)
        if j > 0:
            turned = fraction * motion[slot, j + 1, 0]
        m = parallel_transport(director(state, r, j), t, u)
        m = wp.normalize(m - wp.dot(m, u) * u)
        m = rotate(m, u, turned)
        for c in range(3):
            state[r, j, 3 + c] = m[c]
            state[r, j + 1, c] = new_y[c]
        if j > 0:
            near = state[r, j, 6] + turned - turned_before
            twist = signed_angle(parallel_transport(m_before, u_before, u), m, u)
            state[r, j, 6] = twist + TURN * wp.rint((near - twist) / TURN)
        x = y
        new_x = new_y
        u_before = u
        m_before = m
        turned_before = turned


@wp.kernel
def start_general(
    # In:
    edges: int,
    shape: wp.array3d(dtype=wp.float64),
    roll: wp.array(dtype=wp.float64),
    family: wp.array2d(dtype=wp.float64),
    # Out:
    state_out: wp.array3d(dtype=wp.float64),
    family_out: wp.array2d(dtype=wp.float64),
):
    """An untwisted rod in the shape of a straight one; its first director stands `roll` from up,
    about the tangent."""
    r = wp.tid()
    t = wp.normalize(point(shape, r, 1) - point(shape, r, 0))
    m = rotate(wp.vec3d(ZERO, ZERO, ONE), t, roll[r])
    for j in range(edges + 1):
        x = point(shape, r, j)
        u = t
        if j < edges:
            u = wp.normalize(point(shape, r, j + 1) - x)
        m = parallel_transport(m, t, u)
        m = wp.normalize(m - wp.dot(m, u) * u)
        t = u
        for c in range(3):
            state_out[r, j, c] = x[c]
            state_out[r, j, 3 + c] = m[c]
        state_out[r, j, 6] = ZERO
    # Beside the grip's position there is the roll.
    family_out[r, 1] = ZERO
    family_out[r, 0] = family[r, 0]
    for c in range(1, 6):
        family_out[r, c + 1] = family[r, c]


@wp.kernel
def interpolate_shape(
    # In:
    source_edges: int,
    source_rest: wp.array2d(dtype=wp.float64),
    source: wp.array3d(dtype=wp.float64),
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    # Out:
    shape_out: wp.array3d(dtype=wp.float64),
):
    """Shapes at the nodes of another mesh, by cubics through four neighbours in arc length."""
    r = wp.tid()
    s = wp.float64(0.0)
    first = int(0)
    start = wp.float64(0.0)  # arc length of node `first`
    for i in range(edges + 1):
        while (
            first + 4 <= source_edges
            and start + source_rest[r, first] + source_rest[r, first + 1] < s
        ):
            start += source_rest[r, first]
            first += 1
        a = wp.vec4d(start, ZERO, ZERO, ZERO)
        for k in range(1, 4):
            a[k] = a[k - 1] + source_rest[r, first + k - 1]
        value = wp.vec3d(ZERO, ZERO, ZERO)
        for k in range(4):
            share = wp.float64(1.0)
            for o in range(4):
                if o != k:
                    share = share * (s - a[o]) / (a[k] - a[o])
            value += share * point(source, r, first + k)
        for c in range(3):
            shape_out[r, i, c] = value[c]
        if i < edges:
            s += rest[r, i]
    length = wp.length(point(shape_out, r, 1))
    put_point(shape_out, r, 1, length * first_direction(half_turn(curvature[r], rest[r, 0])))
