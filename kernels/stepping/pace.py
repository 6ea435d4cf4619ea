"""When rods' time steps begin and end: every rod at its own time and pace.

The time to where forces are taken is `span`: the whole `step` but for the midpoint rule. A rod that
something has stopped has a velocity that differences over earlier steps do not know: two-step
formulas would throw it back, the midpoint rule reflect it. So a step with an impact, and the two
after it, are of implicit Euler; and the midpoint rule, which does not damp what is stiff, leaves
steps in which anything is touched to the two-step formula.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO
from wrod.kernels.lanes import count_of_lanes, wait_for_lanes

EULER = wp.constant(0)
TWO_STEP = wp.constant(1)
MIDPOINT = wp.constant(2)
# What has made a rod leave its scheme for a step: nothing, that it touches something, an impact.
NOTHING = wp.constant(0)
TOUCH = wp.constant(1)
IMPACT = wp.constant(2)


@wp.struct
class Pace:
    """Where the steps of rods are, (rod,) each: see `wrod.solvers.steps.Steps`; `touching` is what
    was met in a step, `leaves` what has made the rod leave its scheme."""

    time: wp.array(dtype=wp.float64)
    until: wp.array(dtype=wp.float64)
    step: wp.array(dtype=wp.float64)
    step_before: wp.array(dtype=wp.float64)
    wanted_step: wp.array(dtype=wp.float64)
    span: wp.array(dtype=wp.float64)
    coefficient: wp.array(dtype=wp.vec3d)
    step_tolerance: wp.array(dtype=wp.float64)
    touching: wp.array(dtype=wp.int32)
    leaves: wp.array(dtype=wp.int32)
    iteration: wp.array(dtype=wp.int32)
    iteration_count: wp.array(dtype=wp.int32)
    step_count: wp.array(dtype=wp.int32)
    running: wp.array(dtype=wp.int32)
    starting: wp.array(dtype=wp.int32)
    active: wp.array(dtype=wp.int32)
    converged: wp.array(dtype=wp.int32)
    accepted: wp.array(dtype=wp.int32)
    rejected: wp.array(dtype=wp.int32)
    diverged: wp.array(dtype=wp.int32)


@wp.kernel
def begin_step(
    # Model:
    scheme: int,
    tolerance: wp.float64,
    rounding: wp.array(dtype=wp.vec2d),
    stretching_time: wp.array(dtype=wp.float64),
    # State in and out:
    pace: Pace,
    # State out:
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """Choose the step, which ends on `until` without a crumb before it, and its coefficients."""
    r = wp.tid()
    if pace.starting[r] == 0:
        return
    pace.iteration[r] = 0
    pace.active[r] = 1
    pace.converged[r] = 0
    negative_pivots_out[r] = 0
    left = pace.until[r] - pace.time[r]
    dt = wp.float64(pace.wanted_step[r])
    if left <= wp.float64(1.0001) * dt:
        dt = left
    elif left < TWO * dt:
        dt = HALF * left
    pace.step[r] = dt
    pace.touching[r] = NOTHING
    span = wp.float64(dt)
    if scheme == MIDPOINT and pace.leaves[r] == NOTHING:
        span = HALF * dt
        pace.coefficient[r] = wp.vec3d(ONE, -ONE, ZERO)
    elif scheme != EULER and pace.leaves[r] != IMPACT and pace.step_before[r] > ZERO:
        w = dt / pace.step_before[r]
        pace.coefficient[r] = wp.vec3d((ONE + TWO * w) / (ONE + w), -(ONE + w), w * w / (ONE + w))
    else:
        pace.coefficient[r] = wp.vec3d(ONE, -ONE, ZERO)
    pace.span[r] = span
    # Rounding of positions leaves this much in the stiffest edge, and in the inertia of the step.
    rate = pace.coefficient[r][0] / span
    left_over = rounding[r][0] * (ONE + stretching_time[r] * rate) + rounding[r][1] * rate * rate
    pace.step_tolerance[r] = wp.max(tolerance, left_over)


@wp.kernel
def judge_step(
    # Model:
    max_iterations: int,
    shrinks: wp.float64,
    largest_step: wp.float64,
    smallest_step: wp.float64,
    growth: wp.float64,
    refuses_saddles: int,
    scheme: int,
    # State in:
    negative_pivots: wp.array(dtype=wp.int32),
    residual: wp.array(dtype=wp.float64),
    # State in and out:
    pace: Pace,
):
    """Accept a converged step; halve a failed one; cut out a rod whose step falls too far.

    Every rod has its own iteration, so that none waits for the slowest. A step fails as soon as the
    iterations that are left cannot make it converge, were each to divide its residual by `shrinks`.
    A step that ends where its
    matrix is indefinite sits on an unstable state, which a long implicit step would hold for ever:
    only a shorter one lets the rod leave it.
    """
    r = wp.tid()
    pace.starting[r] = 0
    pace.accepted[r] = 0
    pace.rejected[r] = 0
    if pace.running[r] == 0:
        return
    left = wp.float64(max_iterations - pace.iteration[r])
    hopeless = residual[r] > pace.step_tolerance[r] * wp.pow(shrinks, left)
    if pace.active[r] != 0 and left > ZERO and not hopeless:
        pace.iteration[r] = pace.iteration[r] + 1
        pace.iteration_count[r] = pace.iteration_count[r] + 1
        return
    stands = pace.converged[r] != 0 and (refuses_saddles == 0 or negative_pivots[r] == 0)
    # What is judged is not looked at again: contact might take a rod up that waits for others.
    pace.active[r] = 0
    pace.converged[r] = 0
    dt = pace.step[r]
    if stands:
        halfway = pace.span[r] < dt
        two_step = pace.coefficient[r][2] != ZERO
        if (halfway and pace.touching[r] != NOTHING) or (two_step and pace.touching[r] == IMPACT):
            # Once more, by another scheme.
            pace.rejected[r] = 1
            pace.leaves[r] = pace.touching[r]
            pace.starting[r] = 1
            return
        # No difference, nor one of differences, may reach beyond an impact.
        hit = pace.touching[r] == IMPACT
        pace.step_before[r] = wp.where(hit or pace.leaves[r] == IMPACT, ZERO, dt)
        pace.leaves[r] = wp.where(hit, IMPACT, NOTHING)
        if scheme == MIDPOINT and pace.touching[r] == TOUCH:
            pace.leaves[r] = TOUCH
        pace.accepted[r] = 1
        pace.time[r] = pace.time[r] + dt
        pace.step_count[r] = pace.step_count[r] + 1
        pace.wanted_step[r] = wp.min(growth * pace.wanted_step[r], largest_step)
        if pace.time[r] >= pace.until[r] - wp.float64(1.0e-9) * largest_step:
            pace.running[r] = 0
    else:
        pace.rejected[r] = 1
        pace.wanted_step[r] = HALF * dt
        if pace.wanted_step[r] < smallest_step:
            pace.diverged[r] = 1
            pace.running[r] = 0
    pace.starting[r] = pace.running[r]


@wp.kernel
def forget_history(
    # In:
    chosen: wp.array(dtype=wp.int32),
    # State out:
    pace: Pace,
):
    """The next step of the chosen rods is their first, of implicit Euler."""
    r = wp.tid()
    if chosen[r] != 0:
        pace.step_before[r] = ZERO
        pace.wanted_step[r] = ZERO
        pace.diverged[r] = 0
        pace.leaves[r] = NOTHING


@wp.kernel
def record_frames(
    # Model:
    interval: wp.float64,
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # Out:
    frames_out: wp.array3d(dtype=wp.float64),
):
    """Degrees of freedom at the multiples of `interval` that the step passed, interpolated."""
    r, a = wp.tid()
    if pace.accepted[r] == 0:
        return
    slack = wp.float64(1.0e-9) * interval
    first = int(wp.ceil((pace.time[r] - pace.step[r] + slack) / interval))
    last = int(wp.floor((pace.time[r] + slack) / interval))
    for f in range(first, wp.min(last + 1, frames_out.shape[1])):
        late = (pace.time[r] - wp.float64(f) * interval) / pace.step[r]
        frames_out[r, f, a] = dof[r, a] + late * (dof_before[r, a] - dof[r, a])


@wp.kernel
def begin_advance(
    # Model:
    largest_step: wp.float64,
    duration: wp.float64,
    # State in and out:
    pace: Pace,
):
    """Start the rods that have not reached their time, with the steps that they wanted last; a
    duration that is not 0 is gone on by from a time of 0, so that rounding knows no clock."""
    r = wp.tid()
    if duration > ZERO:
        pace.time[r] = ZERO
        pace.until[r] = duration
    early = pace.time[r] < pace.until[r] - wp.float64(1.0e-9) * largest_step
    runs = wp.where(pace.diverged[r] == 0 and early, 1, 0)
    pace.running[r] = runs
    pace.starting[r] = runs
    if pace.wanted_step[r] > ZERO:
        pace.wanted_step[r] = wp.min(pace.wanted_step[r], largest_step)
    else:
        pace.wanted_step[r] = largest_step


@wp.kernel
def ask_on(
    # State in:
    pace: Pace,
    most_rounds: int,
    # State in and out:
    rounds: wp.array(dtype=wp.int32),
    # State out:
    going_out: wp.array(dtype=wp.int32),
):
    """Whether to take another round, and whether any rod still runs, and whether any starts a step.
    Launched over (1, lane)."""
    _, lane = wp.tid()
    found = int(0)
    starts = int(0)
    for r in range(lane, pace.running.shape[0], wp.block_dim()):
        found += pace.running[r]
        starts += pace.starting[r]
    found = count_of_lanes(found)
    starts = count_of_lanes(starts)
    if lane > 0:
        return
    going_out[0] = wp.where(found > 0 and rounds[0] < most_rounds, 1, 0)
    going_out[1] = wp.where(found > 0, 1, 0)
    going_out[2] = wp.where(starts > 0, 1, 0)
    rounds[0] = rounds[0] + 1


@wp.kernel
def ask_what(
    # State in:
    pace: Pace,
    # State out:
    going_out: wp.array(dtype=wp.int32),
):
    """Whether any rod iterates on, and whether any has ended a step. Launched over (1, lane)."""
    _, lane = wp.tid()
    goes = int(0)
    ends = int(0)
    for r in range(lane, pace.active.shape[0], wp.block_dim()):
        goes += pace.active[r]
        ends += pace.accepted[r] + pace.rejected[r]
    goes = count_of_lanes(goes)
    ends = count_of_lanes(ends)
    if lane == 0:
        going_out[3] = wp.where(goes > 0, 1, 0)
        going_out[4] = wp.where(ends > 0, 1, 0)


@wp.kernel
def measure(
    # Model:
    end: wp.array(dtype=wp.float64),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    force: wp.array2d(dtype=wp.vec3d),
    slip: wp.array2d(dtype=wp.float64),
    # State in and out:
    pace: Pace,
    # State out:
    dof_out: wp.array2d(dtype=wp.float64),
    force_out: wp.array2d(dtype=wp.vec3d),
    slip_out: wp.array2d(dtype=wp.float64),
):
    """Keep where a rod is that has come to its time or goes no further, what touches it and how far
    that slid; and let it go on until `end`, if it can. Launched over (rod, lane)."""
    r, lane = wp.tid()
    if pace.running[r] != 0 or pace.until[r] == end[r]:
        return
    wait_for_lanes()
    for a in range(lane, dof.shape[1], wp.block_dim()):
        dof_out[r, a] = dof[r, a]
    for i in range(lane, force.shape[1], wp.block_dim()):
        force_out[r, i] = force[r, i]
        slip_out[r, i] = slip[r, i]
    if lane == 0:
        pace.until[r] = end[r]
        goes_on = 1 - pace.diverged[r]
        pace.running[r] = goes_on
        pace.starting[r] = goes_on
