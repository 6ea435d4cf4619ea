"""Optimal grasps: each rod's whole Newton iteration by one thread.

From contact (node 0) to grip, block i is node i's position, in a general rod after the angle of the
edge that leads there. Straight isotropic rods, which are not twisted, do without angles and frames.
A rod's continuation, its closure and its step limits are its own, so that what becomes of it does
not depend on its neighbours, nor on how many they are.
"""

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.grasping.bordered import make_border
from wrod.kernels.grasping.closures import CONVERGED, RUNNING, ZERO_TENSION
from wrod.kernels.grasping.contact_edge import (
    first_direction,
    ghost_load,
    ghost_motion,
    half_turn,
    half_turn_rate,
)
from wrod.kernels.grasping.general_rod import GeneralRod
from wrod.kernels.grasping.reading import Level
from wrod.kernels.grasping.scratch import Scratch
from wrod.kernels.grasping.step import make_balance, make_step
from wrod.kernels.grasping.straight_rod import StraightRod, place_contact, point
from wrod.kernels.grasping.walk import make_walk

# Balance that is enough at the target to look along the family.
AT_TARGET = wp.constant(wp.float64(5.0e-3))
# Change of the force that no longer matters, and its part of what rounding leaves out of balance.
FORCE_DONE = wp.constant(wp.float64(1.0e-12))
FORCE_ROUNDING = wp.constant(wp.float64(1.0e-5))
# After a longer way along the family the slope is of what is out of balance, and small by luck; so
# it is where the rod holds.
STILL = wp.constant(wp.float64(3.0e-7))
# A slope that has been refined so often is as good as it gets.
MOST_REFINED = wp.constant(8)


@wp.struct
class IterationTask:
    """What is asked of an iteration, (rod,) each or for all."""

    # Curvature of the pattern, weight, imbalance that rounding leaves, and the continuation's first
    # increment.
    target: wp.array(dtype=wp.float64)
    weight: wp.array(dtype=wp.float64)
    tolerance: wp.array(dtype=wp.float64)
    increment: wp.array(dtype=wp.float64)
    closure: int
    # Change of the force that does not matter, on meshes that only lead to finer ones.
    force_done: wp.float64
    # Largest change of an edge in one step, as a fraction of its length.
    step_limit: wp.float64
    # Newton steps on one continuation step before it counts as failed, and in all.
    patience: int
    most_iterations: int
    # Where general rods begin: as uniform straight ones (0), or as they are (1).
    place: wp.float64


def make_lead(size: int) -> tuple[wp.Function, wp.Function]:
    """What says where the Newton step leads, and what takes the continuation there."""
    general = size == 4
    border = make_border(size)
    walk = make_walk(size).struct
    quick = 6 if general else 3
    growth = wp.constant(wp.float64(2.0 if general else 1.5))

    @wp.func
    def lead(
        w: wp.ref[walk],
        kappa: wp.float64,
        h0: wp.float64,
        walks_on: bool,
        state: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        scratch: Scratch,
    ):
        """How far the continuation goes, the turn of the first edge with it, and the Newton step:
        where it walks on, along the exact tangent of the curvature."""
        half = half_turn(kappa, h0)
        d = first_direction(half)
        ahead = wp.float64(0.0)
        turn = wp.vec3d(ZERO, ZERO, ZERO)
        extra = wp.vec3d(ZERO, ZERO, ZERO)
        if walks_on:
            if w.waited <= quick:
                w.increment = growth * w.increment
            ahead = wp.min(w.increment, w.goal - w.place)
            if wp.static(not general):
                rate = half_turn_rate(kappa, h0, ahead, ZERO)
                turn = (rate * wp.length(point(state, r, 1))) * wp.vec3d(-d[1], d[0], ZERO)
                extra = ghost_load(scratch.stiffness, slot, ghost_motion(half, h0, rate, ZERO))
        f = border.residual(scratch.condensed, slot, turn, w.pull)
        for i in range(3):
            f[i] = f[i] + extra[i]
        v = border.solve(border.matrix(scratch.condensed, slot, d, w.along), -f)
        return ahead, turn, v

    @wp.func
    def walk_on(w: wp.ref[walk], ahead: wp.float64, fraction: wp.float64):
        """Move the place by what the step went."""
        if fraction < ONE and not wp.static(general):
            w.place = w.place + fraction * ahead
            w.increment = wp.abs(fraction * ahead)
        elif ahead == w.goal - w.place:
            w.place = w.goal
        else:
            w.place = w.place + ahead

    return lead, walk_on


def make_go_on(size: int) -> wp.Function:
    """What takes the step that is due: along the family too where the rod is in balance."""
    general = size == 4
    walk = make_walk(size)
    state_of_walk = walk.struct
    border = make_border(size)
    vector = border.vector
    take_step = make_step(size, GeneralRod if general else StraightRod)[0]
    walk_on = make_lead(size)[1]
    # Where the thrust stands among the border's unknowns.
    last = size + 1

    @wp.func
    def go_on(
        w: wp.ref[state_of_walk],
        balanced: bool,
        settled: bool,
        change: wp.float64,
        ahead: wp.float64,
        turn: wp.vec3d,
        newton: vector,
        h0: wp.float64,
        kappa: wp.float64,
        state: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        edges: int,
        scratch: Scratch,
        limit: wp.float64,
    ):
        v = vector(newton)
        along_family = wp.float64(0.0)
        if balanced:
            walk.keep(w, state, scratch.saved, r, slot, edges)
            if not settled:
                if w.waited <= 3:
                    w.reach = wp.float64(1.5) * w.reach
                w.waited = 0
            if w.holds == 0:
                along_family = wp.clamp(change, -w.reach, w.reach)
            v = v + along_family * w.tangent
        w.waited += 1
        node_1 = turn + v[0] * first_direction(half_turn(kappa, h0))
        fraction = take_step(state, scratch, r, slot, edges, node_1, v, w.spin, limit)
        w.pull = w.pull + fraction * v[last]
        if w.status == CONVERGED:
            # Nobody evaluates it again.
            gradient = border.grip_gradient(scratch.condensed, slot)
            gradient += fraction * border.grip_rate(scratch.condensed, slot, node_1, v)
            border.put_grip_gradient(scratch.condensed, slot, gradient)
        if balanced:
            w.moved = fraction * along_family
        if ahead != ZERO:
            walk_on(w, ahead, fraction)
            if wp.static(not general):
                place_contact(state, r, w.place, h0)

    return go_on


def make_solver(size: int):
    """The kernel of straight isotropic rods (`size` 3) or of general ones (4)."""
    general = size == 4
    model = GeneralRod if general else StraightRod
    walk, find_balance = make_walk(size), make_balance(size, model)
    lead, go_on, put_force = make_lead(size)[0], make_go_on(size), make_step(size, model)[1]
    # Without a tangent to lead them, general rods have to be nearer to balance on the way.
    on_the_way = wp.constant(wp.float64(1.0e-2 if general else 5.0e-2))

    # A module each: nobody waits for the compiler because of rods that he does not have.
    @wp.kernel(module="unique", enable_backward=False)
    def solve(
        work: wp.array(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        edges: int,
        rod: model,
        task: IterationTask,
        scratch: Scratch,
        # State in and out:
        state: wp.array3d(dtype=wp.float64),
        curvature: wp.array(dtype=wp.float64),
        thrust: wp.array(dtype=wp.float64),
        family: wp.array2d(dtype=wp.float64),
        out: Level,
    ):
        """Newton with continuation from `state`, at `curvature`, to the target and the closure.

        Out of balance a grasp takes Newton steps. In balance short of the target it walks on, along
        the exact tangent of the curvature, each step a Newton step as well. At the target it goes
        along the family to the closure's minimum at the same time as to its balance. What has not
        found its balance in time goes back to the last grasp, and on in smaller steps. What has
        found it takes the Newton step that is known besides, without which it would end where its
        last one happened to: as far off as its tolerance.
        """
        thread = wp.tid()
        if thread >= count[0]:
            return
        r = work[thread]
        slot = thread % scratch.condensed.shape[0]
        h0 = rod.rest[r, 0]
        force_done = wp.max(wp.max(task.force_done, FORCE_DONE), FORCE_ROUNDING * task.tolerance[r])
        kappa = wp.float64(curvature[r])
        w = walk.begin(r, kappa, task.target[r], task.increment[r], thrust[r], family)
        if wp.static(general):
            w.place = task.place
            w.goal = ONE
        while w.status == RUNNING:
            if wp.static(not general):
                kappa = w.place
            find_balance(w, rod, kappa, state, r, slot, edges, scratch)
            at_target = w.place == w.goal
            balanced = w.worst <= wp.where(at_target, AT_TARGET, on_the_way)
            walks_on = balanced and not at_target
            ahead, turn, v = lead(w, kappa, h0, walks_on, state, r, slot, scratch)
            change = wp.float64(0.0)
            if task.closure != ZERO_TENSION and balanced:
                d = first_direction(half_turn(kappa, h0))
                change = walk.follow_family(
                    w, scratch, slot, edges, d, turn, v, task.closure, task.weight[r],
                    task.tolerance[r],
                )  # fmt: skip
            settled = at_target and w.holds == 0
            settled = settled and wp.abs(w.moved) <= STILL + wp.float64(100.0) * task.force_done
            settled = settled and (wp.abs(change) <= force_done or w.refined > MOST_REFINED)
            lost = not wp.isfinite(w.worst) or w.waited > task.patience
            found = balanced and settled and w.worst <= task.tolerance[r]
            if found:
                w.status = CONVERGED
            if not found and (lost or w.iterations >= task.most_iterations):
                walk.go_back(w, state, scratch.saved, r, slot, edges, task.most_iterations)
            elif not found or task.force_done == ZERO:
                go_on(
                    w, balanced and not found, settled, change, ahead, turn, v, h0, kappa,
                    state, r, slot, edges, scratch, task.step_limit,
                )  # fmt: skip
        if wp.static(not general):
            curvature[r] = w.place
        thrust[r] = w.pull
        walk.put(w, r, family, out)
        put_force(rod, scratch, state, r, slot, edges, task.weight[r], out)

    return solve


solve_straight = make_solver(3)
solve_general = make_solver(4)
