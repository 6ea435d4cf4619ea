"""Where an edge comes nearest to a solid.

An edge is a capsule and a fixture f is a convex solid, whose signed distance d is convex along the
edge (meshes with hollows: `wrod.kernels.contact.gap`). It touches at the
point q + s e where

    D = min over s in [0, 1] of d(q + s e) + (c / 2) (s - 1/2)^2,    c = 0.01 h,

so that a post thinner than the edge presses wherever it stands between two nodes, and edges and
corners of a box are rounded off by the rod's radius. The small term makes the minimum unique where
an edge lies flat on a wall: s and with it the force move continuously while the edge turns past
parallel (compare `wrod.kernels.contact.segments`); it makes D at most 0.00125 h too large.
"""

import warp as wp
from wrod.kernels.contact.shapes import NOTHING, PLANE, Shape
from wrod.kernels.contact.solids import Surface, extent, solid_surface
from wrod.kernels.elastic.frames import HALF, ONE, ZERO

SMOOTHING = wp.constant(wp.float64(0.01))
# Of the search for s; Newton's method within a bracket takes a few.
SEARCHES = wp.constant(60)


@wp.func
def shape_surface(shape: Shape, q: wp.vec3d) -> Surface:
    """Signed distance, normal and the distance's second derivative, in the world frame."""
    turn = wp.quat_to_matrix(shape.rotation)
    p = wp.transpose(turn) * (q - shape.position)
    s = solid_surface(shape.kind, shape.size, shape.mesh, p)
    s.normal = turn * s.normal
    s.bend = turn * s.bend * wp.transpose(turn)
    return s


@wp.struct
class Closest:
    """Closest point of an edge: fraction s, whether it is free (1) or at an end (0), smoothed
    distance and outward normal there, and the second derivative of the distance."""

    s: wp.float64
    free: wp.float64
    distance: wp.float64
    normal: wp.vec3d
    bend: wp.mat33d


@wp.func
def slope_along(s: Surface, e: wp.vec3d, c: wp.float64, x: wp.float64) -> wp.float64:
    return wp.dot(s.normal, e) + c * (x - HALF)


@wp.func
def closest_on_edge(shape: Shape, q: wp.vec3d, e: wp.vec3d, c: wp.float64) -> Closest:
    out = Closest()
    s = wp.float64(0.0)
    found = shape_surface(shape, q)
    if slope_along(found, e, c, ZERO) < ZERO:
        s = ONE
        found = shape_surface(shape, q + e)
        if slope_along(found, e, c, ONE) > ZERO:
            out.free = ONE
            s = HALF
            low = wp.float64(0.0)
            high = wp.float64(1.0)
            done = bool(False)
            for k in range(SEARCHES):
                if not done:
                    found = shape_surface(shape, q + s * e)
                    slope = slope_along(found, e, c, s)
                    if slope > ZERO:
                        high = s
                    else:
                        low = s
                    rate = wp.dot(e, found.bend * e) + c
                    next = s - slope / rate
                    if next <= low or next >= high or k >= SEARCHES // 3:
                        next = HALF * (low + high)
                    done = wp.abs(next - s) < wp.float64(1.0e-14)
                    s = next
            found = shape_surface(shape, q + s * e)
    out.s = s
    out.distance = found.distance + HALF * c * (s - HALF) * (s - HALF)
    out.normal = found.normal
    out.bend = found.bend
    return out


@wp.func
def is_fixture(shape: Shape) -> bool:
    return shape.kind != PLANE and shape.kind != NOTHING


@wp.func
def within_reach(shape: Shape, q: wp.vec3d, e: wp.vec3d, reach: wp.float64) -> bool:
    """False if no point of the edge can be that near to the fixture."""
    if not is_fixture(shape):
        return False
    far = reach + wp.length(e)
    if wp.length(q - shape.position) > far + extent(shape.kind, shape.size):
        return False
    return shape_surface(shape, q).distance <= far
