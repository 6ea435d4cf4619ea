"""The adjoint of what follows the middle of a step of the midpoint rule: see
`wrod.kernels.stepping.adjoint`, which goes on from there.

What is free goes as far again, y_(n+1) = 2 y - y_n and v_(n+1) = 4 (y - y_n) / dt - v_n with y in
the middle; what is moved is put where it belongs, and so is what bodies hold that move with the
rods (2 in `moved`), but with the velocities of what is free. Edges go on by their angles
theta = phi - psi to reference frames, which are carried from the step's start to its end at once:
psi_(n+1) = psi_n + b . de_(n+1) + a . de_n.
"""

import warp as wp
from wrod.kernels.elastic.frames import TWO, ZERO, edge
from wrod.kernels.stepping.adjoint import holonomy, turned
from wrod.kernels.stepping.trace import OneStep, Wanted

wp.set_module_options({"enable_backward": False})

FOUR = wp.constant(wp.float64(4.0))


@wp.kernel
def find_halfway(
    # State in:
    step: OneStep,
    # Out:
    active_out: wp.array(dtype=wp.int32),
):
    """The steps that were of the midpoint rule."""
    r = wp.tid()
    active_out[r] = wp.where(step.active[r] != 0 and step.span[r] < step.whole[r], 1, 0)


@wp.kernel
def want_angles(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    moved: wp.array2d(dtype=wp.int32),
    # State in:
    step: OneStep,
    # State in and out:
    end: OneStep,
    now: Wanted,
    before: Wanted,
    # Out:
    held_out: wp.array2d(dtype=wp.float64),
    turn_out: wp.array2d(dtype=wp.float64),
    by_end_out: wp.array2d(dtype=wp.vec3d),
    by_start_out: wp.array2d(dtype=wp.vec3d),
):
    """Of edges; what is wanted of psi_(n+1) is `turn`, of which `want_places` wants nodes. Launched
    over (rod, edge)."""
    r, i = wp.tid()
    if end.active[r] == 0:
        return
    e = edge(end.dof, r, i)
    t = wp.normalize(e)
    end.tangent[r, i] = t
    start = step.tangent_before[r, i]
    by_end_out[r, i] = holonomy(start, t, wp.length(e))
    by_start_out[r, i] = -holonomy(t, start, wp.length(edge(step.dof_before, r, i)))
    a = 4 * i + 3
    dt = step.whole[r]
    wanted = wp.float64(now.dof[r, a])
    spin = wp.float64(now.velocity[r, a])
    turn = wp.float64(now.turn[r, i])
    middle = wp.float64(0.0)
    held = wp.float64(0.0)
    less = wp.float64(0.0)  # of the angle at the start
    if free[r, a] != 0:
        turn += wanted
        middle = TWO * wanted + FOUR * spin / dt
        less = wanted + FOUR * spin / dt
        before.velocity[r, a] = before.velocity[r, a] - spin
    elif moved[r, a] == 2:
        middle = FOUR * spin / dt
        held = wanted
        less = middle
        before.velocity[r, a] = before.velocity[r, a] - spin
    elif moved[r, a] != 0:
        turn -= spin / dt
        held = wanted + spin / dt
        less = spin / dt
    else:
        turn += wanted
        less = -wanted
    now.dof[r, a] = middle
    now.turn[r, i] = -middle
    now.velocity[r, a] = ZERO
    before.dof[r, a] = before.dof[r, a] - less
    before.turn[r, i] = before.turn[r, i] + less + turn
    held_out[r, a] = held
    turn_out[r, i] = turn


@wp.kernel
def want_places(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    moved: wp.array2d(dtype=wp.int32),
    # State in:
    step: OneStep,
    end: OneStep,
    turn: wp.array2d(dtype=wp.float64),
    by_end: wp.array2d(dtype=wp.vec3d),
    by_start: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    now: Wanted,
    before: Wanted,
    # Out:
    held_out: wp.array2d(dtype=wp.float64),
):
    """Of nodes. Launched over (rod, node)."""
    r, i = wp.tid()
    if end.active[r] == 0:
        return
    dt = step.whole[r]
    from_end = turned(by_end, turn, r, i)
    from_start = turned(by_start, turn, r, i)
    for c in range(3):
        a = 4 * i + c
        wanted = now.dof[r, a] + from_end[c]
        speed = wp.float64(now.velocity[r, a])
        middle = wp.float64(0.0)
        held = wp.float64(0.0)
        start = wp.float64(wanted)
        if free[r, a] != 0:
            middle = TWO * wanted + FOUR * speed / dt
            start = -wanted - FOUR * speed / dt
            before.velocity[r, a] = before.velocity[r, a] - speed
        elif moved[r, a] == 2:
            middle = FOUR * speed / dt
            held = wanted
            start = -middle
            before.velocity[r, a] = before.velocity[r, a] - speed
        elif moved[r, a] != 0:
            held = wanted + speed / dt
            start = -speed / dt
        now.dof[r, a] = middle
        now.velocity[r, a] = ZERO
        before.dof[r, a] = before.dof[r, a] + start + from_start[c]
        held_out[r, a] = held
