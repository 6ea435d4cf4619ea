"""The adjoint of what a simulator and steps exchange of bodies (`body_exchange`): see
`exchange_adjoint`, and `body_adjoint` for the steps."""

import warp as wp
from wrod.kernels.elastic.frames import TWO, ZERO, node, put_node
from wrod.kernels.stepping.bodies import Body, Hold, inertia_of, spin_of, tangent_of
from wrod.kernels.stepping.body_adjoint import BodySteps, WantedBodies, part
from wrod.kernels.stepping.exchange import OutsideNode
from wrod.kernels.stepping.exchange_adjoint import by_turn
from wrod.kernels.stepping.trace import OneStep, Wanted


@wp.kernel
def want_reach(
    # Model:
    hold: wp.array2d(dtype=Hold),
    place: wp.array2d(dtype=OutsideNode),
    # State in:
    at: OneStep,
    gradient: wp.array2d(dtype=wp.float64),
    step: BodySteps,
    multiplier: wp.array2d(dtype=wp.float64),
    held: wp.array2d(dtype=wp.float64),
    # State in and out:
    by_rest_length: wp.array2d(dtype=wp.float64),
):
    """Nodes in clamps lie a rest length away. Launched over (row, hold)."""
    r, k = wp.tid()
    h = hold[r, k]
    if at.active[r] == 0 or h.kind != 2 or h.slot < 0:
        return
    t = tangent_of(h, step.turn[r, h.slot])
    turn = part(multiplier, r, 6 * h.slot + 3)
    moment = wp.cross(t, node(gradient, r, h.other))
    value = wp.dot(node(held, r, h.other), t) - wp.dot(turn, moment)
    wp.atomic_add(by_rest_length, r, h.edge, wp.float64(place[r, h.other].ghost) * value)


@wp.func
def want_spin(b: Body, q: wp.quatd, momentum: wp.vec3d, by_spin: wp.vec3d, w: WantedBodies, r: int,
              s: int):  # fmt: skip
    """Of the spin that a momentum is."""
    spin = spin_of(b, q, momentum)
    slow = wp.inverse(inertia_of(b, q)) * by_spin
    w.momentum[r, s] = w.momentum[r, s] + slow
    w.turn[r, s] = w.turn[r, s] + wp.cross(spin, by_spin) - wp.cross(momentum, slow)


@wp.func
def taken(a: wp.array2d(dtype=wp.float32), i: int, first: int) -> wp.vec3d:
    """Three numbers, of which nothing is left."""
    out = wp.vec3d()
    for c in range(3):
        out[c] = wp.float64(a[i, first + c])
        a[i, first + c] = float(0.0)
    return out


@wp.kernel
def want_bodies_written(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    count: wp.array(dtype=wp.int32),
    end: BodySteps,
    # State in and out:
    by_body_q: wp.array2d(dtype=wp.float32),
    by_body_qd: wp.array2d(dtype=wp.float32),
    now: WantedBodies,
):
    """Of `write_bodies`."""
    r, s = wp.tid()
    b = body[r, s]
    if count[r] == 0 or b.mass == ZERO:
        return
    q = end.turn[r, s]
    if by_body_q.shape[0] > 0:
        origin = taken(by_body_q, b.index, 0)
        axis = taken(by_body_q, b.index, 3)
        wanted = wp.quatd(axis[0], axis[1], axis[2], wp.float64(by_body_q[b.index, 6]))
        by_body_q[b.index, 6] = float(0.0)
        now.place[r, s] = now.place[r, s] + origin
        arm = wp.quat_rotate(q, b.centre)
        now.turn[r, s] = now.turn[r, s] + by_turn(wanted, q) - wp.cross(arm, origin)
    if by_body_qd.shape[0] > 0:
        now.velocity[r, s] = now.velocity[r, s] + taken(by_body_qd, b.index, 0)
        want_spin(b, q, end.momentum[r, s], taken(by_body_qd, b.index, 3), now, r, s)


@wp.kernel
def want_held_read(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    place: wp.array2d(dtype=OutsideNode),
    # State in:
    changed: wp.array(dtype=wp.int32),
    at: OneStep,
    start: BodySteps,
    # State in and out:
    rods: Wanted,
    now: WantedBodies,
    by_rest_length: wp.array2d(dtype=wp.float64),
):
    """Of `place_held` and `carry_velocity` in rows that began anew: nothing is left of what is
    held."""
    r, s = wp.tid()
    b = body[r, s]
    if changed[r] == 0 or b.mass == ZERO:
        return
    q = start.turn_before[r, s]
    momentum = start.momentum_before[r, s]
    spin = spin_of(b, q, momentum)
    by_spin = wp.vec3d()
    for k in range(hold.shape[1]):
        h = hold[r, k]
        if h.kind > 0 and h.slot == s:
            t = tangent_of(h, q)
            for n in range(h.kind):
                i = wp.where(n == 0, h.node, h.other)
                arm = node(at.dof_before, r, i) - start.place_before[r, s]
                p = node(rods.dof, r, i)
                v = node(rods.velocity, r, i)
                now.place[r, s] = now.place[r, s] + p
                now.velocity[r, s] = now.velocity[r, s] + v
                turned = wp.cross(arm, p) + wp.cross(arm, wp.cross(v, spin))
                now.turn[r, s] = now.turn[r, s] + turned
                by_spin += wp.cross(arm, v)
                if n == 1:
                    value = wp.dot(p, t) + wp.dot(v, wp.cross(spin, t))
                    wp.atomic_add(by_rest_length, r, h.edge, wp.float64(place[r, i].ghost) * value)
                put_node(rods.dof, r, i, wp.vec3d(ZERO, ZERO, ZERO))
                put_node(rods.velocity, r, i, wp.vec3d(ZERO, ZERO, ZERO))
            if h.kind == 2:
                a = 4 * h.edge + 3
                now.turn[r, s] = (
                    now.turn[r, s] + rods.dof[r, a] * t + rods.velocity[r, a] * wp.cross(t, spin)
                )
                by_spin += rods.velocity[r, a] * t
                rods.dof[r, a] = ZERO
                rods.velocity[r, a] = ZERO
                rods.turn[r, h.edge] = ZERO
    want_spin(b, q, momentum, by_spin, now, r, s)


@wp.kernel
def want_bodies_read(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    changed: wp.array(dtype=wp.int32),
    follows: int,
    start: BodySteps,
    by_force: wp.array2d(dtype=wp.vec3d),
    by_torque: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    now: WantedBodies,
    by_body_q: wp.array2d(dtype=wp.float32),
    by_body_qd: wp.array2d(dtype=wp.float32),
    by_body_f: wp.array2d(dtype=wp.float32),
):
    """Of `read_bodies`; rows that went on from the step before on the tape (`follows`) pass on
    what is left in `now`, unrounded."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    if by_body_f.shape[0] > 0:
        for c in range(3):
            wp.atomic_add(by_body_f, b.index, c, float(by_force[r, s][c]))
            wp.atomic_add(by_body_f, b.index, 3 + c, float(by_torque[r, s][c]))
    if changed[r] == 0 and follows != 0:
        return
    q = start.turn_before[r, s]
    momentum = start.momentum_before[r, s]
    spin = spin_of(b, q, momentum)
    by_momentum = now.momentum[r, s]
    by_spin = inertia_of(b, q) * by_momentum
    place = now.place[r, s]
    g = now.turn[r, s] + wp.cross(momentum, by_momentum) - wp.cross(spin, by_spin)
    g += wp.cross(wp.quat_rotate(q, b.centre), place)
    if by_body_q.shape[0] > 0:
        wanted = TWO * (wp.quatd(g[0], g[1], g[2], ZERO) * q)  # as if it were normalised
        for c in range(3):
            wp.atomic_add(by_body_q, b.index, c, float(place[c]))
        for c in range(4):
            wp.atomic_add(by_body_q, b.index, 3 + c, float(wanted[c]))
    if by_body_qd.shape[0] > 0:
        velocity = now.velocity[r, s]
        for c in range(3):
            wp.atomic_add(by_body_qd, b.index, c, float(velocity[c]))
            wp.atomic_add(by_body_qd, b.index, 3 + c, float(by_spin[c]))
    none = wp.vec3d()
    now.place[r, s] = none
    now.turn[r, s] = none
    now.velocity[r, s] = none
    now.momentum[r, s] = none
