"""Where a grasp's iteration stands, and how it goes on: along the continuation, along the family of
grasps to the closure's minimum, or back to the last grasp that was in balance.
"""

from typing import NamedTuple

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.grasping.bordered import make_border
from wrod.kernels.grasping.closures import FAILED, RUNNING, counted
from wrod.kernels.grasping.grip_torque import GripTorque, condense_torque, load_torque
from wrod.kernels.grasping.motion_load import make_motion_load
from wrod.kernels.grasping.reading import Level
from wrod.kernels.grasping.scratch import Scratch
from wrod.kernels.linear.frontal import make_elimination

# Slope that an imbalance may feign, over the imbalance and the force: 6 was met. What a way along
# the family leaves out of balance, by its square, is more than rounding where it is more than this
# part of what rounding could leave at most.
FEIGNED = wp.constant(wp.float64(12.0))
ROUNDED = wp.constant(wp.float64(0.004))
# So near to the closure's minimum rounding counts, over the imbalance that it leaves.
NEAR = wp.constant(wp.float64(3.0))
# Two grasps that are nearer are not compared; the doubt that a mesh's steepness leaves on the next.
LEAST_SECANT = wp.constant(wp.float64(1.0e-6))
OTHER_MESH = wp.constant(wp.float64(2.0e-2))
# The smallest step of a continuation.
LEAST_INCREMENT = wp.constant(wp.float64(1.0e-4))


class Walk(NamedTuple):
    """The struct of where an iteration stands, and the functions on it, of one size of block."""

    struct: type
    begin: wp.Function
    follow_family: wp.Function
    keep: wp.Function
    go_back: wp.Function
    put: wp.Function


_cache: dict[int, Walk] = {}


def make_walk(size: int) -> Walk:
    """For straight isotropic rods (`size` 3) or general ones (4)."""
    if size not in _cache:
        struct = _struct(size)
        keep, go_back = _safe_places(struct, 7 if size == 4 else 3)
        begin, put = _ends(size, struct)
        _cache[size] = Walk(struct, begin, _family(size, struct), keep, go_back, put)
    return _cache[size]


def _struct(size: int) -> type:
    vector = make_border(size).vector
    of_grip = GripTorque if size == 4 else wp.float64

    @wp.struct
    class Walk:
        # How far the continuation has come, and its end: in curvature, or from the uniform rod (0)
        # to the rod (1). How far it wants to go next.
        place: wp.float64
        goal: wp.float64
        increment: wp.float64
        # The thrust at the grip; how the last edge of a general rod spins (`grip_torque`).
        pull: wp.float64
        spin: wp.vec3d
        torque: of_grip
        # The family's tangent, and the same by the length of the way of what the closure makes
        # small; where it led last, by how much, and the closure's slope there and its steepness.
        along: vector
        tangent: vector
        heading: wp.vec3d
        moved: wp.float64
        slope: wp.float64
        steepness: wp.float64
        # By how much the steepness may be off.
        doubt: wp.float64
        # Whether the balance comes first, before the way along the family.
        holds: int
        # How far it may go along the family at once.
        reach: wp.float64
        # Balance, now and when the slope was taken.
        worst: wp.float64
        worst_before: wp.float64
        # The last grasp in balance; its state is in the scratch memory.
        saved: int
        place_saved: wp.float64
        pull_saved: wp.float64
        along_saved: vector
        # Steps since then.
        waited: int
        # How often the slope has been refined.
        refined: int
        status: int
        iterations: int
        negative: int

    return Walk


def _ends(size: int, walk: type) -> tuple[wp.Function, wp.Function]:
    vector = make_border(size).vector

    @wp.func
    def begin(
        r: int,
        place: wp.float64,
        goal: wp.float64,
        increment: wp.float64,
        pull: wp.float64,
        family: wp.array2d(dtype=wp.float64),
    ) -> walk:
        w = walk()
        w.place = place
        w.goal = goal
        w.increment = increment
        w.pull = pull
        for i in range(size + 2):
            w.along[i] = family[r, i]
        w.steepness = family[r, size + 2]
        w.tangent = vector()
        w.heading = wp.vec3d(ONE, ZERO, ZERO)
        w.doubt = wp.where(w.steepness == ONE, ONE, OTHER_MESH)
        w.reach = HALF
        w.status = RUNNING
        return w

    @wp.func
    def put(w: walk, r: int, family: wp.array2d(dtype=wp.float64), out: Level):
        for i in range(size + 2):
            family[r, i] = w.along[i]
        family[r, size + 2] = w.steepness
        out.status[r] = w.status
        out.iterations[r] = out.iterations[r] + w.iterations
        out.negative[r] = w.negative
        out.residual[r] = w.worst

    return begin, put


def _family(size: int, walk: type) -> wp.Function:
    border = make_border(size)
    vector = border.vector
    _, recover, condense = make_elimination(size)
    motion_load = make_motion_load(size)
    last = size + 1

    @wp.func
    def rate_of_force(
        along: vector, condensed: wp.array2d(dtype=wp.float64), slot: int, direction: wp.vec3d
    ) -> wp.vec3d:
        """Of the force at the contact along the family."""
        rate = border.grip_rate(condensed, slot, along[0] * direction, along)
        return wp.vec3d(along[last], -rate[1], -rate[2])

    @wp.func
    def refined_rate_of_force(
        w: wp.ref[walk],
        along: vector,
        scratch: Scratch,
        slot: int,
        edges: int,
        direction: wp.vec3d,
    ) -> wp.vec3d:
        """The same without what cancels in the elimination of stiff edges: of the motion along the
        family, as it was rounded, the load that is left is eliminated in its turn."""
        condensed = scratch.condensed
        held = border.grip_gradient(condensed, slot)
        border.put_motion(scratch.motion, slot, edges, along[0] * direction, along)
        recover(scratch.factor, slot, edges, ZERO, scratch.motion)
        motion_load(scratch.stiffness, scratch.motion, slot, edges, scratch.load)
        if wp.static(size == 4):
            load_torque(w.torque, scratch.motion, slot, edges, scratch.load)
        condense(scratch.factor, scratch.load, slot, edges, condensed)
        if wp.static(size == 4):
            condense_torque(w.torque, scratch.factor, scratch.load, slot, edges, condensed)
        f = border.residual(condensed, slot, wp.vec3d(ZERO, ZERO, ZERO), along[last])
        v = border.solve(border.matrix(condensed, slot, direction, w.along), -f)
        rate = border.grip_gradient(condensed, slot)
        rate += border.grip_rate(condensed, slot, v[0] * direction, v)
        border.put_grip_gradient(condensed, slot, held)
        return wp.vec3d(along[last] + v[last], -rate[1], -rate[2])

    @wp.func
    def follow_family(
        w: wp.ref[walk],
        scratch: Scratch,
        slot: int,
        edges: int,
        direction: wp.vec3d,
        turn: wp.vec3d,
        v: vector,
        closure: int,
        weight: wp.float64,
        tolerance: wp.float64,
    ) -> wp.float64:
        """The way along the family to the closure's minimum from where the Newton step `v` leads:
        the slope of what it makes small over the slope's derivative, by two grasps' secant. What is
        out of balance, more than rounding leaves, is in the slope too: where that may be all of it,
        the rod holds, for one step."""
        condensed = scratch.condensed
        rate = vector()
        rate[last] = ONE
        rate = border.solve(border.matrix(condensed, slot, direction, w.along), rate)
        along = rate / wp.length(rate)
        gradient = border.grip_gradient(condensed, slot)
        gradient += border.grip_rate(condensed, slot, turn + v[0] * direction, v)
        force = counted(closure, wp.vec3d(w.pull + v[last], -gradient[1], weight - gradient[2]))
        way = counted(closure, rate_of_force(along, condensed, slot, direction))
        at_goal = w.place == w.goal
        slope = wp.abs(wp.dot(force, way)) / wp.length(way)
        feigned = w.worst > ROUNDED * tolerance
        feigned = feigned and slope < FEIGNED * wp.length(force) * w.worst
        w.holds = wp.where(at_goal and feigned and w.holds == 0, 1, 0)
        near = at_goal and slope < NEAR * tolerance and w.holds == 0
        if near:
            w.refined += 1
            way = refined_rate_of_force(w, along, scratch, slot, edges, direction)
            way = counted(closure, way)
        length = wp.length(way)
        if wp.dot(way, w.heading) < ZERO:
            length = -length
        heading = way / length
        slope = wp.dot(force, heading)
        if not at_goal:
            w.steepness = ONE
        elif w.moved != ZERO:
            gone = wp.abs(w.moved)
            doubt = wp.length(force) * (w.worst + w.worst_before) / gone + gone
            secant = (slope - w.slope) / w.moved
            w.doubt += gone
            sane = secant > wp.float64(0.1) and secant < wp.float64(10.0)
            if sane and gone > LEAST_SECANT and doubt < w.doubt:
                w.steepness = secant
                w.doubt = doubt
        w.along = along
        w.tangent = along / length
        w.heading = heading
        w.slope = slope
        w.worst_before = w.worst
        return -slope / w.steepness

    return follow_family


def _safe_places(walk: type, width: int) -> tuple[wp.Function, wp.Function]:
    """For states of so many numbers a node."""

    @wp.func
    def keep(
        w: wp.ref[walk],
        state: wp.array3d(dtype=wp.float64),
        saved: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        edges: int,
    ):
        """Remember a grasp in balance."""
        for i in range(edges + 1):
            for c in range(width):
                saved[slot, i, c] = state[r, i, c]
        w.place_saved = w.place
        w.pull_saved = w.pull
        w.along_saved = w.along
        w.saved = 1

    @wp.func
    def go_back(
        w: wp.ref[walk],
        state: wp.array3d(dtype=wp.float64),
        saved: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        edges: int,
        most_iterations: int,
    ):
        """To the last grasp in balance, and on in smaller steps; or give up."""
        w.increment = HALF * HALF * w.increment
        w.reach = HALF * HALF * w.reach
        if w.increment < LEAST_INCREMENT or w.saved == 0 or w.iterations >= most_iterations:
            w.status = FAILED
            return
        for i in range(edges + 1):
            for c in range(width):
                state[r, i, c] = saved[slot, i, c]
        w.place = w.place_saved
        w.pull = w.pull_saved
        w.along = w.along_saved
        # The way back is no evidence for larger steps.
        w.waited = 4
        w.moved = ZERO

    return keep, go_back
