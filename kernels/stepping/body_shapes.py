"""Shapes on rigid bodies that move with the rods which touch them, in the same implicit step.

The force of an edge's touch (`wrod.kernels.contact.edges`) depends on the edge's two nodes as the
body sees them. Moving the body by xi is, to the edge, moving the nodes by -W xi, W = (1, -arm x),
and turning the force with the body. With g the touch's residual and H its matrix by the nodes,

    dg/dxi = -H W + (0, phi x g),    residual of the body = -W^T g:

the first is what the touch adds to C of `wrod.kernels.stepping.body_system`, the second is equal
and opposite at the same point. As H, both leave out what would not be symmetric.
"""

import warp as wp
from wrod.kernels.contact.closest import closest_on_edge, within_reach
from wrod.kernels.contact.depths import SHARP
from wrod.kernels.contact.duals import bristle_stiffness
from wrod.kernels.contact.edges import edge_blocks, edge_touch, hold_edge
from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.contact.shapes import WITH_RODS, Shape
from wrod.kernels.elastic.frames import TWO, ZERO, node
from wrod.kernels.stepping.bodies import Body, BodyMotion, turned_on
from wrod.kernels.stepping.body_contact import add_push, pose_in_row


@wp.struct
class Carried:
    """(row, shape): the place in its row of the body that carries a shape (-1: of none), and where
    the shape is in the body's frame."""

    slot: wp.array2d(dtype=wp.int32)
    place: wp.array2d(dtype=wp.vec3d)
    turn: wp.array2d(dtype=wp.quatd)


@wp.kernel
def place_shapes(
    # Model:
    body: wp.array2d(dtype=Body),
    carried: Carried,
    # State in:
    chosen: wp.array(dtype=wp.int32),
    now: BodyMotion,
    before: BodyMotion,
    span: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    at_end: int,
    # State out:
    shape_out: wp.array2d(dtype=Shape),
):
    """Put shapes to where their bodies are, at the end of the step if asked."""
    r, k = wp.tid()
    s = carried.slot[r, k]
    if chosen[r] == 0 or s < 0:
        return
    start = pose_in_row(body, before, r, s)
    end = pose_in_row(body, now, r, s)
    if at_end != 0 and span[r] < step[r]:
        end.rotation = turned_on(now.turn[r, s], before.turn[r, s])
        centre = TWO * now.place[r, s] - before.place[r, s]
        end.position = centre - wp.quat_rotate(end.rotation, body[r, s].centre)
    out = shape_out[r, k]
    out.moves = WITH_RODS
    out.position_before = start.position + wp.quat_rotate(start.rotation, carried.place[r, k])
    out.rotation_before = start.rotation * carried.turn[r, k]
    out.position = end.position + wp.quat_rotate(end.rotation, carried.place[r, k])
    out.rotation = end.rotation * carried.turn[r, k]
    shape_out[r, k] = out


@wp.func
def add_columns(
    touch: wp.array3d(dtype=wp.float64), r: int, j: int, a: int, by_shift: wp.mat33d,
    by_turn: wp.mat33d,
):  # fmt: skip
    for c in range(3):
        for d in range(3):
            wp.atomic_add(touch, r, j + c, a + d, by_shift[d, c])
            wp.atomic_add(touch, r, j + 3 + c, a + d, by_turn[d, c])


@wp.func
def add_press(
    press: wp.array3d(dtype=wp.float64), r: int, j: int, k: int, block: wp.mat33d
):  # fmt: skip
    for c in range(3):
        for d in range(3):
            wp.atomic_add(press, r, j + c, k + d, block[c, d])


@wp.kernel
def push_carriers(
    # Model:
    model: Touchable,
    carried: Carried,
    # State in:
    step: ContactStep,
    now: BodyMotion,
    # State in and out:
    push: wp.array3d(dtype=wp.float64),
    press: wp.array3d(dtype=wp.float64),
    touch: wp.array3d(dtype=wp.float64),
):
    """Add what edges do to the bodies whose shapes they touch, subtracted as in residuals, and the
    derivatives by the motions of these bodies; after `edge_contact`, which says duals."""
    r, i = wp.tid()
    if step.active[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        s = carried.slot[r, k]
        if s < 0:
            continue
        c = edge_touch(model, step, r, k, i)
        if c.force <= ZERO:
            continue
        a = 4 * i
        held = hold_edge(model, step, c, r, k, i)
        if held.slides > ZERO:
            w = step.dual[r, k, i]
            held.tangential = bristle_stiffness(
                c.bristle, w, c.near.normal, c.stiffness, held.limit
            )
        b = edge_blocks(c, held)
        j = 6 * s
        place = now.place[r, s]
        to_head = node(step.dof, r, i) - place
        to_tail = node(step.dof, r, i + 1) - place
        arm_head = wp.skew(to_head)
        arm_tail = wp.skew(to_tail)
        across = wp.transpose(b.mixed)
        by_shift_head = -(b.head + across)
        by_shift_tail = -(b.mixed + b.tail)
        by_turn_head = b.head * arm_head + across * arm_tail - wp.skew(b.at_head)
        by_turn_tail = b.mixed * arm_head + b.tail * arm_tail - wp.skew(b.at_tail)
        add_columns(touch, r, j, a, by_shift_head, by_turn_head)
        add_columns(touch, r, j, a + 4, by_shift_tail, by_turn_tail)
        total = b.at_head + b.at_tail
        add_push(push, r, s, -b.at_head, to_head)
        add_push(push, r, s, -b.at_tail, to_tail)
        add_press(press, r, j, j, -(by_shift_head + by_shift_tail))
        add_press(press, r, j, j + 3, -(by_turn_head + by_turn_tail))
        corner = arm_head * by_shift_head + arm_tail * by_shift_tail + wp.skew(total)
        add_press(press, r, j + 3, j, -corner)
        add_press(press, r, j + 3, j + 3, -(arm_head * by_turn_head + arm_tail * by_turn_tail))
        if held.torque != ZERO:
            along = wp.normalize(c.edge)
            add_press(press, r, j + 3, j + 3, held.turning * wp.outer(along, along))
            for d in range(3):
                wp.atomic_add(push, r, s, 3 + d, -held.torque * along[d])
                wp.atomic_add(touch, r, j + 3 + d, a + 3, -held.turning * along[d])


@wp.kernel
def add_touch(
    # In:
    active: wp.array(dtype=wp.int32),
    touch: wp.array3d(dtype=wp.float64),
    # In and out:
    column: wp.array3d(dtype=wp.float64),
):
    """C, with what touches between rods and bodies add to K V."""
    r, j, a = wp.tid()
    if active[r] != 0:
        column[r, j, a] = column[r, j, a] + touch[r, j, a]


@wp.kernel
def measure_overlaps(
    # Model:
    shapes: wp.array2d(dtype=Shape),
    carried: Carried,
    radius: wp.array2d(dtype=wp.float64),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    # Out:
    depth_out: wp.array3d(dtype=wp.float64),
):
    """(row, shape, edge) how deep edges are in carried shapes, over the radius; 0 apart."""
    r, k, i = wp.tid()
    if carried.slot[r, k] < 0 or radius[r, i] <= ZERO:
        return
    q = node(dof, r, i)
    e = node(dof, r, i + 1) - q
    if within_reach(shapes[r, k], q, e, radius[r, i]):
        c = closest_on_edge(shapes[r, k], q, e, SHARP * wp.length(e))
        depth_out[r, k, i] = wp.max(ZERO, radius[r, i] - c.distance) / radius[r, i]
