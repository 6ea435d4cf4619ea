"""A straight isotropic rod from contact to grip: its unbalanced forces and their derivatives."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.elastic.isotropic import EdgePair, isotropic_bending, isotropic_stencil
from wrod.kernels.grasping.contact_edge import first_direction, ghost_direction, half_turn

WEIGHT = wp.constant(wp.float64(0.5))  # per length, by the definition of L_gb


@wp.struct
class StraightRod:
    """A uniform rod on a mesh: rest lengths (rod, edge) and stretch ratio (rod,)."""

    rest: wp.array2d(dtype=wp.float64)
    stretch_ratio: wp.array(dtype=wp.float64)


@wp.func
def point(shape: wp.array3d(dtype=wp.float64), r: int, i: int) -> wp.vec3d:
    return wp.vec3d(shape[r, i, 0], shape[r, i, 1], shape[r, i, 2])


@wp.func
def put_point(shape: wp.array3d(dtype=wp.float64), r: int, i: int, x: wp.vec3d):
    for c in range(3):
        shape[r, i, c] = x[c]


@wp.func
def put_stencil(stiffness: wp.array3d(dtype=wp.float64), slot: int, j: int, s: EdgePair):
    """Upper triangle of the second derivatives by both edges, row by row."""
    k = int(0)
    for a in range(3):
        for b in range(a, 3):
            stiffness[slot, j, k] = s.ee[a, b]
            k += 1
        for b in range(3):
            stiffness[slot, j, k] = s.ef[a, b]
            k += 1
    for a in range(3):
        for b in range(a, 3):
            stiffness[slot, j, k] = s.ff[a, b]
            k += 1


@wp.func
def evaluate(
    rest: wp.array2d(dtype=wp.float64),
    stretch_ratio: wp.float64,
    curvature: wp.float64,
    shape: wp.array3d(dtype=wp.float64),
    r: int,
    slot: int,
    edges: int,
    # Out:
    stiffness: wp.array3d(dtype=wp.float64),
    load: wp.array3d(dtype=wp.float64),
) -> wp.float64:
    """Fill `stiffness` and `load` (see `kernels.linear.frontal`); the largest unbalanced force of
    the nodes between contact and grip."""
    t = ghost_direction(half_turn(curvature, rest[r, 0]))
    h = rest[r, 0]
    length = wp.float64(h)
    x = point(shape, r, 0)
    # Gradients of the nodes before and at the stencil's, as far as they have come.
    before = wp.vec3d(ZERO, ZERO, ZERO)
    here = wp.vec3d(ZERO, ZERO, ZERO)
    worst = wp.float64(0.0)
    for j in range(edges):
        y = point(shape, r, j + 1)
        f = y - x
        length_f = wp.length(f)
        u = f / length_f
        g = rest[r, j]
        s = isotropic_stencil(ONE, stretch_ratio, h, g, t, length, u, length_f)
        put_stencil(stiffness, slot, j, s)
        before = before - s.e
        for c in range(3):
            load[slot, wp.max(j - 1, 0), c] = before[c]
        if j > 1:
            worst = worse(worst, before)
        half = HALF * WEIGHT * g
        before = here + s.e - s.f + wp.vec3d(ZERO, ZERO, half)
        here = s.f + wp.vec3d(ZERO, ZERO, half)
        t = u
        length = length_f
        h = g
        x = y
    worst = worse(worst, before)
    for c in range(3):
        load[slot, edges - 1, c] = before[c]
        load[slot, edges, c] = here[c]
    return worst


@wp.func
def worse(worst: wp.float64, force: wp.vec3d) -> wp.float64:
    """The larger of two; not a number where one of them is none."""
    value = wp.max(wp.abs(force[0]), wp.max(wp.abs(force[1]), wp.abs(force[2])))
    size = wp.float64(force[0] + force[1] + force[2])
    if value > worst or not wp.isfinite(size):
        if wp.isfinite(size):
            return value
        return size
    return worst


@wp.func
def gradient_rate(
    rest: wp.array2d(dtype=wp.float64),
    rest_rate: wp.array2d(dtype=wp.float64),
    stretch_ratio: wp.float64,
    stretch_ratio_rate: wp.float64,
    curvature: wp.float64,
    shape: wp.array3d(dtype=wp.float64),
    r: int,
    slot: int,
    edges: int,
    # 1 where the rest lengths change, else 0.
    along_length: wp.float64,
    # Out:
    load: wp.array3d(dtype=wp.float64),
):
    """Fill `load` with the gradient's derivative along a change of the rod, its shape held."""
    t = ghost_direction(half_turn(curvature, rest[r, 0]))
    h = rest[r, 0]
    h_rate = along_length * rest_rate[r, 0]
    length = wp.float64(h)
    x = point(shape, r, 0)
    before = wp.vec3d(ZERO, ZERO, ZERO)
    here = wp.vec3d(ZERO, ZERO, ZERO)
    for j in range(edges):
        y = point(shape, r, j + 1)
        f = y - x
        length_f = wp.length(f)
        u = f / length_f
        g = rest[r, j]
        g_rate = along_length * rest_rate[r, j]
        b = isotropic_bending(ONE / (HALF * (h + g)), t, length, u, length_f)
        by = -(h_rate + g_rate) / (h + g)
        force = (
            stretch_ratio_rate * (length_f / g - ONE) - stretch_ratio * length_f / (g * g) * g_rate
        )
        e = by * b.e
        after = by * b.f + force * u
        before = before - e
        for c in range(3):
            load[slot, wp.max(j - 1, 0), c] = before[c]
        half = wp.vec3d(ZERO, ZERO, HALF * WEIGHT * g_rate)
        before = here + e - after + half
        here = after + half
        t = u
        length = length_f
        h = g
        h_rate = g_rate
        x = y
    for c in range(3):
        load[slot, edges - 1, c] = before[c]
        load[slot, edges, c] = here[c]


@wp.func
def place_contact(
    shape: wp.array3d(dtype=wp.float64),
    r: int,
    curvature: wp.float64,
    length: wp.float64,
):
    """Turn the first edge to the curvature, keeping its length."""
    stretched = wp.length(point(shape, r, 1) - point(shape, r, 0))
    put_point(shape, r, 1, stretched * first_direction(half_turn(curvature, length)))
