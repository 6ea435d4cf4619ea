"""Rigid bodies that hold rods and are moved by them, in the same implicit step.

A body has six unknowns: its centre of mass x and its rotation R. What it holds of a rod, nodes and
angles, is a function of them. With V the motion of all degrees of freedom under the six motions of
a body (a turn phi moves a point at x + d by phi x d and an angle by phi . t), K the rods' matrix
and g their residual, a Newton step of the free part (f) and of the bodies solves

    K_ff x + C_f xi = g_f,    C_f^T x + (V^T C + D) xi = r + V^T g,    C = K V,

where r is the residual of the bodies alone and D its derivative. The rods are eliminated: one
right-hand side for each motion of a body, and a small dense system for xi is left (a Schur
complement). Forces between rod and body are equal and opposite to the last bit.

Rotations follow the rods' difference formulas: relative to where it is at the end of the step, a
body was turned by the rotation vectors theta_n and theta_(n-1), and

    omega = (c_1 theta_n + c_2 theta_(n-1)) / dt,    L = R I R^T omega,
    (c_0 L + c_1 L_n + c_2 L_(n-1)) / dt = torque,

so that what nothing turns keeps its angular momentum exactly.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, angle_towards, node

wp.set_module_options({"enable_backward": False})

# Largest turn of a body in one Newton iteration [rad].
LARGEST_TURN = wp.constant(wp.float64(0.5))


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
class Motion:
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
    chosen: wp.array(dtype=wp.int32),
    span: wp.array(dtype=wp.float64),
    before: Motion,
    # State out:
    now: Motion,
):
    """Newton starts where bodies are that move on as they do."""
    r, s = wp.tid()
    b = body[r, s]
    if chosen[r] == 0 or b.mass == ZERO:
        return
    q = before.turn[r, s]
    spin = spin_of(b, q, before.momentum[r, s])
    now.place[r, s] = before.place[r, s] + span[r] * before.velocity[r, s]
    now.turn[r, s] = turned_by(span[r] * spin, q)


@wp.kernel
def place_held(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    now: Motion,
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
    for c in range(3):
        dof[r, 4 * h.node + c] = p[c]
    if h.kind == 2:
        frame = q * h.rotation
        tangent = wp.quat_rotate(frame, wp.vec3d(ONE, ZERO, ZERO))
        aim = wp.quat_rotate(frame, wp.vec3d(ZERO, ONE, ZERO))
        for c in range(3):
            dof[r, 4 * h.other + c] = p[c] + h.reach * tangent[c]
        a = 4 * h.edge + 3
        dof[r, a] = angle_towards(
            aim, tangent, dof[r, a], tangent_before[r, h.edge], director_before[r, h.edge]
        )


@wp.func
def tangent_of(h: Hold, turn: wp.quatd) -> wp.vec3d:
    return wp.quat_rotate(turn * h.rotation, wp.vec3d(ONE, ZERO, ZERO))


@wp.kernel
def carry_velocity(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    before: Motion,
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    velocity_out: wp.array2d(dtype=wp.float64),
):
    """What bodies hold moves with them."""
    r, k = wp.tid()
    h = hold[r, k]
    if chosen[r] == 0 or h.kind == 0 or h.slot < 0:
        return
    spin = spin_of(body[r, h.slot], before.turn[r, h.slot], before.momentum[r, h.slot])
    for n in range(h.kind):
        i = wp.where(n == 0, h.node, h.other)
        arm = node(dof, r, i) - before.place[r, h.slot]
        v = before.velocity[r, h.slot] + wp.cross(spin, arm)
        for c in range(3):
            velocity_out[r, 4 * i + c] = v[c]
    if h.kind == 2:
        velocity_out[r, 4 * h.edge + 3] = wp.dot(spin, tangent_of(h, before.turn[r, h.slot]))


@wp.func
def write_motion(motion: wp.array3d(dtype=wp.float64), r: int, j: int, a: int, arm: wp.vec3d):
    """Columns j to j + 5 of the node at degree of freedom a: shift, and turn phi x arm."""
    for c in range(3):
        motion[r, j + c, a + c] = ONE
    motion[r, j + 3, a + 1] = -arm[2]
    motion[r, j + 3, a + 2] = arm[1]
    motion[r, j + 4, a] = arm[2]
    motion[r, j + 4, a + 2] = -arm[0]
    motion[r, j + 5, a] = -arm[1]
    motion[r, j + 5, a + 1] = arm[0]


@wp.kernel
def spread_motion(
    # Model:
    hold: wp.array2d(dtype=Hold),
    # State in:
    active: wp.array(dtype=wp.int32),
    now: Motion,
    dof: wp.array2d(dtype=wp.float64),
    # Out:
    motion_out: wp.array3d(dtype=wp.float64),
):
    """V: what the motions of a body do to what it holds; all else is and stays 0."""
    r, k = wp.tid()
    h = hold[r, k]
    if active[r] == 0 or h.kind == 0 or h.slot < 0:
        return
    j = 6 * h.slot
    place = now.place[r, h.slot]
    write_motion(motion_out, r, j, 4 * h.node, node(dof, r, h.node) - place)
    if h.kind == 2:
        write_motion(motion_out, r, j, 4 * h.other, node(dof, r, h.other) - place)
        t = tangent_of(h, now.turn[r, h.slot])
        for c in range(3):
            motion_out[r, j + 3 + c, 4 * h.edge + 3] = t[c]


@wp.func
def turning_rate(theta: wp.vec3d) -> wp.mat33d:
    """Derivative of the rotation vector that leads back, by the turn at the end, negative."""
    cross = wp.skew(theta)
    return wp.identity(3, dtype=wp.float64) + HALF * cross + (cross * cross) / wp.float64(12.0)


@wp.func
def held_force(gradient: wp.array2d(dtype=wp.float64), r: int, i: int) -> wp.vec3d:
    return wp.vec3d(gradient[r, 4 * i], gradient[r, 4 * i + 1], gradient[r, 4 * i + 2])


@wp.kernel
def body_balance(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    gravity: wp.array(dtype=wp.vec3d),
    force: wp.array2d(dtype=wp.vec3d),
    torque: wp.array2d(dtype=wp.vec3d),
    # State in:
    active: wp.array(dtype=wp.int32),
    converged: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    before: Motion,
    older: Motion,
    push: wp.array3d(dtype=wp.float64),
    # State in (place, turn) and out (velocity, momentum):
    now: Motion,
    # State out:
    residual_out: wp.array3d(dtype=wp.float64),
    matrix_out: wp.array3d(dtype=wp.float64),
):
    """Residual of every body, with what rods do to it, and its own derivative D (row, slot, 36).
    `push` (row, slot, 42) is what contact adds to both."""
    r, s = wp.tid()
    b = body[r, s]
    if (active[r] == 0 and converged[r] == 0) or b.mass == ZERO:
        return
    dt = step[r]
    c = coefficient[r]
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
                g = held_force(gradient, r, i)
                f = f + g
                t = t + wp.cross(arm, g)
                # A force that does not turn with the body turns it back or on.
                d = d + wp.outer(arm, g) - wp.dot(arm, g) * wp.identity(3, dtype=wp.float64)
            if h.kind == 2:
                along = tangent_of(h, q)
                t = t + gradient[r, 4 * h.edge + 3] * along
                d = d - gradient[r, 4 * h.edge + 3] * wp.skew(along)
    for k in range(36):
        matrix_out[r, s, k] = push[r, s, 6 + k]
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
    tolerance: wp.array(dtype=wp.float64),
    # State in:
    residual: wp.array3d(dtype=wp.float64),
    # State in and out:
    converged: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
):
    """Take back the convergence of rows whose bodies are not in balance yet."""
    r = wp.tid()
    if converged[r] == 0:
        return
    for s in range(body.shape[1]):
        if body[r, s].mass > ZERO:
            limit = tolerance[r] * (force_scale[r] + body[r, s].mass * wp.length(gravity[r]))
            for k in range(6):
                value = wp.abs(residual[r, s, k])
                if k >= 3:
                    value = value / length_scale[r]
                if not (value <= limit):
                    converged[r] = 0
                    if wp.isfinite(value):
                        active[r] = 1


@wp.kernel
def load_bodies(
    # In:
    active: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    column: wp.array3d(dtype=wp.float64),
    # Out:
    rhs_out: wp.array3d(dtype=wp.float64),
):
    """Right-hand sides: the gradient, then C."""
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    if j == 0:
        rhs_out[r, 0, a] = gradient[r, a]
    else:
        rhs_out[r, j, a] = column[r, j - 1, a]


@wp.kernel
def condense(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    motion: wp.array3d(dtype=wp.float64),
    column: wp.array3d(dtype=wp.float64),
    solution: wp.array3d(dtype=wp.float64),
    residual: wp.array3d(dtype=wp.float64),
    matrix: wp.array3d(dtype=wp.float64),
    # Out:
    small_out: wp.array3d(dtype=wp.float64),
):
    """The bodies' system, its right-hand side in the last column. Launched over (row, motion,
    motion + 1)."""
    r, j, k = wp.tid()
    if active[r] == 0:
        return
    n = motion.shape[1]
    value = wp.float64(0.0)
    for a in range(free.shape[1]):
        if free[r, a] != 0:
            value -= column[r, j, a] * solution[r, wp.where(k == n, 0, k + 1), a]
        elif k < n:
            value += motion[r, j, a] * column[r, k, a]
    if k == n:
        value += residual[r, j // 6, j % 6]
    elif j // 6 == k // 6:
        value += matrix[r, j // 6, 6 * (j % 6) + k % 6]
    small_out[r, j, k] = value


@wp.kernel
def solve_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    active: wp.array(dtype=wp.int32),
    # State in and out:
    small: wp.array3d(dtype=wp.float64),
    # Out:
    step_out: wp.array2d(dtype=wp.float64),
    fraction_out: wp.array(dtype=wp.float64),
):
    """Gaussian elimination with partial pivoting; the solution, and how much of it to take."""
    r = wp.tid()
    if active[r] == 0:
        return
    n = small.shape[1]
    for s in range(body.shape[1]):
        if body[r, s].mass == ZERO:
            for k in range(6):
                small[r, 6 * s + k, 6 * s + k] = ONE
    for k in range(n):
        best = int(k)
        for i in range(k + 1, n):
            if wp.abs(small[r, i, k]) > wp.abs(small[r, best, k]):
                best = int(i)
        if best != k:
            for m in range(k, n + 1):
                swap = small[r, k, m]
                small[r, k, m] = small[r, best, m]
                small[r, best, m] = swap
        for i in range(k + 1, n):
            factor = small[r, i, k] / small[r, k, k]
            for m in range(k + 1, n + 1):
                small[r, i, m] = small[r, i, m] - factor * small[r, k, m]
    fraction = wp.float64(1.0)
    for back in range(n):
        i = n - 1 - back
        value = small[r, i, n]
        for m in range(i + 1, n):
            value -= small[r, i, m] * step_out[r, m]
        step_out[r, i] = value / small[r, i, i]
    for s in range(body.shape[1]):
        a = 6 * s + 3
        turn = wp.length(wp.vec3d(step_out[r, a], step_out[r, a + 1], step_out[r, a + 2]))
        if turn * fraction > LARGEST_TURN:
            fraction = LARGEST_TURN / turn
    fraction_out[r] = fraction


@wp.kernel
def combine(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    motion: wp.array3d(dtype=wp.float64),
    step: wp.array2d(dtype=wp.float64),
    fraction: wp.array(dtype=wp.float64),
    # In and out:
    x: wp.array3d(dtype=wp.float64),
):
    """The rods' part of the Newton step, with what bodies hold."""
    r, a = wp.tid()
    if active[r] == 0:
        return
    value = x[r, 0, a]
    for j in range(step.shape[1]):
        if free[r, a] != 0:
            value -= x[r, j + 1, a] * step[r, j]
        else:
            value += motion[r, j, a] * step[r, j]
    x[r, 0, a] = fraction[r] * value


@wp.kernel
def move_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    active: wp.array(dtype=wp.int32),
    step: wp.array2d(dtype=wp.float64),
    fraction: wp.array(dtype=wp.float64),
    shortened: wp.array(dtype=wp.float64),
    taken: wp.array(dtype=wp.float64),
    # State in and out:
    now: Motion,
):
    """As much of the bodies' Newton step as rods took of theirs."""
    r, s = wp.tid()
    if active[r] == 0 or body[r, s].mass == ZERO:
        return
    f = -fraction[r] * shortened[r] * taken[r]
    j = 6 * s
    turn = f * wp.vec3d(step[r, j + 3], step[r, j + 4], step[r, j + 5])
    now.place[r, s] = now.place[r, s] + f * wp.vec3d(step[r, j], step[r, j + 1], step[r, j + 2])
    now.turn[r, s] = turned_by(turn, now.turn[r, s])


@wp.kernel
def finish_bodies(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    rejected: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    span: wp.array(dtype=wp.float64),
    # State in and out:
    now: Motion,
    before: Motion,
    older: Motion,
):
    """Carry accepted steps over to the next, to their ends, and take rejected ones back."""
    r, s = wp.tid()
    if accepted[r] != 0:
        v = now.velocity[r, s]
        m = now.momentum[r, s]
        if span[r] < step[r]:
            v = TWO * v - before.velocity[r, s]
            m = TWO * m - before.momentum[r, s]
            turn = turn_to(now.turn[r, s], before.turn[r, s])
            now.place[r, s] = TWO * now.place[r, s] - before.place[r, s]
            now.turn[r, s] = turned_by(turn, now.turn[r, s])
        older.place[r, s] = before.place[r, s]
        older.turn[r, s] = before.turn[r, s]
        older.velocity[r, s] = before.velocity[r, s]
        older.momentum[r, s] = before.momentum[r, s]
        before.place[r, s] = now.place[r, s]
        before.turn[r, s] = now.turn[r, s]
        before.velocity[r, s] = v
        before.momentum[r, s] = m
    elif rejected[r] != 0:
        now.place[r, s] = before.place[r, s]
        now.turn[r, s] = before.turn[r, s]


@wp.kernel
def find_moved_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    body_q: wp.array(dtype=wp.transform),
    body_qd: wp.array(dtype=wp.spatial_vector),
    written_q: wp.array2d(dtype=wp.transform),
    written_qd: wp.array2d(dtype=wp.spatial_vector),
    # State out:
    changed_out: wp.array(dtype=wp.int32),
):
    """Say of which rows a body is not where `write_bodies` last put it."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    pose = body_q[b.index]
    speed = body_qd[b.index]
    written_pose = written_q[r, s]
    written_speed = written_qd[r, s]
    for k in range(7):
        if pose[k] != written_pose[k]:
            changed_out[r] = 1
    for k in range(6):
        if speed[k] != written_speed[k]:
            changed_out[r] = 1


@wp.func
def wide(v: wp.vec3) -> wp.vec3d:
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def narrow(v: wp.vec3d) -> wp.vec3:
    return wp.vec3(float(v[0]), float(v[1]), float(v[2]))


@wp.kernel
def read_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    body_q: wp.array(dtype=wp.transform),
    body_qd: wp.array(dtype=wp.spatial_vector),
    body_f: wp.array(dtype=wp.spatial_vector),
    # State out:
    now: Motion,
    before: Motion,
    force_out: wp.array2d(dtype=wp.vec3d),
    torque_out: wp.array2d(dtype=wp.vec3d),
):
    """Pose and velocity of the bodies of the chosen rows, and the forces on all."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    force_out[r, s] = wide(wp.spatial_top(body_f[b.index]))
    torque_out[r, s] = wide(wp.spatial_bottom(body_f[b.index]))
    if chosen[r] == 0:
        return
    pose = body_q[b.index]
    q = wp.transform_get_rotation(pose)
    turn = wp.normalize(
        wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3]))
    )
    place = wide(wp.transform_get_translation(pose)) + wp.quat_rotate(turn, b.centre)
    now.place[r, s] = place
    now.turn[r, s] = turn
    before.place[r, s] = place
    before.turn[r, s] = turn
    before.velocity[r, s] = wide(wp.spatial_top(body_qd[b.index]))
    before.momentum[r, s] = inertia_of(b, turn) * wide(wp.spatial_bottom(body_qd[b.index]))


@wp.kernel
def write_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    now: Motion,
    before: Motion,
    # State out:
    body_q_out: wp.array(dtype=wp.transform),
    body_qd_out: wp.array(dtype=wp.spatial_vector),
    written_q_out: wp.array2d(dtype=wp.transform),
    written_qd_out: wp.array2d(dtype=wp.spatial_vector),
):
    """Give out where the bodies are, in the simulator's precision."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    q = now.turn[r, s]
    origin = now.place[r, s] - wp.quat_rotate(q, b.centre)
    pose = wp.transform(narrow(origin), wp.quat(float(q[0]), float(q[1]), float(q[2]), float(q[3])))
    v = narrow(before.velocity[r, s])
    w = narrow(spin_of(b, q, before.momentum[r, s]))
    speed = wp.spatial_vector(v[0], v[1], v[2], w[0], w[1], w[2])
    body_q_out[b.index] = pose
    body_qd_out[b.index] = speed
    written_q_out[r, s] = pose
    written_qd_out[r, s] = speed
