"""The adjoint of a step's contact with planes that stand still or are moved by others: see
`wrod.kernels.stepping.adjoint`, and `wrod.kernels.contact.edge_adjoint` for how a touch follows
what it depends on: that of a node is as of an edge at its head, of a solid that is flat.
"""

import warp as wp
from wrod.kernels.contact.edge_adjoint import (
    AT_START,
    BRISTLE,
    COEFFICIENT,
    RADIUS,
    RELAXATION,
    STIFFNESS,
    TouchedEdge,
    TouchWant,
    WantedShapes,
    finish_hold,
    follow,
    want_shape,
    wanted_of,
    wanted_of_three,
)
from wrod.kernels.contact.law import ContactStep, Touchable, coefficient, return_mapping
from wrod.kernels.contact.planes import PLANE, Touch, touch
from wrod.kernels.contact.rolling import by_logarithms, node_rolled
from wrod.kernels.contact.rolling_adjoint import node_angle
from wrod.kernels.contact.shapes import BY_OTHERS
from wrod.kernels.elastic.assembly import add_vector
from wrod.kernels.elastic.frames import HALF, ZERO, node
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import solved
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import Wanted

# Unrolled loops take a GPU's compiler twice as long.
wp.set_module_options({"max_unroll": 1})


@wp.func
def hold_node(m: Touchable, step: ContactStep, c: Touch, r: int, k: int, i: int) -> TouchedEdge:
    """All that a node's touch is made of."""
    out = TouchedEdge()
    out.near.normal = c.normal
    out.near.head = c.normal
    out.bristle = c.bristle
    out.relaxation = m.relaxation[r, i]
    out.depth = c.depth
    out.closing = c.closing
    out.stiffness = m.stiffness[r, i]
    out.coefficient = coefficient(m, step.sliding[r, k, i], r, k)
    q = node(step.dof, r, i)
    out.head_moved = q - node(step.dof_before, r, i)
    size = wp.vec2d(m.radius[r, i], m.skin[r, i])
    return finish_hold(out, m.shapes[r, k], q, q, step.bristle[r, k, i], step.span[r], size)


@wp.kernel
def find_unknown(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether they touch a plane in a way that has no adjoint: one that
    turns them, or that moves and keeps their roll. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        moves = model.shapes[r, k].moves
        known = moves == 0 or (moves == BY_OTHERS and model.roll_friction[r, k] < ZERO)
        known = known and model.rolling[r] == ZERO
        if model.shapes[r, k].kind == PLANE and not known:
            c = touch(model, step, r, k, i)
            if c.force > ZERO:
                touching_out[r] = 1


@wp.kernel
def want_bristles(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State in and out:
    now: Wanted,
    # Out:
    coupling_out: wp.array2d(dtype=wp.mat33d),
):
    """What is wanted of the bristles at the step's end, of the nodes there; and what of contact is
    missing in the step's symmetric matrix. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    coupling = wp.mat33d()
    for k in range(model.shapes.shape[1]):
        c = touch(model, step, r, k, i)
        if c.force > ZERO:
            h = hold_node(model, step, c, r, k, i)
            held = return_mapping(c.bristle, c.normal, h.stiffness, h.coefficient * h.force)
            there = held.tangential + (h.whole * wp.outer(c.normal, c.normal))
            for b in range(3):
                by = follow(h, b)
                wanted = wp.dot(now.bristle[r, k, i], by.bristle)
                now.dof[r, 4 * i + b] = now.dof[r, 4 * i + b] + wanted
                for a in range(3):
                    coupling[a, b] = coupling[a, b] + by.at_head[a] - there[a, b]
    coupling_out[r, i] = coupling


@wp.kernel
def want_friction(
    # Model:
    model: Touchable,
    stiffness_share: wp.array2d(dtype=wp.float64),
    burdened: wp.array2d(dtype=wp.int32),
    node_mass: wp.array2d(dtype=wp.float64),
    piece: wp.array(dtype=wp.int32),
    # State in:
    step: ContactStep,
    now: Wanted,
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    before: Wanted,
    by_coefficient: wp.array2d(dtype=wp.float64),
    by: WantedModel,
    by_piece: wp.array2d(dtype=wp.float64),
    by_shape: WantedShapes,
):
    """What is wanted of bristles and nodes at the step's start, of the coefficients (rod, shape),
    of planes that move, of masses, lengths and radii: contact damps by sqrt(mass / stiffness), and
    its stiffness goes with the length of a node's cell and by `stiffness_share` (rod, node), if
    there is one, with the mass of a piece of the row and against the radius; where it is burdened,
    against the radius alone. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    w = TouchWant()
    w.head = solved(x, r, i)
    stiffness = model.stiffness[r, i]
    by_stiffness = wp.float64(0.0)
    damped = wp.float64(0.0)
    by_radius = wp.float64(0.0)
    for k in range(model.shapes.shape[1]):
        c = touch(model, step, r, k, i)
        bristle = wp.vec3d(ZERO, ZERO, ZERO)
        if c.force > ZERO:
            h = hold_node(model, step, c, r, k, i)
            w.after = now.bristle[r, k, i]
            w.force = wp.float64(0.0)
            friction = wp.float64(0.0)
            if model.roll_friction[r, k] >= ZERO:
                kept = node_rolled(model, step, h.force, r, k, i)
                by_step = -node_angle(x, r, i)
                by_end = now.turned[r, k, i] / kept.whole
                w.force = kept.per_force * (by_step + by_end)
                friction = kept.per_coefficient * (by_step + by_end)
                parts = by_logarithms(kept, by_step, by_end)
                by_stiffness += parts[0] / stiffness
                by_radius += parts[1]
            add_vector(before.dof, r, 4 * i, wanted_of_three(h, AT_START, w))
            bristle = wanted_of_three(h, BRISTLE, w)
            if model.shapes[r, k].moves != 0:
                want_shape(h, w, r, k, by_shape)
            friction += wanted_of(follow(h, COEFFICIENT), w)
            wp.atomic_add(by_coefficient, r, k, friction)
            by_stiffness += wanted_of(follow(h, STIFFNESS), w)
            damped += HALF * h.relaxation * wanted_of(follow(h, RELAXATION), w)
            by_radius += model.radius[r, i] * wanted_of(follow(h, RADIUS), w)
        before.bristle[r, k, i] = bristle
    if node_mass[r, i] > ZERO:
        by.node_mass[r, i] = by.node_mass[r, i] + damped / node_mass[r, i]
        share = stiffness_share[r, i]
        # Of what is burdened, damping alone goes with the stiffness that it would have.
        stiffened = -damped
        if burdened[r, i] != 0:
            by_radius -= stiffness * by_stiffness
        else:
            stiffened += stiffness * by_stiffness
        if share > ZERO:
            by_radius -= stiffened
        by.radius[r, i] = by.radius[r, i] + by_radius
        wp.atomic_add(by_piece, r, piece[i], share / stiffness * stiffened)
        cell = wp.float64(0.0)
        for n in range(wp.max(i - 1, 0), wp.min(i + 1, model.rest_length.shape[1])):
            cell += model.rest_length[r, n]
        for n in range(wp.max(i - 1, 0), wp.min(i + 1, model.rest_length.shape[1])):
            wp.atomic_add(by.rest_length, r, n, stiffened / cell)
