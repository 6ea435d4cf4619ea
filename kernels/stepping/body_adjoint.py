"""The adjoint of a step of rods and of the bodies that hold them (`bodies`, `body_system`).

With lambda the multipliers of a body's balance, the rods' multipliers are those of what is free,
and V lambda of what the body holds: with them, the rods' adjoint is as it is without bodies.
With A_n^T the rods' matrix (`adjoint`) and D the derivative of the body's own balance,

    A_ff^T w + (A^T V)_f lambda = l_f,
    (V^T A^T)_f w + (V^T A^T V + D^T) lambda = l + V^T l_h.

Turns are differentiated by rotation vectors in the world. That of log(after before^-1) is by the
inverse of the left Jacobian J: dtheta = J^-1 dbefore towards what was before, -J^-T dafter from it.
A held edge's moment turns with the body, but half of what that does to it is in A already: along
two turns, one after the other, a frame goes farther than along both at once.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, TWO, ZERO, node
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import StepMatrix, entry
from wrod.kernels.stepping.bodies import Body, Hold, inertia_of, tangent_of, turn_to, turned_on
from wrod.kernels.stepping.exchange_adjoint import jacobian, turned_back
from wrod.kernels.stepping.trace import OneStep


@wp.struct
class BodySteps:
    """Bodies of one step of every row (row, slot): centres, rotations and momenta at its end and
    its start, rotations a step earlier."""

    place: wp.array2d(dtype=wp.vec3d)
    turn: wp.array2d(dtype=wp.quatd)
    momentum: wp.array2d(dtype=wp.vec3d)
    place_before: wp.array2d(dtype=wp.vec3d)
    turn_before: wp.array2d(dtype=wp.quatd)
    momentum_before: wp.array2d(dtype=wp.vec3d)
    turn_older: wp.array2d(dtype=wp.quatd)


@wp.struct
class WantedBodies:
    """What a loss wants of bodies at one time (row, slot)."""

    place: wp.array2d(dtype=wp.vec3d)
    turn: wp.array2d(dtype=wp.vec3d)
    velocity: wp.array2d(dtype=wp.vec3d)
    momentum: wp.array2d(dtype=wp.vec3d)


@wp.kernel
def multiply_motions(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    # State in:
    active: wp.array(dtype=wp.int32),
    m: StepMatrix,
    motion: wp.array3d(dtype=wp.float64),
    # Out:
    column_out: wp.array3d(dtype=wp.float64),
    line_out: wp.array3d(dtype=wp.float64),
    x_out: wp.array3d(dtype=ALONE),
):
    """A^T V, V^T A^T, and the first again as right-hand sides. Launched over (row, motion, dof)."""
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    column = wp.float64(0.0)
    line = wp.float64(0.0)
    n = free.shape[1]
    for b in range(wp.max(a - 10, 0), wp.min(a + 11, n)):
        v = motion[r, j, b]
        if v != ZERO:
            column += entry(m, r, a, b) * v
            line += entry(m, r, b, a) * v
    column_out[r, j, a] = column
    line_out[r, j, a] = line
    x_out[r, 1 + j, a] = ALONE(wp.where(free[r, a] != 0, column, ZERO))


@wp.struct
class Turning:
    """A body's inertia and spin, the derivative of its momentum by its turn, and the inverses of
    the Jacobians of how far it has turned in the last step and the last two."""

    inertia: wp.mat33d
    spin: wp.vec3d
    by_turn: wp.mat33d
    first: wp.mat33d
    second: wp.mat33d


@wp.func
def turning_of(b: Body, step: BodySteps, r: int, s: int, c: wp.vec3d, dt: wp.float64) -> Turning:
    out = Turning()
    q = step.turn[r, s]
    way = turn_to(step.turn_before[r, s], q)
    out.inertia = inertia_of(b, q)
    out.first = wp.inverse(jacobian(way))
    out.spin = (c[1] / dt) * way
    own = (-c[1] / dt) * wp.transpose(out.first)
    if c[2] != ZERO:
        way = turn_to(step.turn_older[r, s], q)
        out.second = wp.inverse(jacobian(way))
        out.spin += (c[2] / dt) * way
        own -= (c[2] / dt) * wp.transpose(out.second)
    momentum = out.inertia * out.spin
    out.by_turn = out.inertia * (own + wp.skew(out.spin)) - wp.skew(momentum)
    return out


@wp.kernel
def balance_wanted(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    # State in:
    at: OneStep,
    gradient: wp.array2d(dtype=wp.float64),
    step: BodySteps,
    now: WantedBodies,
    # Out:
    load_out: wp.array3d(dtype=wp.float64),
    matrix_out: wp.array3d(dtype=wp.float64),
):
    """l and D^T (row, slot, 36)."""
    r, s = wp.tid()
    b = body[r, s]
    if at.active[r] == 0 or b.mass == ZERO:
        return
    c = at.coefficient[r]
    dt = at.span[r]
    own = turning_of(b, step, r, s, c, dt)
    d = (c[0] / dt) * own.by_turn
    place = step.place[r, s]
    for k in range(hold.shape[1]):
        h = hold[r, k]
        if h.kind > 0 and h.slot == s:
            for n in range(h.kind):
                i = wp.where(n == 0, h.node, h.other)
                arm = node(at.dof, r, i) - place
                g = node(gradient, r, i)
                d = d + wp.outer(arm, g) - wp.dot(arm, g) * wp.identity(3, dtype=wp.float64)
            if h.kind == 2:
                d = d - HALF * gradient[r, 4 * h.edge + 3] * wp.skew(tangent_of(h, step.turn[r, s]))
    push = now.place[r, s] + (c[0] / dt) * now.velocity[r, s]
    turn = now.turn[r, s] + wp.transpose(own.by_turn) * now.momentum[r, s]
    for k in range(36):
        matrix_out[r, s, k] = ZERO
    for k in range(3):
        load_out[r, s, k] = push[k]
        load_out[r, s, 3 + k] = turn[k]
        matrix_out[r, s, 7 * k] = b.mass * c[0] * c[0] / (dt * dt)
        for n in range(3):
            matrix_out[r, s, 6 * (3 + k) + 3 + n] = d[n, k]


@wp.kernel
def condense_wanted(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    motion: wp.array3d(dtype=wp.float64),
    column: wp.array3d(dtype=wp.float64),
    line: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=ALONE),
    wanted: wp.array2d(dtype=wp.float64),
    load: wp.array3d(dtype=wp.float64),
    matrix: wp.array3d(dtype=wp.float64),
    press: wp.array3d(dtype=wp.float64),
    by_bodies: wp.array3d(dtype=wp.float64),
    # Out:
    small_out: wp.array3d(dtype=wp.float64),
):
    """The bodies' system, its right-hand side in the last column; of contact `press` is D,
    `by_bodies` the derivative of the rods' residual by the bodies, both may be empty. Launched over
    (row, motion, motion + 1)."""
    r, j, k = wp.tid()
    if active[r] == 0:
        return
    n = motion.shape[1]
    value = wp.float64(0.0)
    for a in range(free.shape[1]):
        touched = wp.float64(0.0)
        if by_bodies.shape[1] > 0:
            touched = by_bodies[r, j, a]
        if free[r, a] != 0:
            value -= (line[r, j, a] + touched) * x[r, wp.where(k == n, 0, k + 1), a][0]
        elif k < n:
            value += motion[r, j, a] * column[r, k, a] + touched * motion[r, k, a]
        else:
            value += motion[r, j, a] * wanted[r, a]
    if k == n:
        value += load[r, j // 6, j % 6]
    else:
        if j // 6 == k // 6:
            value += matrix[r, j // 6, 6 * (j % 6) + k % 6]
        if press.shape[1] > 0:
            value += press[r, k, j]
    small_out[r, j, k] = value


@wp.func
def part(multiplier: wp.array2d(dtype=wp.float64), r: int, j: int) -> wp.vec3d:
    return wp.vec3d(multiplier[r, j], multiplier[r, j + 1], multiplier[r, j + 2])


@wp.kernel
def want_bodies_before(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    at: OneStep,
    step: BodySteps,
    multiplier: wp.array2d(dtype=wp.float64),
    now: WantedBodies,
    # State in and out:
    before: WantedBodies,
    older: WantedBodies,
    by_gravity: wp.array(dtype=wp.vec3d),
    by_force: wp.array2d(dtype=wp.vec3d),
    by_torque: wp.array2d(dtype=wp.vec3d),
):
    """Through differences to the starts of the step, and to what acts on the bodies."""
    r, s = wp.tid()
    b = body[r, s]
    if at.active[r] == 0 or b.mass == ZERO:
        return
    c = at.coefficient[r] / at.span[r]
    own = turning_of(b, step, r, s, at.coefficient[r], at.span[r])
    shift = part(multiplier, r, 6 * s)
    turn = part(multiplier, r, 6 * s + 3)
    pushed = b.mass * shift
    velocity = now.velocity[r, s] - c[0] * pushed
    spun = own.inertia * (now.momentum[r, s] - c[0] * turn)
    before.place[r, s] = before.place[r, s] + c[1] * velocity
    older.place[r, s] = older.place[r, s] + c[2] * velocity
    before.turn[r, s] = before.turn[r, s] + c[1] * (wp.transpose(own.first) * spun)
    older.turn[r, s] = older.turn[r, s] + c[2] * (wp.transpose(own.second) * spun)
    before.velocity[r, s] = before.velocity[r, s] - c[1] * pushed
    older.velocity[r, s] = older.velocity[r, s] - c[2] * pushed
    before.momentum[r, s] = before.momentum[r, s] - c[1] * turn
    older.momentum[r, s] = older.momentum[r, s] - c[2] * turn
    wp.atomic_add(by_gravity, r, pushed)
    by_force[r, s] = by_force[r, s] + shift
    by_torque[r, s] = by_torque[r, s] + turn


@wp.kernel
def find_ends(
    # State in:
    at: OneStep,
    step: BodySteps,
    # Out:
    end: BodySteps,
):
    """Where steps ended of which `step` is where forces were."""
    r, s = wp.tid()
    end.place[r, s] = step.place[r, s]
    end.turn[r, s] = step.turn[r, s]
    end.momentum[r, s] = step.momentum[r, s]
    if at.span[r] < at.whole[r]:
        end.place[r, s] = TWO * step.place[r, s] - step.place_before[r, s]
        end.turn[r, s] = turned_on(step.turn[r, s], step.turn_before[r, s])
        end.momentum[r, s] = TWO * step.momentum[r, s] - step.momentum_before[r, s]


@wp.kernel
def want_middle(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    # State in:
    at: OneStep,
    step: BodySteps,
    end: BodySteps,
    held: wp.array2d(dtype=wp.float64),
    # State in and out:
    now: WantedBodies,
    before: WantedBodies,
):
    """From the ends of steps of the midpoint rule (`at`), where bodies put what they hold: with
    theta the turn from the start to the middle, that to the end is exp(2 theta)."""
    r, s = wp.tid()
    if at.active[r] == 0 or body[r, s].mass == ZERO:
        return
    place = now.place[r, s]
    turn = now.turn[r, s]
    for k in range(hold.shape[1]):
        h = hold[r, k]
        if h.kind > 0 and h.slot == s:
            for n in range(h.kind):
                i = wp.where(n == 0, h.node, h.other)
                wanted = node(held, r, i)
                place += wanted
                turn += wp.cross(node(at.dof, r, i) - end.place[r, s], wanted)
            if h.kind == 2:
                turn += held[r, 4 * h.edge + 3] * tangent_of(h, end.turn[r, s])
    way = turn_to(step.turn[r, s], step.turn_before[r, s])
    inverse = wp.inverse(jacobian(way))
    twice = TWO * (wp.transpose(jacobian(TWO * way)) * turn)
    now.place[r, s] = TWO * place
    before.place[r, s] = before.place[r, s] - place
    now.turn[r, s] = wp.transpose(inverse) * twice
    before.turn[r, s] = before.turn[r, s] + turned_back(turn, TWO * way) - inverse * twice
    before.velocity[r, s] = before.velocity[r, s] - now.velocity[r, s]
    now.velocity[r, s] = TWO * now.velocity[r, s]
    before.momentum[r, s] = before.momentum[r, s] - now.momentum[r, s]
    now.momentum[r, s] = TWO * now.momentum[r, s]
