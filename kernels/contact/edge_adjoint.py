"""The adjoint of a step's contact of edges with solids that stand still or are moved by others: see
`wrod.kernels.stepping.adjoint`, and `wrod.kernels.contact.edges` for the forces.

Whether an edge touches, sticks or slides counts as it was. What changes is followed forwards, from
each of the few numbers that one touch depends on. A solid that moves by u changes what an edge
would that moves by -u; one that turns by w, what one does that turns by -w, and is turned by w.
"""

import warp as wp
from wrod.kernels.contact.closest import SMOOTHING, is_fixture
from wrod.kernels.contact.edges import EdgeTouch, edge_relaxation, edge_touch, is_burdened, is_late
from wrod.kernels.contact.gap import Gap
from wrod.kernels.contact.law import (
    ContactStep,
    Touchable,
    coefficient,
    damped_force,
    return_mapping,
)
from wrod.kernels.contact.rolling import by_logarithms, edge_rolled, follow_turn
from wrod.kernels.contact.shapes import WITH_RODS, Borne, Shape, beside, shape_displacement
from wrod.kernels.elastic.assembly import add_vector
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, node
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import EdgeBlock, solved
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import Wanted

# Unrolled loops take a GPU's compiler twice as long.
wp.set_module_options({"max_unroll": 1})
# Numbers that a touch depends on: nodes at the end of the step, at its start, the bristle; radius,
# stiffness, relaxation time, smoothing, coefficient of friction; where the solid is and how it is
# turned at the end of the step, and at its start.
AT_START = wp.constant(6)
BRISTLE = wp.constant(12)
RADIUS = wp.constant(15)
STIFFNESS = wp.constant(16)
RELAXATION = wp.constant(17)
ROUNDING = wp.constant(18)
COEFFICIENT = wp.constant(19)
PLACE = wp.constant(20)
TURN = wp.constant(23)
PLACE_AT_START = wp.constant(26)
TURN_AT_START = wp.constant(29)


@wp.struct
class WantedShapes:
    """What is wanted of shapes (rod, shape) at the end of a step and at its start: of where they
    are, and of how they are turned, by rotation vectors."""

    place: wp.array2d(dtype=wp.vec3d)
    turn: wp.array2d(dtype=wp.vec3d)
    place_at_start: wp.array2d(dtype=wp.vec3d)
    turn_at_start: wp.array2d(dtype=wp.vec3d)


@wp.struct
class TouchedEdge:
    """An edge that is touched: the arms of its nodes about the solid's place and by how much they
    moved in the step, seen from the solid, how the solid was turned before (a rotation from now),
    unprojected stretch, relaxation time and lag, depth and how it grew, normal force, its slope by
    depth alone and with how that grows, what skin takes off it by the radius, coefficient,
    stiffness, pull of the bristle, and how this follows the stretch (0 where it slides)."""

    near: Gap
    head_arm: wp.vec3d
    tail_arm: wp.vec3d
    head_moved: wp.vec3d
    tail_moved: wp.vec3d
    back: wp.mat33d
    stretch: wp.vec3d
    bristle: wp.vec3d
    time: wp.float64
    relaxation: wp.float64
    lag: wp.float64
    depth: wp.float64
    closing: wp.float64
    force: wp.float64
    slope: wp.float64
    whole: wp.float64
    by_skin: wp.float64
    coefficient: wp.float64
    stiffness: wp.float64
    pull: wp.vec3d
    slides: wp.float64


@wp.struct
class Change:
    """How residuals at head and tail, the bristle after the step, and the normal force follow a
    number."""

    at_head: wp.vec3d
    at_tail: wp.vec3d
    bristle: wp.vec3d
    force: wp.float64


@wp.func
def finish_hold(
    h: TouchedEdge, shape: Shape, head: wp.vec3d, tail: wp.vec3d, bristle: wp.vec3d,
    time: wp.float64, size: wp.vec2d,
) -> TouchedEdge:  # fmt: skip
    """What follows of a touch of an edge between nodes, of whose motions in a time `head_moved` and
    `tail_moved` are; size is of radius and skin."""
    out = h
    out.head_arm = head - shape.position
    out.tail_arm = tail - shape.position
    out.head_moved = h.head_moved - shape_displacement(shape, head)
    out.tail_moved = h.tail_moved - shape_displacement(shape, tail)
    out.back = wp.identity(3, dtype=wp.float64)
    if shape.moves != 0:
        out.back = wp.quat_to_matrix(shape.rotation_before * wp.quat_inverse(shape.rotation))
    out.stretch = bristle + (ONE - h.near.s) * out.head_moved + h.near.s * out.tail_moved
    out.time = time
    out.lag = h.relaxation / time
    law = damped_force(h.depth, h.closing, h.relaxation, time, h.stiffness, size[1])
    out.force = law[0]
    out.whole = law[1]
    out.slope = law[1] / (ONE + out.lag)
    thin = h.depth + out.lag * wp.min(h.closing, h.depth) < size[1]
    out.by_skin = wp.where(thin, -law[0], -HALF * h.stiffness * size[1]) / size[0]
    held = return_mapping(h.bristle, h.near.normal, h.stiffness, h.coefficient * law[0])
    out.pull = held.pull
    out.slides = held.slides
    return out


@wp.func
def hold(m: Touchable, step: ContactStep, c: EdgeTouch, r: int, k: int, i: int) -> TouchedEdge:
    """All that a touch is made of."""
    out = TouchedEdge()
    out.near = c.near
    head = node(step.dof, r, i)
    tail = node(step.dof, r, i + 1)
    out.head_moved = head - node(step.dof_before, r, i)
    out.tail_moved = tail - node(step.dof_before, r, i + 1)
    out.bristle = c.bristle
    out.relaxation = edge_relaxation(m, c, step.span[r], r, k, i)
    out.depth = c.depth
    out.closing = c.closing
    out.stiffness = c.stiffness
    out.coefficient = coefficient(m, step.sliding[r, k, i], r, k)
    b = step.bristle[r, k, i]
    size = wp.vec2d(m.radius[r, i], m.skin[r, i])
    return finish_hold(out, m.shapes[r, k], head, tail, b, step.span[r], size)


@wp.func
def part(number: int, first: int) -> wp.vec3d:
    """Unit vector of a number among the three from `first` on."""
    out = wp.vec3d(ZERO, ZERO, ZERO)
    if number >= first and number < first + 3:
        out[number - first] = ONE
    return out


@wp.func
def one_of(number: int, this: int) -> wp.float64:
    return wp.where(number == this, ONE, ZERO)


@wp.func
def follow(h: TouchedEdge, number: int) -> Change:
    """By one of the numbers."""
    g = h.near
    s = g.s
    n = g.normal
    by_stiffness = one_of(number, STIFFNESS)
    by_rounding = one_of(number, ROUNDING)
    by_radius = one_of(number, RADIUS)
    # The gap, where it touches, and the normal there.
    turned = part(number, TURN)
    head = part(number, 0) - part(number, PLACE) - wp.cross(turned, h.head_arm)
    tail = part(number, 3) - part(number, PLACE) - wp.cross(turned, h.tail_arm)
    distance = wp.dot(g.head, head) + wp.dot(g.tail, tail)
    distance += by_rounding * g.by_rounding.distance + by_radius * g.by_radius.distance
    shift = wp.dot(g.s_by_head, head) + wp.dot(g.s_by_tail, tail)
    shift += by_rounding * g.by_rounding.s + by_radius * g.by_radius.s
    at_head = g.by_head * head + wp.transpose(g.mixed) * tail + wp.cross(turned, g.head)
    at_head = at_head + by_rounding * g.by_rounding.head + by_radius * g.by_radius.head
    at_tail = g.mixed * head + g.by_tail * tail + wp.cross(turned, g.tail)
    at_tail = at_tail + by_rounding * g.by_rounding.tail + by_radius * g.by_radius.tail
    turn = at_head + at_tail
    turn = (turn - wp.dot(n, turn) * n) / wp.length(g.head + g.tail)
    # The normal force.
    start = part(number, PLACE_AT_START)
    whirl = part(number, TURN_AT_START)
    moved_head = h.back * head - part(number, AT_START) + start
    moved_head = moved_head + wp.cross(whirl, h.back * h.head_arm)
    moved_tail = h.back * tail - part(number, AT_START + 3) + start
    moved_tail = moved_tail + wp.cross(whirl, h.back * h.tail_arm)
    depth = by_radius - distance
    closing = wp.dot(moved_head, g.head) + wp.dot(moved_tail, g.tail)
    closing = -closing - wp.dot(h.head_moved, at_head) - wp.dot(h.tail_moved, at_tail)
    deeper = depth + h.lag * wp.where(h.closing < h.depth, closing, depth)
    deeper += one_of(number, RELAXATION) / h.time * wp.min(h.closing, h.depth)
    force = h.slope * deeper + h.by_skin * by_radius
    force += by_stiffness * h.force / h.stiffness
    # Friction.
    moved = (ONE - s) * moved_head + s * moved_tail + shift * (h.tail_moved - h.head_moved)
    stretch = part(number, BRISTLE) + moved
    bristle = stretch - wp.dot(n, stretch) * n - wp.dot(h.stretch, n) * turn
    bristle = bristle - wp.dot(h.stretch, turn) * n
    pull = h.stiffness * bristle + by_stiffness * h.bristle
    if h.slides > ZERO:
        ahead = wp.normalize(h.bristle)
        limit = h.coefficient * force + h.force * one_of(number, COEFFICIENT)
        shrink = h.coefficient * h.force / wp.length(h.bristle)
        pull = shrink * (bristle - wp.dot(ahead, bristle) * ahead) + limit * ahead
    out = Change()
    out.at_head = (ONE - s) * pull - shift * h.pull - force * g.head - h.force * at_head
    out.at_tail = s * pull + shift * h.pull - force * g.tail - h.force * at_tail
    out.bristle = (pull - by_stiffness / h.stiffness * h.pull) / h.stiffness
    out.force = force
    return out


@wp.kernel
def find_unknown(
    # Model:
    model: Touchable,
    hidden: wp.array2d(dtype=wp.float64),
    # State in:
    step: ContactStep,
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether they touch a solid in a way that has no adjoint: one that
    turns them, that they come out of, or that moves with rods whose roll it keeps. Launched over
    (rod, edge)."""
    r, i = wp.tid()
    if step.active[r] == 0 or model.radius[r, i] == ZERO:
        return
    for k in range(model.shapes.shape[1]):
        known = model.shapes[r, k].moves != WITH_RODS or model.roll_friction[r, k] < ZERO
        known = known and hidden[r, i] == ZERO and model.rolling[r] == ZERO
        if is_fixture(model.shapes[r, k]):
            c = edge_touch(model, step, r, k, i)
            if c.force > ZERO and not known:
                touching_out[r] = 1


@wp.kernel
def want_bristles(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State in and out:
    now: Wanted,
    gradient: wp.array2d(dtype=wp.float64),
    # Out:
    block_out: wp.array2d(dtype=EdgeBlock),
):
    """What is wanted of the bristles at the step's end, of the nodes there; and the part that
    touches have in residual and matrix. Launched over (rod, edge)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    block = EdgeBlock()
    if model.radius[r, i] != ZERO:
        for k in range(model.shapes.shape[1]):
            c = edge_touch(model, step, r, k, i)
            if c.force > ZERO:
                h = hold(model, step, c, r, k, i)
                g = c.near
                add_vector(gradient, r, 4 * i, (ONE - g.s) * h.pull - h.force * g.head)
                add_vector(gradient, r, 4 * i + 4, g.s * h.pull - h.force * g.tail)
                for b in range(6):
                    by = follow(h, b)
                    for a in range(3):
                        block[a, b] = block[a, b] + by.at_head[a]
                        block[a + 3, b] = block[a + 3, b] + by.at_tail[a]
                    wanted = wp.dot(now.edge_bristle[r, k, i], by.bristle)
                    wp.atomic_add(now.dof, r, 4 * (i + b / 3) + b % 3, wanted)
    block_out[r, i] = block


@wp.struct
class TouchWant:
    """What a step wants of a touch: of the residuals at head and tail (the solution), of the
    bristle after it, and of the normal force by what keeps the roll."""

    head: wp.vec3d
    tail: wp.vec3d
    after: wp.vec3d
    force: wp.float64


@wp.func
def wanted_of(c: Change, w: TouchWant) -> wp.float64:
    value = wp.dot(w.after, c.bristle) + w.force * c.force
    return value - wp.dot(w.head, c.at_head) - wp.dot(w.tail, c.at_tail)


@wp.func
def wanted_of_three(h: TouchedEdge, first: int, w: TouchWant) -> wp.vec3d:
    out = wp.vec3d(ZERO, ZERO, ZERO)
    for b in range(3):
        out[b] = wanted_of(follow(h, first + b), w)
    return out


@wp.func
def want_shape(h: TouchedEdge, w: TouchWant, r: int, k: int, by: WantedShapes):
    wp.atomic_add(by.place, r, k, wanted_of_three(h, PLACE, w))
    wp.atomic_add(by.turn, r, k, wanted_of_three(h, TURN, w))
    wp.atomic_add(by.place_at_start, r, k, wanted_of_three(h, PLACE_AT_START, w))
    wp.atomic_add(by.turn_at_start, r, k, wanted_of_three(h, TURN_AT_START, w))


@wp.kernel
def want_friction(
    # Model:
    model: Touchable,
    stiffness_per_mass: wp.array2d(dtype=wp.float64),
    node_mass: wp.array2d(dtype=wp.float64),
    piece: wp.array(dtype=wp.int32),
    # State in:
    step: ContactStep,
    now: Wanted,
    x: wp.array3d(dtype=ALONE),
    borne: Borne,
    # State in and out:
    before: Wanted,
    by_coefficient: wp.array2d(dtype=wp.float64),
    by: WantedModel,
    by_piece: wp.array2d(dtype=wp.float64),
    by_shape: WantedShapes,
):
    """What is wanted of bristles and nodes at the step's start, of the coefficients (rod, shape),
    of shapes that move, and of masses, lengths and radii, with which contact goes as that with
    planes does; `stiffness_per_mass` (rod, node) is stiffness over itself and the mass of the piece
    of the row, if it goes with that. Launched over (rod, edge)."""
    r, i = wp.tid()
    if step.active[r] == 0 or model.radius[r, i] == ZERO:
        return
    w = TouchWant()
    mean_mass = HALF * (node_mass[r, i] + node_mass[r, i + 1])
    for k in range(model.shapes.shape[1]):
        bristle = wp.vec3d(ZERO, ZERO, ZERO)
        turned = wp.float64(0.0)
        c = edge_touch(model, step, r, k, i)
        if c.force > ZERO:
            h = hold(model, step, c, r, k, i)
            w.head = beside(solved(x, r, i), borne, node(step.dof, r, i), r, k)
            w.tail = beside(solved(x, r, i + 1), borne, node(step.dof, r, i + 1), r, k)
            w.after = now.edge_bristle[r, k, i]
            w.force = wp.float64(0.0)
            parts = wp.vec2d(ZERO, ZERO)
            friction = wp.float64(0.0)
            if model.roll_friction[r, k] >= ZERO:
                kept = edge_rolled(model, step, h.stiffness, h.force, r, k, i)
                by_step = -x[r, 0, 4 * i + 3][0]
                by_end = now.edge_turned[r, k, i] / kept.whole
                w.force = kept.per_force * (by_step + by_end)
                friction = kept.per_coefficient * (by_step + by_end)
                parts = by_logarithms(kept, by_step, by_end)
                turned = kept.stiffness * (by_step + by_end)
                wp.atomic_add(now.turn, r, i, -kept.stiffness * by_step)
                wp.atomic_add(before.dof, r, 4 * i + 3, -turned)
                wp.atomic_add(before.turn, r, i, turned)
                if model.shapes[r, k].moves != 0:
                    carried = follow_turn(model.shapes[r, k], c.edge)
                    wp.atomic_add(by_shape.turn, r, k, -turned * carried.now)
                    wp.atomic_add(by_shape.turn_at_start, r, k, -turned * carried.at_start)
            for b in range(6):
                wanted = wanted_of(follow(h, AT_START + b), w)
                wp.atomic_add(before.dof, r, 4 * (i + b / 3) + b % 3, wanted)
            bristle = wanted_of_three(h, BRISTLE, w)
            if model.shapes[r, k].moves != 0:
                want_shape(h, w, r, k, by_shape)
            friction += wanted_of(follow(h, COEFFICIENT), w)
            wp.atomic_add(by_coefficient, r, k, friction)
            by_stiffness = wanted_of(follow(h, STIFFNESS), w)
            damped = wanted_of(follow(h, RELAXATION), w)
            damped = HALF * h.relaxation * damped
            if is_late(model, h.relaxation, h.time, r, k):
                damped = wp.float64(0.0)
            by_stiffness += (parts[0] - damped) / h.stiffness
            stiffened = h.stiffness * by_stiffness
            radius = parts[1] + model.radius[r, i] * wanted_of(follow(h, RADIUS), w)
            length = SMOOTHING * wanted_of(follow(h, ROUNDING), w)
            share = stiffness_per_mass[r, i]
            if h.stiffness == model.stiffness[r, i]:
                wp.atomic_add(by_piece, r, piece[i], share * stiffened)
                length += stiffened / model.rest_length[r, i]
                if share > ZERO:
                    radius -= stiffened
            elif is_burdened(model, h.stiffness, r, k, i):
                radius -= stiffened
            wp.atomic_add(by.rest_length, r, i, length)
            for n in range(2):
                wp.atomic_add(by.node_mass, r, i + n, damped / (TWO * mean_mass))
                wp.atomic_add(by.radius, r, i + n, HALF * radius)
        before.edge_bristle[r, k, i] = bristle
        if model.roll_friction[r, k] >= ZERO:
            before.edge_turned[r, k, i] = turned
