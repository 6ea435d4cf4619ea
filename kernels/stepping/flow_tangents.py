"""What a tangent of a deployment feels of the rod's shape at rest: its own rate, and the flow that
internal damping makes of it (`viscosity`), which remembers the strains of two steps."""

from functools import cache
from typing import Any

import warp as wp
from wrod.kernels.elastic.curvature import Component, component, stencil
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge

wp.set_module_options({"enable_backward": False})


@wp.func
def along(g: wp.vec3d, x: wp.array3d(dtype=Any), r: int, p: int, i: int):
    """Of the edge after node i, times g."""
    a = 4 * i
    return (
        g[0] * (x[r, p, a + 4] - x[r, p, a])
        + g[1] * (x[r, p, a + 5] - x[r, p, a + 1])
        + g[2] * (x[r, p, a + 6] - x[r, p, a + 2])
    )


@wp.kernel
def measure_strain_rates(
    # Model:
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    x: wp.array3d(dtype=Any),
    # State in and out: (rod, pack, 4 i + k), curvatures, twist and |e| after node i
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
):
    """Rates of the strains at the end of the step; shifts those of the step before."""
    r, p, i = wp.tid()
    if accepted[r] == 0 or time[r] < begin[r, p]:
        return
    for k in range(4):
        older[r, p, 4 * i + k] = now[r, p, 4 * i + k]
    last = dof.shape[1] / 4
    if i == last:
        return
    now[r, p, 4 * i + 3] = along(wp.normalize(edge(dof, r, i)), x, r, p, i)
    if i == 0:
        return
    s = stencil(dof, director, r, i)
    te = x[r, p, 4 * i - 1]
    tf = x[r, p, 4 * i + 3]
    for k in range(2):
        c = component(s, k)
        rate = along(c.e / s.length_e, x, r, p, i - 1) + along(c.f / s.length_f, x, r, p, i)
        now[r, p, 4 * i + k] = rate + c.te * te + c.tf * tf
    binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
    rate = along(binormal / s.length_e, x, r, p, i - 1) + along(binormal / s.length_f, x, r, p, i)
    now[r, p, 4 * i + 2] = rate + tf - te


@wp.func
def take(
    free: wp.array2d(dtype=wp.int32), r: int, p: int, a: int, value: Any, x: wp.array3d(dtype=Any)
):
    if free[r, a] != 0:
        wp.atomic_sub(x, r, p, a, value)


@wp.func
def take_of_edges(
    free: wp.array2d(dtype=wp.int32),
    r: int,
    p: int,
    i: int,
    e: wp.vec3d,
    f: wp.vec3d,
    value: Any,
    x: wp.array3d(dtype=Any),
):
    """`value` times a gradient by the edges around node i."""
    for k in range(3):
        take(free, r, p, 4 * i - 4 + k, -e[k] * value, x)
        take(free, r, p, 4 * i + k, (e[k] - f[k]) * value, x)
        take(free, r, p, 4 * i + 4 + k, f[k] * value, x)


@wp.kernel
def load_flow(
    # Model, elastic:
    rest_length: wp.array2d(dtype=wp.float64),
    stretching: wp.array2d(dtype=wp.float64),
    bending: wp.array2d(dtype=wp.vec2d),
    natural_curvature: wp.array2d(dtype=wp.vec2d),
    softening: wp.array2d(dtype=wp.vec2d),
    twisting: wp.array2d(dtype=wp.float64),
    viscous_time: wp.array2d(dtype=wp.vec4d),
    # Rates of the natural curvature towards both principal directions:
    natural_rate: wp.array3d(dtype=Any),
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    strain_before: wp.array2d(dtype=wp.vec4d),
    strain_older: wp.array2d(dtype=wp.vec4d),
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
    # In and out:
    x: wp.array3d(dtype=Any),
):
    """Minus the rates of the moments at node i, and of the pull of the edge after it, by what the
    rod is at rest and by strains that damping remembers."""
    r, p, i = wp.tid()
    if accepted[r] == 0 or time[r] < begin[r, p]:
        return
    c = coefficient[r] / step[r]
    eta = viscous_time[r, i]
    a = 4 * i
    h = rest_length[r, i]
    if eta[3] != ZERO:
        t = wp.normalize(edge(dof, r, i))
        pull = c[1] * now[r, p, a + 3] + c[2] * older[r, p, a + 3]
        pull = (eta[3] * stretching[r, i] / h) * pull
        for k in range(3):
            take(free, r, p, a + k, -t[k] * pull, x)
            take(free, r, p, a + 4 + k, t[k] * pull, x)
    if i == 0:
        return
    length = HALF * (rest_length[r, i - 1] + h)
    # Of the grip's node a share of the cell is beyond the grip.
    share = ONE
    if i == rest_length.shape[1] - 1:
        share = HALF * rest_length[r, i - 1] / length
    s = stencil(dof, director, r, i)
    b = bending[r, i]
    law = softening[r, i]
    change_1 = (eta[0] / length) * (c[1] * now[r, p, a] + c[2] * older[r, p, a])
    change_2 = (eta[1] / length) * (c[1] * now[r, p, a + 1] + c[2] * older[r, p, a + 1])
    moment_1 = b[0] * (change_1 - share * natural_rate[r, p, 0])
    moment_2 = b[1] * (change_2 - share * natural_rate[r, p, 1])
    first = component(s, 0)
    second = component(s, 1)
    if law[0] != ZERO:
        # M = B e (r + (1 - r) / D), D = 1 + 2 c (B_1 e_1^2 + B_2 e_2^2) / (B_1 + B_2).
        was = strain_before[r, i]
        past = strain_older[r, i]
        flow_1 = c[0] * first.kappa + c[1] * was[0] + c[2] * past[0]
        flow_2 = c[0] * second.kappa + c[1] * was[1] + c[2] * past[1]
        e_1 = (first.kappa + eta[0] * flow_1) / length - natural_curvature[r, i][0]
        e_2 = (second.kappa + eta[1] * flow_2) / length - natural_curvature[r, i][1]
        by = TWO * law[0] / (b[0] + b[1])
        d = ONE + by * (b[0] * e_1 * e_1 + b[1] * e_2 * e_2)
        secant = law[1] + (ONE - law[1]) / d
        fall = -(ONE - law[1]) / (d * d) * TWO * by
        turn = fall * (e_1 * moment_1 + e_2 * moment_2)
        moment_1 = secant * moment_1 + (b[0] * e_1) * turn
        moment_2 = secant * moment_2 + (b[1] * e_2) * turn
    take_of_bend(free, r, p, i, s.length_e, s.length_f, first, moment_1, x)
    take_of_bend(free, r, p, i, s.length_e, s.length_f, second, moment_2, x)
    if eta[2] != ZERO:
        torque = c[1] * now[r, p, a + 2] + c[2] * older[r, p, a + 2]
        torque = (eta[2] * twisting[r, i] / length) * torque
        binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
        take_of_edges(free, r, p, i, binormal / s.length_e, binormal / s.length_f, torque, x)
        take(free, r, p, a - 1, -torque, x)
        take(free, r, p, a + 3, torque, x)


@wp.func
def take_of_bend(
    free: wp.array2d(dtype=wp.int32),
    r: int,
    p: int,
    i: int,
    length_e: wp.float64,
    length_f: wp.float64,
    c: Component,
    moment: Any,
    x: wp.array3d(dtype=Any),
):
    take_of_edges(free, r, p, i, c.e / length_e, c.f / length_f, moment, x)
    take(free, r, p, 4 * i - 1, c.te * moment, x)
    take(free, r, p, 4 * i + 3, c.tf * moment, x)


@cache
def of_vector(dtype: type) -> None:
    """Build the kernels for packs of that type."""
    for kernel in (measure_strain_rates, load_flow):
        known = kernel.adj.arg_types.values()
        wp.overload(
            kernel,
            [
                wp.array(dtype=dtype, ndim=t.ndim) if getattr(t, "dtype", None) is Any else t
                for t in known
            ],
        )
