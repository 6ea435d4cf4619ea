"""Edges deep inside solids: how they come out, and that none passes through one unseen."""

import warp as wp
from wrod.kernels.contact.closest import SMOOTHING, closest_on_edge, within_reach
from wrod.kernels.contact.edges import may_touch
from wrod.kernels.contact.law import Touchable
from wrod.kernels.contact.shapes import BY_OTHERS, shape_before, shape_displacement
from wrod.kernels.elastic.frames import TWO, ZERO, node

# Of an edge, as `SMOOTHING`, where distances are to be exact: this only breaks ties.
SHARP = wp.constant(wp.float64(1.0e-9))
# What begins deeper than this part of its radius is let out slowly.
DEEP = wp.constant(wp.float64(0.5))


@wp.kernel
def hide(
    # State in:
    chosen: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    # State in and out:
    model: Touchable,
    hidden: wp.array2d(dtype=wp.float64),
):
    """Edges of the chosen rods that lie deep inside a shape begin as thin as they just touch it, of
    a radius below 0 even: all at once, contact would throw them out."""
    r, i = wp.tid()
    radius = model.radius[r, i] + hidden[r, i]
    if chosen[r] == 0 or radius == ZERO:
        return
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    deepest = wp.float64(0.0)
    for k in range(model.shapes.shape[1]):
        if may_touch(model, r, k, i) and within_reach(model.shapes[r, k], q, e, radius):
            c = closest_on_edge(model.shapes[r, k], q, e, SHARP * wp.length(e))
            deepest = wp.max(deepest, radius - c.distance)
    hidden[r, i] = wp.where(deepest > DEEP * radius, deepest, ZERO)
    model.radius[r, i] = radius - hidden[r, i]


@wp.kernel
def swell(
    # Model:
    speed: wp.array2d(dtype=wp.float64),
    # State in:
    step: wp.array(dtype=wp.float64),
    accepted: wp.array(dtype=wp.int32),
    # State in and out:
    model: Touchable,
    hidden: wp.array2d(dtype=wp.float64),
):
    """Let hidden radii grow."""
    r, i = wp.tid()
    if accepted[r] == 0 or hidden[r, i] == ZERO:
        return
    grown = wp.min(hidden[r, i], speed[r, i] * step[r])
    hidden[r, i] = hidden[r, i] - grown
    model.radius[r, i] = model.radius[r, i] + grown


@wp.kernel
def refuse_tunnelling(
    # Model:
    model: Touchable,
    # State in:
    hidden: wp.array2d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State in and out:
    converged: wp.array(dtype=wp.int32),
):
    """Nothing tunnels: a step stands only if no centreline can have met a fixture on the way.

    An edge whose nodes move by m, from a distance D to a distance D', was nowhere nearer than
    (D + D' - m) / 2. One that began inside may come out, and sink deeper, but not pass to the other
    side. Fixtures that others move are left to them; to one that moves with the rods, ways are
    relative.
    """
    r, i = wp.tid()
    if converged[r] == 0 or model.radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    p = node(dof, r, i + 1)
    q_before = node(dof_before, r, i)
    p_before = node(dof_before, r, i + 1)
    c = SHARP * model.rest_length[r, i]
    for k in range(model.shapes.shape[1]):
        shape = model.shapes[r, k]
        if shape.moves == BY_OTHERS or not may_touch(model, r, k, i):
            continue
        was = shape_before(shape)
        way = wp.max(
            wp.length(q - q_before - shape_displacement(shape, q)),
            wp.length(p - p_before - shape_displacement(shape, p)),
        )
        if within_reach(was, q_before, p_before - q_before, way):
            before = closest_on_edge(was, q_before, p_before - q_before, c)
            after = closest_on_edge(shape, q, p - q, c)
            inside = before.distance <= ZERO or hidden[r, i] > ZERO
            met = before.distance + wp.abs(after.distance) <= way
            if inside:
                n = wp.quat_rotate_inv(was.rotation, before.normal)
                met = wp.dot(wp.quat_rotate(shape.rotation, n), after.normal) < ZERO
            if met:
                converged[r] = 0


@wp.kernel
def measure_depth(
    # Model:
    model: Touchable,
    # State in:
    hidden: wp.array2d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    depth_out: wp.array(dtype=wp.float64),
):
    """Deepest penetration of each rod into any fixture, in `depth_out` where it is deeper."""
    r, i = wp.tid()
    if model.radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    for k in range(model.shapes.shape[1]):
        reach = model.radius[r, i] + hidden[r, i]
        if may_touch(model, r, k, i) and within_reach(model.shapes[r, k], q, e, reach):
            c = closest_on_edge(model.shapes[r, k], q, e, SHARP * wp.length(e))
            wp.atomic_max(depth_out, r, reach - c.distance)


@wp.kernel
def count_near(
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    # Model, and out:
    model: Touchable,
):
    """How many edges are within a radius of touching the bodies of which that matters. Launched
    over (rod, edge)."""
    r, i = wp.tid()
    if model.radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    reach = TWO * wp.abs(model.radius[r, i])
    for k in range(model.shapes.shape[1]):
        shape = model.shapes[r, k]
        matters = model.firmest[r, k] > ZERO and may_touch(model, r, k, i)
        if matters and within_reach(shape, q, e, reach):
            near = closest_on_edge(shape, q, e, SMOOTHING * model.rest_length[r, i])
            if near.distance < reach:
                wp.atomic_add(model.near, model.bearer[r, k], 1)
