"""Closest points of two segments, smooth also where they are parallel.

Between p = q_0 + s (q_1 - q_0) and p' = q_2 + t (q_3 - q_2) the distance is taken as D = sqrt(m),

    m = min over s, t in [0, 1] of |p - p'|^2 + c^32 (rho (s - 1/2)^2 + rho' (t - 1/2)^2).

The small terms rho make the minimum unique, so that s and t move continuously and D has a
continuous gradient while one segment turns past parallel to the other; plain closest points jump
from end to end there. They are corners where segments meet in line, and make D too large: by up to
h^2 / (400 D) with rho = 0.01 h^2 for edges of h. So they fade with the angle between the segments,
by the 32nd power of the square c of its cosine (to a half at 0.15, a hundredth at 0.37), where
closest points are unique without them: nothing holds what crosses and slides, nor lets it sink in,
and parallel ones keep them whole. By the envelope theorem the gradient of m is that at fixed s and
t.

Edges meet in corners, and a load in the middle of an edge bends a rod less than one at a node: both
hold what should slide along a rod. Pieces of a quadratic B-spline, whose control points are the
nodes, meet tangent-continuously, and the second moment of their weights is the same all along. A
piece reaches from the middle of an edge to that of the next; the angle is that of their chords.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO

SMOOTHING = wp.constant(wp.float64(0.01))
POWER = wp.constant(wp.float64(32.0))

# Kinds of pieces: an edge, or three nodes of a spline, of which the first or last may end it.
EDGE = wp.constant(0)
SPLINE = wp.constant(4)
AT_START = wp.constant(1)
AT_END = wp.constant(2)
_MOST_TURNS = wp.constant(100)
# Times what was: no more than rounding.
_ROUNDED = wp.constant(wp.float64(1.0 + 1.0e-14))


@wp.struct
class Nearest:
    """Closest points: fractions s, t, which of them are free (1) or at an end (0), the vector
    `gap` from the second point to the first, the smoothed distance, and the derivatives `first`,
    `second` of the points by s and t. Also the weights of the points' nodes, their derivatives, the
    diagonal of the matrix of the minimum, the pieces' chords, by what half the share of
    their angle follows each, and what it multiplies: the small terms, and their half derivatives
    by s and t."""

    s: wp.float64
    t: wp.float64
    free_s: wp.float64
    free_t: wp.float64
    gap: wp.vec3d
    distance: wp.float64
    first: wp.vec3d
    second: wp.vec3d
    first_weight: wp.vec3d
    second_weight: wp.vec3d
    first_slope: wp.vec3d
    second_slope: wp.vec3d
    ss: wp.float64
    tt: wp.float64
    first_chord: wp.vec3d
    second_chord: wp.vec3d
    first_turn: wp.vec3d
    second_turn: wp.vec3d
    small: wp.float64
    small_s: wp.float64
    small_t: wp.float64


@wp.func
def half_slope(e: wp.vec3d, f: wp.vec3d) -> wp.vec3d:
    """Half the derivative by e of the squared cosine c between e and f."""
    ef = wp.dot(e, f)
    ee = wp.dot(e, e)
    return (ef / (ee * wp.dot(f, f))) * (f - (ef / ee) * e)


@wp.func
def squared_cosine(e: wp.vec3d, f: wp.vec3d) -> wp.float64:
    ef = wp.dot(e, f)
    return ef * ef / (wp.dot(e, e) * wp.dot(f, f))


@wp.func
def eighth_power(c: wp.float64) -> wp.float64:
    c2 = c * c
    return c2 * c2 * c2 * c2


@wp.func
def share_of_angle(e: wp.vec3d, f: wp.vec3d) -> wp.float64:
    """c^32: what pieces at an angle keep of the small terms."""
    c8 = eighth_power(squared_cosine(e, f))
    return c8 * c8 * c8 * c8


@wp.func
def add_small_terms(
    near: Nearest, e: wp.vec3d, f: wp.vec3d, rho_first: wp.float64, rho_second: wp.float64
) -> Nearest:
    """Distance of points that lie `gap` apart, and what it has of the chords e, f."""
    out = near
    c = squared_cosine(e, f)
    c8 = eighth_power(c)
    rate = POWER * c8 * c8 * c8 * c * c * c * c * c * c * c
    out.first_chord = e
    out.second_chord = f
    out.first_turn = rate * half_slope(e, f)
    out.second_turn = rate * half_slope(f, e)
    out.small_s = rho_first * (near.s - HALF)
    out.small_t = rho_second * (near.t - HALF)
    out.small = out.small_s * (near.s - HALF) + out.small_t * (near.t - HALF)
    out.distance = wp.sqrt(wp.dot(near.gap, near.gap) + share_of_angle(e, f) * out.small)
    return out


@wp.func
def turning(e: wp.vec3d, f: wp.vec3d, other: bool) -> wp.mat33d:
    """How the derivative of half the share by e follows e, or the other."""
    ee = wp.dot(e, e)
    ff = wp.dot(f, f)
    u = wp.dot(e, f) / ee
    v = wp.dot(e, f) / ff
    c = u * v
    c8 = eighth_power(c)
    rate = POWER * c8 * c8 * c8 * c * c * c * c * c * c
    g = half_slope(e, f)
    eye = wp.identity(3, dtype=wp.float64)
    if other:
        out = wp.outer(f, e) + (u * ee) * eye - TWO * v * wp.outer(f, f)
        out = (out - TWO * u * wp.outer(e, e - v * f)) / (ee * ff)
        bend = wp.outer(g, half_slope(f, e))
    else:
        out = wp.outer(f, f) - TWO * u * (wp.outer(f, e) + wp.outer(e, f))
        out = (out + wp.float64(4.0) * u * u * wp.outer(e, e) - (u * u * ee) * eye) / (ee * ff)
        bend = wp.outer(g, g)
    return rate * (c * out + TWO * (POWER - ONE) * bend)


@wp.func
def nearest(
    q0: wp.vec3d,
    q1: wp.vec3d,
    q2: wp.vec3d,
    q3: wp.vec3d,
    rho_first: wp.float64,
    rho_second: wp.float64,
) -> Nearest:
    out = Nearest()
    e = q1 - q0
    f = q3 - q2
    c = q0 - q2
    first = wp.dot(e, e)
    second = wp.dot(f, f)
    ef = wp.dot(e, f)
    along = share_of_angle(e, f)
    rho_s = along * rho_first
    rho_t = along * rho_second
    ee = first + rho_s
    ff = second + rho_t
    u = HALF * rho_s - wp.dot(c, e)
    v = HALF * rho_t + wp.dot(c, f)
    det = ee * ff - ef * ef
    s = (u * ff + v * ef) / det
    t = (v * ee + u * ef) / det
    if s <= ZERO or s >= ONE or t <= ZERO or t >= ONE:
        # The minimum of a convex function over the square is on its border: the best of four sides.
        best = wp.float64(1.0e300)
        for side in range(4):
            x = wp.float64(side % 2)
            y = wp.clamp((v + x * ef) / ff, ZERO, ONE)
            if side >= 2:
                y = x
                x = wp.clamp((u + y * ef) / ee, ZERO, ONE)
            value = ee * x * x - TWO * ef * x * y + ff * y * y - TWO * (u * x + v * y)
            if value < best:
                best = value
                s = x
                t = y
    out.s = s
    out.t = t
    out.free_s = wp.where(s > ZERO and s < ONE, ONE, ZERO)
    out.free_t = wp.where(t > ZERO and t < ONE, ONE, ZERO)
    out.gap = c + s * e - t * f
    out.first = e
    out.second = f
    out.first_weight = wp.vec3d(ONE - s, s, ZERO)
    out.second_weight = wp.vec3d(ONE - t, t, ZERO)
    out.first_slope = wp.vec3d(-ONE, ONE, ZERO)
    out.second_slope = wp.vec3d(-ONE, ONE, ZERO)
    out.ss = ee
    out.tt = ff
    return add_small_terms(out, e, f, rho_first, rho_second)


@wp.func
def piece_size(kind: int) -> int:
    """How many nodes a piece has."""
    return wp.where(kind == EDGE, 2, 3)


@wp.func
def piece_bends(kind: int) -> wp.vec3d:
    """Second derivatives of the weights."""
    if kind == EDGE:
        return wp.vec3d(ZERO, ZERO, ZERO)
    a = wp.where(kind & AT_START, TWO, ONE)
    b = wp.where(kind & AT_END, TWO, ONE)
    return wp.vec3d(a, -a - b, b)


@wp.func
def piece_weights(kind: int, s: wp.float64) -> wp.vec3d:
    """Weights of a piece's nodes at s."""
    if kind == EDGE:
        return wp.vec3d(ONE - s, s, ZERO)
    bends = piece_bends(kind)
    a = HALF * bends[0] * (ONE - s) * (ONE - s)
    b = HALF * bends[2] * s * s
    return wp.vec3d(a, ONE - a - b, b)


@wp.func
def piece_slopes(kind: int, s: wp.float64) -> wp.vec3d:
    """Derivatives of `piece_weights` by s."""
    if kind == EDGE:
        return wp.vec3d(-ONE, ONE, ZERO)
    bends = piece_bends(kind)
    a = bends[0] * (s - ONE)
    b = bends[2] * s
    return wp.vec3d(a, -a - b, b)


@wp.func
def piece_chord(kind: int) -> wp.vec3d:
    """Weights of the end less those of the beginning."""
    return piece_weights(kind, ONE) - piece_weights(kind, ZERO)


@wp.func
def onto_border(x: wp.float64) -> wp.float64:
    """What rounding leaves beside an end of [0, 1] is at that end: next to it a turn would be cut
    off at once, and the other coordinate with it."""
    near = wp.float64(1.0e-14)
    return wp.where(x < near, ZERO, wp.where(x > ONE - near, ONE, x))


@wp.func
def leaves(x: wp.float64, dx: wp.float64) -> bool:
    """Whether what is at an end of [0, 1] goes out of it."""
    return (x <= ZERO and dx < ZERO) or (x >= ONE and dx > ZERO)


@wp.func
def newton_turn(
    s: wp.float64, t: wp.float64, gs: wp.float64, gt: wp.float64, ss: wp.float64, st: wp.float64,
    tt: wp.float64, straight_ss: wp.float64, straight_tt: wp.float64,
) -> wp.vec2d:  # fmt: skip
    """Where Newton's method goes from (s, t) within the unit square, one edge of it at a time.

    Where its matrix leads to no minimum, that of straight pieces does, which is never indefinite.
    """
    a = ss
    b = tt
    if a * b - st * st < wp.float64(1.0e-3) * a * b:
        a = straight_ss
        b = straight_tt
    det = a * b - st * st
    # No more than half of what each would go alone, where they hardly determine each other.
    ds = -HALF * gs / a
    dt = -HALF * gt / b
    if det > wp.float64(1.0e-6) * a * b:
        ds = -(gs * b - gt * st) / det
        dt = -(gt * a - gs * st) / det
    held_s = leaves(s, -gs)
    held_t = leaves(t, -gt)
    if not (held_s or held_t):
        held_s = leaves(s, ds)
        held_t = leaves(t, dt) and not held_s
    if held_s or held_t:
        ds = wp.where(held_s, ZERO, -gs / ss)
        dt = wp.where(held_t, ZERO, -gt / tt)
    # Where one of them meets its end on the way, the other goes on from there in the next turn.
    way = wp.float64(1.0)
    if s + ds > ONE:
        way = wp.min(way, (ONE - s) / ds)
    if s + ds < ZERO:
        way = wp.min(way, -s / ds)
    if t + dt > ONE:
        way = wp.min(way, (ONE - t) / dt)
    if t + dt < ZERO:
        way = wp.min(way, -t / dt)
    return wp.vec2d(onto_border(s + way * ds), onto_border(t + way * dt))


@wp.func
def nearest_of_pieces(
    p: wp.mat33d,
    q: wp.mat33d,
    first_kind: int,
    second_kind: int,
    rho_first: wp.float64,
    rho_second: wp.float64,
) -> Nearest:
    """Closest points of two pieces, whose nodes are the columns of p and q, by Newton's method from
    those of their chords."""
    out = nearest(
        p * piece_weights(first_kind, ZERO), p * piece_weights(first_kind, ONE),
        q * piece_weights(second_kind, ZERO), q * piece_weights(second_kind, ONE),
        rho_first, rho_second,
    )  # fmt: skip
    e = p * piece_chord(first_kind)
    f = q * piece_chord(second_kind)
    along = share_of_angle(e, f)
    rho_s = along * rho_first
    rho_t = along * rho_second
    bend_p = p * piece_bends(first_kind)
    bend_q = q * piece_bends(second_kind)
    s = onto_border(out.s)
    t = onto_border(out.t)
    from_here = wp.vec2d(s, t)
    least = wp.float64(1.0e300)
    change = wp.float64(1.0)
    turn = int(0)
    while change > wp.float64(1.0e-15) and turn < _MOST_TURNS:
        turn += 1
        out.first_weight = piece_weights(first_kind, s)
        out.second_weight = piece_weights(second_kind, t)
        out.first_slope = piece_slopes(first_kind, s)
        out.second_slope = piece_slopes(second_kind, t)
        out.gap = p * out.first_weight - q * out.second_weight
        out.first = p * out.first_slope
        out.second = q * out.second_slope
        out.s = s
        out.t = t
        a = s - HALF
        b = t - HALF
        value = wp.dot(out.gap, out.gap) + rho_s * a * a + rho_t * b * b
        gs = wp.dot(out.gap, out.first) + rho_s * a
        gt = -wp.dot(out.gap, out.second) + rho_t * b
        ss = wp.dot(out.first, out.first)
        tt = wp.dot(out.second, out.second)
        # What wraps around the other curve may lie all along at the same distance, or less.
        out.ss = wp.max(ss + wp.dot(out.gap, bend_p) + rho_s, wp.float64(0.001) * ss)
        out.tt = wp.max(tt - wp.dot(out.gap, bend_q) + rho_t, wp.float64(0.001) * tt)
        st = -wp.dot(out.first, out.second)
        there = newton_turn(s, t, gs, gt, out.ss, st, out.tt, ss + rho_s, tt + rho_t)
        if value > _ROUNDED * least:
            # Newton's method went too far.
            there = HALF * (from_here + wp.vec2d(s, t))
            change = wp.abs(there[0] - from_here[0]) + wp.abs(there[1] - from_here[1])
        else:
            least = value
            from_here = wp.vec2d(s, t)
            change = wp.abs(there[0] - s) + wp.abs(there[1] - t)
        s = there[0]
        t = there[1]
    out.free_s = wp.where(out.s > ZERO and out.s < ONE, ONE, ZERO)
    out.free_t = wp.where(out.t > ZERO and out.t < ONE, ONE, ZERO)
    return add_small_terms(out, e, f, rho_first, rho_second)
