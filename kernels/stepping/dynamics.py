"""Implicit time steps of the equation of motion (Eq. EOM), every rod at its own time and pace.

Velocity and acceleration at the end of a step are linear in the new configuration,

    v = (c_0 q + c_1 q_n + c_2 q_(n-1)) / dt,    a = (c_0 v + c_1 v_n + c_2 v_(n-1)) / dt,

with c = (1, -1, 0) for implicit Euler and, for the two-step backward differentiation formula with
steps in the ratio w = dt / dt_before, c = ((1 + 2w)/(1 + w), -(1 + w), w^2/(1 + w)). The implicit
midpoint rule is a step of implicit Euler to the middle, where forces are taken, and as far again
without new forces: q_(n+1) = 2 q - q_n, v_(n+1) = 2 v - v_n. Which formula a rod's step is of, and
how long it is: `wrod.kernels.stepping.pace`. Angles are differenced as they are: reference frames
carried by time-parallel transport do not spin. The gyroscopic forces of an edge that spins while
its axis turns are left out, as in Bergou et al. 2008: they are smaller than the inertia of the
nodes by the square of radius over length.
"""

from typing import Any

import warp as wp
from wrod.kernels.elastic.assembly import add_diagonal_block, add_vector
from wrod.kernels.elastic.frames import TWO, ZERO, node
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.trace import OneStep


@wp.kernel
def predict(
    # State in:
    pace: Pace,
    free: wp.array2d(dtype=wp.int32),
    growth: wp.float64,
    # State in and out:
    step: OneStep,
):
    """Newton starts where the free degrees of freedom are expected."""
    r, a = wp.tid()
    if pace.starting[r] == 0:
        return
    if free[r, a] != 0:
        step.dof[r, a] = step.dof[r, a] + advance_of(growth, step, r, a)


@wp.func
def advance_of(growth: wp.float64, step: OneStep, r: int, a: int) -> wp.float64:
    """How far a degree of freedom would go in a step with `growth` times the last change of
    velocity, of which there is none in a first step."""
    v = wp.float64(step.velocity[r, a])
    if step.coefficient[r][2] != ZERO:
        v += growth * (step.velocity[r, a] - step.velocity_older[r, a])
    return step.span[r] * v


@wp.func
def difference(coefficient: wp.vec3d, dt: wp.float64, now: Any, before: Any, older: Any):
    return (coefficient[0] * now + coefficient[1] * before + coefficient[2] * older) / dt


@wp.kernel
def add_inertia(
    stride: int,
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    # State in:
    step: OneStep,
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Turn gradient and Hessian of the potential energy into residual and matrix of a step: add
    inertia and the air's drag c m v. Launched over (rod, thread), each for every `stride`th number.
    """
    r, first = wp.tid()
    if step.active[r] == 0:
        return
    dt = step.span[r]
    c = step.coefficient[r]
    rate = c[0] / dt
    for a in range(first, mass.shape[1], stride):
        m = mass[r, a]
        v = difference(c, dt, step.dof[r, a], step.dof_before[r, a], step.dof_older[r, a])
        acceleration = difference(c, dt, v, step.velocity[r, a], step.velocity_older[r, a])
        gradient[r, a] = gradient[r, a] + m * (acceleration + air_damping[r] * v)
        hessian[r, a, 0] = hessian[r, a, 0] + m * rate * (rate + air_damping[r])


@wp.kernel
def add_edge_inertia(
    # Model:
    edge_mass: wp.array2d(dtype=wp.float64),
    # State in:
    step: OneStep,
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Take back from lumped nodes what edges of uniform mass m have less: m / 6 against any
    difference of their ends' accelerations. Launched over (rod, edge)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    less = edge_mass[r, i] / wp.float64(6.0)
    if less == ZERO:
        return
    dt = step.span[r]
    c = step.coefficient[r]
    matrix = less * (c[0] / dt) * (c[0] / dt)
    for k in range(3):
        a = 4 * i + k
        b = a + 4
        stretched = step.dof[r, b] - step.dof[r, a]
        before = step.dof_before[r, b] - step.dof_before[r, a]
        v = difference(c, dt, stretched, before, step.dof_older[r, b] - step.dof_older[r, a])
        faster = step.velocity[r, b] - step.velocity[r, a]
        older = step.velocity_older[r, b] - step.velocity_older[r, a]
        force = less * difference(c, dt, v, faster, older)
        wp.atomic_add(gradient, r, a, force)
        wp.atomic_sub(gradient, r, b, force)
        wp.atomic_sub(hessian, r, a, 0, matrix)
        wp.atomic_sub(hessian, r, b, 0, matrix)
        wp.atomic_add(hessian, r, b, 4, matrix)


@wp.func
def velocity_of(step: OneStep, r: int, i: int) -> wp.vec3d:
    """Of node i, where forces are taken."""
    now = node(step.dof, r, i)
    before = node(step.dof_before, r, i)
    return difference(step.coefficient[r], step.span[r], now, before, node(step.dof_older, r, i))


@wp.func
def drag_force(v: wp.vec3d, linear: wp.float64, quadratic: wp.float64) -> wp.vec3d:
    return (linear + quadratic * wp.length(v)) * v


@wp.func
def drag_matrix(v: wp.vec3d, linear: wp.float64, quadratic: wp.float64) -> wp.mat33d:
    """Derivative of `drag_force` by the velocity."""
    speed = wp.length(v)
    d = (linear + quadratic * speed) * wp.identity(3, dtype=wp.float64)
    if speed > ZERO:
        d += (quadratic / speed) * wp.outer(v, v)
    return d


@wp.kernel
def add_drag(
    # Model:
    drag: wp.array2d(dtype=wp.vec2d),
    # State in:
    step: OneStep,
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Add the drag of every node, (d_1 + d_2 |v|) v."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    d = drag[r, i]
    v = velocity_of(step, r, i)
    by_place = step.coefficient[r][0] / step.span[r]
    add_vector(gradient, r, 4 * i, drag_force(v, d[0], d[1]))
    add_diagonal_block(hessian, r, 4 * i, by_place * drag_matrix(v, d[0], d[1]))


@wp.kernel
def extrapolate(
    # State in:
    chosen: wp.array(dtype=wp.int32),
    step: OneStep,
    # State out:
    end_out: wp.array2d(dtype=wp.float64),
):
    """Where the chosen rods are at the end of their steps."""
    r, a = wp.tid()
    if chosen[r] == 0:
        return
    end = step.dof[r, a]
    if step.span[r] < step.whole[r]:
        end = TWO * end - step.dof_before[r, a]
    end_out[r, a] = end


@wp.kernel
def shift_history(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    residual: wp.array2d(dtype=wp.float64),
    carried: wp.array2d(dtype=wp.int32),
    # State in and out:
    step: OneStep,
    # State out:
    reaction_out: wp.array2d(dtype=wp.float64),
):
    """Carry an accepted step over to the next, and keep the forces that hold the rod in it."""
    r, a = wp.tid()
    if accepted[r] == 0:
        return
    c = step.coefficient[r]
    before = step.dof_before[r, a]
    v = difference(c, step.whole[r], step.dof[r, a], before, step.dof_older[r, a])
    if step.span[r] < step.whole[r] and carried[r, a] != 0:
        v = TWO * v - step.velocity[r, a]
    step.velocity_older[r, a] = step.velocity[r, a]
    step.velocity[r, a] = v
    step.dof_older[r, a] = before
    reaction_out[r, a] = residual[r, a]
