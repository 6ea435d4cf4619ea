"""Implicit time steps of the equation of motion (Eq. EOM), every rod at its own time and pace.

Velocity and acceleration at the end of a step are linear in the new configuration,

    v = (c_0 q + c_1 q_n + c_2 q_(n-1)) / dt,    a = (c_0 v + c_1 v_n + c_2 v_(n-1)) / dt,

with c = (1, -1, 0) for implicit Euler and, for the two-step backward differentiation formula with
steps in the ratio w = dt / dt_before, c = ((1 + 2w)/(1 + w), -(1 + w), w^2/(1 + w)). The implicit
midpoint rule is a step of implicit Euler to the middle, where forces are taken, and as far again
without new forces: q_(n+1) = 2 q - q_n, v_(n+1) = 2 v - v_n. The time to where forces are taken is
`span`; it is the whole `step` but for the midpoint rule.

A rod that something has stopped has a velocity that differences over earlier steps do not know:
two-step formulas would throw it back, the midpoint rule reflect it. So a step with an impact, and
the two after it, are of implicit Euler; and the midpoint rule, which does not damp what is stiff,
leaves steps in which anything is touched to the two-step formula. Angles are
differenced as they are: reference frames carried by time-parallel transport do not spin. The
gyroscopic forces of an edge that spins while its axis turns are left out, as in Bergou et al. 2008:
they are smaller than the inertia of the nodes by the square of radius over length.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_diagonal_block, add_vector
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, node
from wrod.kernels.lanes import count_of_lanes
from wrod.kernels.stepping.newton_iteration import largest_safe_fraction_of_lanes

wp.set_module_options({"enable_backward": False})

EULER = wp.constant(0)
TWO_STEP = wp.constant(1)
MIDPOINT = wp.constant(2)
# What has made a rod leave its scheme for a step: nothing, that it touches something, an impact.
NOTHING = wp.constant(0)
TOUCH = wp.constant(1)
IMPACT = wp.constant(2)


@wp.kernel
def begin_step(
    # Model:
    scheme: int,
    tolerance: wp.float64,
    rounding: wp.array(dtype=wp.vec2d),
    stretching_time: wp.array(dtype=wp.float64),
    until: wp.array(dtype=wp.float64),
    # State in:
    starting: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step_before: wp.array(dtype=wp.float64),
    wanted_step: wp.array(dtype=wp.float64),
    leaves: wp.array(dtype=wp.int32),
    # State out:
    step_out: wp.array(dtype=wp.float64),
    span_out: wp.array(dtype=wp.float64),
    touching_out: wp.array(dtype=wp.int32),
    coefficient_out: wp.array(dtype=wp.vec3d),
    tolerance_out: wp.array(dtype=wp.float64),
    iteration_out: wp.array(dtype=wp.int32),
    active_out: wp.array(dtype=wp.int32),
    converged_out: wp.array(dtype=wp.int32),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """Choose the step, which ends on `until` without a crumb before it, and its coefficients."""
    r = wp.tid()
    if starting[r] == 0:
        return
    iteration_out[r] = 0
    active_out[r] = 1
    converged_out[r] = 0
    negative_pivots_out[r] = 0
    left = until[r] - time[r]
    dt = wp.float64(wanted_step[r])
    if left <= wp.float64(1.0001) * dt:
        dt = left
    elif left < TWO * dt:
        dt = HALF * left
    step_out[r] = dt
    touching_out[r] = NOTHING
    span = wp.float64(dt)
    if scheme == MIDPOINT and leaves[r] == NOTHING:
        span = HALF * dt
        coefficient_out[r] = wp.vec3d(ONE, -ONE, ZERO)
    elif scheme != EULER and leaves[r] != IMPACT and step_before[r] > ZERO:
        w = dt / step_before[r]
        coefficient_out[r] = wp.vec3d((ONE + TWO * w) / (ONE + w), -(ONE + w), w * w / (ONE + w))
    else:
        coefficient_out[r] = wp.vec3d(ONE, -ONE, ZERO)
    span_out[r] = span
    # Rounding of positions leaves this much in the stiffest edge, and in the inertia of the step.
    rate = coefficient_out[r][0] / span
    left_over = rounding[r][0] * (ONE + stretching_time[r] * rate) + rounding[r][1] * rate * rate
    tolerance_out[r] = wp.max(tolerance, left_over)


@wp.kernel
def predict(
    # State in:
    starting: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    growth: wp.float64,
    # State in and out:
    dof: wp.array2d(dtype=wp.float64),
):
    """Newton starts where the free degrees of freedom would be with `growth` times the last change
    of velocity, of which there is none in a first step."""
    r, a = wp.tid()
    if starting[r] == 0:
        return
    if free[r, a] != 0:
        v = wp.float64(velocity[r, a])
        if coefficient[r][2] != ZERO:
            v += growth * (velocity[r, a] - velocity_older[r, a])
        dof[r, a] = dof[r, a] + step[r] * v


@wp.func
def difference(
    coefficient: wp.vec3d, dt: wp.float64, now: wp.float64, before: wp.float64, older: wp.float64
) -> wp.float64:
    return (coefficient[0] * now + coefficient[1] * before + coefficient[2] * older) / dt


@wp.kernel
def add_inertia(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    # State in:
    active: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    dof_older: wp.array2d(dtype=wp.float64),
    velocity_before: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Turn gradient and Hessian of the potential energy into residual and matrix of a step: add
    inertia and the air's drag c m v."""
    r, a = wp.tid()
    if active[r] == 0:
        return
    dt = step[r]
    c = coefficient[r]
    m = mass[r, a]
    v = difference(c, dt, dof[r, a], dof_before[r, a], dof_older[r, a])
    acceleration = difference(c, dt, v, velocity_before[r, a], velocity_older[r, a])
    gradient[r, a] = gradient[r, a] + m * (acceleration + air_damping[r] * v)
    rate = c[0] / dt
    hessian[r, a, 0] = hessian[r, a, 0] + m * rate * (rate + air_damping[r])


@wp.func
def rate(
    coefficient: wp.vec3d, dt: wp.float64, now: wp.vec3d, before: wp.vec3d, older: wp.vec3d
) -> wp.vec3d:
    return (coefficient[0] * now + coefficient[1] * before + coefficient[2] * older) / dt


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
    active: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    before: wp.array2d(dtype=wp.float64),
    older: wp.array2d(dtype=wp.float64),
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Add the drag of every node, (d_1 + d_2 |v|) v."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    c = coefficient[r]
    d = drag[r, i]
    v = rate(c, step[r], node(dof, r, i), node(before, r, i), node(older, r, i))
    add_vector(gradient, r, 4 * i, drag_force(v, d[0], d[1]))
    add_diagonal_block(hessian, r, 4 * i, (c[0] / step[r]) * drag_matrix(v, d[0], d[1]))


@wp.kernel
def take_newton_step(
    # Model:
    limit: wp.float64,
    # State in:
    active: wp.array(dtype=wp.int32),
    solution: wp.array3d(dtype=wp.float64),
    # State in and out:
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    taken_out: wp.array(dtype=wp.float64),
):
    """Subtract the solution, or as much of it as leaves every edge recognisable.

    Launched over (rod, lane).
    """
    r, lane = wp.tid()
    if active[r] == 0:
        return
    fraction = largest_safe_fraction_of_lanes(dof, solution, r, limit, lane)
    if lane == 0:
        taken_out[r] = fraction
    for a in range(lane, dof.shape[1], wp.block_dim()):
        dof[r, a] = dof[r, a] - fraction * solution[r, 0, a]


@wp.kernel
def judge_step(
    # Model:
    until: wp.array(dtype=wp.float64),
    max_iterations: int,
    largest_step: wp.float64,
    smallest_step: wp.float64,
    growth: wp.float64,
    refuses_saddles: int,
    scheme: int,
    # State in:
    converged: wp.array(dtype=wp.int32),
    negative_pivots: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    span: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    touching: wp.array(dtype=wp.int32),
    # State in and out:
    leaves: wp.array(dtype=wp.int32),
    iteration: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step_before: wp.array(dtype=wp.float64),
    wanted_step: wp.array(dtype=wp.float64),
    running: wp.array(dtype=wp.int32),
    step_count: wp.array(dtype=wp.int32),
    iteration_count: wp.array(dtype=wp.int32),
    # State out:
    starting_out: wp.array(dtype=wp.int32),
    accepted_out: wp.array(dtype=wp.int32),
    rejected_out: wp.array(dtype=wp.int32),
    diverged_out: wp.array(dtype=wp.int32),
):
    """Accept a converged step; halve a failed one; cut out a rod whose step falls too far.

    Every rod has its own iteration, so that none waits for the slowest. A step that ends where its
    matrix is indefinite sits on an unstable state, which a long implicit step would hold for ever:
    only a shorter one lets the rod leave it.
    """
    r = wp.tid()
    starting_out[r] = 0
    accepted_out[r] = 0
    rejected_out[r] = 0
    if running[r] == 0:
        return
    if active[r] != 0 and iteration[r] < max_iterations:
        iteration[r] = iteration[r] + 1
        iteration_count[r] = iteration_count[r] + 1
        return
    active[r] = 0
    dt = step[r]
    if converged[r] != 0 and (refuses_saddles == 0 or negative_pivots[r] == 0):
        halfway = span[r] < dt
        two_step = coefficient[r][2] != ZERO
        if (halfway and touching[r] != NOTHING) or (two_step and touching[r] == IMPACT):
            # Once more, by another scheme.
            rejected_out[r] = 1
            leaves[r] = touching[r]
            starting_out[r] = 1
            return
        # No difference, nor one of differences, may reach beyond an impact.
        hit = touching[r] == IMPACT
        step_before[r] = wp.where(hit or leaves[r] == IMPACT, ZERO, dt)
        leaves[r] = wp.where(hit, IMPACT, NOTHING)
        if scheme == MIDPOINT and touching[r] == TOUCH:
            leaves[r] = TOUCH
        accepted_out[r] = 1
        time[r] = time[r] + dt
        step_count[r] = step_count[r] + 1
        wanted_step[r] = wp.min(growth * wanted_step[r], largest_step)
        if time[r] >= until[r] - wp.float64(1.0e-9) * largest_step:
            running[r] = 0
    else:
        rejected_out[r] = 1
        wanted_step[r] = HALF * dt
        if wanted_step[r] < smallest_step:
            diverged_out[r] = 1
            running[r] = 0
    starting_out[r] = running[r]


@wp.kernel
def extrapolate(
    # State in:
    chosen: wp.array(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    span: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State out:
    end_out: wp.array2d(dtype=wp.float64),
):
    """Where the chosen rods are at the end of their steps."""
    r, a = wp.tid()
    if chosen[r] == 0:
        return
    end = dof[r, a]
    if span[r] < step[r]:
        end = TWO * end - dof_before[r, a]
    end_out[r, a] = end


@wp.kernel
def shift_history(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    residual: wp.array2d(dtype=wp.float64),
    carried: wp.array2d(dtype=wp.int32),
    step: wp.array(dtype=wp.float64),
    span: wp.array(dtype=wp.float64),
    coefficient: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State in and out:
    dof_older: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    # State out:
    reaction_out: wp.array2d(dtype=wp.float64),
):
    """Carry an accepted step over to the next, and keep the forces that hold the rod in it."""
    r, a = wp.tid()
    if accepted[r] == 0:
        return
    v = difference(coefficient[r], step[r], dof[r, a], dof_before[r, a], dof_older[r, a])
    if span[r] < step[r] and carried[r, a] != 0:
        v = TWO * v - velocity[r, a]
    velocity_older[r, a] = velocity[r, a]
    velocity[r, a] = v
    dof_older[r, a] = dof_before[r, a]
    reaction_out[r, a] = residual[r, a]


@wp.kernel
def forget_history(
    # In:
    chosen: wp.array(dtype=wp.int32),
    # State out:
    step_before_out: wp.array(dtype=wp.float64),
    wanted_step_out: wp.array(dtype=wp.float64),
    diverged_out: wp.array(dtype=wp.int32),
    leaves_out: wp.array(dtype=wp.int32),
):
    """The next step of the chosen rods is their first, of implicit Euler."""
    r = wp.tid()
    if chosen[r] != 0:
        step_before_out[r] = ZERO
        wanted_step_out[r] = ZERO
        diverged_out[r] = 0
        leaves_out[r] = NOTHING


@wp.kernel
def record_frames(
    # Model:
    interval: wp.float64,
    # State in:
    accepted: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # Out:
    frames_out: wp.array3d(dtype=wp.float64),
):
    """Degrees of freedom at the multiples of `interval` that the step passed, interpolated."""
    r, a = wp.tid()
    if accepted[r] == 0:
        return
    slack = wp.float64(1.0e-9) * interval
    first = int(wp.ceil((time[r] - step[r] + slack) / interval))
    last = int(wp.floor((time[r] + slack) / interval))
    for f in range(first, wp.min(last + 1, frames_out.shape[1])):
        late = (time[r] - wp.float64(f) * interval) / step[r]
        frames_out[r, f, a] = dof[r, a] + late * (dof_before[r, a] - dof[r, a])


@wp.kernel
def set_until(
    # Model:
    duration: wp.float64,
    # State in:
    time: wp.array(dtype=wp.float64),
    # State out:
    until_out: wp.array(dtype=wp.float64),
):
    """Let every rod go on by a duration."""
    r = wp.tid()
    until_out[r] = time[r] + duration


@wp.kernel
def begin_advance(
    # Model:
    largest_step: wp.float64,
    until: wp.array(dtype=wp.float64),
    # State in:
    time: wp.array(dtype=wp.float64),
    diverged: wp.array(dtype=wp.int32),
    # State in and out:
    wanted_step: wp.array(dtype=wp.float64),
    # State out:
    running_out: wp.array(dtype=wp.int32),
    starting_out: wp.array(dtype=wp.int32),
):
    """Start the rods that have not reached their time, with the steps that they wanted last."""
    r = wp.tid()
    early = time[r] < until[r] - wp.float64(1.0e-9) * largest_step
    runs = wp.where(diverged[r] == 0 and early, 1, 0)
    running_out[r] = runs
    starting_out[r] = runs
    if wanted_step[r] > ZERO:
        wanted_step[r] = wp.min(wanted_step[r], largest_step)
    else:
        wanted_step[r] = largest_step


@wp.kernel
def ask_on(
    # State in:
    running: wp.array(dtype=wp.int32),
    most_rounds: int,
    # State in and out:
    rounds: wp.array(dtype=wp.int32),
    # State out:
    going_out: wp.array(dtype=wp.int32),
):
    """Whether to take another round, and whether any rod still runs. Launched over (1, lane)."""
    _, lane = wp.tid()
    found = int(0)
    for r in range(lane, running.shape[0], wp.block_dim()):
        found += running[r]
    found = count_of_lanes(found)
    if lane > 0:
        return
    going_out[0] = wp.where(found > 0 and rounds[0] < most_rounds, 1, 0)
    going_out[1] = wp.where(found > 0, 1, 0)
    rounds[0] = rounds[0] + 1
