"""The adjoint of what edges of rods and bodies that move with them do to each other
(`wrod.kernels.stepping.body_shapes`), in the steps of `wrod.kernels.stepping.body_adjoint`.

A touch's residuals at the edge's nodes, and its bristle, are followed by where nodes and shape are
(`wrod.kernels.contact.edge_adjoint`); the body has the opposite of them, with their torques about
its centre. So a multiplier of the body takes off from those of the nodes by what it would move
them.
"""

import warp as wp
from wrod.kernels.contact.edge_adjoint import PLACE, TURN, Change, WantedShapes, follow, hold
from wrod.kernels.contact.edges import edge_touch
from wrod.kernels.contact.law import ContactStep, Touchable
from wrod.kernels.contact.shapes import Borne, Shape
from wrod.kernels.elastic.frames import ONE, ZERO, node
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.bodies import BodyMotion
from wrod.kernels.stepping.body_adjoint import WantedBodies, part
from wrod.kernels.stepping.body_shapes import Carried
from wrod.kernels.stepping.trace import Wanted

# Unrolled, its loops take a GPU's compiler two or three times as long.
wp.set_module_options({"max_unroll": 1})


@wp.struct
class Arms:
    """Of an edge's nodes about a body's centre, and the residuals there."""

    head: wp.vec3d
    tail: wp.vec3d
    at_head: wp.vec3d
    at_tail: wp.vec3d


@wp.func
def unit(c: int) -> wp.vec3d:
    out = wp.vec3d(ZERO, ZERO, ZERO)
    out[c] = ONE
    return out


@wp.func
def torque_of(x: Arms, by: Change) -> wp.vec3d:
    return wp.cross(x.head, by.at_head) + wp.cross(x.tail, by.at_tail)


@wp.func
def add_six(
    to: wp.array3d(dtype=wp.float64), r: int, j: int, a: int, push: wp.vec3d, turn: wp.vec3d
):
    """Subtract from six rows of a column."""
    for d in range(3):
        wp.atomic_add(to, r, j + d, a, -push[d])
        wp.atomic_add(to, r, j + 3 + d, a, -turn[d])


@wp.kernel
def weigh_touches(
    # Model:
    model: Touchable,
    carried: Carried,
    # State in:
    step: ContactStep,
    now: Wanted,
    at: BodyMotion,
    # State in and out:
    load: wp.array3d(dtype=wp.float64),
    press: wp.array3d(dtype=wp.float64),
    on_bodies: wp.array3d(dtype=wp.float64),
    by_bodies: wp.array3d(dtype=wp.float64),
):
    """Add to the bodies' system what touches have in it: derivatives of the bodies' residuals by
    their motions (`press`) and by the rods (`on_bodies`, of a row of six a body), of the rods' by
    the motions of bodies (`by_bodies`), and to the right-hand side what is wanted of bristles at
    the end of the step. Launched over (rod, edge)."""
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
        h = hold(model, step, c, r, k, i)
        x = Arms()
        x.head = node(step.dof, r, i) - at.place[r, s]
        x.tail = node(step.dof, r, i + 1) - at.place[r, s]
        x.at_head = (ONE - c.near.s) * h.pull - h.force * c.near.head
        x.at_tail = c.near.s * h.pull - h.force * c.near.tail
        j = 6 * s
        for b in range(6):
            by = follow(h, b)
            at_node = wp.where(b < 3, x.at_head, x.at_tail)
            turn = torque_of(x, by) + wp.cross(unit(b % 3), at_node)
            add_six(on_bodies, r, j, 4 * (i + b / 3) + b % 3, by.at_head + by.at_tail, turn)
        y = now.edge_bristle[r, k, i]
        off = model.shapes[r, k].position - at.place[r, s]
        for b in range(6):
            by = Change()
            arms_move = wp.vec3d(ZERO, ZERO, ZERO)
            if b < 3:
                by = follow(h, PLACE + b)
                arms_move = -wp.cross(unit(b), x.at_head + x.at_tail)
            else:
                by = follow(h, TURN + b - 3)
                way = wp.cross(unit(b - 3), off)
                for d in range(3):
                    shifted = follow(h, PLACE + d)
                    by.at_head = by.at_head + way[d] * shifted.at_head
                    by.at_tail = by.at_tail + way[d] * shifted.at_tail
                    by.bristle = by.bristle + way[d] * shifted.bristle
            for d in range(3):
                wp.atomic_add(by_bodies, r, j + b, 4 * i + d, by.at_head[d])
                wp.atomic_add(by_bodies, r, j + b, 4 * i + 4 + d, by.at_tail[d])
            add_six(press, r, j, j + b, by.at_head + by.at_tail, torque_of(x, by) + arms_move)
            wp.atomic_add(load, r, s, b, wp.dot(y, by.bristle))


@wp.kernel
def add_touches(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    # In:
    active: wp.array(dtype=wp.int32),
    on_bodies: wp.array3d(dtype=wp.float64),
    # In and out:
    column: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=ALONE),
):
    """To A^T V, and to right-hand sides. Launched over (row, motion, dof)."""
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    value = column[r, j, a] + on_bodies[r, j, a]
    column[r, j, a] = value
    if free[r, a] != 0:
        x[r, 1 + j, a] = ALONE(value)


@wp.kernel
def want_held(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    # In:
    active: wp.array(dtype=wp.int32),
    on_bodies: wp.array3d(dtype=wp.float64),
    multiplier: wp.array2d(dtype=wp.float64),
    # In and out:
    wanted: wp.array2d(dtype=wp.float64),
):
    """What the bodies' balance wants of what is not free. Launched over (row, dof)."""
    r, a = wp.tid()
    if active[r] == 0 or free[r, a] != 0:
        return
    value = wp.float64(0.0)
    for j in range(on_bodies.shape[1]):
        value += on_bodies[r, j, a] * multiplier[r, j]
    wanted[r, a] = wanted[r, a] - value


@wp.kernel
def bear(
    # Model:
    carried: Carried,
    # State in:
    active: wp.array(dtype=wp.int32),
    at: BodyMotion,
    multiplier: wp.array2d(dtype=wp.float64),
    # Out:
    out: Borne,
):
    """How multipliers of bodies would move the shapes that they carry. Launched over (row,
    shape)."""
    r, k = wp.tid()
    s = carried.slot[r, k]
    if s < 0 or active[r] == 0:
        return
    turn = part(multiplier, r, 6 * s + 3)
    out.turn[r, k] = turn
    out.shift[r, k] = part(multiplier, r, 6 * s) - wp.cross(turn, at.place[r, s])


@wp.kernel
def want_carriers_before(
    # Model:
    carried: Carried,
    shape: wp.array2d(dtype=Shape),
    # State in:
    active: wp.array(dtype=wp.int32),
    before: BodyMotion,
    # State in and out:
    by_shape: WantedShapes,
    wanted: WantedBodies,
):
    """From shapes at the start of the step to their bodies; those at its end are in the system.
    Launched over (row, shape)."""
    r, k = wp.tid()
    s = carried.slot[r, k]
    if s < 0 or active[r] == 0:
        return
    none = wp.vec3d(ZERO, ZERO, ZERO)
    g = by_shape.place_at_start[r, k]
    turn = by_shape.turn_at_start[r, k]
    by_shape.place[r, k] = none
    by_shape.turn[r, k] = none
    by_shape.place_at_start[r, k] = none
    by_shape.turn_at_start[r, k] = none
    arm = shape[r, k].position_before - before.place[r, s]
    wp.atomic_add(wanted.place, r, s, g)
    wp.atomic_add(wanted.turn, r, s, turn + wp.cross(arm, g))
