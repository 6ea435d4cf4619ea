"""The gap between an edge and a solid, with its derivatives.

Of a convex solid it is the smoothed distance D of `wrod.kernels.contact.closest`, with the gradient
of the solid's at fixed s (the envelope theorem). With J = ((1 - s) 1, s 1) and
v = J^T d'' e + (-n, n),

    D'' = J^T d'' J - v v^T / D_ss,    ds = -(v, s - 1/2) / D_ss    by the nodes and by c.

A mesh with hollows has no such unique place: an edge across a fold comes down on both sides, and a
distance that is the least of some has a kink wherever two are equal, in which no force of a single
one is in balance. There the gap is a soft minimum over the triangles f within reach,

    D = -w log sum_f a_f exp(-D_f / w),    w = 0.01 r,

of the radius r. What triangles share would count twice: so each takes half of its sides off again,
which it shares with one other, and adds to that its corners, each by its angle over 2 pi
(inclusion and exclusion; of penalties: Li et al., Convergent Incremental Potential Contact, 2023).
On a flat or convex part of a mesh D is the distance, in a fold w log 2 less.
"""

import warp as wp
from wrod.kernels.contact.closest import Closest, closest_on_edge, shape_surface
from wrod.kernels.contact.parts import CORNERS, PARTS, Part, nearest_on_edge, part_of
from wrod.kernels.contact.shapes import Shape
from wrod.kernels.contact.solids import MESH, mesh_corner
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO

# Unrolled, its loop over parts is compiled seven times.
wp.set_module_options({"max_unroll": 1})

# Of the soft minimum, over the radius, and how many such widths farther a triangle still counts.
SOFTNESS = wp.constant(wp.float64(0.01))
WIDTHS = wp.constant(wp.float64(30.0))
# What is left of what counts, at least, for its logarithm to mean something: in a pipe as narrow as
# the rod its triangles cancel.
LEAST = wp.constant(wp.float64(0.01))
TURN = wp.constant(wp.float64(2.0 * wp.pi))


@wp.struct
class ByNumber:
    """How the distance, its gradient by the nodes at head and tail, and s follow a number."""

    distance: wp.float64
    head: wp.vec3d
    tail: wp.vec3d
    s: wp.float64


@wp.struct
class Gap:
    """Distance, outward normal, and where on the edge (s; where several places share the touch,
    their mean); the distance's gradient by the nodes at head and tail and its second derivatives
    (`mixed` has rows of the tail); the gradient of s; and how all that follows c and the radius."""

    s: wp.float64
    distance: wp.float64
    normal: wp.vec3d
    head: wp.vec3d
    tail: wp.vec3d
    by_head: wp.mat33d
    mixed: wp.mat33d
    by_tail: wp.mat33d
    s_by_head: wp.vec3d
    s_by_tail: wp.vec3d
    by_rounding: ByNumber
    by_radius: ByNumber


@wp.func
def gap_of(near: Closest, e: wp.vec3d, c: wp.float64) -> Gap:
    """Of what is touched in one place."""
    out = Gap()
    n = near.normal
    s = near.s
    u = ONE - s
    bent = near.bend * e
    v = u * bent - n
    w = s * bent + n
    share = near.free / (wp.dot(e, bent) + c)
    out.s = s
    out.distance = near.distance
    out.normal = n
    out.head = u * n
    out.tail = s * n
    out.by_head = u * u * near.bend - share * wp.outer(v, v)
    out.mixed = s * u * near.bend - share * wp.outer(w, v)
    out.by_tail = s * s * near.bend - share * wp.outer(w, w)
    out.s_by_head = -share * v
    out.s_by_tail = -share * w
    out.by_rounding.distance = HALF * (s - HALF) * (s - HALF)
    out.by_rounding.s = -share * (s - HALF)
    out.by_rounding.head = out.by_rounding.s * v
    out.by_rounding.tail = out.by_rounding.s * w
    return out


@wp.func
def is_hollow(shape: Shape) -> bool:
    return shape.kind == MESH and shape.size[1] < shape.size[0]


@wp.func
def part_weight(part: Part) -> wp.float64:
    """How a triangle, one of its sides, or one of its corners counts."""
    if part.k == 0:
        return ONE
    if part.k < CORNERS:
        return -HALF
    a = wp.normalize(part.b - part.a)
    b = wp.normalize(part.c - part.a)
    return wp.atan2(wp.length(wp.cross(a, b)), wp.dot(a, b)) / TURN


@wp.struct
class Sums:
    """Of parts by their weights: of one, of all that a gap has, and of products."""

    weight: wp.float64
    positive: wp.float64
    gap: Gap
    head_head: wp.mat33d
    tail_head: wp.mat33d
    tail_tail: wp.mat33d
    s_head: wp.vec3d
    s_tail: wp.vec3d
    rounding: ByNumber
    distances: ByNumber


@wp.func
def added(
    sum: ByNumber, p: wp.float64, distance: wp.float64, head: wp.vec3d, tail: wp.vec3d,
    s: wp.float64,
) -> ByNumber:  # fmt: skip
    out = sum
    out.distance += p * distance
    out.head = out.head + p * head
    out.tail = out.tail + p * tail
    out.s += p * s
    return out


@wp.func
def add_part(sums: Sums, p: wp.float64, g: Gap) -> Sums:
    out = sums
    out.weight += p
    out.positive += wp.max(p, ZERO)
    out.gap.s += p * g.s
    out.gap.distance += p * g.distance
    out.gap.head = out.gap.head + p * g.head
    out.gap.tail = out.gap.tail + p * g.tail
    out.gap.by_head = out.gap.by_head + p * g.by_head
    out.gap.mixed = out.gap.mixed + p * g.mixed
    out.gap.by_tail = out.gap.by_tail + p * g.by_tail
    out.gap.s_by_head = out.gap.s_by_head + p * g.s_by_head
    out.gap.s_by_tail = out.gap.s_by_tail + p * g.s_by_tail
    c = g.by_rounding
    out.gap.by_rounding = added(out.gap.by_rounding, p, c.distance, c.head, c.tail, c.s)
    out.head_head = out.head_head + p * wp.outer(g.head, g.head)
    out.tail_head = out.tail_head + p * wp.outer(g.tail, g.head)
    out.tail_tail = out.tail_tail + p * wp.outer(g.tail, g.tail)
    out.s_head = out.s_head + p * g.s * g.head
    out.s_tail = out.s_tail + p * g.s * g.tail
    d = g.distance
    out.rounding = added(out.rounding, p * c.distance, d, g.head, g.tail, g.s)
    out.distances = added(out.distances, p * d, d, g.head, g.tail, g.s)
    return out


@wp.func
def mean_gap(sums: Sums, radius: wp.float64) -> Gap:
    """The soft minimum of parts, whose distances were taken from the radius."""
    width = SOFTNESS * radius
    out = Gap()
    total = sums.weight
    g = sums.gap
    mean = g.distance / total
    out.distance = radius - width * wp.log(total)
    out.s = g.s / total
    out.head = g.head / total
    out.tail = g.tail / total
    out.normal = wp.normalize(out.head + out.tail)
    head = out.head
    tail = out.tail
    out.by_head = g.by_head / total - (sums.head_head / total - wp.outer(head, head)) / width
    out.mixed = g.mixed / total - (sums.tail_head / total - wp.outer(tail, head)) / width
    out.by_tail = g.by_tail / total - (sums.tail_tail / total - wp.outer(tail, tail)) / width
    out.s_by_head = g.s_by_head / total - (sums.s_head / total - out.s * head) / width
    out.s_by_tail = g.s_by_tail / total - (sums.s_tail / total - out.s * tail) / width
    c = g.by_rounding
    rounded = c.distance / total
    out.by_rounding.distance = rounded
    out.by_rounding.head = c.head / total - (sums.rounding.head / total - rounded * head) / width
    out.by_rounding.tail = c.tail / total - (sums.rounding.tail / total - rounded * tail) / width
    out.by_rounding.s = c.s / total - (sums.rounding.s / total - rounded * out.s) / width
    out.by_radius.distance = SOFTNESS * (out.distance - mean) / width
    per = SOFTNESS / (width * width)
    out.by_radius.head = per * (sums.distances.head / total - mean * head)
    out.by_radius.tail = per * (sums.distances.tail / total - mean * tail)
    out.by_radius.s = per * (sums.distances.s / total - mean * out.s)
    return out


@wp.func
def turned(g: Gap, turn: wp.mat33d) -> Gap:
    """A gap in a solid's frame, seen from outside."""
    out = g
    back = wp.transpose(turn)
    out.normal = turn * g.normal
    out.head = turn * g.head
    out.tail = turn * g.tail
    out.by_head = turn * g.by_head * back
    out.mixed = turn * g.mixed * back
    out.by_tail = turn * g.by_tail * back
    out.s_by_head = turn * g.s_by_head
    out.s_by_tail = turn * g.s_by_tail
    out.by_rounding.head = turn * g.by_rounding.head
    out.by_rounding.tail = turn * g.by_rounding.tail
    out.by_radius.head = turn * g.by_radius.head
    out.by_radius.tail = turn * g.by_radius.tail
    return out


# Written out at every place that asks, this and `touched_parts` take a GPU's compiler long.
@wp.func(inline=False)
def edge_gap(
    shape: Shape, q: wp.vec3d, e: wp.vec3d, c: wp.float64, radius: wp.float64
) -> Gap:  # fmt: skip
    """Of an edge from q to q + e and a solid that it may touch."""
    if is_hollow(shape) and radius > ZERO:
        turn = wp.quat_to_matrix(shape.rotation)
        back = wp.transpose(turn)
        sums = touched_parts(shape, back * (q - shape.position), back * e, c, radius)
        apart = sums.positive == ZERO
        if apart or sums.weight > LEAST * sums.positive:
            outside = shape_surface(shape, q).distance >= ZERO
            if outside and apart:
                out = Gap()
                out.distance = TWO * radius
                return out
            if outside and shape_surface(shape, q + e).distance >= ZERO:
                return turned(mean_gap(sums, radius), turn)
    return gap_of(closest_on_edge(shape, q, e, c), e, c)


@wp.func(inline=False)
def touched_parts(
    shape: Shape, q: wp.vec3d, e: wp.vec3d, c: wp.float64, radius: wp.float64
) -> Sums:  # fmt: skip
    """Sums over the parts of a mesh within reach, all by exp((radius - distance) / width); the
    edge, and they, are seen from the mesh."""
    width = SOFTNESS * radius
    reach = radius + WIDTHS * width
    far = wp.vec3d(reach, reach, reach)
    low = wp.min(q, q + e) - far
    high = wp.max(q, q + e) + far
    query = wp.mesh_query_aabb(shape.mesh, wp.vec3(low), wp.vec3(high))
    sums = Sums()
    face = int(0)
    while wp.mesh_query_aabb_next(query, face):
        corner_a = mesh_corner(shape.mesh, face, 0)
        corner_b = mesh_corner(shape.mesh, face, 1)
        corner_c = mesh_corner(shape.mesh, face, 2)
        parts = int(1)
        k = int(0)
        while k < parts:
            part = part_of(k, corner_a, corner_b, corner_c, shape.size[2])
            near = nearest_on_edge(part, q, e, c, reach)
            if near.distance < reach:
                parts = PARTS
                p = part_weight(part) * wp.exp((radius - near.distance) / width)
                sums = add_part(sums, p, gap_of(near, e, c))
            k += 1
    return sums
