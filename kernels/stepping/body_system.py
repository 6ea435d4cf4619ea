"""The linear system of a Newton step of rods and of the bodies that hold them.

A body has six unknowns: its centre of mass x and its rotation R. What it holds of a rod, nodes and
angles, is a function of them. With V the motion of all degrees of freedom under the six motions of
a body (a turn phi moves a point at x + d by phi x d and an angle by phi . t), K the rods' matrix
and g their residual, a Newton step of the free part (f) and of the bodies solves

    K_ff x + C_f xi = g_f,    C_f^T x + (V^T C + T^T V + D) xi = r + V^T g,    C = K V + T,

where r is the residual of the bodies alone, with what they do to each other and to rods where they
touch, D its derivative, and T that of g by motions of the bodies whose shapes rods touch
(`wrod.kernels.stepping.body_shapes`). The rods are eliminated: one right-hand side for each motion
of a body, and a small dense system for xi is left (a Schur complement). Forces between rod and body
are equal and opposite to the last bit.
"""

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO, node
from wrod.kernels.stepping.bodies import Body, BodyMotion, Hold, tangent_of, turned_by

# Largest turn of a body in one Newton iteration [rad].
LARGEST_TURN = wp.constant(wp.float64(0.5))


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
    now: BodyMotion,
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
    press: wp.array3d(dtype=wp.float64),
    touch: wp.array3d(dtype=wp.float64),
    # Out:
    small_out: wp.array3d(dtype=wp.float64),
):
    """The bodies' system, its right-hand side in the last column: `press` is the part of D that
    contact makes, `touch` is T or empty. Launched over (row, motion, motion + 1)."""
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
            if touch.shape[2] > 0:
                value += touch[r, j, a] * motion[r, k, a]
    if k == n:
        value += residual[r, j // 6, j % 6]
    else:
        value += press[r, j, k]
        if j // 6 == k // 6:
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
    now: BodyMotion,
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
