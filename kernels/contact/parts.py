"""Where an edge comes nearest to a part of a mesh: a triangle, a side or a corner of one.

They are convex, so that the smoothed distance D(s) of `wrod.kernels.contact.closest` is, and its
tangent at any s bounds it from below: what that keeps out of reach is known to be after one look,
as most parts are.
"""

import warp as wp
from wrod.kernels.contact.closest import SEARCHES, Closest, slope_along
from wrod.kernels.contact.solids import Surface, on_segment, triangle_surface
from wrod.kernels.elastic.frames import HALF, ONE, ZERO

wp.set_module_options({"max_unroll": 1})

# Parts of a triangle by number: itself, its sides, its corners.
CORNERS = wp.constant(4)
PARTS = wp.constant(7)
# Sides that are this near to the edge's direction, by the sine's square, have no crossing with it.
PARALLEL = wp.constant(wp.float64(1.0e-12))


@wp.struct
class Part:
    """Part k of a triangle a b c of a mesh within `size` of its origin; a side goes from a to b, a
    corner is a."""

    k: int
    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d
    size: wp.float64


@wp.func
def part_of(k: int, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, size: wp.float64) -> Part:
    out = Part()
    out.k = k
    out.size = size
    out.a = a
    out.b = b
    out.c = c
    turns = wp.where(k < CORNERS, wp.max(k - 1, 0), k - CORNERS)
    if turns == 1:
        out.a = b
        out.b = c
        out.c = a
    if turns == 2:
        out.a = c
        out.b = a
        out.c = b
    return out


@wp.func(inline=False)
def part_surface(part: Part, p: wp.vec3d) -> Surface:
    """Distance of a point, the direction to it, and how that bends."""
    if part.k == 0:
        return triangle_surface(p, part.a, part.b, part.c, ZERO, part.size)
    s = Surface()
    e = part.b - part.a
    f = wp.float64(0.0)
    if part.k < CORNERS:
        f = on_segment(p, part.a, part.b)
    way = p - part.a - f * e
    s.distance = wp.length(way)
    if s.distance > wp.float64(1.0e-9) * part.size:
        n = way / s.distance
        across = wp.identity(3, dtype=wp.float64) - wp.outer(n, n)
        if f > ZERO and f < ONE:
            across = across - wp.outer(e, e) / wp.dot(e, e)
        s.normal = n
        s.bend = across / s.distance
    return s


@wp.func
def first_guess(part: Part, q: wp.vec3d, e: wp.vec3d) -> wp.float64:
    """Where the edge's line is nearest to a corner or a side's line."""
    w = part.a - q
    ee = wp.dot(e, e)
    along = wp.dot(e, w)
    if part.k == 0:
        return HALF
    if part.k < CORNERS:
        u = part.b - part.a
        uu = wp.dot(u, u)
        eu = wp.dot(e, u)
        apart = ee * uu - eu * eu
        if apart <= PARALLEL * ee * uu:
            return HALF
        return wp.clamp((along * uu - wp.dot(u, w) * eu) / apart, ZERO, ONE)
    return wp.clamp(along / wp.max(ee, wp.float64(1.0e-300)), ZERO, ONE)


@wp.func
def nearest_on_edge(
    part: Part, q: wp.vec3d, e: wp.vec3d, c: wp.float64, reach: wp.float64
) -> Closest:  # fmt: skip
    """Of the edge from q to q + e; of parts out of `reach` the distance alone, as that."""
    out = Closest()
    low = wp.float64(0.0)
    high = wp.float64(1.0)
    at_low = bool(False)
    at_high = bool(False)
    s = first_guess(part, q, e)
    for k in range(SEARCHES):
        found = part_surface(part, q + s * e)
        slope = slope_along(found, e, c, s)
        out.s = s
        out.distance = found.distance + HALF * c * (s - HALF) * (s - HALF)
        out.normal = found.normal
        out.bend = found.bend
        least = wp.float64(out.distance)
        if slope > ZERO:
            least -= slope * (s - low)
            high = s
        else:
            least += slope * (high - s)
            low = s
        if least >= reach:
            out.distance = reach
            return out
        if (s == ZERO and slope >= ZERO) or (s == ONE and slope <= ZERO):
            return out
        step = slope / (wp.dot(e, found.bend * e) + c)
        if wp.abs(step) < wp.float64(1.0e-14):
            break
        next = s - step
        if next <= low and low == ZERO and not at_low:
            next = ZERO
            at_low = True
        elif next >= high and high == ONE and not at_high:
            next = ONE
            at_high = True
        elif next <= low or next >= high or k >= SEARCHES // 3:
            next = HALF * (low + high)
        s = next
    out.free = ONE
    return out
