"""The optimal grasp as one bordered Newton system.

Node 0 is a ghost that, with the contact at node 1 and the first free node 2, holds the pattern's
curvature: the edges before and after the contact are turned by half the turning angle to either
side of the pattern's tangent. The last node is the grip. Border unknowns are the stretch of the
edge between nodes 1 and 2 and the position of the grip; border equations are the balance of node 2
(which makes the moment at the contact k_b kappa) and the closure, f_x = -T at the grip.

`condensed[r]` is the Hessian condensed on nodes 2 and grip (6 x 6), `reaction[r]` their gradient
after the free nodes have been brought to balance.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node
from wrod.kernels.linear.banded import banded_entry
from wrod.kernels.linear.border import worst_imbalance
from wrod.kernels.stepping.newton_iteration import largest_safe_fraction

wp.set_module_options({"enable_backward": False})

vec6d = wp.types.vector(length=6, dtype=wp.float64)
mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)

# Closures: how the one freedom that mechanics leaves is used.
ZERO_TENSION = wp.constant(0)
MIN_FORCE = wp.constant(1)
MIN_FRICTION = wp.constant(2)

# What a grasp is doing.
RUNNING = wp.constant(0)
CONVERGED = wp.constant(1)
FAILED = wp.constant(2)


@wp.func
def border_column(j: int, dof_count: int) -> int:
    """Degree of freedom of border coordinate j: node 2 (0...2), grip (3...5)."""
    if j < 3:
        return 8 + j
    return dof_count - 6 + j


@wp.kernel
def condense(
    # In:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    solution: wp.array3d(dtype=wp.float64),
    # Out:
    condensed_out: wp.array(dtype=mat66d),
    reaction_out: wp.array(dtype=vec6d),
):
    """Static condensation on the border coordinates."""
    r = wp.tid()
    if active[r] == 0:
        return
    n = gradient.shape[1]
    s = mat66d()
    g = vec6d()
    for i in range(6):
        a = border_column(i, n)
        g[i] = gradient[r, a]
        for j in range(6):
            s[i, j] = banded_entry(hessian, r, a, border_column(j, n))
        for b in range(wp.max(0, a - HALF_BANDWIDTH), wp.min(n, a + HALF_BANDWIDTH + 1)):
            if free[r, b] != 0:
                h = banded_entry(hessian, r, a, b)
                g[i] -= h * solution[r, 0, b]
                for j in range(6):
                    s[i, j] -= h * solution[r, 1 + j, b]
    condensed_out[r] = s
    reaction_out[r] = g


@wp.func
def half_turn(curvature: wp.float64, length: wp.float64) -> wp.float64:
    """Half the turning angle at the contact: kappa = 2 tan(phi/2) / l."""
    return wp.atan(HALF * curvature * length)


@wp.func
def half_turn_rate(curvature: wp.float64, length: wp.float64) -> wp.float64:
    x = HALF * curvature * length
    return HALF * length / (ONE + x * x)


@wp.func
def first_direction(angle: wp.float64) -> wp.vec3d:
    return wp.vec3d(wp.cos(angle), wp.sin(angle), ZERO)


@wp.func
def contact_hessian_block(hessian: wp.array3d(dtype=wp.float64), r: int) -> wp.mat33d:
    """Rows of node 2, columns of the ghost."""
    m = wp.mat33d()
    for c in range(3):
        for d in range(3):
            m[c, d] = banded_entry(hessian, r, 8 + c, d)
    return m


@wp.func
def border_matrix(s: mat66d, stretch_direction: wp.vec3d) -> wp.mat44d:
    """Derivative of the border equations by (stretch of the first edge, grip position)."""
    m = wp.mat44d()
    for i in range(4):
        for j in range(3):
            m[i, 0] += s[i, j] * stretch_direction[j]
            m[i, 1 + j] = s[i, 3 + j]
    return m


@wp.func
def contact_motion(
    dof: wp.array2d(dtype=wp.float64), r: int, curvature: wp.float64, length: wp.float64
) -> wp.vec3d:
    """Motion of node 2 by the curvature, at the first edge's present stretch."""
    rate = half_turn_rate(curvature, length)
    d = first_direction(half_turn(curvature, length))
    return (rate * wp.length(node(dof, r, 2))) * wp.vec3d(-d[1], d[0], ZERO)


@wp.func
def ghost_motion(curvature: wp.float64, length: wp.float64) -> wp.vec3d:
    """Motion of the ghost by the curvature."""
    rate = half_turn_rate(curvature, length)
    d = first_direction(half_turn(curvature, length))
    return (rate * length) * wp.vec3d(d[1], d[0], ZERO)


@wp.func
def border_forcing(s: mat66d, node_2: wp.vec3d, load: wp.vec3d) -> wp.vec4d:
    """Border equations' rate when node 2 moves and `load` is added to its balance."""
    f = wp.vec4d()
    for i in range(4):
        for j in range(3):
            f[i] += s[i, j] * node_2[j]
    for i in range(3):
        f[i] += load[i]
    return f


@wp.func
def write_step(
    solution: wp.array3d(dtype=wp.float64),
    free: wp.array2d(dtype=wp.int32),
    r: int,
    residual_weight: wp.float64,
    node_2: wp.vec3d,
    grip: wp.vec3d,
):
    """Turn border changes into a step of every degree of freedom, in `solution[r, 0]`."""
    n = solution.shape[2]
    for a in range(n):
        if free[r, a] != 0:
            value = residual_weight * solution[r, 0, a]
            for j in range(3):
                value += solution[r, 1 + j, a] * node_2[j] + solution[r, 4 + j, a] * grip[j]
            solution[r, 0, a] = -value
        else:
            solution[r, 0, a] = ZERO
    for j in range(3):
        solution[r, 0, 8 + j] = node_2[j]
        solution[r, 0, n - 3 + j] = grip[j]


@wp.func
def place_contact(
    dof: wp.array2d(dtype=wp.float64),
    r: int,
    curvature: wp.float64,
    length: wp.float64,
):
    """Turn the ghost edge and the first edge to the curvature, keeping their lengths."""
    d = first_direction(half_turn(curvature, length))
    stretched = wp.length(node(dof, r, 2))
    for c in range(3):
        dof[r, 8 + c] = stretched * d[c]
    dof[r, 0] = -length * d[0]
    dof[r, 1] = length * d[1]
    dof[r, 2] = ZERO


@wp.func
def grip_force(reaction: vec6d) -> wp.vec3d:
    return wp.vec3d(reaction[3], reaction[4], reaction[5])


@wp.func
def family_rate(inverse: wp.mat44d, s: mat66d, d: wp.vec3d) -> vec6d:
    """Rates (stretch, grip position; then the contact force's y, z) along the family of grasps.

    The family is what the closure chooses from; the thrust F_x parametrises it.
    """
    v = inverse * wp.vec4d(ZERO, ZERO, ZERO, -ONE)
    rate = vec6d(v[0], v[1], v[2], v[3], ZERO, ZERO)
    for i in range(2):
        for j in range(3):
            rate[4 + i] -= s[4 + i, j] * d[j] * v[0] + s[4 + i, 3 + j] * v[1 + j]
    return rate


@wp.func
def closure_slope(closure: int, force: wp.vec3d, rate: vec6d) -> wp.vec2d:
    """Slope, by the thrust, of half the square of what the closure minimises, and Gauss-Newton's
    estimate of the slope's own slope."""
    slope = force[0] + force[1] * rate[4]
    steepness = ONE + rate[4] * rate[4]
    if closure == MIN_FORCE:
        slope += force[2] * rate[5]
        steepness += rate[5] * rate[5]
    return wp.vec2d(slope, steepness)


@wp.func
def thrust_step(
    closure: int,
    force: wp.vec3d,
    rate: vec6d,
    thrust: wp.float64,
    thrust_saved: wp.float64,
    slope_saved: wp.float64,
) -> wp.vec2d:
    """Change of the thrust towards the closure's minimum, and the slope where it starts.

    Gauss-Newton at first, then the secant of the slope between the last two grasps.
    """
    q = closure_slope(closure, force, rate)
    steepness = q[1]
    moved = thrust - thrust_saved
    if wp.abs(moved) > wp.float64(1.0e-7):
        secant = (q[0] - slope_saved) / moved
        if secant > wp.float64(0.05) * q[1]:
            steepness = secant
    return wp.vec2d(-q[0] / steepness, q[0])


@wp.kernel
def iterate_grasp(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    weight: wp.array(dtype=wp.float64),
    target: wp.array(dtype=wp.float64),
    closure: int,
    tolerance: wp.array(dtype=wp.float64),
    limit: wp.float64,
    patience: int,
    # State in:
    free: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    condensed: wp.array(dtype=mat66d),
    reaction: wp.array(dtype=vec6d),
    # State in and out:
    solution: wp.array3d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    thrust: wp.array(dtype=wp.float64),
    # The last grasp on the way, to go back to; the size of the next step; progress.
    dof_saved: wp.array2d(dtype=wp.float64),
    curvature_saved: wp.array(dtype=wp.float64),
    thrust_saved: wp.array(dtype=wp.float64),
    slope_saved: wp.array(dtype=wp.float64),
    saved: wp.array(dtype=wp.int32),
    increment: wp.array(dtype=wp.float64),
    waited: wp.array(dtype=wp.int32),
    iterations: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    status: wp.array(dtype=wp.int32),
    # Out:
    residual_out: wp.array(dtype=wp.float64),
):
    """One step of every running grasp.

    A grasp that has not converged takes a Newton step. One that has converged short of the target
    curvature, or of the closure's minimum, walks on along the exact tangent. One that has not
    converged in `patience` steps goes back to the last grasp and walks on in smaller steps.
    """
    r = wp.tid()
    if active[r] == 0:
        return
    n = gradient.shape[1]
    length = rest_length[r, 1]
    s = condensed[r]
    g = reaction[r]
    kappa = curvature[r]
    at_target = kappa == target[r]
    d = first_direction(half_turn(kappa, length))
    inverse = wp.inverse(border_matrix(s, d))

    worst = worst_imbalance(free, gradient, r, 8, 11)  # node 2 too
    worst = wp.max(worst, wp.abs(gradient[r, n - 3] + thrust[r]))
    residual_out[r] = worst
    iterations[r] = iterations[r] + 1

    # How far the closure's minimum is, as this grasp sees it.
    rate = vec6d()
    to_minimum = wp.vec2d()
    if closure != ZERO_TENSION and at_target:
        rate = family_rate(inverse, s, d)
        force = -grip_force(g)
        force[2] = force[2] + weight[r]
        to_minimum = thrust_step(closure, force, rate, thrust[r], thrust_saved[r], slope_saved[r])

    on_the_way = not at_target or wp.abs(to_minimum[0]) > wp.float64(1.0e-7)
    wanted = tolerance[r]
    if on_the_way:
        wanted = wp.max(wanted, wp.float64(1.0e-4))
        if at_target:
            # Slopes of neighbouring grasps are compared: they have to be sharper than the step.
            wanted = wp.max(
                tolerance[r], wp.min(wanted, wp.float64(1.0e-3) * wp.abs(to_minimum[0]))
            )

    if worst <= wanted:
        if not on_the_way:
            status[r] = CONVERGED
            active[r] = 0
            return
        for a in range(n):
            dof_saved[r, a] = dof[r, a]
        curvature_saved[r] = kappa
        saved[r] = 1
        if waited[r] <= 3:
            increment[r] = wp.float64(1.5) * increment[r]
        waited[r] = 0
        if at_target:
            thrust_saved[r] = thrust[r]
            slope_saved[r] = to_minimum[1]
            change = wp.clamp(to_minimum[0], -increment[r], increment[r])
            grip = change * wp.vec3d(rate[1], rate[2], rate[3])
            write_step(solution, free, r, ZERO, (change * rate[0]) * d, grip)
            fraction = largest_safe_fraction(dof, solution, r, limit)
            for a in range(n):
                dof[r, a] = dof[r, a] + fraction * solution[r, 0, a]
            thrust[r] = thrust[r] + fraction * change
            return
        change = wp.min(increment[r], wp.abs(target[r] - kappa))
        if target[r] < kappa:
            change = -change
        ghost = ghost_motion(kappa, length)
        turn = contact_motion(dof, r, kappa, length)
        v = -(inverse * border_forcing(s, turn, contact_hessian_block(hessian, r) * ghost))
        node_2 = change * (turn + v[0] * d)
        write_step(solution, free, r, ZERO, node_2, change * wp.vec3d(v[1], v[2], v[3]))
        fraction = largest_safe_fraction(dof, solution, r, limit)
        for a in range(n):
            dof[r, a] = dof[r, a] + fraction * solution[r, 0, a]
        if fraction < ONE:
            kappa = kappa + fraction * change
            increment[r] = wp.abs(fraction * change)
        elif wp.abs(target[r] - kappa) <= increment[r]:
            kappa = target[r]
        else:
            kappa = kappa + change
        curvature[r] = kappa
        place_contact(dof, r, kappa, length)
        return

    waited[r] = waited[r] + 1
    if waited[r] > patience or not wp.isfinite(worst):
        increment[r] = HALF * HALF * increment[r]
        if increment[r] < wp.float64(1.0e-4) or saved[r] == 0:
            status[r] = FAILED
            active[r] = 0
            return
        for a in range(n):
            dof[r, a] = dof_saved[r, a]
        curvature[r] = curvature_saved[r]
        thrust[r] = thrust_saved[r]
        # The way back is no evidence for larger steps.
        waited[r] = 4
        return

    # Newton.
    rhs = wp.vec4d(-g[0], -g[1], -g[2], -(g[3] + thrust[r]))
    v = inverse * rhs
    write_step(solution, free, r, ONE, v[0] * d, wp.vec3d(v[1], v[2], v[3]))
    fraction = largest_safe_fraction(dof, solution, r, limit)
    for a in range(n):
        dof[r, a] = dof[r, a] + fraction * solution[r, 0, a]
