"""Contact of a rod's edges with solids: true thickness, and Coulomb friction.

An edge touches where it comes nearest (`wrod.kernels.contact.closest`). By the envelope theorem the
gradient of that distance D is that of the solid's at fixed s, and the normal force of
`wrod.kernels.contact.planes` derives from an energy whose Hessian is exact. Friction is that of
`wrod.kernels.contact.planes` at the point of contact.
"""

import warp as wp
from wrod.kernels.contact.closest import SMOOTHING, Closest, closest_on_edge, within_reach
from wrod.kernels.contact.planes import (
    Touchable,
    coefficient,
    normal_force,
    note_touch,
    present_force,
    return_mapping,
    shape_displacement,
)
from wrod.kernels.contact.rolling import held_turn
from wrod.kernels.elastic.assembly import (
    add_block,
    add_column,
    add_component,
    add_diagonal_block,
    add_entry,
    add_row,
    add_vector,
)
from wrod.kernels.elastic.frames import ONE, ZERO, node

wp.set_module_options({"enable_backward": False})

# Of an edge, as `SMOOTHING`, where distances are to be exact: this only breaks ties.
SHARP = wp.constant(wp.float64(1.0e-9))
# What begins deeper than this part of its radius is let out slowly.
DEEP = wp.constant(wp.float64(0.5))


@wp.struct
class EdgeTouch:
    """What a fixture does to an edge: closest point, normal force at rest and its slope, depth and
    by how much it has grown in this step, stretch of the
    bristle before return mapping, the edge itself, the direction in which its surface moves when it
    spins (radius times n x t), and c."""

    near: Closest
    depth: wp.float64
    closing: wp.float64
    force: wp.float64
    slope: wp.float64
    bristle: wp.vec3d
    edge: wp.vec3d
    spin: wp.vec3d
    smoothing: wp.float64


@wp.func
def edge_touch(
    m: Touchable,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle_before: wp.vec3d,
    r: int,
    k: int,
    i: int,
) -> EdgeTouch:
    """Edge i and shape k of rod r."""
    out = EdgeTouch()
    shape = m.shapes[r, k]
    radius = m.radius[r, i]
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    out.edge = e
    out.smoothing = SMOOTHING * m.rest_length[r, i]
    if not within_reach(shape, q, e, wp.max(radius, ZERO)):
        return out
    near = closest_on_edge(shape, q, e, out.smoothing)
    out.near = near
    out.depth = radius - near.distance
    law = normal_force(out.depth, m.stiffness[r, i], m.skin[r, i])
    out.force = law[0]
    out.slope = law[1]
    if out.force > ZERO:
        n = near.normal
        out.spin = (m.rolling[r] * radius) * wp.cross(n, wp.normalize(e))
        spun = dof[r, 4 * i + 3] - dof_before[r, 4 * i + 3]
        moved = (ONE - near.s) * (q - node(dof_before, r, i))
        moved = moved + near.s * (q + e - node(dof_before, r, i + 1))
        moved = moved - shape_displacement(shape, q + near.s * e)
        b = bristle_before + moved + spun * out.spin
        out.bristle = b - wp.dot(b, n) * n
        out.closing = -wp.dot(moved, n)
    return out


@wp.kernel
def edge_contact(
    # Model:
    model: Touchable,
    # State in:
    step: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle: wp.array3d(dtype=wp.vec3d),
    sliding: wp.array3d(dtype=wp.int32),
    turned: wp.array3d(dtype=wp.float64),
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Subtract contact forces from the residual and add their stiffness to the matrix.

    Left out of the matrix, which would not be symmetric with it: how a sliding edge's friction
    depends on its normal force, and how it moves along the edge with the point of contact.
    """
    r, i = wp.tid()
    if active[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, dof, dof_before, bristle[r, k, i], r, k, i)
        if c.force > ZERO:
            mu = coefficient(model, sliding[r, k, i], r, k)
            law = present_force(model, c.depth, c.closing, step[r], r, i)
            c.force = law[0]
            c.slope = law[1]
            held = return_mapping(c.bristle, c.near.normal, model.stiffness[r, i], mu * c.force)
            add_edge(gradient, hessian, r, i, c, held.pull, held.tangential)
            if model.rolling[r] > ZERO:
                add_edge_spin(gradient, hessian, r, i, c, held.pull, held.tangential)
            if model.roll_friction[r, k] >= ZERO:
                a = 4 * i + 3
                arm = wp.abs(model.radius[r, i])
                turn = turned[r, k, i] + dof[r, a] - dof_before[r, a]
                limit = model.roll_friction[r, k] * c.force * arm
                roll = held_turn(turn, model.stiffness[r, i] * arm * arm, limit)
                add_component(gradient, r, a, roll[0])
                add_entry(hessian, r, a, 0, roll[1])


@wp.func
def add_edge(
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    c: EdgeTouch,
    pull: wp.vec3d,
    tangential: wp.mat33d,
):
    a = 4 * i
    n = c.near.normal
    tail = c.near.s
    head = ONE - tail
    total = pull - c.force * n
    add_vector(gradient, r, a, head * total)
    add_vector(gradient, r, a + 4, tail * total)
    # D'' = J^T d'' J - v v^T / D_ss with J = ((1 - s) 1, s 1) and v = J^T d'' e + (-n, n).
    block = tangential + c.slope * wp.outer(n, n) - c.force * c.near.bend
    bent = c.near.bend * c.edge
    v = head * bent - n
    w = tail * bent + n
    share = ZERO
    if c.near.free > ZERO:
        share = c.force / (wp.dot(c.edge, bent) + c.smoothing)
    add_diagonal_block(hessian, r, a, head * head * block + share * wp.outer(v, v))
    add_block(hessian, r, a + 4, a, tail * head * block + share * wp.outer(w, v))
    add_diagonal_block(hessian, r, a + 4, tail * tail * block + share * wp.outer(w, w))


@wp.func
def add_edge_spin(
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    c: EdgeTouch,
    pull: wp.vec3d,
    tangential: wp.mat33d,
):
    """The torque of friction on the edge's angle."""
    a = 4 * i
    coupling = tangential * c.spin
    add_component(gradient, r, a + 3, wp.dot(pull, c.spin))
    add_entry(hessian, r, a + 3, 0, wp.dot(coupling, c.spin))
    add_row(hessian, r, a + 3, a, (ONE - c.near.s) * coupling)
    add_column(hessian, r, a + 4, a + 3, c.near.s * coupling)


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
        if within_reach(model.shapes[r, k], q, e, radius):
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
    side. Fixtures that move themselves are left to who moves them.
    """
    r, i = wp.tid()
    if converged[r] == 0 or model.radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    p = node(dof, r, i + 1)
    q_before = node(dof_before, r, i)
    p_before = node(dof_before, r, i + 1)
    way = wp.max(wp.length(q - q_before), wp.length(p - p_before))
    c = SHARP * model.rest_length[r, i]
    for k in range(model.shapes.shape[1]):
        shape = model.shapes[r, k]
        if shape.moves == 0 and within_reach(shape, q_before, p_before - q_before, way):
            before = closest_on_edge(shape, q_before, p_before - q_before, c)
            after = closest_on_edge(shape, q, p - q, c)
            inside = before.distance <= ZERO or hidden[r, i] > ZERO
            met = before.distance + after.distance <= way
            if inside:
                met = wp.dot(before.normal, after.normal) < ZERO
            if met:
                converged[r] = 0


@wp.kernel
def find_touching(
    # Model:
    model: Touchable,
    # State in:
    chosen: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether their edges touch a fixture (1), and in an impact (2)."""
    r, i = wp.tid()
    if chosen[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, dof, dof_before, wp.vec3d(), r, k, i)
        if c.force > ZERO:
            note_touch(touching_out, r, c.depth, c.closing, model.radius[r, i])


@wp.kernel
def clear_pushes(
    accepted: wp.array(dtype=wp.int32),
    push_out: wp.array2d(dtype=wp.vec3d),
    moment_out: wp.array2d(dtype=wp.vec3d),
):
    r, k = wp.tid()
    if accepted[r] != 0:
        push_out[r, k] = wp.vec3d(ZERO, ZERO, ZERO)
        moment_out[r, k] = wp.vec3d(ZERO, ZERO, ZERO)


@wp.kernel
def settle_edges(
    # Model:
    model: Touchable,
    # State in:
    step: wp.array(dtype=wp.float64),
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State in and out:
    bristle: wp.array3d(dtype=wp.vec3d),
    sliding: wp.array3d(dtype=wp.int32),
    turned: wp.array3d(dtype=wp.float64),
    slip: wp.array2d(dtype=wp.float64),
    force: wp.array2d(dtype=wp.vec3d),
    push: wp.array2d(dtype=wp.vec3d),
    moment: wp.array2d(dtype=wp.vec3d),
):
    """After an accepted step: let overloaded bristles slide, and add forces and slip to those of
    the nodes, and forces, and their moments about the origin, to those of the shapes."""
    r, i = wp.tid()
    if accepted[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, dof, dof_before, bristle[r, k, i], r, k, i)
        mu = coefficient(model, sliding[r, k, i], r, k)
        sliding[r, k, i] = 0
        b = wp.vec3d(ZERO, ZERO, ZERO)
        turn = wp.float64(0.0)
        if c.force > ZERO:
            law = present_force(model, c.depth, c.closing, step[r], r, i)
            held = return_mapping(c.bristle, c.near.normal, model.stiffness[r, i], mu * law[0])
            if held.slides > ZERO:
                sliding[r, k, i] = 1
                wp.atomic_add(slip, r, i, (ONE - c.near.s) * held.slides)
                wp.atomic_add(slip, r, i + 1, c.near.s * held.slides)
            b = held.pull / model.stiffness[r, i]
            if model.roll_friction[r, k] >= ZERO:
                arm = wp.abs(model.radius[r, i])
                k_r = model.stiffness[r, i] * arm * arm
                turn = turned[r, k, i] + dof[r, 4 * i + 3] - dof_before[r, 4 * i + 3]
                limit = model.roll_friction[r, k] * law[0] * arm
                turn = held_turn(turn, k_r, limit)[0] / k_r
            total = law[0] * c.near.normal - held.pull
            wp.atomic_add(force, r, i, (ONE - c.near.s) * total)
            wp.atomic_add(force, r, i + 1, c.near.s * total)
            wp.atomic_add(push, r, k, -total)
            wp.atomic_add(moment, r, k, -wp.cross(node(dof, r, i) + c.near.s * c.edge, total))
        bristle[r, k, i] = b
        turned[r, k, i] = turn


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
        if within_reach(model.shapes[r, k], q, e, model.radius[r, i] + hidden[r, i]):
            c = closest_on_edge(model.shapes[r, k], q, e, SHARP * wp.length(e))
            wp.atomic_max(depth_out, r, model.radius[r, i] + hidden[r, i] - c.distance)
