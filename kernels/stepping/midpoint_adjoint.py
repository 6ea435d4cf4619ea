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


@wp.func
def share_out(
    wanted: wp.float64, speed: wp.float64, dt: wp.float64, free: int, moved: int
) -> wp.vec3d:
    """What is wanted of a degree of freedom at the end of the step and of its velocity, wanted of
    its middle, of where it is held, and of its start."""
    faster = FOUR * speed / dt
    if free != 0:
        return wp.vec3d(TWO * wanted + faster, ZERO, -wanted - faster)
    if moved == 2:
        return wp.vec3d(faster, wanted, -faster)
    if moved != 0:
        return wp.vec3d(ZERO, wanted + speed / dt, -speed / dt)
    return wp.vec3d(ZERO, ZERO, wanted)


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
    share = share_out(wanted, spin, dt, free[r, a], moved[r, a])
    if free[r, a] != 0 or moved[r, a] == 0:
        turn += wanted
    elif moved[r, a] != 2:
        turn -= spin / dt
    if free[r, a] != 0 or moved[r, a] == 2:
        before.velocity[r, a] = before.velocity[r, a] - spin
    now.dof[r, a] = share[0]
    now.turn[r, i] = -share[0]
    now.velocity[r, a] = ZERO
    before.dof[r, a] = before.dof[r, a] + share[2]
    before.turn[r, i] = before.turn[r, i] - share[2] + turn
    held_out[r, a] = share[1]
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
        speed = wp.float64(now.velocity[r, a])
        share = share_out(now.dof[r, a] + from_end[c], speed, dt, free[r, a], moved[r, a])
        if free[r, a] != 0 or moved[r, a] == 2:
            before.velocity[r, a] = before.velocity[r, a] - speed
        now.dof[r, a] = share[0]
        now.velocity[r, a] = ZERO
        before.dof[r, a] = before.dof[r, a] + share[2] + from_start[c]
        held_out[r, a] = share[1]
