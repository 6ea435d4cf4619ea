"""Tangents of a deployment: how the rod moves with the grip's path, the friction and the rod.

A tangent is the derivative along one direction of (path, friction, stiffness, natural curvature):
displacements of the nodes, and spins of the edges about their axes. It solves the linearised step

    A x = -(rates of inertia, friction's memory and parameters),    x prescribed at the grip,

with A the Jacobian of the accepted step: the solver's matrix and, where a node slides, the part of
its friction that follows its normal force, for which the matrix of the solver is not symmetric.
Where a node changes between sticking and sliding, or touches down, the derivative is the one on the
side on which the step ended.

Eight directions are carried at a time, as a vector: the factorisation is read once for all.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.curvature import add_component_rate, component, stencil
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO
from wrod.kernels.stepping.grip import THREE

wp.set_module_options({"enable_backward": False})

PACK = 8
vec8d = wp.types.vector(length=PACK, dtype=wp.float64)


@wp.kernel
def elastic_forces(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    node_mass: wp.array2d(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    dof_older: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    residual: wp.array2d(dtype=wp.float64),
    push: wp.array2d(dtype=wp.vec3d),
    # Out:
    elastic_out: wp.array2d(dtype=wp.float64),
    natural_out: wp.array2d(dtype=wp.float64),
):
    """Gradient of the elastic energy: what is left of a step's residual. Clears `natural_out`."""
    r, a = wp.tid()
    if accepted[r] == 0:
        return
    c = coefficient[r]
    dt = step[r]
    v = (c[0] * dof[r, a] + c[1] * dof_before[r, a] + c[2] * dof_older[r, a]) / dt
    acceleration = (c[0] * v + c[1] * velocity[r, a] + c[2] * velocity_older[r, a]) / dt
    value = residual[r, a] - mass[r, a] * (acceleration + air_damping[r] * v)
    k = a % 4
    if k < 3:
        i = a / 4
        value += node_mass[r, i] * gravity[r][k] - push[r, i][k]
    elastic_out[r, a] = value
    natural_out[r, a] = ZERO


@wp.kernel
def natural_forces(
    # Model:
    bending_stiffness: wp.array2d(dtype=wp.vec2d),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    # In and out:
    natural: wp.array2d(dtype=wp.float64),
):
    """Rate of the elastic gradient by the first natural curvature of the whole rod."""
    r, j = wp.tid()
    if accepted[r] == 0:
        return
    i = j + 1
    s = stencil(dof, director, r, i)
    add_component_rate(natural, r, i, s, component(s, 0), -bending_stiffness[r, i][0])


@wp.func
def jacobian_entry(
    hessian: wp.array3d(dtype=wp.float64),
    coupling: wp.array2d(dtype=wp.mat33d),
    r: int,
    a: int,
    b: int,
) -> wp.float64:
    value = hessian[r, wp.max(a, b), wp.abs(a - b)]
    if a / 4 == b / 4 and a % 4 < 3 and b % 4 < 3:
        value += coupling[r, a / 4][a % 4, b % 4]
    return value


@wp.kernel
def factorise_step(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    coupling: wp.array2d(dtype=wp.mat33d),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
):
    """A = L U, banded, without pivoting: `factor_out[r, a, 10 + k]` holds U[a, a + k], 1 / U[a, a]
    for k = 0, and `factor_out[r, a, 10 - k]` L[a, a - k]. Rows that are not free are those of the
    identity; their columns are kept, which is how the grip moves the rest."""
    r = wp.tid()
    if accepted[r] == 0:
        return
    n = hessian.shape[1]
    for a in range(n):
        first = wp.max(0, a - HALF_BANDWIDTH)
        stop = wp.min(n, a + HALF_BANDWIDTH + 1)
        if free[r, a] == 0:
            for k in range(2 * HALF_BANDWIDTH + 1):
                factor_out[r, a, k] = ZERO
            factor_out[r, a, HALF_BANDWIDTH] = ONE
            continue
        for b in range(first, stop):
            value = jacobian_entry(hessian, coupling, r, a, b)
            for c in range(wp.max(first, b - HALF_BANDWIDTH), wp.min(a, b)):
                value -= (
                    factor_out[r, a, HALF_BANDWIDTH + c - a]
                    * factor_out[r, c, HALF_BANDWIDTH + b - c]
                )
            if b < a:
                value = value * factor_out[r, b, HALF_BANDWIDTH]
            elif b == a:
                value = ONE / value
            factor_out[r, a, HALF_BANDWIDTH + b - a] = value


@wp.func
def key_rate(
    rates: wp.array4d(dtype=vec8d), m: int, p: int, k: int, x: wp.float64, c: int
) -> vec8d:
    """Along the spline between keys k and k + 1 (see `wrod.kernels.stepping.grip`)."""
    last = rates.shape[2] - 1
    p0 = rates[m, p, wp.max(k - 1, 0), c]
    p1 = rates[m, p, k, c]
    p2 = rates[m, p, wp.min(k + 1, last), c]
    p3 = rates[m, p, wp.min(k + 2, last), c]
    x2 = x * x
    x3 = x2 * x
    return (
        (TWO * x3 - THREE * x2 + ONE) * p1
        + (x3 - TWO * x2 + x) * HALF * (p2 - p0)
        + (THREE * x2 - TWO * x3) * p2
        + (x3 - x2) * HALF * (p3 - p1)
    )


@wp.func
def angles_around(i: int, n: int):
    """Columns of the angles before and after node i, the same at an end, and each one's share."""
    before = wp.max(4 * i - 1, 3)
    after = wp.min(4 * i + 3, n - 4)
    return before, after, wp.where(before < after, HALF, ONE)


@wp.kernel
def load_tangents(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    interval: wp.float64,
    rates: wp.array4d(dtype=vec8d),
    friction_rate: wp.array2d(dtype=vec8d),
    stiffness_rate: wp.array2d(dtype=vec8d),
    natural_rate: wp.array2d(dtype=vec8d),
    roll: wp.array2d(dtype=wp.float64),
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    edge_tangent: wp.array2d(dtype=wp.vec3d),
    friction: wp.array2d(dtype=wp.mat33d),
    by_coefficient: wp.array2d(dtype=wp.vec3d),
    push: wp.array2d(dtype=wp.vec3d),
    memory: wp.array2d(dtype=wp.mat33d),
    elastic: wp.array2d(dtype=wp.float64),
    natural: wp.array2d(dtype=wp.float64),
    now: wp.array3d(dtype=vec8d),
    older: wp.array3d(dtype=vec8d),
    velocity: wp.array3d(dtype=vec8d),
    velocity_older: wp.array3d(dtype=vec8d),
    bristle: wp.array3d(dtype=vec8d),
    turned: wp.array3d(dtype=vec8d),
    # Out:
    x_out: wp.array3d(dtype=vec8d),
):
    """Right-hand sides: minus the rates at a fixed configuration, and where the grip is."""
    r, p = wp.tid()
    if accepted[r] == 0 or time[r] < begin[r, p]:
        return
    n = now.shape[2]
    c = coefficient[r]
    dt = step[r]
    for a in range(n):
        v = (c[1] * now[r, p, a] + c[2] * older[r, p, a]) / dt
        acceleration = (c[0] * v + c[1] * velocity[r, p, a] + c[2] * velocity_older[r, p, a]) / dt
        x = -mass[r, a] * (acceleration + air_damping[r] * v)
        x -= elastic[r, a] * stiffness_rate[r, p] + natural[r, a] * natural_rate[r, p]
        if free[r, a] == 0:
            x = vec8d()
        x_out[r, p, a] = x
    for i in range(mass.shape[1] / 4 + 1):
        if push[r, i][2] != ZERO:
            d = friction[r, i]
            for row in range(3):
                x = by_coefficient[r, i][row] * friction_rate[r, p]
                for k in range(3):
                    x += d[row, k] * (bristle[r, p, 3 * i + k] - now[r, p, 4 * i + k])
                    x += memory[r, i][row, k] * now[r, p, 4 * i + k]
                if free[r, 4 * i + row] != 0:
                    x_out[r, p, 4 * i + row] = x_out[r, p, 4 * i + row] - x
            if roll[r, i] > ZERO:
                before, after, share = angles_around(i, n)
                x = (share * roll[r, i]) * (
                    turned[r, p, i] - HALF * (now[r, p, before] + now[r, p, after])
                )
                for side in range(2):
                    a = 4 * i - 1 + 4 * side
                    if a > 0 and a < n and free[r, a] != 0:
                        x_out[r, p, a] = x_out[r, p, a] - x
    if free[r, n - 1] == 0:
        m = wp.min(r, rates.shape[0] - 1)
        at = wp.clamp(time[r] / interval, ZERO, wp.float64(rates.shape[2] - 1))
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
        x_out[r, p, n - 3] = x0
        x_out[r, p, n - 2] = x1
        x_out[r, p, n - 1] = x2
        x_out[r, p, n - 4] = t[0] * s0 + t[1] * s1 + t[2] * s2
        x_out[r, p, n - 7] = x0 - length * (t[2] * s1 - t[1] * s2)
        x_out[r, p, n - 6] = x1 - length * (t[0] * s2 - t[2] * s0)
        x_out[r, p, n - 5] = x2 - length * (t[1] * s0 - t[0] * s1)


@wp.kernel
def advance_tangents(
    # Model:
    stiffness: wp.array2d(dtype=wp.float64),
    friction_rate: wp.array2d(dtype=vec8d),
    begin: wp.array2d(dtype=wp.float64),
    # State in:
    accepted: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    factor: wp.array3d(dtype=wp.float64),
    friction: wp.array2d(dtype=wp.mat33d),
    coupling: wp.array2d(dtype=wp.mat33d),
    by_coefficient: wp.array2d(dtype=wp.vec3d),
    push: wp.array2d(dtype=wp.vec3d),
    sliding_memory: wp.array2d(dtype=wp.mat33d),
    roll: wp.array2d(dtype=wp.float64),
    # State in and out:
    x: wp.array3d(dtype=vec8d),
    now: wp.array3d(dtype=vec8d),
    older: wp.array3d(dtype=vec8d),
    velocity: wp.array3d(dtype=vec8d),
    velocity_older: wp.array3d(dtype=vec8d),
    bristle: wp.array3d(dtype=vec8d),
    turned: wp.array3d(dtype=vec8d),
):
    """Solve for the tangents at the end of the step, and shift their history by it."""
    r, p = wp.tid()
    if accepted[r] == 0 or time[r] < begin[r, p]:
        return
    n = x.shape[2]
    for a in range(n):
        value = x[r, p, a]
        for k in range(1, wp.min(a, HALF_BANDWIDTH) + 1):
            value -= factor[r, a, HALF_BANDWIDTH - k] * x[r, p, a - k]
        x[r, p, a] = value
    for back in range(n):
        a = n - 1 - back
        value = x[r, p, a]
        for k in range(1, wp.min(back, HALF_BANDWIDTH) + 1):
            value -= factor[r, a, HALF_BANDWIDTH + k] * x[r, p, a + k]
        x[r, p, a] = factor[r, a, HALF_BANDWIDTH] * value
    for i in range(stiffness.shape[1]):
        b0 = vec8d()
        b1 = vec8d()
        b2 = vec8d()
        if push[r, i][2] != ZERO:
            d = friction[r, i]
            g = coupling[r, i]
            h = sliding_memory[r, i]
            f = by_coefficient[r, i]
            inverse = ONE / stiffness[r, i]
            b0 = f[0] * friction_rate[r, p]
            b1 = f[1] * friction_rate[r, p]
            b2 = f[2] * friction_rate[r, p]
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
        turn = vec8d()
        if roll[r, i] > ZERO:
            before, after, _ = angles_around(i, n)
            turn = turned[r, p, i] + HALF * (
                x[r, p, before] + x[r, p, after] - now[r, p, before] - now[r, p, after]
            )
        turned[r, p, i] = turn
        bristle[r, p, 3 * i] = b0
        bristle[r, p, 3 * i + 1] = b1
        bristle[r, p, 3 * i + 2] = b2
    c = coefficient[r]
    for a in range(n):
        v = (c[0] * x[r, p, a] + c[1] * now[r, p, a] + c[2] * older[r, p, a]) / step[r]
        velocity_older[r, p, a] = velocity[r, p, a]
        velocity[r, p, a] = v
        older[r, p, a] = now[r, p, a]
        now[r, p, a] = x[r, p, a]
