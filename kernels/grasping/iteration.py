"""Optimal grasps: each rod's whole Newton iteration by one thread.

From contact (node 0) to grip, block i is node i's position, in a general rod after the angle of the
edge that leads there. Straight isotropic rods, which are not twisted, do without angles and frames.
A rod's continuation, its closure and
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
from wrod.kernels.grasping.general_rod import GeneralRod, advance_general, evaluate_general
from wrod.kernels.grasping.straight_rod import (
    StraightRod,
    evaluate,
    place_contact,
    point,
)
from wrod.kernels.linear.frontal import make_elimination

wp.set_module_options({"enable_backward": False})


# Balance that is enough at the target to look along the family.
AT_TARGET = wp.constant(wp.float64(5.0e-3))
# How much better balanced two grasps are than they are apart, for their slopes to be compared.
SHARP = wp.constant(wp.float64(2.0e-2))
# Change of the force that no longer matters, and its part of what rounding leaves out of balance.
FORCE_DONE = wp.constant(wp.float64(1.0e-11))
FORCE_ROUNDING = wp.constant(wp.float64(0.01))


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
def advance_straight(
    shape: wp.array3d(dtype=wp.float64),
    motion: wp.array3d(dtype=wp.float64),
    r: int,
    slot: int,
    edges: int,
    fraction: wp.float64,
):
    for i in range(1, edges + 1):
        for c in range(3):
            shape[r, i, c] = shape[r, i, c] + fraction * motion[slot, i, c]


def make_solver(size: int):
    """The kernel of straight isotropic rods (`size` 3) or of general ones (4)."""
    general = size == 4
    eliminate, recover = make_elimination(size)
    border = make_border(size)
    vector = border.vector
    first = size - 3
    # Numbers of a node's state, and where the thrust stands among the border's unknowns.
    width = 7 if general else 3
    last = size + 1
    model = GeneralRod if general else StraightRod
    advance = advance_general if general else advance_straight
    # Without a tangent to lead them, general rods have to be nearer to balance on the way.
    on_the_way = wp.constant(wp.float64(1.0e-2 if general else 5.0e-2))
    quick = 6 if general else 3
    growth = wp.constant(wp.float64(2.0 if general else 1.5))

    @wp.func
    def safe_fraction(
        state: wp.array3d(dtype=wp.float64),
        motion: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        edges: int,
        limit: wp.float64,
    ) -> wp.float64:
        """Fraction of the step after which no edge has changed by more than `limit` of its length,
        nor any angle by more than 2 `limit` radians."""
        largest = wp.float64(0.0)
        x = point(state, r, 0)
        dx = wp.vec3d(ZERO, ZERO, ZERO)
        for j in range(edges):
            y = point(state, r, j + 1)
            dy = wp.vec3d(ZERO, ZERO, ZERO)
            for c in range(3):
                dy[c] = motion[slot, j + 1, first + c]
            e = y - x
            d = dy - dx
            largest = wp.max(largest, wp.dot(d, d) / wp.dot(e, e))
            if wp.static(general):
                half = HALF * motion[slot, j + 1, 0]
                if j > 0:
                    largest = wp.max(largest, half * half)
            x = y
            dx = dy
        if largest > limit * limit:
            return limit / wp.sqrt(largest)
        return ONE

    # A module each: nobody waits for the compiler because of rods that he does not have.
    @wp.kernel(module="unique")
    def solve(
        # Model:
        work: wp.array(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        edges: int,
        rod: model,
        target: wp.array(dtype=wp.float64),
        weight: wp.array(dtype=wp.float64),
        tolerance: wp.array(dtype=wp.float64),
        closure: int,
        limit: wp.float64,
        first_increment: wp.array(dtype=wp.float64),
        patience: int,
        most_iterations: int,
        scratch: Scratch,
        # State in and out:
        state: wp.array3d(dtype=wp.float64),
        curvature: wp.array(dtype=wp.float64),
        thrust: wp.array(dtype=wp.float64),
        family: wp.array2d(dtype=wp.float64),
        # Out:
        status_out: wp.array(dtype=wp.int32),
        iterations_out: wp.array(dtype=wp.int32),
        negative_out: wp.array(dtype=wp.int32),
        residual_out: wp.array(dtype=wp.float64),
        force_out: wp.array2d(dtype=wp.float64),
        jacobian_out: wp.array2d(dtype=wp.float64),
    ):
        """Newton with continuation from `shape`, at `curvature`, to the target and the closure.

        Out of balance a grasp takes Newton steps. In balance short of the target it walks on, along
        the exact tangent of the curvature, each step a Newton step as well. At the target it goes
        along the family to the closure's minimum at the same time as to its balance. What has not
        found its balance in `patience` steps goes back to the last grasp, and on in smaller steps.
        """
        thread = wp.tid()
        if thread >= count[0]:
            return
        r = work[thread]
        slot = thread % scratch.condensed.shape[0]
        h0 = rod.rest[r, 0]
        force_done = wp.max(FORCE_DONE, FORCE_ROUNDING * tolerance[r])
        kappa = curvature[r]
        # How far the continuation has come: in curvature, or from the uniform rod to the rod.
        place = wp.float64(kappa)
        goal = target[r]
        if wp.static(general):
            place = ZERO
            goal = ONE
        pull = thrust[r]
        place_saved = wp.float64(place)
        pull_saved = wp.float64(pull)
        # The family's tangent, and how the closure's slope changes along it; where it led last, and
        # the slope there.
        along = vector()
        for i in range(size + 2):
            along[i] = family[r, i]
        steepness = wp.float64(family[r, size + 2])
        along_saved = vector(along)
        heading = wp.vec3d(ONE, ZERO, ZERO)
        moved = wp.float64(0.0)
        slope_before = wp.float64(0.0)
        worst_before = wp.float64(0.0)
        increment = wp.float64(first_increment[r])
        reach = wp.float64(HALF)
        waited = int(0)
        saved = int(0)
        status = int(RUNNING)
        iterations = int(0)
        negative = int(0)
        worst = wp.float64(0.0)
        while status == RUNNING:
            iterations += 1
            imbalance = wp.float64(0.0)
            if wp.static(general):
                imbalance = evaluate_general(
                    rod, place, kappa, state, r, slot, edges, scratch.stiffness, scratch.load
                )
            else:
                kappa = place
                imbalance = evaluate(
                    rod.rest, rod.stretch_ratio[r], kappa, state, r, slot, edges,
                    scratch.stiffness, scratch.load,
                )  # fmt: skip
            worst = wp.max(imbalance, wp.abs(scratch.load[slot, edges, first] + pull))
            negative = eliminate(
                scratch.stiffness, scratch.load, slot, edges, scratch.factor, scratch.condensed
            )
            half = half_turn(kappa, h0)
            d = first_direction(half)
            at_target = place == goal
            balanced = worst <= wp.where(at_target, AT_TARGET, on_the_way)

            # Where the Newton step leads, and along the tangent from there.
            turn = wp.vec3d(ZERO, ZERO, ZERO)
            change_of_place = wp.float64(0.0)
            extra = wp.vec3d(ZERO, ZERO, ZERO)
            if balanced and not at_target:
                # Along the exact tangent to more curvature, and a Newton step with it.
                if waited <= quick:
                    increment = growth * increment
                change_of_place = wp.min(increment, goal - place)
                if wp.static(not general):
                    angle_rate = half_turn_rate(kappa, h0, change_of_place, ZERO)
                    turn = (angle_rate * wp.length(point(state, r, 1))) * wp.vec3d(
                        -d[1], d[0], ZERO
                    )
                    extra = ghost_load(
                        scratch.stiffness, slot, ghost_motion(half, h0, angle_rate, ZERO)
                    )
            f = border.residual(scratch.condensed, slot, turn, pull)
            for i in range(3):
                f[i] = f[i] + extra[i]
            v = border.solve(border.matrix(scratch.condensed, slot, d, along), -f)
            change = wp.float64(0.0)
            tangent = vector()
            tangent[last] = ONE
            if closure != ZERO_TENSION and balanced:
                tangent = border.solve(border.matrix(scratch.condensed, slot, d, along), tangent)
                along = tangent / wp.length(tangent)
                # The tangent by the length of the way of what the closure makes small.
                gradient = border.grip_gradient(scratch.condensed, slot)
                gradient += border.grip_rate(scratch.condensed, slot, turn + v[0] * d, v)
                force = counted(
                    closure, wp.vec3d(pull + v[last], -gradient[1], weight[r] - gradient[2])
                )
                way = border.grip_rate(scratch.condensed, slot, along[0] * d, along)
                way = counted(closure, wp.vec3d(along[last], -way[1], -way[2]))
                length = wp.length(way)
                if wp.dot(way, heading) < ZERO:
                    length = -length
                tangent = along / length
                heading = way / length
                slope = wp.dot(force, heading)
                if not at_target:
                    steepness = ONE
                elif worst + worst_before < SHARP * wp.abs(moved):
                    # What is out of balance is in the slope too.
                    secant = (slope - slope_before) / moved
                    if secant > wp.float64(0.1) and secant < wp.float64(10.0):
                        steepness = secant
                change = -slope / steepness
                slope_before = slope
                worst_before = worst

            if balanced and worst <= tolerance[r] and at_target and wp.abs(change) <= force_done:
                status = CONVERGED
            elif not wp.isfinite(worst) or waited > patience or iterations >= most_iterations:
                increment = HALF * HALF * increment
                reach = HALF * HALF * reach
                if increment < wp.float64(1.0e-4) or saved == 0 or iterations >= most_iterations:
                    status = FAILED
                else:
                    for i in range(edges + 1):
                        for c in range(width):
                            state[r, i, c] = scratch.saved[slot, i, c]
                    place = place_saved
                    pull = pull_saved
                    # The way back is no evidence for larger steps.
                    waited = 4
                    along = vector(along_saved)
                    moved = ZERO
            else:
                if balanced:
                    for i in range(edges + 1):
                        for c in range(width):
                            scratch.saved[slot, i, c] = state[r, i, c]
                    place_saved = place
                    pull_saved = pull
                    along_saved = vector(along)
                    saved = 1
                    if not at_target or wp.abs(change) > force_done:
                        if waited <= 3:
                            reach = wp.float64(1.5) * reach
                        waited = 0
                waited += 1
                change = wp.clamp(change, -reach, reach)
                if balanced:
                    v = v + change * tangent
                node_1 = turn + v[0] * d
                for c in range(size):
                    scratch.motion[slot, 0, c] = ZERO
                    scratch.motion[slot, 1, c] = ZERO
                    scratch.motion[slot, edges, c] = v[1 + c]
                for c in range(3):
                    scratch.motion[slot, 1, first + c] = node_1[c]
                recover(scratch.factor, slot, edges, ONE, scratch.motion)
                fraction = safe_fraction(state, scratch.motion, r, slot, edges, limit)
                advance(state, scratch.motion, r, slot, edges, fraction)
                pull = pull + fraction * v[last]
                if balanced:
                    moved = fraction * change
                if change_of_place != ZERO:
                    if fraction < ONE and not general:
                        place = place + fraction * change_of_place
                        increment = wp.abs(fraction * change_of_place)
                    elif change_of_place == goal - place:
                        place = goal
                    else:
                        place = place + change_of_place
                    if wp.static(not general):
                        place_contact(state, r, place, h0)
        if wp.static(not general):
            curvature[r] = place
        thrust[r] = pull
        for i in range(size + 2):
            family[r, i] = along[i]
        family[r, size + 2] = steepness
        status_out[r] = status
        iterations_out[r] = iterations_out[r] + iterations
        negative_out[r] = negative
        residual_out[r] = worst
        held = border.grip_gradient(scratch.condensed, slot)
        for i in range(3):
            force_out[r, i] = -held[i]
            at = (size + first + i) * 2 * size + size + first
            for c in range(3):
                jacobian_out[r, 3 * i + c] = -scratch.condensed[slot, at + c]
        force_out[r, 2] = force_out[r, 2] + weight[r]

    return solve


solve_straight = make_solver(3)
solve_general = make_solver(4)
