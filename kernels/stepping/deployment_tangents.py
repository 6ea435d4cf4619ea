"""Tangents of a deployment: how the rod moves with the grip's path, the friction and the rod.

A tangent is the derivative along one direction of (path, friction, stiffness, natural curvature):
displacements of the nodes, and spins of the edges about their axes. It solves the linearised step

    A x = -(rates of inertia, friction's memory and parameters),    x prescribed at the grip,

with A the Jacobian of the accepted step: the solver's matrix and, where a node slides, the part of
its friction that follows its normal force, for which the matrix of the solver is not symmetric.
Where a node changes between sticking and sliding, or touches down, the derivative is the one on the
side on which the step ended.

On a CPU a thread carries eight directions as a vector and reads the factorisation once for all; on
a GPU each direction is solved for by a warp. Arrays of tangents (rod, pack, ...) hold vectors of
that size, or of one.
"""

from functools import cache
from typing import Any

import warp as wp
from wrod.kernels.contact.linearised import LinearContact
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge
from wrod.kernels.linear.banded_lu import ALONE, substitute, substitute_lanes
from wrod.kernels.stepping.flow_tangents import (
    along,
    is_under_way,
    load_flow,
    measure_strain_rates,
    of_vector,
)
from wrod.kernels.stepping.grip import spline
from wrod.kernels.stepping.inelastic_tangents import begin_memory, carry_memory, remembered_moments
from wrod.kernels.stepping.pace import Pace

# Directions that a thread of a CPU carries at a time.
PACK = 8


@wp.func
def share_of(i: int, nodes: int) -> wp.float64:
    """Of what holds the roll of node i, on the angle of an edge beside it."""
    return wp.where(i > 0 and i < nodes - 1, HALF, ONE)


@wp.kernel
def elastic_forces(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    node_mass: wp.array2d(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    dof_older: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    residual: wp.array2d(dtype=wp.float64),
    contact: wp.array2d(dtype=LinearContact),
    # Out:
    elastic_out: wp.array2d(dtype=wp.float64),
):
    """Gradient of the elastic energy: what is left of a step's residual."""
    r, a = wp.tid()
    if pace.accepted[r] == 0:
        return
    c = pace.coefficient[r]
    dt = pace.step[r]
    v = (c[0] * dof[r, a] + c[1] * dof_before[r, a] + c[2] * dof_older[r, a]) / dt
    acceleration = (c[0] * v + c[1] * velocity[r, a] + c[2] * velocity_older[r, a]) / dt
    value = residual[r, a] - mass[r, a] * (acceleration + air_damping[r] * v)
    k = a % 4
    if k < 3:
        i = a / 4
        value += node_mass[r, i] * gravity[r][k] - contact[r, i].push[k]
    else:
        for m in range(a / 4, a / 4 + 2):
            value -= share_of(m, contact.shape[1]) * contact[r, m].torque
    elastic_out[r, a] = value


@wp.func
def key_rate(rates: wp.array4d(dtype=Any), m: int, p: int, k: int, x: wp.float64, c: int):
    """Along the spline between keys k and k + 1."""
    last = rates.shape[2] - 1
    return spline(
        rates[m, p, wp.max(k - 1, 0), c],
        rates[m, p, k, c],
        rates[m, p, wp.min(k + 1, last), c],
        rates[m, p, wp.min(k + 2, last), c],
        x,
    )


@wp.func
def turn_around(angles: wp.array3d(dtype=Any), r: int, p: int, i: int):
    """Turn of node i about the rod: the mean of the angles before and after it."""
    n = angles.shape[2]
    return HALF * (angles[r, p, wp.max(4 * i - 1, 3)] + angles[r, p, wp.min(4 * i + 3, n - 4)])


@wp.kernel
def measure_winding(
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    tangent_before: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array2d(dtype=wp.vec3d),
    elastic: wp.array2d(dtype=wp.float64),
    # Out:
    winding_out: wp.array2d(dtype=wp.vec3d),
    torque_out: wp.array2d(dtype=wp.vec3d),
):
    """What an edge's turn over the step, between frames carried from its start to its end, gains
    where both lie otherwise: by their vectors' displacements, as twist does between two edges; and
    the torque on it from outside, for what its stiffness lacks of symmetry (see
    `kernels.grasping.grip_torque`)."""
    r, e = wp.tid()
    if pace.accepted[r] != 0:
        t = tangent_before[r, e]
        u = tangent[r, e]
        length = wp.length(edge(dof, r, e))
        winding_out[r, e] = wp.cross(t, u) / ((ONE + wp.dot(t, u)) * length)
        torque_out[r, e] = (HALF * elastic[r, 4 * e + 3] / (length * length)) * u


@wp.func
def wound(winding: wp.array2d(dtype=wp.vec3d), x: wp.array3d(dtype=Any), r: int, p: int, i: int):
    """The mean over the edges around node i."""
    last = winding.shape[1] - 1
    e = wp.max(i - 1, 0)
    f = wp.min(i, last)
    return HALF * (along(winding[r, e], x, r, p, e) + along(winding[r, f], x, r, p, f))


@wp.func
def leaning(torque: wp.vec3d, k: int) -> wp.vec3d:
    """Row k of [torque]."""
    row = wp.vec3d()
    row[(k + 1) % 3] = -torque[(k + 2) % 3]
    row[(k + 2) % 3] = torque[(k + 1) % 3]
    return row


@wp.kernel
def load_tangents(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    friction_rate: wp.array3d(dtype=Any),
    stiffness_rate: wp.array2d(dtype=Any),
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    free: wp.array2d(dtype=wp.int32),
    contact: wp.array2d(dtype=LinearContact),
    elastic: wp.array2d(dtype=wp.float64),
    winding: wp.array2d(dtype=wp.vec3d),
    torque: wp.array2d(dtype=wp.vec3d),
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
    velocity: wp.array3d(dtype=Any),
    velocity_older: wp.array3d(dtype=Any),
    bristle: wp.array3d(dtype=Any),
    turned: wp.array3d(dtype=Any),
    # Out:
    x_out: wp.array3d(dtype=Any),
):
    """Right-hand sides at node i and the edge after it: minus the rates of what holds it."""
    r, p, i = wp.tid()
    if not is_under_way(pace, begin, r, p):
        return
    n = now.shape[2]
    c = pace.coefficient[r] / pace.step[r]
    # Of the acceleration and the velocity, by what was.
    by_place = c[0] + air_damping[r]
    here = contact[r, i]
    touches = here.push[2] != ZERO
    by_bristle = here.friction
    by_node = here.memory - by_bristle
    for k in range(4):
        a = 4 * i + k
        if a < n:
            x = type(now[r, p, a])()
            if free[r, a] != 0:
                m0 = -mass[r, a]
                m1 = m0 * by_place
                x = (m1 * c[1]) * now[r, p, a] + (m1 * c[2]) * older[r, p, a]
                x += (m0 * c[1]) * velocity[r, p, a] + (m0 * c[2]) * velocity_older[r, p, a]
                x -= elastic[r, a] * stiffness_rate[r, p]
                if k < 3 and touches:
                    x -= here.by_coefficient[k] * friction_rate[r, p, i]
                    for m in range(3):
                        x -= by_bristle[k, m] * bristle[r, p, 3 * i + m]
                        x -= by_node[k, m] * now[r, p, 4 * i + m]
                if k < 3:
                    if i > 0 and wp.length_sq(torque[r, i - 1]) > ZERO:
                        x -= along(leaning(torque[r, i - 1], k), now, r, p, i - 1)
                    if i < torque.shape[1] and wp.length_sq(torque[r, i]) > ZERO:
                        x += along(leaning(torque[r, i], k), now, r, p, i)
                if k == 3:
                    for m in range(i, i + 2):
                        roll = contact[r, m].roll
                        if roll > ZERO:
                            share = share_of(m, contact.shape[1]) * roll
                            turn = turned[r, p, m] - turn_around(now, r, p, m)
                            # The end's displacements are nearly those of the start.
                            x -= share * (turn + TWO * wound(winding, now, r, p, m))
            x_out[r, p, a] = x


@wp.kernel
def load_grip(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    interval: wp.float64,
    rates: wp.array4d(dtype=Any),
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    free: wp.array2d(dtype=wp.int32),
    edge_tangent: wp.array2d(dtype=wp.vec3d),
    # Out:
    x_out: wp.array3d(dtype=Any),
):
    """Where the grip, while it holds, moves the rod's end and the ghost edge beyond it."""
    r, p = wp.tid()
    n = x_out.shape[2]
    if not is_under_way(pace, begin, r, p) or free[r, n - 1] != 0:
        return
    m = wp.min(r, rates.shape[0] - 1)
    at = wp.clamp(pace.time[r] / interval, ZERO, wp.float64(rates.shape[2] - 1))
    k = wp.min(int(wp.floor(at)), rates.shape[2] - 2)
    y = at - wp.float64(k)
    e = rest_length.shape[1] - 1
    t = edge_tangent[r, e]
    length = rest_length[r, e]
    s0 = (ONE - y) * rates[m, p, k, 3] + y * rates[m, p, k + 1, 3]
    s1 = (ONE - y) * rates[m, p, k, 4] + y * rates[m, p, k + 1, 4]
    s2 = (ONE - y) * rates[m, p, k, 5] + y * rates[m, p, k + 1, 5]
    x0 = key_rate(rates, m, p, k, y, 0)
    x1 = key_rate(rates, m, p, k, y, 1)
    x2 = key_rate(rates, m, p, k, y, 2)
    x_out[r, p, n - 7] = x0
    x_out[r, p, n - 6] = x1
    x_out[r, p, n - 5] = x2
    x_out[r, p, n - 4] = t[0] * s0 + t[1] * s1 + t[2] * s2
    x_out[r, p, n - 3] = x0 + length * (t[2] * s1 - t[1] * s2)
    x_out[r, p, n - 2] = x1 + length * (t[0] * s2 - t[2] * s0)
    x_out[r, p, n - 1] = x2 + length * (t[1] * s0 - t[0] * s1)


@wp.kernel
def solve_tangents(
    # Model:
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    factor: wp.array3d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=Any),
):
    """The tangents at the end of the step."""
    r, p = wp.tid()
    if not is_under_way(pace, begin, r, p):
        return
    substitute(factor, r, p, x)


@wp.kernel
def solve_tangents_lanes(
    # Model:
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    factor: wp.array3d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=ALONE),
):
    """`solve_tangents` on a GPU, launched over (rod, direction, lane) in blocks of a warp."""
    r, p, _lane = wp.tid()
    if is_under_way(pace, begin, r, p):
        substitute_lanes(factor, r, p, x)


@wp.kernel
def carry_bristles(
    # Model:
    stiffness: wp.array2d(dtype=wp.float64),
    friction_rate: wp.array3d(dtype=Any),
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    contact: wp.array2d(dtype=LinearContact),
    coupling: wp.array2d(dtype=wp.mat33d),
    winding: wp.array2d(dtype=wp.vec3d),
    x: wp.array3d(dtype=Any),
    now: wp.array3d(dtype=Any),
    # State in and out:
    bristle: wp.array3d(dtype=Any),
    turned: wp.array3d(dtype=Any),
):
    """What friction remembers at node i at the end of the step."""
    r, p, i = wp.tid()
    if not is_under_way(pace, begin, r, p):
        return
    b0 = type(x[r, p, 0])()
    b1 = type(x[r, p, 0])()
    b2 = type(x[r, p, 0])()
    here = contact[r, i]
    if here.push[2] != ZERO:
        d = here.friction
        g = coupling[r, i]
        h = here.sliding_memory
        f = here.by_coefficient
        inverse = ONE / stiffness[r, i]
        b0 = f[0] * friction_rate[r, p, i]
        b1 = f[1] * friction_rate[r, p, i]
        b2 = f[2] * friction_rate[r, p, i]
        for k in range(3):
            moved = x[r, p, 4 * i + k]
            pulled = bristle[r, p, 3 * i + k] + moved - now[r, p, 4 * i + k]
            was = now[r, p, 4 * i + k]
            b0 += d[0, k] * pulled + g[0, k] * moved + h[0, k] * was
            b1 += d[1, k] * pulled + g[1, k] * moved + h[1, k] * was
            b2 += d[2, k] * pulled + g[2, k] * moved + h[2, k] * was
        b0 = inverse * b0
        b1 = inverse * b1
        b2 = inverse * b2
    turn = type(x[r, p, 0])()
    if here.roll > ZERO:
        turn = turned[r, p, i] + turn_around(x, r, p, i) - turn_around(now, r, p, i)
        turn += wound(winding, now, r, p, i) + wound(winding, x, r, p, i)
    turned[r, p, i] = turn
    bristle[r, p, 3 * i] = b0
    bristle[r, p, 3 * i + 1] = b1
    bristle[r, p, 3 * i + 2] = b2


@wp.kernel
def advance_tangents(
    # Model:
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    x: wp.array3d(dtype=Any),
    # State in and out:
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
    velocity: wp.array3d(dtype=Any),
    velocity_older: wp.array3d(dtype=Any),
):
    """Shift the history of the tangents by a step."""
    r, p, a = wp.tid()
    if not is_under_way(pace, begin, r, p):
        return
    c = pace.coefficient[r] / pace.step[r]
    v = c[0] * x[r, p, a] + c[1] * now[r, p, a] + c[2] * older[r, p, a]
    velocity_older[r, p, a] = velocity[r, p, a]
    velocity[r, p, a] = v
    older[r, p, a] = now[r, p, a]
    now[r, p, a] = x[r, p, a]


@cache
def vector_of(size: int) -> type:
    """The type of `size` directions that a thread carries, for which the kernels are then built."""
    dtype = ALONE if size == 1 else wp.types.vector(length=size, dtype=wp.float64)
    of_vector(
        dtype, load_tangents, load_grip, solve_tangents, carry_bristles, advance_tangents,
        measure_strain_rates, load_flow, begin_memory, remembered_moments, carry_memory,
    )  # fmt: skip
    return dtype
