"""Rigid bodies that hold rods and are moved by them, in the same implicit step.

How the step is solved: `wrod.kernels.stepping.body_system`. Rotations follow the rods' difference
formulas: relative to where it is at the end of the step, a body was turned by the rotation vectors
theta_n and theta_(n-1), and

    omega = (c_1 theta_n + c_2 theta_(n-1)) / dt,    L = R I R^T omega,
    (c_0 L + c_1 L_n + c_2 L_(n-1)) / dt = torque,

so that what nothing turns keeps its angular momentum exactly.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, angle_towards, node, put_node
from wrod.kernels.stepping.pace import Pace


@wp.struct
class Body:
    """Mass, centre of mass and inertia about it in the frame of body `index` of the simulator;
    mass 0 fills a row."""

    index: int
    mass: wp.float64
    centre: wp.vec3d
    inertia: wp.mat33d


@wp.struct
class Hold:
    """What is held: nothing (0), a node (1) or an edge (2), by `body` of the simulator (-1: the
    world), which is in place `slot` of the row if it moves with the rods (-1: something else moves
    it). Of the body's frame: where `node` is, and the edge's frame (tangent, director, their cross
    product); `other` is the node at the signed distance `reach` along the tangent, `edge` the edge
    between the two."""

    kind: int
    body: int
    slot: int
    node: int
    other: int
    edge: int
    reach: wp.float64
    position: wp.vec3d
    rotation: wp.quatd


@wp.struct
class BodyMotion:
    """(row, slot) of bodies at one time: centres of mass, rotations, velocity of the centre and
    angular momentum about it."""

    place: wp.array2d(dtype=wp.vec3d)
    turn: wp.array2d(dtype=wp.quatd)
    velocity: wp.array2d(dtype=wp.vec3d)
    momentum: wp.array2d(dtype=wp.vec3d)


@wp.func
def turned_by(v: wp.vec3d, q: wp.quatd) -> wp.quatd:
    """q after a turn by the rotation vector v."""
    angle = wp.length(v)
    half = HALF * angle
    s = HALF - angle * angle / wp.float64(48.0)
    if angle > wp.float64(1.0e-3):
        s = wp.sin(half) / angle
    turn = wp.quatd(s * v[0], s * v[1], s * v[2], wp.cos(half))
    return wp.normalize(turn * q)


@wp.func
def turn_to(after: wp.quatd, before: wp.quatd) -> wp.vec3d:
    """Rotation vector that takes `before` to `after`, the shorter way."""
    d = after * wp.quat_inverse(before)
    v = wp.vec3d(d[0], d[1], d[2])
    w = d[3]
    if w < ZERO:
        v = -v
        w = -w
    s = wp.length(v)
    if s < wp.float64(1.0e-7):
        return TWO * v
    return (TWO * wp.atan2(s, w) / s) * v


@wp.func
def turned_on(now: wp.quatd, before: wp.quatd) -> wp.quatd:
    """What has turned from `before` to `now`, after as much again."""
    return turned_by(turn_to(now, before), now)


@wp.func
def inertia_of(b: Body, q: wp.quatd) -> wp.mat33d:
    turn = wp.quat_to_matrix(q)
    return turn * b.inertia * wp.transpose(turn)


@wp.func
def spin_of(b: Body, q: wp.quatd, momentum: wp.vec3d) -> wp.vec3d:
    return wp.inverse(inertia_of(b, q)) * momentum


@wp.kernel
def predict_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    pace: Pace,
    before: BodyMotion,
    # State out:
    now: BodyMotion,
):
    """Newton starts where bodies are that move on as they do."""
    r, s = wp.tid()
    b = body[r, s]
    if pace.starting[r] == 0 or b.mass == ZERO:
        return
    q = before.turn[r, s]
    spin = spin_of(b, q, before.momentum[r, s])
    now.place[r, s] = before.place[r, s] + pace.span[r] * before.velocity[r, s]
    now.turn[r, s] = turned_by(pace.span[r] * spin, q)


@wp.kernel
def place_held(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    now: BodyMotion,
    tangent_before: wp.array2d(dtype=wp.vec3d),
    director_before: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    dof: wp.array2d(dtype=wp.float64),
):
    """Put what bodies hold where they are."""
    r, k = wp.tid()
    h = hold[r, k]
    if chosen[r] == 0 or h.kind == 0 or h.slot < 0:
        return
    q = now.turn[r, h.slot]
    p = now.place[r, h.slot] + wp.quat_rotate(q, h.position - body[r, h.slot].centre)
    put_node(dof, r, h.node, p)
    if h.kind == 2:
        frame = q * h.rotation
        tangent = wp.quat_rotate(frame, wp.vec3d(ONE, ZERO, ZERO))
        aim = wp.quat_rotate(frame, wp.vec3d(ZERO, ONE, ZERO))
        put_node(dof, r, h.other, p + h.reach * tangent)
        a = 4 * h.edge + 3
        dof[r, a] = angle_towards(
            aim, tangent, dof[r, a], tangent_before[r, h.edge], director_before[r, h.edge]
        )


@wp.func
def tangent_of(h: Hold, turn: wp.quatd) -> wp.vec3d:
    return wp.quat_rotate(turn * h.rotation, wp.vec3d(ONE, ZERO, ZERO))


@wp.func
def turning_rate(theta: wp.vec3d) -> wp.mat33d:
    """Derivative of the rotation vector that leads back, by the turn at the end, negative."""
    cross = wp.skew(theta)
    return wp.identity(3, dtype=wp.float64) + HALF * cross + (cross * cross) / wp.float64(12.0)


@wp.kernel
def body_balance(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    gravity: wp.array(dtype=wp.vec3d),
    force: wp.array2d(dtype=wp.vec3d),
    torque: wp.array2d(dtype=wp.vec3d),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    before: BodyMotion,
    older: BodyMotion,
    push: wp.array3d(dtype=wp.float64),
    # State in (place, turn) and out (velocity, momentum):
    now: BodyMotion,
    # State out:
    residual_out: wp.array3d(dtype=wp.float64),
    matrix_out: wp.array3d(dtype=wp.float64),
):
    """Residual of every body, with what rods do to it, and its own derivative D (row, slot, 36).
    `push` (row, slot, 7) is what contact adds to the first."""
    r, s = wp.tid()
    b = body[r, s]
    if (pace.active[r] == 0 and pace.converged[r] == 0) or b.mass == ZERO:
        return
    dt = pace.span[r]
    c = pace.coefficient[r]
    x = now.place[r, s]
    q = now.turn[r, s]
    v = (c[0] * x + c[1] * before.place[r, s] + c[2] * older.place[r, s]) / dt
    a = (c[0] * v + c[1] * before.velocity[r, s] + c[2] * older.velocity[r, s]) / dt
    first = turn_to(before.turn[r, s], q)
    second = turn_to(older.turn[r, s], q)
    spin = (c[1] * first + c[2] * second) / dt
    inertia = inertia_of(b, q)
    momentum = inertia * spin
    rate = (c[0] * momentum + c[1] * before.momentum[r, s] + c[2] * older.momentum[r, s]) / dt
    now.velocity[r, s] = v
    now.momentum[r, s] = momentum
    f = b.mass * (a - gravity[r]) - force[r, s]
    t = rate - torque[r, s]
    own = (-c[1] / dt) * turning_rate(first) - (c[2] / dt) * turning_rate(second)
    d = (c[0] / dt) * (inertia * (own + wp.skew(spin)) - wp.skew(momentum))
    for k in range(hold.shape[1]):
        h = hold[r, k]
        if h.kind > 0 and h.slot == s:
            for n in range(h.kind):
                i = wp.where(n == 0, h.node, h.other)
                arm = node(dof, r, i) - x
                g = node(gradient, r, i)
                f = f + g
                t = t + wp.cross(arm, g)
                # A force that does not turn with the body turns it back or on.
                d = d + wp.outer(arm, g) - wp.dot(arm, g) * wp.identity(3, dtype=wp.float64)
            if h.kind == 2:
                along = tangent_of(h, q)
                t = t + gradient[r, 4 * h.edge + 3] * along
                d = d - gradient[r, 4 * h.edge + 3] * wp.skew(along)
    for k in range(36):
        matrix_out[r, s, k] = ZERO
    for k in range(3):
        residual_out[r, s, k] = f[k] + push[r, s, k]
        residual_out[r, s, 3 + k] = t[k] + push[r, s, 3 + k]
        matrix_out[r, s, 7 * k] = matrix_out[r, s, 7 * k] + b.mass * c[0] * c[0] / (dt * dt)
        for n in range(3):
            at = 6 * (3 + k) + 3 + n
            matrix_out[r, s, at] = matrix_out[r, s, at] + d[k, n]


@wp.kernel
def refuse_unbalanced(
    # Model:
    body: wp.array2d(dtype=Body),
    gravity: wp.array(dtype=wp.vec3d),
    force_scale: wp.array(dtype=wp.float64),
    length_scale: wp.array(dtype=wp.float64),
    # State in:
    residual: wp.array3d(dtype=wp.float64),
    push: wp.array3d(dtype=wp.float64),
    # State in and out:
    pace: Pace,
):
    """Take back the convergence of rows whose bodies are not in balance yet."""
    r = wp.tid()
    if pace.converged[r] == 0:
        return
    for s in range(body.shape[1]):
        if body[r, s].mass > ZERO:
            weight = body[r, s].mass * wp.length(gravity[r])
            limit = pace.step_tolerance[r] * (force_scale[r] + weight + push[r, s, 6])
            for k in range(6):
                value = wp.abs(residual[r, s, k])
                if k >= 3:
                    value = value / length_scale[r]
                if not (value <= limit):
                    pace.converged[r] = 0
                    if wp.isfinite(value):
                        pace.active[r] = 1


@wp.kernel
def finish_bodies(
    # State in:
    pace: Pace,
    # State in and out:
    now: BodyMotion,
    before: BodyMotion,
    older: BodyMotion,
):
    """Carry accepted steps over to the next, to their ends, and take rejected ones back."""
    r, s = wp.tid()
    if pace.accepted[r] != 0:
        v = now.velocity[r, s]
        m = now.momentum[r, s]
        if pace.span[r] < pace.step[r]:
            v = TWO * v - before.velocity[r, s]
            m = TWO * m - before.momentum[r, s]
            now.place[r, s] = TWO * now.place[r, s] - before.place[r, s]
            now.turn[r, s] = turned_on(now.turn[r, s], before.turn[r, s])
        older.place[r, s] = before.place[r, s]
        older.turn[r, s] = before.turn[r, s]
        older.velocity[r, s] = before.velocity[r, s]
        older.momentum[r, s] = before.momentum[r, s]
        before.place[r, s] = now.place[r, s]
        before.turn[r, s] = now.turn[r, s]
        before.velocity[r, s] = v
        before.momentum[r, s] = m
    elif pace.rejected[r] != 0:
        now.place[r, s] = before.place[r, s]
        now.turn[r, s] = before.turn[r, s]
