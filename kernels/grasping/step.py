"""One step of a grasp's iteration: where each rod stands out of balance, and its motion."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.grasping.bordered import make_border
from wrod.kernels.grasping.general_rod import advance_general, evaluate_general, spin_at_grip
from wrod.kernels.grasping.grip_torque import add_torque
from wrod.kernels.grasping.reading import Level
from wrod.kernels.grasping.scratch import Scratch
from wrod.kernels.grasping.straight_rod import evaluate, point
from wrod.kernels.grasping.walk import make_walk
from wrod.kernels.linear.frontal import make_elimination


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


def make_balance(size: int, model: type) -> wp.Function:
    """What evaluates a rod where its iteration stands and leaves its border."""
    general = size == 4
    eliminate = make_elimination(size)[0]
    walk = make_walk(size).struct
    first = size - 3

    @wp.func
    def find_balance(
        w: wp.ref[walk],
        rod: model,
        kappa: wp.float64,
        state: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        edges: int,
        scratch: Scratch,
    ):
        w.iterations += 1
        imbalance = wp.float64(0.0)
        if wp.static(general):
            imbalance = evaluate_general(
                rod, w.place, kappa, state, r, slot, edges, scratch.stiffness, scratch.load
            )
        else:
            imbalance = evaluate(
                rod.rest, rod.stretch_ratio[r], kappa, state, r, slot, edges,
                scratch.stiffness, scratch.load,
            )  # fmt: skip
        w.worst = wp.max(imbalance, wp.abs(scratch.load[slot, edges, first] + w.pull))
        w.negative = eliminate(
            scratch.stiffness, scratch.load, slot, edges, scratch.factor, scratch.condensed
        )
        if wp.static(general):
            w.spin = spin_at_grip(rod, w.place, state, r, edges)
            w.torque = add_torque(
                scratch.load[slot, edges, 0],
                point(state, r, edges) - point(state, r, edges - 1),
                w.spin, slot, edges, scratch.factor, scratch.condensed,
            )  # fmt: skip

    return find_balance


def make_step(size: int, model: type) -> tuple[wp.Function, wp.Function]:
    """What moves a rod by what its border does, no further than is safe, and what reads the forces
    at the grip."""
    general = size == 4
    recover = make_elimination(size)[1]
    border = make_border(size)
    vector = border.vector
    block = wp.types.matrix(shape=(size, size), dtype=wp.float64)
    first = size - 3
    advance = advance_general if general else advance_straight

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

    @wp.func
    def take_step(
        state: wp.array3d(dtype=wp.float64),
        scratch: Scratch,
        r: int,
        slot: int,
        edges: int,
        node_1: wp.vec3d,
        v: vector,
        spin: wp.vec3d,
        limit: wp.float64,
    ) -> wp.float64:
        """Move the rod; the fraction of the step that was taken."""
        border.put_motion(scratch.motion, slot, edges, node_1, v)
        recover(scratch.factor, slot, edges, ONE, scratch.motion)
        if wp.static(general):
            for c in range(3):
                by = scratch.motion[slot, edges, 1 + c] - scratch.motion[slot, edges - 1, 1 + c]
                scratch.motion[slot, edges, 0] += spin[c] * by
        fraction = safe_fraction(state, scratch.motion, r, slot, edges, limit)
        advance(state, scratch.motion, r, slot, edges, fraction)
        return fraction

    @wp.func
    def put_force(
        rod: model,
        scratch: Scratch,
        state: wp.array3d(dtype=wp.float64),
        r: int,
        slot: int,
        edges: int,
        weight: wp.float64,
        out: Level,
    ):
        """The force at the contact, and its derivative by the grip's position.

        The contact holds the pattern's tangent, and the first edge gives: half of the contact's
        cell bends and twists, twice as stiff as stencil 0, which has the whole. The grip holds a
        general rod's roll, from which the last half edge twists."""
        condensed = scratch.condensed
        held = border.grip_gradient(condensed, slot)
        e = point(state, r, 1) - point(state, r, 0)
        d = wp.normalize(e)
        bent = block()
        across = block()
        for a in range(size):
            for c in range(size):
                p = size + wp.min(a, c)
                q = size + wp.max(a, c)
                bent[a, c] = scratch.stiffness[slot, 0, p * (4 * size - 1 - p) // 2 + q]
            across[a, a] = ONE
        for a in range(3):
            for c in range(3):
                across[first + a, first + c] = across[first + a, first + c] - d[a] * d[c]
        bent = across * bent * across
        coupling = block()
        back = block()
        last = block()
        for a in range(size):
            for c in range(size):
                bent[a, c] += condensed[slot, 2 * size * a + c]
                coupling[a, c] = condensed[slot, 2 * size * a + size + c]
                back[a, c] = condensed[slot, 2 * size * (size + a) + c]
                last[a, c] = condensed[slot, 2 * size * (size + a) + size + c]
        last = last - back * wp.inverse(bent) * coupling
        if wp.static(general):
            angle = last[0, 0] + rod.twisting[r, edges] / (HALF * rod.rest[r, edges - 1])
            for i in range(3):
                for c in range(3):
                    last[1 + i, 1 + c] = (
                        last[1 + i, 1 + c] - last[1 + i, 0] * last[0, 1 + c] / angle
                    )
        for i in range(3):
            out.force[r, i] = -held[i]
            for c in range(3):
                out.jacobian[r, 3 * i + c] = -last[first + i, first + c]
        out.force[r, 2] = out.force[r, 2] + weight

    return take_step, put_force
