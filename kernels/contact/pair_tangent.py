"""How a touching pair of pieces follows what it is made of, exactly: for the adjoint of its steps.

Of a change of one of the numbers that a pair depends on (`Way`), what changes is followed forwards,
through closest points, normal, motion of the surfaces, normal force and bristle
(`wrod.kernels.contact.pair_contact`), to what pushes and turns each piece. Whether a pair touches,
where closest points are free, and whether friction holds or slides counts as it is.
"""

import warp as wp
from wrod.kernels.contact.law import normal_force
from wrod.kernels.contact.pair_contact import PairLaw, spin_share
from wrod.kernels.contact.pair_sides import Piece, Side, TouchingPair, across
from wrod.kernels.contact.segments import (
    EDGE,
    piece_bends,
    piece_chord,
    piece_slopes,
    piece_weights,
    share_of_angle,
    turning,
)
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO


@wp.struct
class Way:
    """Changes of one piece's nodes (columns) at the end of a step and at its start, of how far its
    edge and the next turn in it, of the logarithm of its radius, and of its small terms."""

    now: wp.mat33d
    before: wp.mat33d
    spin: wp.vec2d
    radius: wp.float64
    rounding: wp.float64


@wp.struct
class LawWay:
    """Changes of the bristle before, and of logarithms: of stiffness, of the relaxation time, and
    of the mean radius, with which depths go over which forces rise."""

    bristle: wp.vec2d
    stiffness: wp.float64
    relaxation: wp.float64
    size: wp.float64


@wp.struct
class Follow:
    """How what each side feels follows a change, where the points of contact go along the pieces,
    and how the bristle after the step does."""

    first: Side
    second: Side
    ds: wp.float64
    dt: wp.float64
    bristle: wp.vec2d


@wp.struct
class Guided:
    """A direction and how it changes."""

    way: wp.vec3d
    change: wp.vec3d


@wp.func
def guide(t: wp.vec3d, dt: wp.vec3d, n: wp.vec3d, dn: wp.vec3d) -> Guided:
    """`wrod.kernels.contact.pair_contact.first_tangent` of a direction t."""
    v = t
    dv = dt
    if wp.length(across(t, n)) < wp.float64(1.0e-6):
        v = wp.vec3d(n[1], n[2], n[0])
        dv = wp.vec3d(dn[1], dn[2], dn[0])
    e = across(v, n)
    de = across(dv, n) - wp.dot(v, dn) * n - wp.dot(v, n) * dn
    out = Guided()
    out.way = wp.normalize(e)
    out.change = across(de, out.way) / wp.length(e)
    return out


@wp.func
def follow_tangent(nodes: wp.mat33d, change: wp.mat33d, p: Piece, ds: wp.float64) -> Guided:
    """Unit tangent of a piece at its point of contact."""
    slope = piece_slopes(p.kind, p.s)
    e = nodes * slope
    out = Guided()
    out.way = wp.normalize(e)
    de = change * slope + ds * (nodes * piece_bends(p.kind))
    out.change = across(de, out.way) / wp.length(e)
    return out


@wp.func
def follow_motion(p: Piece, w: Way, ds: wp.float64, n: wp.vec3d, dn: wp.vec3d) -> wp.vec3d:
    """Of `wrod.kernels.contact.pair_contact.surface_motion`."""
    after = follow_tangent(p.now, w.now, p, ds)
    before = follow_tangent(p.before, w.before, p, ds)
    t = after.way
    dt = after.change
    turn = t - before.way
    dturn = dt - before.change
    share = spin_share(p.kind, p.s)
    spin = (ONE - share) * p.spin[0] + share * p.spin[1]
    dspin = (ONE - share) * w.spin[0] + share * w.spin[1]
    if p.kind != EDGE:
        dspin += ds * (p.spin[1] - p.spin[0])
    swing = wp.dot(t, n) * turn - wp.dot(n, turn) * t + spin * wp.cross(t, n)
    dswing = (wp.dot(dt, n) + wp.dot(t, dn)) * turn + wp.dot(t, n) * dturn
    dswing = dswing - (wp.dot(dn, turn) + wp.dot(n, dturn)) * t - wp.dot(n, turn) * dt
    dswing = dswing + dspin * wp.cross(t, n) + spin * (wp.cross(dt, n) + wp.cross(t, dn))
    out = (w.now - w.before) * piece_weights(p.kind, p.s)
    out = out + ds * ((p.now - p.before) * piece_slopes(p.kind, p.s))
    return out + (w.radius * p.arm) * swing + p.arm * dswing


@wp.func
def follow_side(
    p: Piece, w: Way, ds: wp.float64, n: wp.vec3d, dn: wp.vec3d, pull: wp.vec3d, dpull: wp.vec3d
) -> Side:
    """Of `what_it_feels`, but for the force and what turns the chord."""
    out = Side()
    slope = piece_slopes(p.kind, p.s)
    e = p.now * slope
    length = wp.length(e)
    tangent = follow_tangent(p.now, w.now, p, ds)
    t = tangent.way
    dt = tangent.change
    stretch = wp.dot(t, w.now * slope + ds * (p.now * piece_bends(p.kind))) / length
    arm = p.arm / length
    v = wp.dot(t, n) * pull - wp.dot(t, pull) * n
    dv = (wp.dot(dt, n) + wp.dot(t, dn)) * pull + wp.dot(t, n) * dpull
    dv = dv - (wp.dot(dt, pull) + wp.dot(t, dpull)) * n - wp.dot(t, pull) * dn
    out.lever = ((w.radius - stretch) * arm) * across(v, t)
    out.lever = out.lever + arm * (across(dv, t) - wp.dot(t, v) * dt - wp.dot(dt, v) * t)
    side = wp.cross(t, n)
    out.spin = w.radius * p.arm * wp.dot(side, pull) + p.arm * wp.dot(side, dpull)
    out.spin += p.arm * wp.dot(wp.cross(dt, n) + wp.cross(t, dn), pull)
    return out


@wp.func
def follow_force(
    depth: wp.float64, change: wp.float64, closing: wp.float64, faster: wp.float64,
    lag: wp.float64, longer: wp.float64, stiffness: wp.float64, skin: wp.float64,
    wider: wp.float64,
) -> wp.float64:  # fmt: skip
    """Of `wrod.kernels.contact.law.damped_force`; `longer` and `wider` are of logarithms."""
    x = depth + lag * wp.min(closing, depth)
    dx = change + lag * wp.where(closing < depth, faster, change)
    dx += longer * lag * wp.min(closing, depth)
    law = normal_force(x, stiffness, skin)
    thick = -law[0]
    if x > skin:
        thick = -HALF * stiffness * skin
    return law[1] * dx + wider * thick


@wp.func
def follow_repulsion(
    law: PairLaw, dt: wp.float64, depth: wp.float64, change: wp.float64, closing: wp.float64,
    faster: wp.float64, force: wp.float64, w: LawWay,
) -> wp.float64:  # fmt: skip
    """Of `wrod.kernels.contact.pair_contact.repulsion`."""
    lag = law.relaxation / dt
    out = follow_force(
        depth, change, closing, faster, lag, w.relaxation, law.stiffness, law.skin, w.size
    )
    if law.hardening > ZERO:
        out += follow_force(
            depth - law.hard_depth, change - w.size * law.hard_depth, closing, faster,
            lag / law.hardening, w.relaxation, law.hardening * law.stiffness, law.hard_skin, w.size,
        )  # fmt: skip
    return out + w.stiffness * force


@wp.struct
class Closer:
    """How a pair's closest points follow: along the pieces, their gap, distance, the chords, and
    the small terms."""

    ds: wp.float64
    dt: wp.float64
    gap: wp.vec3d
    distance: wp.float64
    first_chord: wp.vec3d
    second_chord: wp.vec3d
    small: wp.float64


@wp.func
def follow_nearest(t: TouchingPair, a: Way, b: Way) -> Closer:
    out = Closer()
    near = t.pair.near
    out.first_chord = a.now * piece_chord(t.first.kind)
    out.second_chord = b.now * piece_chord(t.second.kind)
    share = wp.dot(near.first_turn, out.first_chord) + wp.dot(near.second_turn, out.second_chord)
    gap = a.now * near.first_weight - b.now * near.second_weight
    u = near.s - HALF
    v = near.t - HALF
    along = share_of_angle(near.first_chord, near.second_chord)
    rounding = a.rounding * u * u + b.rounding * v * v
    out.distance = wp.dot(near.gap, gap) + share * near.small + HALF * along * rounding
    out.distance = out.distance / near.distance
    gs = wp.dot(gap, near.first) + wp.dot(near.gap, a.now * near.first_slope)
    gs += TWO * share * near.small_s + along * a.rounding * u
    gt = -wp.dot(gap, near.second) - wp.dot(near.gap, b.now * near.second_slope)
    gt += TWO * share * near.small_t + along * b.rounding * v
    st = -wp.dot(near.first, near.second)
    if near.free_s > ZERO and near.free_t > ZERO:
        det = near.ss * near.tt - st * st
        out.ds = -(gs * near.tt - gt * st) / det
        out.dt = -(gt * near.ss - gs * st) / det
    elif near.free_s > ZERO:
        out.ds = -gs / near.ss
    elif near.free_t > ZERO:
        out.dt = -gt / near.tt
    out.gap = gap + out.ds * near.first - out.dt * near.second
    out.small = TWO * (near.small_s * out.ds + near.small_t * out.dt) + rounding
    return out


@wp.func(inline=False)
def follow_pair(t: TouchingPair, a: Way, b: Way, w: LawWay) -> Follow:
    """How a pair follows a change of its first piece, of its second and of its law."""
    out = Follow()
    c = t.pair
    near = c.near
    n = c.normal
    closer = follow_nearest(t, a, b)
    out.ds = closer.ds
    out.dt = closer.dt
    dn = across(closer.gap, n) / wp.length(near.gap)
    motion = follow_motion(t.first, a, out.ds, n, dn) - follow_motion(t.second, b, out.dt, n, dn)
    depth = wp.abs(t.first.arm) * a.radius + wp.abs(t.second.arm) * b.radius - closer.distance
    closing = -wp.dot(motion, n) - wp.dot(t.motion, dn)
    force = follow_repulsion(t.law, t.dt, t.depth, depth, -wp.dot(t.motion, n), closing, c.force, w)
    tangent = follow_tangent(t.first.now, a.now, t.first, out.ds)
    along = guide(tangent.way, tangent.change, n, dn)
    e = along.way
    f = wp.cross(n, e)
    df = wp.cross(dn, e) + wp.cross(n, along.change)
    x = c.stretched[0]
    y = c.stretched[1]
    dx = w.bristle[0] + wp.dot(motion, e) + wp.dot(t.motion, along.change)
    dy = w.bristle[1] + wp.dot(motion, f) + wp.dot(t.motion, df)
    size = wp.sqrt(x * x + y * y)
    shrink = ONE
    dshrink = ZERO
    if size > t.limit:
        shrink = t.limit / size
        dlimit = ZERO
        if t.slides != 0:
            dlimit = t.limit * (force / c.force - w.stiffness)
        dshrink = (dlimit - shrink * (x * dx + y * dy) / size) / size
    x1 = shrink * dx + dshrink * x
    y1 = shrink * dy + dshrink * y
    out.bristle = wp.vec2d(x1, y1)
    pull = x1 * e + y1 * f + shrink * (x * along.change + y * df)
    pull = t.law.tangential * pull + w.stiffness * c.pull
    pressure = -c.force / near.distance
    dpressure = (-force + c.force * closer.distance / near.distance) / near.distance
    push = dpressure * near.gap + pressure * closer.gap
    out.first = follow_side(t.first, a, out.ds, n, dn, c.pull, pull)
    out.second = follow_side(t.second, b, out.dt, n, dn, -c.pull, -pull)
    out.first.force = push + pull
    out.second.force = -push - pull
    turn = dpressure * near.small + pressure * closer.small
    turned = pressure * near.small
    u = near.first_chord
    v = near.second_chord
    du = closer.first_chord
    dv = closer.second_chord
    out.first.turn = turn * near.first_turn + turned * (turning(u, v, False) * du)
    out.first.turn = out.first.turn + turned * (turning(u, v, True) * dv)
    out.second.turn = turn * near.second_turn + turned * (turning(v, u, False) * dv)
    out.second.turn = out.second.turn + turned * (turning(v, u, True) * du)
    return out
