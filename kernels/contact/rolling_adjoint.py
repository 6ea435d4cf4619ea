"""The adjoint of what keeps the roll of rods (`wrod.kernels.contact.rolling`): see
`wrod.kernels.stepping.adjoint`.

A bristle is turned by the edges' angles theta = phi - psi to reference frames, as far as these have
gone in the step, which frames that are carried along do too: its stiffness is felt by nodes as the
edges' inertia is, and a bristle that slides turns by the normal force.
"""

import warp as wp
from wrod.kernels.contact.edge_adjoint import follow, hold
from wrod.kernels.contact.edges import edge_touch
from wrod.kernels.contact.law import ContactStep, Touchable, present_force
from wrod.kernels.contact.planes import PLANE, touch
from wrod.kernels.contact.rolling import Rolled, edge_rolled, follow_turn, node_rolled
from wrod.kernels.elastic.assembly import add_vector
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import RollBlock, StepMatrix
from wrod.kernels.stepping.trace import OneStep, Wanted


@wp.func
def turn_edge(
    at: OneStep,
    h: Rolled,
    share: wp.float64,
    wanted: wp.float64,
    r: int,
    e: int,
    now: Wanted,
    m: StepMatrix,
):
    """What a bristle that turns edge e adds to its part of the matrix; `wanted` is of its torque at
    the end of the step."""
    stiff = share * h.stiffness
    wp.atomic_add(now.dof, r, 4 * e + 3, stiff * wanted)
    wp.atomic_add(now.turn, r, e, -stiff * wanted)
    wp.atomic_add(m.roll, r, e, share * stiff)
    moment = share * h.torque / (TWO * wp.length_sq(edge(at.dof, r, e)))
    wp.atomic_add(m.moment, r, e, moment * at.tangent[r, e])


@wp.kernel
def want_node_rolls(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    at: OneStep,
    # State in and out:
    now: Wanted,
    m: StepMatrix,
):
    """On planes: what is wanted of the bristles at the step's end, of nodes and edges there; and
    what they add to the step's matrix, which is zero before but for its Hessian. Launched over
    (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    last = m.roll.shape[1]
    inner = i > 0 and i < last
    share = wp.where(inner, HALF, ONE)
    pushed = wp.vec3d(ZERO, ZERO, ZERO)
    for k in range(model.shapes.shape[1]):
        if model.roll_friction[r, k] >= ZERO and model.shapes[r, k].kind == PLANE:
            c = touch(model, step, r, k, i)
            if c.force > ZERO:
                law = present_force(model, c.depth, c.closing, step.span[r], r, i)
                h = node_rolled(model, step, law[0], r, k, i)
                wanted = now.turned[r, k, i] / h.whole
                for side in range(2):
                    e = i - 1 + side
                    if e >= 0 and e < last:
                        turn_edge(at, h, share, wanted, r, e, now, m)
                if inner:
                    wp.atomic_add(m.roll_with_next, r, i - 1, share * share * h.stiffness)
                by_place = (-h.per_force * law[1]) * c.normal
                pushed += share * by_place
                add_vector(now.dof, r, 4 * i, wanted * by_place)
    m.roll_of_node[r, i] = pushed


@wp.kernel
def want_edge_rolls(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    at: OneStep,
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    now: Wanted,
    m: StepMatrix,
):
    """On solids, likewise; and their torques. Launched over (rod, edge)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    block = RollBlock()
    if model.radius[r, i] != ZERO:
        for k in range(model.shapes.shape[1]):
            if model.roll_friction[r, k] < ZERO:
                continue
            c = edge_touch(model, step, r, k, i)
            if c.force > ZERO:
                touched = hold(model, step, c, r, k, i)
                h = edge_rolled(model, step, touched.stiffness, touched.force, r, k, i)
                wanted = now.edge_turned[r, k, i] / h.whole
                turn_edge(at, h, ONE, wanted, r, i, now, m)
                wp.atomic_add(gradient, r, 4 * i + 3, h.torque)
                wp.atomic_add(m.hessian, r, 4 * i + 3, 0, h.stiffness)
                way = wp.vec3d(ZERO, ZERO, ZERO)
                if model.shapes[r, k].moves != 0:
                    way = h.stiffness * follow_turn(model.shapes[r, k], c.edge).by_edge
                for b in range(6):
                    by = h.per_force * follow(touched, b).force
                    by += wp.where(b < 3, way[b % 3], -way[b % 3])
                    block[b] = block[b] + by
                    wp.atomic_add(now.dof, r, 4 * (i + b / 3) + b % 3, wanted * by)
    m.roll_of_edge[r, i] = block


@wp.kernel
def want_turned_nodes(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    now: Wanted,
    before: Wanted,
):
    """On planes, what is wanted of the bristles at the step's start, and of the edges' angles and
    of their reference frames; for the normal force see `plane_adjoint`. Launched over
    (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        turned = wp.float64(0.0)
        if model.roll_friction[r, k] >= ZERO and model.shapes[r, k].kind == PLANE:
            c = touch(model, step, r, k, i)
            if c.force > ZERO:
                law = present_force(model, c.depth, c.closing, step.span[r], r, i)
                h = node_rolled(model, step, law[0], r, k, i)
                last = x.shape[2] / 4
                share = wp.where(i > 0 and i < last, HALF, ONE)
                by_step = -node_angle(x, r, i)
                turned = h.stiffness * (now.turned[r, k, i] / h.whole + by_step)
                for side in range(2):
                    e = i - 1 + side
                    if e >= 0 and e < last:
                        wp.atomic_add(now.turn, r, e, -share * h.stiffness * by_step)
                        wp.atomic_add(before.dof, r, 4 * e + 3, -share * turned)
                        wp.atomic_add(before.turn, r, e, share * turned)
        before.turned[r, k, i] = turned


@wp.func
def node_angle(x: wp.array3d(dtype=ALONE), r: int, i: int) -> wp.float64:
    """Of a solution, the mean of the edges around a node."""
    last = x.shape[2] / 4
    before = wp.max(i - 1, 0)
    after = wp.min(i, last - 1)
    return HALF * (x[r, 0, 4 * before + 3][0] + x[r, 0, 4 * after + 3][0])
