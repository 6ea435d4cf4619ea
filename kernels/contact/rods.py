"""Contact of the edges of rods with each other: true thickness, and Coulomb friction that sticks.

Edges are capsules, or pieces of a spline are tubes (`wrod.kernels.contact.segments`). A pair that
is closer than the sum of its radii repels with the normal force of `wrod.kernels.contact.law`
along the shortest way between them (`wrod.kernels.contact.segments`), which derives from an energy
with an exact Hessian. Friction acts between the surfaces: their relative motion at the point of
contact, with the turning of both edges and their spin, stretches a bristle that slides on where the
load exceeds mu N (return mapping). Two rods that move as one rigid body do not rub, and the forces
conserve momentum and angular momentum. The bristle is kept in the frame of the first edge and the
normal. N is held while Newton iterates, as in Li et al. 2020, so that the matrix of a step is
symmetric and exact but for the turning of the pair; in balance it is compared with what the pairs
press then, and taken anew where a bristle slides, or would, and they differ. A step ends with
friction within a twentieth of mu times the load at its end; on a post (`load_on_post`) loads are
followed over steps, on a thick or smooth one within each (`part_on_post`), where other loads of
the row may be left farther off.
"""

import warp as wp
from wrod.kernels.contact.law import note_touch
from wrod.kernels.contact.pair_contact import (
    Pair,
    Pieces,
    Rubbing,
    add_edge_force,
    edge_motion,
    nearest_of_edges,
    note_stretch,
    pair_contact,
    relative_motion,
)
from wrod.kernels.contact.segments import Nearest, piece_size
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node

# A load is out of date when it differs by more than this part; how often a step takes them anew.
# Where loads are settled, also by a part of what the residual may be.
STALE = wp.constant(wp.float64(0.05))
MOST_RENEWALS = wp.constant(2)
SETTLED = wp.constant(wp.float64(1.0e-10))
NOTHING = wp.constant(wp.float64(0.01))
MOST_TO_SETTLE = wp.constant(40)
# A rod so many times as thick as another is a post to it, over which its loads are spread, and a
# thick one: turning little from edge to edge, loads settle there within a step. So they do under
# little friction, on what is so many times as thick for each unit of it. On others steps that tried
# it did not converge.
POST = wp.constant(wp.float64(2.0))
THICK_POST = wp.constant(wp.float64(18.0))
LITTLE_FRICTION = wp.constant(wp.float64(0.5))
SMOOTH_POST = wp.constant(wp.float64(9.0))
STALE_ON_THICK = wp.constant(wp.float64(0.01))
STALE_ON_SMOOTH = wp.constant(wp.float64(0.02))
# Part of the way that loads go on a post at once, from step to step, and within a step on one that
# is not thick, and the part of them that is left at least.
GENTLY = wp.constant(wp.float64(0.25))
MOSTLY = wp.constant(wp.float64(0.7))
LEAST_LEFT = wp.constant(wp.float64(0.1))
# Residual over the tolerance from which on loads are taken anew: to come nearer to balance under
# the old ones is in vain. Ten times less costs knots that are pulled a sixth more iterations, ten
# times more a tenth.
NEARLY = wp.constant(wp.float64(1000.0))
# A depth that is none.
TINY = wp.constant(wp.float64(1.0e-300))
# Part of the way that nodes may go in a step by which a pair that meets in it would have come
# nearer at most: in a longer one implicit Euler stops what should bounce.
FIRST_WAY = wp.constant(wp.float64(0.5))


@wp.func
def way_of(
    velocity: wp.array2d(dtype=wp.float64), kind: int, weight: wp.vec3d, r: int, i: int
) -> wp.vec3d:
    """Velocity of a point of piece i at the start of a step."""
    out = wp.vec3d(ZERO, ZERO, ZERO)
    for n in range(piece_size(kind)):
        out += weight[n] * node(velocity, r, i + n)
    return out


@wp.func
def meets_fast(
    m: Pieces,
    near: Nearest,
    dt: wp.float64,
    reach: wp.float64,
    velocity: wp.array2d(dtype=wp.float64),
    r: int,
    i: int,
    j: int,
) -> bool:
    """Whether a pair that was apart comes nearer by more than `FIRST_WAY` in a step."""
    first = way_of(velocity, m.kind[r, i], near.first_weight, r, i)
    apart = first - way_of(velocity, m.kind[r, j], near.second_weight, r, j)
    return -dt * wp.dot(apart, near.gap) > FIRST_WAY * reach * near.distance


@wp.func
def add_pair_force(
    m: Pieces,
    c: Pair,
    pressure: wp.float64,
    pull: wp.vec3d,
    r: int,
    i: int,
    j: int,
    gradient: wp.array2d(dtype=wp.float64),
):
    """Gradient of a pair's force per distance along its gap, and of a pull on its first surface."""
    turn = pressure * c.near.small
    push = pressure * c.near.gap
    kind = m.kind[r, i]
    move = edge_motion(kind, c.near.first, c.near.s, -m.radius[r, i], c.normal)
    add_edge_force(gradient, kind, r, i, push, turn * c.near.first_turn, move, pull)
    kind = m.kind[r, j]
    move = edge_motion(kind, c.near.second, c.near.t, m.radius[r, j], c.normal)
    add_edge_force(gradient, kind, r, j, -push, turn * c.near.second_turn, move, -pull)


@wp.func
def is_on_post(m: Pieces, thicker: wp.float64, r: int, i: int, j: int) -> bool:
    """Whether one of two edges is so many times as thick as the other, which lies on it as on a
    post."""
    thick = wp.max(m.radius[r, i], m.radius[r, j])
    return thick > thicker * wp.min(m.radius[r, i], m.radius[r, j])


@wp.func
def part_on_post(m: Pieces, r: int, i: int, j: int) -> wp.float64:
    """Part of the way that loads go at once on a post: more than `GENTLY` where they settle within
    a step."""
    if is_on_post(m, THICK_POST, r, i, j):
        return ONE
    mu = m.law[r].static_friction
    if mu <= LITTLE_FRICTION and is_on_post(m, wp.max(POST, SMOOTH_POST * mu), r, i, j):
        return MOSTLY
    return GENTLY


@wp.func
def load_on_post(
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    excess: wp.array3d(dtype=wp.float64),
    part: wp.float64,
    force: wp.float64,
    load: wp.float64,
    r: int,
    i: int,
    k: int,
) -> wp.float64:
    """The load that bounds what slides on a post from now on, where it presses by `force`.

    Pulled at its surface, an edge leans on its end, and its neighbour is relieved: loads that were
    taken as they come would swing from edge to edge without end, and friction with them, which
    pulls by its greater half. So what they are off by, `excess`, is averaged with that of the pairs
    beside, and a `part` of the way is gone. Where it leads to is the same.
    """
    j = partner[r, i, k]
    sum = wp.float64(0.0)
    beside = wp.float64(0.0)
    for o in range(wp.max(k - 1, 0), wp.min(k + 2, partner_count[r, i])):
        if wp.abs(partner[r, i, o] - j) == 1 and excess[r, i, o] != ZERO:
            sum += excess[r, i, o]
            beside += ONE
    for e in range(wp.max(i - 1, 0), wp.min(i + 2, partner_count.shape[1])):
        if e != i:
            for o in range(partner_count[r, e]):
                if partner[r, e, o] == j and excess[r, e, o] != ZERO:
                    sum += excess[r, e, o]
                    beside += ONE
    own = excess[r, i, k]
    change = HALF * part * (own + wp.where(beside > ZERO, sum / wp.max(beside, ONE), own))
    return wp.max(load + change, LEAST_LEFT * wp.min(force, load))


@wp.kernel
def rod_contact(
    # Model:
    m: Pieces,
    reach: wp.array(dtype=wp.float64),
    # State in:
    step: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    rubbing: Rubbing,
    velocity: wp.array2d(dtype=wp.float64),
    slots: int,
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    # State out:
    depth_out: wp.array3d(dtype=wp.float64),
    excess_out: wp.array3d(dtype=wp.float64),
    renewed_out: wp.array(dtype=wp.int32),
):
    """Subtract the forces of every touching pair from the residual, and note how deep it is.

    `renewed` is 2 where a pair meets too fast where the step begins. Launched over (rod, edge,
    slot), as what follows: so many `slots` share an edge's partners.
    """
    r, i, slot = wp.tid()
    if active[r] == 0:
        return
    for k in range(slot, partner_count[r, i], slots):
        j = partner[r, i, k]
        begins = rubbing.iteration[r] == 0
        c = pair_contact(m, rubbing, step[r], dof, dof_before, begins, r, i, j, k)
        load = rubbing.load[r, i, k]
        depth = m.radius[r, i] + m.radius[r, j] - c.near.distance
        if load > ZERO:
            depth = wp.max(depth, TINY)  # it rubs
        depth_out[r, i, k] = depth
        excess_out[r, i, k] = wp.where(load > ZERO, c.force - load, ZERO)
        if c.force > ZERO or load > ZERO:
            if load > ZERO:
                note_stretch(rubbing, c, begins, r, i, k)
            elif begins and meets_fast(m, c.near, step[r], reach[r], velocity, r, i, j):
                wp.atomic_max(renewed_out, r, 2)
            add_pair_force(m, c, -c.force / c.near.distance, c.pull, r, i, j, gradient)


@wp.kernel
def find_touching(
    # Model:
    m: Pieces,
    reach: wp.array(dtype=wp.float64),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether their edges touch (1), and whether in an impact (2). What goes
    farther than the lists of partners were made for may touch."""
    r, i = wp.tid()
    if chosen[r] == 0:
        return
    if wp.length(node(dof, r, i) - node(dof_before, r, i)) > reach[r]:
        wp.atomic_max(touching_out, r, 1)
    for k in range(partner_count[r, i]):
        j = partner[r, i, k]
        near = nearest_of_edges(m, dof, r, i, j)
        depth = m.radius[r, i] + m.radius[r, j] - near.distance
        if depth > ZERO:
            n = near.gap / wp.max(wp.length(near.gap), wp.float64(1.0e-12))
            motion = relative_motion(m, dof, dof_before, near, n, r, i, j)
            note_touch(touching_out, r, depth, -wp.dot(motion, n), m.radius[r, i])


@wp.kernel
def hold_loads(
    starting: wp.array(dtype=wp.int32),
    load: wp.array3d(dtype=wp.float64),
    rubbing: Rubbing,
    renewals_out: wp.array(dtype=wp.int32),
):
    """A step begins with the loads of the last, and nothing slides yet."""
    r, i, k = wp.tid()
    if starting[r] != 0:
        renewals_out[r] = 0
        rubbing.load[r, i, k] = load[r, i, k]
        rubbing.dual[r, i, k] = wp.vec2d(ZERO, ZERO)
        rubbing.stretch[r, i, k] = wp.vec2d(ZERO, ZERO)


@wp.kernel
def renew_loads(
    # Model:
    m: Pieces,
    reach: wp.array(dtype=wp.float64),
    settles: int,
    # State in:
    step: wp.array(dtype=wp.float64),
    converged: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    residual: wp.array(dtype=wp.float64),
    tolerance: wp.array(dtype=wp.float64),
    renewals: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    depth: wp.array3d(dtype=wp.float64),
    excess: wp.array3d(dtype=wp.float64),
    slots: int,
    # State in and out:
    rubbing: Rubbing,
    gradient: wp.array2d(dtype=wp.float64),
    # State out:
    renewed_out: wp.array(dtype=wp.int32),
):
    """Where a rod is in balance or nearly so, take the loads anew that bound what slides and are
    out of date. A pair that meets in this step rubs from the next one on, and is told of where it
    came too far at once."""
    r, i, slot = wp.tid()
    if converged[r] == 0:
        if renewals[r] >= MOST_TO_SETTLE or active[r] == 0:
            return
        if residual[r] > NEARLY * tolerance[r]:
            return
    for k in range(slot, partner_count[r, i], slots):
        j = partner[r, i, k]
        old = rubbing.load[r, i, k]
        if old == ZERO:
            if converged[r] != 0 and depth[r, i, k] > ZERO:
                near = nearest_of_edges(m, dof, r, i, j)
                if meets_fast(m, near, step[r], reach[r], velocity, r, i, j):
                    wp.atomic_max(renewed_out, r, 2)
            continue
        part = wp.where(settles != 0, GENTLY, part_on_post(m, r, i, j))
        if renewals[r] >= wp.where(settles != 0 or part > GENTLY, MOST_TO_SETTLE, MOST_RENEWALS):
            continue
        c = pair_contact(m, rubbing, step[r], dof, dof_before, False, r, i, j, k)
        stale = wp.where(part > GENTLY, STALE_ON_SMOOTH, STALE)
        stale = wp.where(part == ONE, STALE_ON_THICK, stale) * wp.max(c.force, old)
        if settles != 0:
            stale = SETTLED * wp.max(c.force, old) + NOTHING * tolerance[r]
        if wp.abs(c.force - old) > stale:
            slides = rubbing.sliding[r, i, k] != 0
            mu = wp.where(slides, m.law[r].kinetic_friction, m.law[r].static_friction)
            wanted = m.law[r].tangential * wp.length(c.stretched)
            if mu > ZERO and wanted > mu * wp.min(c.force, old):
                # Short of balance what slides may have left the surface, and no load that is 0
                # comes back within the step.
                least = wp.where(converged[r] == 0 and part > GENTLY, LEAST_LEFT * old, ZERO)
                next = wp.max(c.force, least)
                if settles == 0 and c.force > ZERO and is_on_post(m, POST, r, i, j):
                    next = load_on_post(partner_count, partner, excess, part, c.force, old, r, i, k)
                    if wp.abs(next - old) <= stale:
                        continue
                rubbing.load[r, i, k] = next
                wp.atomic_max(renewed_out, r, 1)
                pull = -c.pull
                c = pair_contact(m, rubbing, step[r], dof, dof_before, False, r, i, j, k)
                pull += c.pull
                add_pair_force(m, c, ZERO, pull, r, i, j, gradient)


@wp.kernel
def clear_forces(
    accepted: wp.array(dtype=wp.int32),
    force_out: wp.array2d(dtype=wp.vec3d),
    penetration_out: wp.array(dtype=wp.float64),
):
    r, i = wp.tid()
    if accepted[r] != 0:
        force_out[r, i] = wp.vec3d(ZERO, ZERO, ZERO)
        penetration_out[r] = ZERO


@wp.kernel
def settle_friction(
    # Model:
    m: Pieces,
    # State in:
    step: wp.array(dtype=wp.float64),
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    excess: wp.array3d(dtype=wp.float64),
    slots: int,
    # State in and out:
    rubbing: Rubbing,
    load: wp.array3d(dtype=wp.float64),
    slip: wp.array2d(dtype=wp.float64),
    force: wp.array2d(dtype=wp.vec3d),
    penetration: wp.array(dtype=wp.float64),
):
    """After an accepted step: let overloaded bristles slide; note forces, slip and penetration."""
    r, i, slot = wp.tid()
    if accepted[r] == 0:
        return
    for k in range(slot, partner_count[r, i], slots):
        j = partner[r, i, k]
        c = pair_contact(m, rubbing, step[r], dof, dof_before, False, r, i, j, k)
        rubbing.bristle[r, i, k] = wp.where(c.force > ZERO, ONE, ZERO) * c.bristle
        old = rubbing.load[r, i, k]
        next = wp.float64(c.force)
        if c.force > ZERO and c.slid > ZERO and old > ZERO and is_on_post(m, POST, r, i, j):
            part = part_on_post(m, r, i, j)
            next = load_on_post(partner_count, partner, excess, part, c.force, old, r, i, k)
        load[r, i, k] = next
        rubbing.sliding[r, i, k] = 0
        if c.force > ZERO:
            if c.slid > ZERO:
                rubbing.sliding[r, i, k] = 1
                wp.atomic_add(slip, r, i, c.slid)
                wp.atomic_add(slip, r, j, c.slid)
            total = (c.force / c.near.distance) * c.near.gap - c.pull
            for n in range(piece_size(m.kind[r, i])):
                wp.atomic_add(force, r, i + n, c.near.first_weight[n] * total)
            for n in range(piece_size(m.kind[r, j])):
                wp.atomic_add(force, r, j + n, -c.near.second_weight[n] * total)
            wp.atomic_max(penetration, r, m.radius[r, i] + m.radius[r, j] - c.near.distance)
