"""Optimal grasps of straight isotropic rods: each rod's whole Newton iteration by one thread.

From contact (node 0) to grip, block i is node i's position. A rod's continuation, its closure and
its step limits are its own, so that what becomes of it does not depend on its neighbours, nor on
how many they are.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.grasping.bordered import make_border
from wrod.kernels.grasping.closures import (
    CONVERGED,
    FAILED,
    RUNNING,
    ZERO_TENSION,
    counted,
)
from wrod.kernels.grasping.contact_edge import (
    first_direction,
    ghost_motion,
    half_turn,
    half_turn_rate,
)
from wrod.kernels.grasping.straight_rod import (
    evaluate,
    place_contact,
    point,
    put_point,
)
from wrod.kernels.linear.frontal import make_elimination

wp.set_module_options({"enable_backward": False})

eliminate, recover = make_elimination(3)
border = make_border(3)
vector5 = border.vector

# Balance that is enough on the way.
ON_THE_WAY = wp.constant(wp.float64(1.0e-2))
# Change of the force that no longer matters.
FORCE_DONE = wp.constant(wp.float64(1.0e-7))


@wp.struct
class Scratch:
    """What the iteration of a rod needs while it runs; one slot a thread."""

    stiffness: wp.array3d(dtype=wp.float64)
    load: wp.array3d(dtype=wp.float64)
    factor: wp.array3d(dtype=wp.float64)
    condensed: wp.array2d(dtype=wp.float64)
    motion: wp.array3d(dtype=wp.float64)
    saved: wp.array3d(dtype=wp.float64)


@wp.func
def ghost_load(stiffness: wp.array3d(dtype=wp.float64), slot: int, ghost: wp.vec3d) -> wp.vec3d:
    """Rate of the first free node's gradient when the ghost moves."""
    # Rows of the edge before the contact, columns of that after it.
    rate = wp.vec3d(ZERO, ZERO, ZERO)
    for b in range(3):
        rate[b] = -(
            stiffness[slot, 0, 3 + b] * ghost[0]
            + stiffness[slot, 0, 8 + b] * ghost[1]
            + stiffness[slot, 0, 12 + b] * ghost[2]
        )
    return rate


@wp.func
def safe_fraction(
    shape: wp.array3d(dtype=wp.float64),
    motion: wp.array3d(dtype=wp.float64),
    r: int,
    slot: int,
    edges: int,
    limit: wp.float64,
) -> wp.float64:
    """Fraction of the step after which no edge has changed by more than `limit` of its length."""
    largest = wp.float64(0.0)
    x = point(shape, r, 0)
    dx = wp.vec3d(ZERO, ZERO, ZERO)
    for j in range(edges):
        y = point(shape, r, j + 1)
        dy = point(motion, slot, j + 1)
        e = y - x
        d = dy - dx
        largest = wp.max(largest, wp.dot(d, d) / wp.dot(e, e))
        x = y
        dx = dy
    if largest > limit * limit:
        return limit / wp.sqrt(largest)
    return ONE


@wp.kernel
def solve_straight(
    # Model:
    work: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    stretch_ratio: wp.array(dtype=wp.float64),
    target: wp.array(dtype=wp.float64),
    weight: wp.array(dtype=wp.float64),
    tolerance: wp.array(dtype=wp.float64),
    closure: int,
    limit: wp.float64,
    first_increment: wp.float64,
    patience: int,
    most_iterations: int,
    scratch: Scratch,
    # State in and out:
    shape: wp.array3d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    thrust: wp.array(dtype=wp.float64),
    # Out:
    status_out: wp.array(dtype=wp.int32),
    iterations_out: wp.array(dtype=wp.int32),
    negative_out: wp.array(dtype=wp.int32),
    residual_out: wp.array(dtype=wp.float64),
    force_out: wp.array2d(dtype=wp.float64),
    jacobian_out: wp.array2d(dtype=wp.float64),
):
    """Newton with continuation from `shape`, at `curvature`, to the target and the closure.

    Out of balance a grasp takes Newton steps. In balance short of the target curvature it walks on
    along the exact tangent, each step a Newton step as well. At the target the thrust goes to the
    closure's minimum at the same time as the rod to its balance. What has not found its balance in
    `patience` steps goes back to the last grasp and walks on in smaller steps.
    """
    thread = wp.tid()
    if thread >= count[0]:
        return
    r = work[thread]
    slot = thread % scratch.condensed.shape[0]
    k_s = stretch_ratio[r]
    h0 = rest[r, 0]
    goal = target[r]
    kappa = curvature[r]
    pull = thrust[r]
    kappa_saved = wp.float64(kappa)
    pull_saved = wp.float64(pull)
    # The family's tangent, at first along the thrust; where it led last, and the slope there.
    along = vector5(ZERO, ZERO, ZERO, ZERO, ONE)
    heading = wp.vec3d(ONE, ZERO, ZERO)
    moved = wp.float64(0.0)
    slope_before = wp.float64(0.0)
    increment = wp.float64(first_increment)
    reach = wp.float64(first_increment)
    waited = int(0)
    saved = int(0)
    status = int(RUNNING)
    iterations = int(0)
    negative = int(0)
    worst = wp.float64(0.0)
    nothing = wp.vec3d(ZERO, ZERO, ZERO)
    while status == RUNNING:
        iterations += 1
        imbalance = evaluate(
            rest, k_s, kappa, shape, r, slot, edges, scratch.stiffness, scratch.load
        )
        worst = wp.max(imbalance, wp.abs(scratch.load[slot, edges, 0] + pull))
        negative = eliminate(
            scratch.stiffness, scratch.load, slot, edges, scratch.factor, scratch.condensed
        )
        half = half_turn(kappa, h0)
        d = first_direction(half)
        at_target = kappa == goal
        balanced = worst <= ON_THE_WAY

        # Where the Newton step leads, and along the tangent from there.
        turn = wp.vec3d(ZERO, ZERO, ZERO)
        kappa_change = wp.float64(0.0)
        extra = wp.vec3d(ZERO, ZERO, ZERO)
        if balanced and not at_target:
            # Along the exact tangent to more curvature, and a Newton step with it.
            if waited <= 3:
                increment = wp.float64(1.5) * increment
            kappa_change = wp.min(increment, goal - kappa)
            angle_rate = half_turn_rate(kappa, h0, kappa_change, ZERO)
            turn = (angle_rate * wp.length(point(shape, r, 1))) * wp.vec3d(-d[1], d[0], ZERO)
            extra = ghost_load(scratch.stiffness, slot, ghost_motion(half, h0, angle_rate, ZERO))
        f = border.residual(scratch.condensed, slot, turn, pull)
        for i in range(3):
            f[i] = f[i] + extra[i]
        v = border.solve(border.matrix(scratch.condensed, slot, d, along), -f)
        change = wp.float64(0.0)
        tangent = vector5(ZERO, ZERO, ZERO, ZERO, ONE)
        if closure != ZERO_TENSION and balanced:
            tangent = border.solve(border.matrix(scratch.condensed, slot, d, along), tangent)
            along = tangent / wp.length(tangent)
            # The tangent by the length of the way of what the closure makes small.
            gradient = border.grip_gradient(scratch.condensed, slot)
            gradient += border.grip_rate(scratch.condensed, slot, turn + v[0] * d, v)
            force = counted(closure, wp.vec3d(pull + v[4], -gradient[1], weight[r] - gradient[2]))
            way = border.grip_rate(scratch.condensed, slot, along[0] * d, along)
            way = counted(closure, wp.vec3d(along[4], -way[1], -way[2]))
            length = wp.length(way)
            if wp.dot(way, heading) < ZERO:
                length = -length
            tangent = along / length
            heading = way / length
            slope = wp.dot(force, heading)
            steepness = wp.float64(1.0)
            if at_target and wp.abs(moved) > wp.float64(1.0e-6):
                secant = (slope - slope_before) / moved
                if secant > wp.float64(0.1) and secant < wp.float64(10.0):
                    steepness = secant
            change = -slope / steepness
            slope_before = slope

        if balanced and worst <= tolerance[r] and at_target and wp.abs(change) <= FORCE_DONE:
            status = CONVERGED
        elif not wp.isfinite(worst) or waited > patience or iterations >= most_iterations:
            increment = HALF * HALF * increment
            reach = HALF * HALF * reach
            if increment < wp.float64(1.0e-4) or saved == 0 or iterations >= most_iterations:
                status = FAILED
            else:
                for i in range(edges + 1):
                    for c in range(3):
                        shape[r, i, c] = scratch.saved[slot, i, c]
                kappa = kappa_saved
                pull = pull_saved
                # The way back is no evidence for larger steps.
                waited = 4
                along = vector5(ZERO, ZERO, ZERO, ZERO, ONE)
                moved = ZERO
        else:
            if balanced:
                for i in range(edges + 1):
                    for c in range(3):
                        scratch.saved[slot, i, c] = shape[r, i, c]
                kappa_saved = kappa
                pull_saved = pull
                saved = 1
                if not at_target or wp.abs(change) > FORCE_DONE:
                    if waited <= 3:
                        reach = wp.float64(1.5) * reach
                    waited = 0
            waited += 1
            change = wp.clamp(change, -reach, reach)
            if balanced:
                v = v + change * tangent
            put_point(scratch.motion, slot, 0, nothing)
            put_point(scratch.motion, slot, 1, turn + v[0] * d)
            put_point(scratch.motion, slot, edges, wp.vec3d(v[1], v[2], v[3]))
            recover(scratch.factor, slot, edges, ONE, scratch.motion)
            fraction = safe_fraction(shape, scratch.motion, r, slot, edges, limit)
            for i in range(1, edges + 1):
                for c in range(3):
                    shape[r, i, c] = shape[r, i, c] + fraction * scratch.motion[slot, i, c]
            pull = pull + fraction * v[4]
            if balanced:
                moved = fraction * change
            if kappa_change != ZERO:
                if fraction < ONE:
                    kappa = kappa + fraction * kappa_change
                    increment = wp.abs(fraction * kappa_change)
                elif kappa_change == goal - kappa:
                    kappa = goal
                else:
                    kappa = kappa + kappa_change
                place_contact(shape, r, kappa, h0)
    curvature[r] = kappa
    thrust[r] = pull
    status_out[r] = status
    iterations_out[r] = iterations_out[r] + iterations
    negative_out[r] = negative
    residual_out[r] = worst
    for i in range(3):
        force_out[r, i] = -scratch.condensed[slot, 39 + i]
        for c in range(3):
            jacobian_out[r, 3 * i + c] = -scratch.condensed[slot, (3 + i) * 6 + 3 + c]
    force_out[r, 2] = force_out[r, 2] + weight[r]
