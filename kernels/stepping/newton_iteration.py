"""Steps of a batched, damped Newton iteration; every rod has its own state of progress."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ZERO, edge
from wrod.kernels.lanes import count_of_lanes, largest_of_lanes, sum_of_lanes

ARMIJO = wp.constant(wp.float64(1.0e-4))
ROUNDING = wp.constant(wp.float64(1.0e-13))


@wp.func
def step_edge(step: wp.array3d(dtype=wp.float64), r: int, i: int) -> wp.vec3d:
    a = 4 * i
    return wp.vec3d(
        step[r, 0, a + 4] - step[r, 0, a],
        step[r, 0, a + 5] - step[r, 0, a + 1],
        step[r, 0, a + 6] - step[r, 0, a + 2],
    )


@wp.func
def safe_fraction(
    dof: wp.array2d(dtype=wp.float64),
    step: wp.array3d(dtype=wp.float64),
    r: int,
    limit: wp.float64,
    first: int,
    stride: int,
) -> wp.float64:
    """Fraction of the step after which no edge has changed by more than `limit` of its length,
    nor any angle by more than 2 `limit` radians; of every `stride`th edge from `first` on."""
    fraction = wp.float64(1.0)
    edge_count = (dof.shape[1] + 1) // 4 - 1
    for i in range(first, edge_count, stride):
        change = wp.length(step_edge(step, r, i)) / wp.length(edge(dof, r, i))
        change = wp.max(change, HALF * wp.abs(step[r, 0, 4 * i + 3]))
        if change * fraction > limit:
            fraction = limit / change
    return fraction


@wp.func
def largest_safe_fraction_of_lanes(
    dof: wp.array2d(dtype=wp.float64),
    step: wp.array3d(dtype=wp.float64),
    r: int,
    limit: wp.float64,
    lane: int,
) -> wp.float64:
    """The same of all edges, in every lane."""
    return -largest_of_lanes(-safe_fraction(dof, step, r, limit, lane, wp.block_dim()))


@wp.kernel
def measure_residual(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    force_scale: wp.array(dtype=wp.float64),
    length_scale: wp.array(dtype=wp.float64),
    tolerance: wp.array(dtype=wp.float64),
    # State in:
    gradient: wp.array2d(dtype=wp.float64),
    # State in and out:
    active: wp.array(dtype=wp.int32),
    # State out:
    residual_out: wp.array(dtype=wp.float64),
    converged_out: wp.array(dtype=wp.int32),
):
    """Largest unbalanced force over the force scale (torques over the length scale as well).

    A rod within the tolerance stops; one whose residual is not a number stops as not converged.
    Launched over (rod, lane).
    """
    r, lane = wp.tid()
    if active[r] == 0:
        return
    worst = wp.float64(0.0)
    for a in range(lane, gradient.shape[1], wp.block_dim()):
        if free[r, a] != 0:
            value = wp.abs(gradient[r, a])
            if a % 4 == 3:
                value = value / length_scale[r]
            # Comparisons with a NaN are false, so that one is not lost.
            if not (value <= worst) and wp.isfinite(worst):
                worst = wp.float64(value)
    worst = largest_of_lanes(worst)
    if lane > 0:
        return
    residual_out[r] = worst / force_scale[r]
    if not wp.isfinite(worst):
        active[r] = 0
    elif worst <= tolerance[r] * force_scale[r]:
        converged_out[r] = 1
        active[r] = 0


@wp.kernel
def ask_any(
    # State in:
    chosen: wp.array(dtype=wp.int32),
    most: int,
    # State in and out:
    asked: wp.array(dtype=wp.int32),
    # State out:
    any_out: wp.array(dtype=wp.int32),
):
    """Whether any rod is chosen, as long as it was not asked more than `most` times.

    Launched over (1, lane).
    """
    _, lane = wp.tid()
    found = int(0)
    for r in range(lane, chosen.shape[0], wp.block_dim()):
        found += chosen[r]
    found = count_of_lanes(found)
    if lane > 0:
        return
    any_out[0] = wp.where(found > 0 and asked[0] < most, 1, 0)
    asked[0] = asked[0] + 1


@wp.kernel
def count_active(
    # State in:
    active: wp.array(dtype=wp.int32),
    # State in and out:
    iterations: wp.array(dtype=wp.int32),
):
    r = wp.tid()
    iterations[r] = iterations[r] + active[r]


@wp.kernel
def choose_shift(
    # State in:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    negative_pivots: wp.array(dtype=wp.int32),
    # State out:
    shift_out: wp.array(dtype=wp.float64),
    shift_unit_out: wp.array(dtype=wp.float64),
    retry_out: wp.array(dtype=wp.int32),
):
    """Where the free Hessian is indefinite, raise its shift and ask for another factorisation."""
    r = wp.tid()
    # Read before it is written: on a retry `active` is `retry_out` itself.
    indefinite = active[r] != 0 and negative_pivots[r] > 0
    retry_out[r] = 0
    if not indefinite:
        return
    largest = wp.float64(0.0)
    for a in range(hessian.shape[1]):
        if free[r, a] != 0:
            largest = wp.max(largest, wp.abs(hessian[r, a, 0]))
    shift_unit_out[r] = wp.float64(1.0e-8) * largest
    shift_out[r] = wp.max(wp.float64(8.0) * shift_out[r], shift_unit_out[r])
    retry_out[r] = 1


@wp.kernel
def start_line_search(
    # Model:
    limit: wp.float64,
    # State in:
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    # State in and out:
    step: wp.array3d(dtype=wp.float64),
    # State out:
    slope_out: wp.array(dtype=wp.float64),
    fraction_out: wp.array(dtype=wp.float64),
    searching_out: wp.array(dtype=wp.int32),
):
    """Turn the solved system into a descent step and choose its first fraction.

    Launched over (rod, lane).
    """
    r, lane = wp.tid()
    searching_out[r] = active[r]
    if active[r] == 0:
        return
    fraction = largest_safe_fraction_of_lanes(dof, step, r, limit, lane)
    slope = wp.float64(0.0)
    for a in range(lane, gradient.shape[1], wp.block_dim()):
        step[r, 0, a] = -step[r, 0, a]
        if free[r, a] != 0:
            slope += gradient[r, a] * step[r, 0, a]
    slope = sum_of_lanes(slope)
    if lane == 0:
        slope_out[r] = slope
        fraction_out[r] = fraction


@wp.kernel
def take_trial_step(
    stride: int,
    # State in:
    searching: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    step: wp.array3d(dtype=wp.float64),
    fraction: wp.array(dtype=wp.float64),
    # State out:
    dof_out: wp.array2d(dtype=wp.float64),
):
    """Go a fraction of the step. Launched over (rod, thread), each for every `stride`th number."""
    r, first = wp.tid()
    if searching[r] != 0:
        for a in range(first, dof_in.shape[1], stride):
            dof_out[r, a] = dof_in[r, a] + fraction[r] * step[r, 0, a]


@wp.kernel
def judge_trial_step(
    # Model:
    search: int,
    smallest_fraction: wp.float64,
    force_scale: wp.array(dtype=wp.float64),
    length_scale: wp.array(dtype=wp.float64),
    # State in:
    shift_unit: wp.array(dtype=wp.float64),
    energy: wp.array(dtype=wp.float64),
    trial_energy: wp.array(dtype=wp.float64),
    slope: wp.array(dtype=wp.float64),
    # State in and out:
    fraction: wp.array(dtype=wp.float64),
    searching: wp.array(dtype=wp.int32),
    shift: wp.array(dtype=wp.float64),
):
    """Armijo's rule on the energy, with room for rounding; halve the step where it fails.

    Without `search` every step is taken: turning the edges of a stiff rod stretches them for one
    iteration, and the energy would forbid the steps that converge fastest (Maratos effect).
    """
    r = wp.tid()
    if searching[r] == 0:
        return
    room = ROUNDING * (wp.abs(energy[r]) + force_scale[r] * length_scale[r])
    if search == 0 or trial_energy[r] <= energy[r] + ARMIJO * fraction[r] * slope[r] + room:
        searching[r] = 0
        # Below its unit the shift ends: it would cost the quadratic convergence.
        shift[r] = wp.where(shift[r] > shift_unit[r], shift[r] / wp.float64(8.0), ZERO)
    elif fraction[r] < smallest_fraction:
        # No descent to be found: stay, and let a stiffer model make the next step shorter.
        fraction[r] = ZERO
        searching[r] = 0
        shift[r] = wp.max(wp.float64(64.0) * shift[r], shift_unit[r])
    else:
        fraction[r] = HALF * fraction[r]


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
