"""Rolling friction: what touches a shape holds its roll up to a torque of mu_r N R.

Friction of the centreline (`wrod.kernels.contact.law`) does not know of the rod's turning about
its axis, which decides where a naturally curved rod bends. A bristle between the angle of the rod
and the shape holds it as one of the tangential stiffness at the rod's surface would, k R^2, and
slides on where its torque exceeds the bound: below it the rod does not creep however long it is
loaded, above it it rolls, whatever the time step. Turning about the normal, where the rod lies
along a shape, is held by the friction of its nodes.
"""

import warp as wp
from wrod.kernels.contact.law import ContactStep, Touchable, present_force
from wrod.kernels.contact.planes import mean_angle, touch
from wrod.kernels.contact.shapes import Shape, shape_turn
from wrod.kernels.elastic.assembly import add_component, add_entry
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge


@wp.func
def held_turn(turn: wp.float64, stiffness: wp.float64, limit: wp.float64) -> wp.vec2d:
    """Torque of a bristle that is turned so far, and its stiffness: none where it slides."""
    torque = stiffness * turn
    if wp.abs(torque) > limit:
        return wp.vec2d(wp.sign(turn) * limit, ZERO)
    return wp.vec2d(torque, stiffness)


@wp.struct
class Rolled:
    """Torque of such a bristle and its stiffness, that which it would have if it held; and where it
    slides, by how much its torque follows the normal force and the coefficient."""

    torque: wp.float64
    stiffness: wp.float64
    whole: wp.float64
    per_force: wp.float64
    per_coefficient: wp.float64


@wp.func
def rolled(
    turn: wp.float64, stiffness: wp.float64, arm: wp.float64, mu: wp.float64, force: wp.float64
) -> Rolled:
    out = Rolled()
    out.whole = stiffness * arm * arm
    held = held_turn(turn, out.whole, mu * force * arm)
    out.torque = held[0]
    out.stiffness = held[1]
    if held[1] == ZERO:
        out.per_coefficient = wp.sign(turn) * force * arm
        out.per_force = wp.sign(turn) * mu * arm
    return out


@wp.func
def by_logarithms(h: Rolled, by_step: wp.float64, by_end: wp.float64) -> wp.vec2d:
    """What is wanted of the logarithms of the stiffness and of the radius at a given normal force,
    if so much is wanted of the torque, by the step and by what the bristle remembers."""
    if h.per_coefficient == ZERO:
        return wp.vec2d(h.torque * by_step, wp.float64(2.0) * h.torque * by_step)
    return wp.vec2d(-h.torque * by_end, h.torque * (by_step - by_end))


@wp.func
def edge_rolled(
    m: Touchable,
    step: ContactStep,
    stiffness: wp.float64,
    force: wp.float64,
    r: int,
    k: int,
    i: int,
) -> Rolled:
    spun = step.dof[r, 4 * i + 3] - step.dof_before[r, 4 * i + 3]
    turn = step.turned[r, k, i] + spun
    turn -= shape_turn(m.shapes[r, k], wp.normalize(edge(step.dof, r, i)))
    return rolled(turn, stiffness, wp.abs(m.radius[r, i]), m.roll_friction[r, k], force)


@wp.struct
class ShapeTurned:
    """How the turn of a shape about an edge follows the edge, and rotations of the shape now and at
    the start of the step."""

    by_edge: wp.vec3d
    now: wp.vec3d
    at_start: wp.vec3d


@wp.func
def follow_turn(shape: Shape, e: wp.vec3d) -> ShapeTurned:
    """Of `shape_turn`."""
    d = shape.rotation * wp.quat_inverse(shape.rotation_before)
    sign = wp.where(d[3] < wp.float64(0.0), -ONE, ONE)
    v = sign * wp.vec3d(d[0], d[1], d[2])
    w = sign * d[3]
    length = wp.length(e)
    t = e / length
    out = ShapeTurned()
    out.by_edge = (TWO / length) * (v - wp.dot(v, t) * t)
    out.now = w * t + wp.cross(v, t)
    out.at_start = wp.cross(v, t) - w * t
    return out


@wp.func
def node_turn(step: ContactStep, r: int, k: int, i: int) -> wp.float64:
    turned = step.turned[r, k, i] + mean_angle(step.dof, r, i)
    return turned - mean_angle(step.dof_before, r, i)


@wp.func
def node_rolled(
    m: Touchable, step: ContactStep, force: wp.float64, r: int, k: int, i: int
) -> Rolled:
    turn = node_turn(step, r, k, i)
    return rolled(turn, m.stiffness[r, i], m.radius[r, i], m.roll_friction[r, k], force)


@wp.kernel
def hold_roll(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Add the torques on the angles of the edges around nodes in contact: half each, all at an end.

    A coefficient below 0 is that of a rod which rolls freely.
    """
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    last = gradient.shape[1] // 4
    for k in range(model.shapes.shape[1]):
        if model.roll_friction[r, k] < ZERO:
            continue
        c = touch(model, step, r, k, i)
        if c.force > ZERO:
            law = present_force(model, c.depth, c.closing, step.span[r], r, i)
            held = node_rolled(model, step, law[0], r, k, i)
            inner = i > 0 and i < last
            share = wp.where(inner, HALF, ONE)
            for side in range(2):
                a = 4 * i - 1 + 4 * side
                if a > 0 and i + side <= last:
                    add_component(gradient, r, a, share * held.torque)
                    add_entry(hessian, r, a, 0, share * share * held.stiffness)
            if inner:
                add_entry(hessian, r, 4 * i + 3, 4, share * share * held.stiffness)


@wp.kernel
def settle_roll(
    # Model:
    model: Touchable,
    # State in and out:
    step: ContactStep,
):
    """After an accepted step: let overloaded bristles slide."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        if model.roll_friction[r, k] < ZERO or model.shapes[r, k].kind != 0:
            continue
        c = touch(model, step, r, k, i)
        turn = wp.float64(0.0)
        if c.force > ZERO:
            law = present_force(model, c.depth, c.closing, step.span[r], r, i)
            held = node_rolled(model, step, law[0], r, k, i)
            turn = held.torque / held.whole
        step.turned[r, k, i] = turn
