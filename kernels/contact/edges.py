"""Contact of a rod's edges with solids: true thickness, and Coulomb friction.

An edge is a capsule and a fixture f is a convex solid, whose signed distance d is convex along the
edge (of a hollow mesh, an edge finds one of the places where it is nearest). It touches at the
point q + s e where

    D = min over s in [0, 1] of d(q + s e) + (c / 2) (s - 1/2)^2,    c = 0.01 h,

so that a post thinner than the edge presses wherever it stands between two nodes, and edges and
corners of a box are rounded off by the rod's radius. The small term makes the minimum unique where
an edge lies flat on a wall: s and with it the force move continuously while the edge turns past
parallel (compare `wrod.kernels.contact.segments`); it makes D at most 0.00125 h too large. By the
envelope theorem the gradient of D is that of d at fixed s, and the normal force of
`wrod.kernels.contact.planes` derives from an energy whose Hessian is exact. Friction is that of
`wrod.kernels.contact.planes` at the point of contact.
"""

import warp as wp
from wrod.kernels.contact.planes import (
    NOTHING,
    PLANE,
    Shape,
    damped_force,
    hold,
    normal_force,
    note_touch,
    shape_displacement,
)
from wrod.kernels.contact.rolling import held_turn
from wrod.kernels.contact.solids import Surface, extent, solid_surface
from wrod.kernels.elastic.assembly import (
    add_block,
    add_column,
    add_diagonal_block,
    add_row,
    add_vector,
)
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node

wp.set_module_options({"enable_backward": False})

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


@wp.struct
class Grip:
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
    shape: Shape,
    radius: wp.float64,
    rest_length: wp.float64,
    rolling: wp.float64,
    stiffness: wp.float64,
    skin: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle_before: wp.vec3d,
    r: int,
    i: int,
) -> Grip:
    out = Grip()
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    out.edge = e
    out.smoothing = SMOOTHING * rest_length
    if not within_reach(shape, q, e, radius):
        return out
    near = closest_on_edge(shape, q, e, out.smoothing)
    out.near = near
    out.depth = radius - near.distance
    law = normal_force(out.depth, stiffness, skin)
    out.force = law[0]
    out.slope = law[1]
    if out.force > ZERO:
        n = near.normal
        out.spin = (rolling * radius) * wp.cross(n, wp.normalize(e))
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
    shapes: wp.array2d(dtype=Shape),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.float64),
    skin: wp.array2d(dtype=wp.float64),
    static_friction: wp.array2d(dtype=wp.float64),
    kinetic_friction: wp.array2d(dtype=wp.float64),
    rolling: wp.array(dtype=wp.float64),
    relaxation: wp.array2d(dtype=wp.float64),
    roll_friction: wp.array2d(dtype=wp.float64),
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
    if active[r] == 0 or radius[r, i] == ZERO:
        return
    for k in range(shapes.shape[1]):
        c = edge_touch(
            shapes[r, k], radius[r, i], rest_length[r, i], rolling[r], stiffness[r, i], skin[r, i],
            dof, dof_before, bristle[r, k, i], r, i,
        )  # fmt: skip
        if c.force > ZERO:
            mu = wp.where(sliding[r, k, i] != 0, kinetic_friction[r, k], static_friction[r, k])
            law = damped_force(
                c.depth, c.closing, relaxation[r, i], step[r], stiffness[r, i], skin[r, i]
            )
            c.force = law[0]
            c.slope = law[1]
            held = hold(c.bristle, c.near.normal, stiffness[r, i], mu * c.force)
            add_edge(gradient, hessian, r, i, c, held.pull, held.grip)
            if rolling[r] > ZERO:
                add_edge_spin(gradient, hessian, r, i, c, held.pull, held.grip)
            if roll_friction[r, k] >= ZERO:
                a = 4 * i + 3
                arm = radius[r, i]
                turn = turned[r, k, i] + dof[r, a] - dof_before[r, a]
                roll = held_turn(
                    turn, stiffness[r, i] * arm * arm, roll_friction[r, k] * c.force * arm
                )
                wp.atomic_add(gradient, r, a, roll[0])
                wp.atomic_add(hessian, r, a, 0, roll[1])


@wp.func
def add_edge(
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    c: Grip,
    pull: wp.vec3d,
    grip: wp.mat33d,
):
    a = 4 * i
    n = c.near.normal
    tail = c.near.s
    head = ONE - tail
    total = pull - c.force * n
    add_vector(gradient, r, a, head * total)
    add_vector(gradient, r, a + 4, tail * total)
    # D'' = J^T d'' J - v v^T / D_ss with J = ((1 - s) 1, s 1) and v = J^T d'' e + (-n, n).
    block = grip + c.slope * wp.outer(n, n) - c.force * c.near.bend
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
    c: Grip,
    pull: wp.vec3d,
    grip: wp.mat33d,
):
    """The torque of friction on the edge's angle."""
    a = 4 * i
    coupling = grip * c.spin
    wp.atomic_add(gradient, r, a + 3, wp.dot(pull, c.spin))
    wp.atomic_add(hessian, r, a + 3, 0, wp.dot(coupling, c.spin))
    add_row(hessian, r, a + 3, a, (ONE - c.near.s) * coupling)
    add_column(hessian, r, a + 4, a + 3, c.near.s * coupling)


@wp.kernel
def refuse_tunnelling(
    # Model:
    shapes: wp.array2d(dtype=Shape),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State in and out:
    converged: wp.array(dtype=wp.int32),
):
    """Nothing tunnels: a step stands only if no centreline can have met a fixture on the way.

    An edge whose nodes move by m, from a distance D to a distance D', was nowhere nearer than
    (D + D' - m) / 2. Fixtures that move themselves are left to who moves them.
    """
    r, i = wp.tid()
    if converged[r] == 0 or radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    p = node(dof, r, i + 1)
    q_before = node(dof_before, r, i)
    p_before = node(dof_before, r, i + 1)
    way = wp.max(wp.length(q - q_before), wp.length(p - p_before))
    c = SMOOTHING * rest_length[r, i]
    for k in range(shapes.shape[1]):
        shape = shapes[r, k]
        if shape.moves == 0 and within_reach(shape, q_before, p_before - q_before, way):
            before = closest_on_edge(shape, q_before, p_before - q_before, c)
            after = closest_on_edge(shape, q, p - q, c)
            # Smoothed distances are up to c / 8 too large.
            met = before.distance + after.distance - wp.float64(0.25) * c <= way
            # What began inside may come out.
            if met and (before.distance > ZERO or after.distance < before.distance):
                converged[r] = 0


@wp.kernel
def find_touching(
    # Model:
    shapes: wp.array2d(dtype=Shape),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether their edges touch a fixture (1), and in an impact (2)."""
    r, i = wp.tid()
    if chosen[r] == 0 or radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    for k in range(shapes.shape[1]):
        if within_reach(shapes[r, k], q, e, radius[r, i]):
            near = closest_on_edge(shapes[r, k], q, e, SMOOTHING * rest_length[r, i])
            if near.distance < radius[r, i]:
                moved = (ONE - near.s) * (q - node(dof_before, r, i))
                moved = moved + near.s * (q + e - node(dof_before, r, i + 1))
                moved = moved - shape_displacement(shapes[r, k], q + near.s * e)
                closing = -wp.dot(moved, near.normal)
                note_touch(touching_out, r, radius[r, i] - near.distance, closing, radius[r, i])


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
    shapes: wp.array2d(dtype=Shape),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.float64),
    skin: wp.array2d(dtype=wp.float64),
    static_friction: wp.array2d(dtype=wp.float64),
    kinetic_friction: wp.array2d(dtype=wp.float64),
    rolling: wp.array(dtype=wp.float64),
    relaxation: wp.array2d(dtype=wp.float64),
    roll_friction: wp.array2d(dtype=wp.float64),
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
    if accepted[r] == 0 or radius[r, i] == ZERO:
        return
    for k in range(shapes.shape[1]):
        c = edge_touch(
            shapes[r, k], radius[r, i], rest_length[r, i], rolling[r], stiffness[r, i], skin[r, i],
            dof, dof_before, bristle[r, k, i], r, i,
        )  # fmt: skip
        mu = wp.where(sliding[r, k, i] != 0, kinetic_friction[r, k], static_friction[r, k])
        sliding[r, k, i] = 0
        b = wp.vec3d(ZERO, ZERO, ZERO)
        turn = wp.float64(0.0)
        if c.force > ZERO:
            law = damped_force(
                c.depth, c.closing, relaxation[r, i], step[r], stiffness[r, i], skin[r, i]
            )
            held = hold(c.bristle, c.near.normal, stiffness[r, i], mu * law[0])
            if held.slides > ZERO:
                sliding[r, k, i] = 1
                wp.atomic_add(slip, r, i, (ONE - c.near.s) * held.slides)
                wp.atomic_add(slip, r, i + 1, c.near.s * held.slides)
            b = held.pull / stiffness[r, i]
            if roll_friction[r, k] >= ZERO:
                arm = radius[r, i]
                k_r = stiffness[r, i] * arm * arm
                turn = turned[r, k, i] + dof[r, 4 * i + 3] - dof_before[r, 4 * i + 3]
                turn = held_turn(turn, k_r, roll_friction[r, k] * law[0] * arm)[0] / k_r
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
    shapes: wp.array2d(dtype=Shape),
    radius: wp.array2d(dtype=wp.float64),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    depth_out: wp.array(dtype=wp.float64),
):
    """Deepest penetration of each rod into any fixture, in `depth_out` where it is deeper."""
    r, i = wp.tid()
    if radius[r, i] == ZERO:
        return
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    for k in range(shapes.shape[1]):
        if within_reach(shapes[r, k], q, e, radius[r, i]):
            # The tiny term only breaks ties.
            c = closest_on_edge(shapes[r, k], q, e, wp.float64(1.0e-9) * wp.length(e))
            wp.atomic_max(depth_out, r, radius[r, i] - c.distance)
