"""The adjoint of a step's contact of rods with each other: see `wrod.kernels.stepping.adjoint`, and
`wrod.kernels.contact.pair_tangent` for how a pair follows what it is made of.

Friction is bounded by loads that a step has taken anew until they were those of its end
(`wrod.solvers.rod_contact.RodContact`, `settles_loads`), so that they follow the normal force.
Edges turn in a step, against reference frames that are carried along, by what their frames turn
less by what nodes that move turn these (`by_end`, `by_start`).

Pairs are kept in slots of each edge, as they touched in a step; the next one may have others.
Launched over (rod, edge, slot) but where something else is said.
"""

import warp as wp
from wrod.kernels.contact.pair_contact import Pieces, Rubbing, spin_share
from wrod.kernels.contact.pair_numbers import (
    NUMBERS,
    Turns,
    follow_number,
    has,
    number_node,
    of_residuals,
    on_number_node,
    pair_node,
)
from wrod.kernels.contact.pair_sides import Piece, Side, TouchingPair, touching_of
from wrod.kernels.contact.pair_tangent import LawWay, Way, follow_pair
from wrod.kernels.contact.rods import add_pair_force
from wrod.kernels.contact.segments import SMOOTHING, piece_size
from wrod.kernels.elastic.frames import ONE, TWO, ZERO, edge
from wrod.kernels.linear.coupling import free_of
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import OneStep, Wanted

# Unrolled, these loops take a compiler of CUDA four minutes, and less than one as they are.
wp.set_module_options({"max_unroll": 1})


@wp.func
def bristle_wanted(now: Wanted, r: int, i: int, j: int) -> wp.vec2d:
    """Of edge i with edge j, wherever the step after has kept it."""
    out = wp.vec2d(ZERO, ZERO)
    for k in range(now.pair_partner.shape[2]):
        if now.pair_partner[r, i, k] == j:
            out = now.pair_bristle[r, i, k]
    return out


@wp.func
def pair_of(m: Pieces, kept: Rubbing, step: OneStep, r: int, i: int, k: int) -> TouchingPair:
    j = step.pair_partner[r, i, k]
    return touching_of(m, kept, step.span[r], step.dof, step.dof_before, r, i, j, k)


@wp.func
def add_moment(
    p: Piece, at: Side, step: OneStep, r: int, i: int, moment: wp.array2d(dtype=wp.vec3d)
):
    share = spin_share(p.kind, p.s)
    for q in range(piece_size(p.kind) - 1):
        spin = wp.where(q == 0, ONE - share, share) * at.spin
        over = TWO * wp.length_sq(edge(step.dof, r, i + q))
        wp.atomic_add(moment, r, i + q, (spin / over) * step.tangent[r, i + q])


@wp.kernel
def want_pairs(
    # Model:
    m: Pieces,
    # State in:
    step: OneStep,
    kept: Rubbing,
    turns: Turns,
    # State in and out:
    now: Wanted,
    gradient: wp.array2d(dtype=wp.float64),
    moment: wp.array2d(dtype=wp.vec3d),
    touching: wp.array3d(dtype=wp.float64),
):
    """What is wanted of bristles at the step's end, of nodes and edges there; the pairs' part of
    the residual, and of its moments as `wrod.kernels.stepping.adjoint.weigh_spins` has those of
    inertia; and which touch."""
    r, i, k = wp.tid()
    touching[r, i, k] = ZERO
    j = step.pair_partner[r, i, k]
    if step.active[r] == 0 or j == 0:
        return
    touching[r, i, k] = ONE
    t = pair_of(m, kept, step, r, i, k)
    c = t.pair
    add_pair_force(m, c, -c.force / c.near.distance, c.pull, r, i, j, gradient)
    add_moment(t.first, t.on_first, step, r, i, moment)
    add_moment(t.second, t.on_second, step, r, j, moment)
    wanted = bristle_wanted(now, r, i, j)
    if c.force == ZERO or wp.length(wanted) == ZERO:
        return
    for b in range(NUMBERS):
        if has(t, b):
            f = follow_number(t, turns, r, i, j, b, False)
            wp.atomic_add(now.dof, r, 4 * number_node(b, i, j) + b % 4, wp.dot(f.bristle, wanted))


@wp.kernel
def add_pairs(
    # Model:
    m: Pieces,
    free: wp.array2d(dtype=wp.int32),
    # State in:
    step: OneStep,
    kept: Rubbing,
    turns: Turns,
    overflow: wp.array(dtype=wp.int32),
    rank: wp.array2d(dtype=wp.int32),
    row: wp.array2d(dtype=wp.int32),
    # State in and out:
    lower: wp.array2d(dtype=wp.mat44d),
    upper: wp.array2d(dtype=wp.mat44d),
):
    """Add to the transposed matrix (`wrod.kernels.linear.skyline_lu`)."""
    r, i, k = wp.tid()
    j = step.pair_partner[r, i, k]
    if step.active[r] == 0 or j == 0 or overflow[r] != 0:
        return
    t = pair_of(m, kept, step, r, i, k)
    for b in range(NUMBERS):
        v = number_node(b, i, j)
        if has(t, b) and free_of(free, r, v, b % 4) > ZERO:
            f = follow_number(t, turns, r, i, j, b, False)
            p = rank[r, v]
            for w in range(6):
                change = on_number_node(t, f, w)
                u = pair_node(w, i, j)
                if wp.length(change) > ZERO:
                    block = wp.mat44d()
                    for c in range(4):
                        block[b % 4, c] = change[c] * free_of(free, r, u, c)
                    if rank[r, u] <= p:
                        wp.atomic_add(lower, r, row[r, p] + rank[r, u], block)
                    else:
                        wp.atomic_add(upper, r, row[r, rank[r, u]] + p, block)


@wp.kernel
def want_held(
    # Model:
    m: Pieces,
    # State in:
    step: OneStep,
    kept: Rubbing,
    turns: Turns,
    free: wp.array2d(dtype=wp.int32),
    x: wp.array3d(dtype=wp.float64),
    # State in and out:
    held: wp.array2d(dtype=wp.float64),
):
    """What pairs want of what is not free."""
    r, i, k = wp.tid()
    j = step.pair_partner[r, i, k]
    if step.active[r] == 0 or j == 0:
        return
    t = pair_of(m, kept, step, r, i, k)
    for b in range(NUMBERS):
        v = number_node(b, i, j)
        if has(t, b) and free_of(free, r, v, b % 4) == ZERO:
            f = follow_number(t, turns, r, i, j, b, False)
            wp.atomic_add(held, r, 4 * v + b % 4, -of_residuals(t, f, x, 0, r, i, j))


@wp.kernel
def multiply_motions(
    # Model:
    m: Pieces,
    # State in:
    step: OneStep,
    kept: Rubbing,
    turns: Turns,
    free: wp.array2d(dtype=wp.int32),
    motion: wp.array3d(dtype=wp.float64),
    # State in and out:
    column: wp.array3d(dtype=wp.float64),
    line: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=wp.float64),
):
    """The pairs' part in products of the transposed matrix with motions of bodies: see
    `wrod.kernels.stepping.body_adjoint.multiply_motions`."""
    r, i, k = wp.tid()
    j = step.pair_partner[r, i, k]
    if step.active[r] == 0 or j == 0:
        return
    t = pair_of(m, kept, step, r, i, k)
    for b in range(NUMBERS):
        if has(t, b):
            f = follow_number(t, turns, r, i, j, b, False)
            v = number_node(b, i, j)
            a = 4 * v + b % 4
            for p in range(motion.shape[1]):
                value = of_residuals(t, f, motion, p, r, i, j)
                wp.atomic_add(column, r, p, a, value)
                if free_of(free, r, v, b % 4) > ZERO:
                    wp.atomic_add(x, r, 1 + p, a, value)
                along = motion[r, p, a]
                if along != ZERO:
                    for w in range(6):
                        change = along * on_number_node(t, f, w)
                        for c in range(4):
                            if change[c] != ZERO:
                                u = pair_node(w, i, j)
                                wp.atomic_add(line, r, p, 4 * u + c, change[c])


@wp.struct
class WantedLaw:
    """Derivatives by logarithms (rod,): of the stiffness of pairs, of the mean radius with which
    their forces rise, and of their relaxation time, as far as it goes with mass."""

    stiffness: wp.array(dtype=wp.float64)
    size: wp.array(dtype=wp.float64)
    relaxation: wp.array(dtype=wp.float64)


@wp.func
def of_law(
    t: TouchingPair, first: Way, second: Way, law: LawWay, x: wp.array3d(dtype=wp.float64),
    wanted: wp.vec2d, r: int, i: int, j: int,
) -> wp.float64:  # fmt: skip
    """What is wanted of a change, through what is wanted of the bristle and of residuals."""
    f = follow_pair(t, first, second, law)
    return wp.dot(f.bristle, wanted) - of_residuals(t, f, x, 0, r, i, j)


@wp.kernel
def want_pairs_before(
    # Model:
    m: Pieces,
    # State in:
    step: OneStep,
    kept: Rubbing,
    turns: Turns,
    now: Wanted,
    x: wp.array3d(dtype=wp.float64),
    # State in and out:
    before: Wanted,
    by: WantedModel,
    by_law: WantedLaw,
):
    """What is wanted of bristles, nodes and edges at the step's start, of the rods' radii and rest
    lengths, and of the law of pairs."""
    r, i, k = wp.tid()
    if step.active[r] == 0:
        return
    j = step.pair_partner[r, i, k]
    bristle = wp.vec2d(ZERO, ZERO)
    if j != 0:
        t = pair_of(m, kept, step, r, i, k)
        wanted = bristle_wanted(now, r, i, j)
        if t.pair.force == ZERO:
            wanted = bristle
        for b in range(NUMBERS):
            if has(t, b):
                f = follow_number(t, turns, r, i, j, b, True)
                value = wp.dot(f.bristle, wanted) - of_residuals(t, f, x, 0, r, i, j)
                wp.atomic_add(before.dof, r, 4 * number_node(b, i, j) + b % 4, value)
        none = Way()
        for b in range(2):
            law = LawWay()
            law.bristle[b] = ONE
            bristle[b] = of_law(t, none, none, law, x, wanted, r, i, j)
        law = LawWay()
        law.relaxation = ONE
        damped = of_law(t, none, none, law, x, wanted, r, i, j)
        wp.atomic_add(by_law.relaxation, r, damped)
        law = LawWay()
        law.stiffness = ONE
        stiff = of_law(t, none, none, law, x, wanted, r, i, j)
        wp.atomic_add(by_law.stiffness, r, stiff - damped / TWO)
        law = LawWay()
        law.size = ONE
        wp.atomic_add(by_law.size, r, of_law(t, none, none, law, x, wanted, r, i, j))
        law = LawWay()
        for n in range(4):
            e = wp.where(n < 2, i, j)
            way = Way()
            if n % 2 == 0:
                way.radius = ONE
            else:
                way.rounding = TWO * SMOOTHING * m.rest_length[r, e]
            first = none
            second = way
            if n < 2:
                first = way
                second = none
            value = of_law(t, first, second, law, x, wanted, r, i, j)
            if n % 2 == 0:
                wp.atomic_add(by.radius, r, e, value)
            else:
                wp.atomic_add(by.rest_length, r, e, value)
    before.pair_bristle[r, i, k] = bristle
    before.pair_partner[r, i, k] = j


@wp.struct
class LawShares:
    """How the logarithms of the pairs' stiffness, and of the mean radius, follow what the rods are
    made of (rod, edge or node); radii by logarithms."""

    by_stretching: wp.array2d(dtype=wp.float64)
    by_radius: wp.array2d(dtype=wp.float64)
    by_mass: wp.array2d(dtype=wp.float64)
    by_length: wp.array2d(dtype=wp.float64)
    size_by_radius: wp.array2d(dtype=wp.float64)
    total_mass: wp.array(dtype=wp.float64)


@wp.kernel
def want_law(
    # Model:
    share: LawShares,
    # State in:
    law: WantedLaw,
    # State in and out:
    by: WantedModel,
):
    """Of the law of pairs, by what it is made of. Launched over (rod, node)."""
    r, i = wp.tid()
    stiffness = law.stiffness[r]
    damped = law.relaxation[r] / (TWO * share.total_mass[r])
    by.node_mass[r, i] = by.node_mass[r, i] + stiffness * share.by_mass[r, i] + damped
    if i < share.by_length.shape[1]:
        wp.atomic_add(by.stretching, r, i, stiffness * share.by_stretching[r, i])
        wp.atomic_add(by.rest_length, r, i, stiffness * share.by_length[r, i])
        radius = stiffness * share.by_radius[r, i] + law.size[r] * share.size_by_radius[r, i]
        wp.atomic_add(by.radius, r, i, radius)
