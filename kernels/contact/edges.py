"""Contact of a rod's edges with solids: true thickness, and Coulomb friction.

The normal force of `wrod.kernels.contact.law` derives from an energy of the gap between edge and
solid (`wrod.kernels.contact.gap`), whose Hessian is exact. Friction is that of
`wrod.kernels.contact.law` at the point of contact.
"""

import warp as wp
from wrod.kernels.contact.closest import SMOOTHING, within_reach
from wrod.kernels.contact.duals import bristle_stiffness, follow_dual
from wrod.kernels.contact.gap import Gap, edge_gap
from wrod.kernels.contact.law import (
    ContactStep,
    Touchable,
    coefficient,
    damped_force,
    normal_force,
    note_touch,
    return_mapping,
)
from wrod.kernels.contact.rolling import edge_rolled
from wrod.kernels.contact.shapes import shape_displacement
from wrod.kernels.elastic.assembly import (
    add_block,
    add_column,
    add_component,
    add_diagonal_block,
    add_entry,
    add_row,
    add_vector,
)
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node

# Longest relaxation over the step where a body gets the force a step late: damping that is late
# drives.
LATE = wp.constant(wp.float64(0.3))
# Over what all edges may have that press such a body, what at most bears its weight: with each edge
# as firm as one that bears it alone, many throw it off.
BEARING = wp.constant(wp.float64(2.5))


@wp.struct
class EdgeTouch:
    """What a fixture does to an edge: the gap, normal force at rest, depth and by how much it
    has grown in this step, stiffness, stretch of the bristle before return mapping, the edge
    itself, the direction in which its surface moves when it spins (radius times n x t), and how
    far it has spun in this step."""

    near: Gap
    depth: wp.float64
    closing: wp.float64
    force: wp.float64
    stiffness: wp.float64
    bristle: wp.vec3d
    edge: wp.vec3d
    spin: wp.vec3d
    spun: wp.float64


@wp.func
def may_touch(m: Touchable, r: int, k: int, i: int) -> bool:
    if m.apart.shape[2] == 0:
        return True
    return m.apart[r, k, i] == wp.int8(0)


@wp.func
def edge_stiffness(m: Touchable, r: int, k: int, i: int) -> wp.float64:
    """At most its share of what all edges may have, or of `BEARING` times that where an edge is to
    bear something: what it is to bear then goes in by two skins beyond half the first."""
    out = wp.float64(m.stiffness[r, i])
    least = wp.float64(0.0)
    if m.burden.shape[1] > 0:
        least = HALF * m.burden[r, k] / m.skin[r, i]
    if m.firmest.shape[1] > 0 and m.firmest[r, k] > ZERO:
        share = m.firmest[r, k] / wp.float64(wp.max(m.near[m.bearer[r, k]], 1))
        out = wp.min(out, share)
        least = wp.min(least, BEARING * share)
    out = wp.max(out, least)
    return out


@wp.func
def edge_touch(m: Touchable, step: ContactStep, r: int, k: int, i: int) -> EdgeTouch:
    """Edge i and shape k of rod r."""
    out = EdgeTouch()
    shape = m.shapes[r, k]
    radius = m.radius[r, i]
    q = node(step.dof, r, i)
    e = node(step.dof, r, i + 1) - q
    out.edge = e
    if not (may_touch(m, r, k, i) and within_reach(shape, q, e, wp.max(radius, ZERO))):
        return out
    near = edge_gap(shape, q, e, SMOOTHING * m.rest_length[r, i], radius)
    out.near = near
    out.depth = radius - near.distance
    out.stiffness = edge_stiffness(m, r, k, i)
    out.force = normal_force(out.depth, out.stiffness, m.skin[r, i])[0]
    if out.force > ZERO:
        n = near.normal
        out.spin = (m.rolling[r] * radius) * wp.cross(n, wp.normalize(e))
        out.spun = step.dof[r, 4 * i + 3] - step.dof_before[r, 4 * i + 3]
        head = q - node(step.dof_before, r, i) - shape_displacement(shape, q)
        tail = q + e - node(step.dof_before, r, i + 1) - shape_displacement(shape, q + e)
        moved = (ONE - near.s) * head + near.s * tail
        b = step.bristle[r, k, i] + moved + out.spun * out.spin
        out.bristle = b - wp.dot(b, n) * n
        out.closing = -wp.dot(head, near.head) - wp.dot(tail, near.tail)
    return out


@wp.func
def is_burdened(m: Touchable, stiffness: wp.float64, r: int, k: int, i: int) -> bool:
    """Whether an edge's stiffness is what a burden wants."""
    return m.burden.shape[1] > 0 and stiffness == HALF * m.burden[r, k] / m.skin[r, i]


@wp.func
def edge_relaxation(
    m: Touchable, c: EdgeTouch, dt: wp.float64, r: int, k: int, i: int
) -> wp.float64:
    """What is stiffer comes to rest sooner."""
    out = wp.float64(m.relaxation[r, i] * wp.sqrt(m.stiffness[r, i] / c.stiffness))
    if m.firmest.shape[1] > 0 and m.firmest[r, k] > ZERO:
        out = wp.min(out, LATE * dt)
    return out


@wp.func
def is_late(m: Touchable, relaxation: wp.float64, dt: wp.float64, r: int, k: int) -> bool:
    """Whether an edge's relaxation time is bounded by the step."""
    return m.firmest.shape[1] > 0 and m.firmest[r, k] > ZERO and relaxation == LATE * dt


@wp.struct
class EdgeHold:
    """How a fixture holds an edge that it touches: normal force and its slope, the bristle's pull,
    its stiffness, the stretch at which it slides, and by how much it does; torque about the edge of
    what keeps its roll, and its stiffness."""

    force: wp.float64
    slope: wp.float64
    pull: wp.vec3d
    tangential: wp.mat33d
    limit: wp.float64
    slides: wp.float64
    torque: wp.float64
    turning: wp.float64


@wp.func
def hold_edge(m: Touchable, step: ContactStep, c: EdgeTouch, r: int, k: int, i: int) -> EdgeHold:
    out = EdgeHold()
    dt = step.span[r]
    relaxation = edge_relaxation(m, c, dt, r, k, i)
    law = damped_force(c.depth, c.closing, relaxation, dt, c.stiffness, m.skin[r, i])
    out.force = law[0]
    out.slope = law[1]
    limit = coefficient(m, step.sliding[r, k, i], r, k) * law[0]
    held = return_mapping(c.bristle, c.near.normal, c.stiffness, limit)
    out.limit = limit / c.stiffness
    out.pull = held.pull
    out.tangential = held.tangential
    out.slides = held.slides
    if m.roll_friction[r, k] >= ZERO:
        roll = edge_rolled(m, step, c.stiffness, law[0], r, k, i)
        out.torque = roll.torque
        out.turning = roll.stiffness
    return out


@wp.struct
class EdgeBlocks:
    """Residual and stiffness of a touch by the nodes at the edge's head and tail; `mixed` has rows
    of the tail."""

    at_head: wp.vec3d
    at_tail: wp.vec3d
    head: wp.mat33d
    mixed: wp.mat33d
    tail: wp.mat33d


@wp.func
def edge_blocks(c: EdgeTouch, held: EdgeHold) -> EdgeBlocks:
    out = EdgeBlocks()
    g = c.near
    tail = g.s
    head = ONE - tail
    out.at_head = head * held.pull - held.force * g.head
    out.at_tail = tail * held.pull - held.force * g.tail
    out.head = held.slope * wp.outer(g.head, g.head) - held.force * g.by_head
    out.mixed = held.slope * wp.outer(g.tail, g.head) - held.force * g.mixed
    out.tail = held.slope * wp.outer(g.tail, g.tail) - held.force * g.by_tail
    out.head = out.head + head * head * held.tangential
    out.mixed = out.mixed + tail * head * held.tangential
    out.tail = out.tail + tail * tail * held.tangential
    return out


@wp.kernel
def edge_contact(
    # Model:
    model: Touchable,
    # State in and out:
    step: ContactStep,
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Subtract contact forces from the residual and add their stiffness to the matrix, that of
    friction by its dual, which goes on from iteration to iteration.

    Left out of the matrix, which would not be symmetric with it: how a sliding edge's friction
    depends on its normal force, and how it moves along the edge with the point of contact.
    """
    r, i = wp.tid()
    if step.active[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, step, r, k, i)
        if c.force > ZERO:
            a = 4 * i
            held = hold_edge(model, step, c, r, k, i)
            w = follow_dual(step, c.bristle, held.limit, held.slides > ZERO, r, k, i)
            held.tangential = bristle_stiffness(
                c.bristle, w, c.near.normal, c.stiffness, held.limit
            )
            b = edge_blocks(c, held)
            add_vector(gradient, r, a, b.at_head)
            add_vector(gradient, r, a + 4, b.at_tail)
            add_diagonal_block(hessian, r, a, b.head)
            add_block(hessian, r, a + 4, a, b.mixed)
            add_diagonal_block(hessian, r, a + 4, b.tail)
            if model.rolling[r] > ZERO:
                add_edge_spin(gradient, hessian, r, i, c, held.pull, held.tangential)
            if model.roll_friction[r, k] >= ZERO:
                add_component(gradient, r, a + 3, held.torque)
                add_entry(hessian, r, a + 3, 0, held.turning)
        elif step.iteration[r] == 0:
            step.stretch[r, k, i] = wp.vec3d()


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
def find_touching(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether their edges touch a fixture (1), and in an impact (2)."""
    r, i = wp.tid()
    if step.active[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, step, r, k, i)
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
    # State in and out:
    step: ContactStep,
    slip: wp.array2d(dtype=wp.float64),
    force: wp.array2d(dtype=wp.vec3d),
    push: wp.array2d(dtype=wp.vec3d),
    moment: wp.array2d(dtype=wp.vec3d),
):
    """After an accepted step: let overloaded bristles slide, and add forces and slip to those of
    the nodes, and forces, and their moments about the origin, to those of the shapes."""
    r, i = wp.tid()
    if step.active[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        c = edge_touch(model, step, r, k, i)
        slides = int(0)
        b = wp.vec3d(ZERO, ZERO, ZERO)
        turn = wp.float64(0.0)
        if c.force > ZERO:
            held = hold_edge(model, step, c, r, k, i)
            if held.slides > ZERO:
                slides = 1
                wp.atomic_add(slip, r, i, (ONE - c.near.s) * held.slides)
                wp.atomic_add(slip, r, i + 1, c.near.s * held.slides)
            b = held.pull / c.stiffness
            if model.roll_friction[r, k] >= ZERO:
                arm = wp.abs(model.radius[r, i])
                turn = held.torque / (c.stiffness * arm * arm)
            head = held.force * c.near.head - (ONE - c.near.s) * held.pull
            tail = held.force * c.near.tail - c.near.s * held.pull
            wp.atomic_add(force, r, i, head)
            wp.atomic_add(force, r, i + 1, tail)
            wp.atomic_add(push, r, k, -head - tail)
            turning = held.torque * wp.normalize(c.edge)
            turning = turning - wp.cross(node(step.dof, r, i), head)
            wp.atomic_add(moment, r, k, turning - wp.cross(node(step.dof, r, i + 1), tail))
        step.bristle[r, k, i] = b
        step.sliding[r, k, i] = slides
        step.turned[r, k, i] = turn
