"""Contact of the edges of rods with each other: true thickness, and Coulomb friction that sticks.

Edges are capsules, or pieces of a spline are tubes (`wrod.kernels.contact.segments`). A pair that
is closer than the sum of its radii repels with the normal force of `wrod.kernels.contact.planes`
along the shortest way between them (`wrod.kernels.contact.segments`), which derives from an energy
with an exact Hessian. Friction acts between the surfaces: their relative motion at the point of
contact, with the turning of both edges and their spin, stretches a bristle that slides on where the
load exceeds mu N (return mapping). Two rods that move as one rigid body do not rub, and the forces
conserve momentum and angular momentum. The bristle is kept in the frame of the first edge and the
normal. N is held while Newton iterates, as in Li et al. 2020, so that the matrix of a step is
symmetric and exact but for the turning of the pair; in balance it is compared with what the pairs
press then, and taken anew where a bristle slides, or would, and they differ. A step ends with
friction within a twentieth of mu times the load at its end.
"""

import warp as wp
from wrod.kernels.contact.planes import damped_force, normal_force, note_touch
from wrod.kernels.contact.segments import (
    EDGE,
    SMOOTHING,
    Nearest,
    nearest,
    nearest_of_pieces,
    piece_chord,
    piece_size,
    piece_slopes,
    piece_weights,
)
from wrod.kernels.elastic.frames import ONE, ZERO, node

wp.set_module_options({"enable_backward": False})


# Which bristles hold any load: none, those that held before, all.
SLIPPING = wp.constant(0)
HELD = wp.constant(1)
EVERY = wp.constant(2)


# A load is out of date when it differs by more than this part; how often a step takes them anew.
STALE = wp.constant(wp.float64(0.05))
MOST_RENEWALS = wp.constant(2)


@wp.struct
class Law:
    """What all pairs of a rod share: stiffness, skin, relaxation time of the normal force, and the
    coefficients of friction."""

    stiffness: wp.float64
    skin: wp.float64
    relaxation: wp.float64
    static_friction: wp.float64
    kinetic_friction: wp.float64


@wp.struct
class Pair:
    """A touching pair: closest points, normal force, its slope, unit normal from the second edge to
    the first, pull of the bristle on the first edge and its stiffness, and, for the next step, the
    bristle in the pair's own frame, by how much it slid, and the mid angles between the edges."""

    near: Nearest
    force: wp.float64
    slope: wp.float64
    normal: wp.vec3d
    pull: wp.vec3d
    grip: wp.mat33d
    bristle: wp.vec2d
    slid: wp.float64


@wp.func
def piece_nodes(dof: wp.array2d(dtype=wp.float64), kind: int, r: int, i: int) -> wp.mat33d:
    """Nodes of piece i as columns; of an edge the second one twice."""
    last = i + piece_size(kind) - 1
    return wp.matrix_from_cols(node(dof, r, i), node(dof, r, i + 1), node(dof, r, last))


@wp.func
def nearest_of_edges(
    dof: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    piece: wp.array2d(dtype=wp.int32),
    r: int,
    i: int,
    j: int,
) -> Nearest:
    a = SMOOTHING * rest_length[r, i] * rest_length[r, i]
    b = SMOOTHING * rest_length[r, j] * rest_length[r, j]
    if piece[r, i] == EDGE and piece[r, j] == EDGE:
        return nearest(
            node(dof, r, i), node(dof, r, i + 1), node(dof, r, j), node(dof, r, j + 1), a, b
        )
    return nearest_of_pieces(
        piece_nodes(dof, piece[r, i], r, i), piece_nodes(dof, piece[r, j], r, j),
        piece[r, i], piece[r, j], a, b,
    )  # fmt: skip


@wp.func
def spin_share(kind: int, s: wp.float64) -> wp.float64:
    """Share of the edge after it in the spin of a piece at s; the rest is its own edge's."""
    return wp.where(kind == EDGE, ZERO, s)


@wp.func
def surface_motion(
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    kind: int,
    r: int,
    i: int,
    s: wp.float64,
    arm: wp.float64,
    normal: wp.vec3d,
) -> wp.vec3d:
    """Motion in this step of the material point at `arm` normal from the centreline of piece i."""
    now = piece_nodes(dof, kind, r, i)
    before = piece_nodes(dof_before, kind, r, i)
    slope = piece_slopes(kind, s)
    t = wp.normalize(now * slope)
    turn = t - wp.normalize(before * slope)
    after = spin_share(kind, s)
    spin = (ONE - after) * (dof[r, 4 * i + 3] - dof_before[r, 4 * i + 3])
    if kind != EDGE:
        spin += after * (dof[r, 4 * i + 7] - dof_before[r, 4 * i + 7])
    centre = (now - before) * piece_weights(kind, s)
    swing = wp.dot(t, normal) * turn - wp.dot(normal, turn) * t + spin * wp.cross(t, normal)
    return centre + arm * swing


@wp.func
def first_tangent(t: wp.vec3d, n: wp.vec3d) -> wp.vec3d:
    """Direction of the first edge in the plane of contact; any, where it is along the normal."""
    e = t - wp.dot(t, n) * n
    if wp.length(e) < wp.float64(1.0e-6):
        e = wp.vec3d(n[1], n[2], n[0])
        e = e - wp.dot(e, n) * n
    return wp.normalize(e)


@wp.func
def pair_contact(
    law: Law,
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    piece: wp.array2d(dtype=wp.int32),
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle: wp.vec2d,
    load: wp.float64,
    sliding: int,
    sticks: int,
    r: int,
    i: int,
    j: int,
) -> Pair:
    out = Pair()
    near = nearest_of_edges(dof, rest_length, piece, r, i, j)
    out.near = near
    p = radius[r, i] + radius[r, j] - near.distance
    normal = normal_force(p, law.stiffness, law.skin)
    out.force = normal[0]
    out.slope = normal[1]
    if out.force > ZERO:
        # Centrelines that cross have no normal; the step is refused for its depth anyway.
        n = near.gap / wp.max(wp.length(near.gap), wp.float64(1.0e-12))
        out.normal = n
        e1 = first_tangent(wp.normalize(near.first), n)
        e2 = wp.cross(n, e1)
        motion = surface_motion(dof, dof_before, piece[r, i], r, i, near.s, -radius[r, i], n)
        motion = motion - surface_motion(
            dof, dof_before, piece[r, j], r, j, near.t, radius[r, j], n
        )
        normal = damped_force(p, -wp.dot(motion, n), law.relaxation, dt, law.stiffness, law.skin)
        out.force = normal[0]
        out.slope = normal[1]
        b1 = bristle[0] + wp.dot(motion, e1)
        b2 = bristle[1] + wp.dot(motion, e2)
        stretch = b1 * e1 + b2 * e2
        size = wp.length(stretch)
        mu = wp.where(sliding != 0, law.kinetic_friction, law.static_friction)
        limit = mu * load / law.stiffness
        out.grip = law.stiffness * (wp.identity(3, dtype=wp.float64) - wp.outer(n, n))
        out.bristle = wp.vec2d(b1, b2)
        if size > limit or limit == ZERO:
            # Also without friction, where the bristle never holds.
            size = wp.max(size, wp.float64(1.0e-30))
            out.slid = size - limit
            holds = sticks == EVERY or (sticks == HELD and sliding == 0)
            if limit == ZERO or not holds:
                shrink = limit / size
                out.bristle = shrink * out.bristle
                along = stretch / size
                out.grip = shrink * (out.grip - law.stiffness * wp.outer(along, along))
                stretch = shrink * stretch
        out.pull = law.stiffness * stretch
    return out


@wp.struct
class EdgeMotion:
    """How the surface point of a piece follows its nodes (weight and slope, 3 each; 3x3) and its
    angles."""

    weight: wp.vec3d
    slope: wp.vec3d
    swing: wp.mat33d
    spin: wp.vec3d
    share: wp.float64


@wp.func
def edge_motion(kind: int, e: wp.vec3d, s: wp.float64, arm: wp.float64, n: wp.vec3d) -> EdgeMotion:
    """Derivative of `surface_motion`, closest point and normal held."""
    length = wp.length(e)
    t = e / length
    eye = wp.identity(3, dtype=wp.float64)
    swing = wp.dot(t, n) * eye - wp.outer(t, n)
    out = EdgeMotion()
    out.weight = piece_weights(kind, s)
    out.slope = piece_slopes(kind, s)
    out.swing = (arm / length) * (swing * (eye - wp.outer(t, t)))
    out.spin = arm * wp.cross(t, n)
    out.share = spin_share(kind, s)
    return out


@wp.func
def add_force(gradient: wp.array2d(dtype=wp.float64), r: int, a: int, v: wp.vec3d):
    for c in range(3):
        wp.atomic_add(gradient, r, a + c, v[c])


@wp.func
def add_edge_force(
    gradient: wp.array2d(dtype=wp.float64),
    kind: int,
    r: int,
    i: int,
    push: wp.vec3d,
    turn: wp.vec3d,
    m: EdgeMotion,
    pull: wp.vec3d,
):
    """Gradient of a force `push` at the closest point, `turn` on the chord and `pull` at the
    surface of piece i."""
    chord = piece_chord(kind)
    swing = wp.transpose(m.swing) * pull
    for k in range(piece_size(kind)):
        force = m.weight[k] * (push + pull) + m.slope[k] * swing + chord[k] * turn
        add_force(gradient, r, 4 * (i + k), force)
    spin = wp.dot(m.spin, pull)
    wp.atomic_add(gradient, r, 4 * i + 3, (ONE - m.share) * spin)
    if kind != EDGE:
        wp.atomic_add(gradient, r, 4 * i + 7, m.share * spin)


@wp.kernel
def rod_contact(
    # Model:
    law: wp.array(dtype=Law),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    piece: wp.array2d(dtype=wp.int32),
    # State in:
    step: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    bristle: wp.array3d(dtype=wp.vec2d),
    load: wp.array3d(dtype=wp.float64),
    sliding: wp.array3d(dtype=wp.int32),
    sticking: wp.array(dtype=wp.int32),
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    # State out:
    depth_out: wp.array3d(dtype=wp.float64),
    overloaded_out: wp.array(dtype=wp.int32),
):
    """Subtract the forces of every touching pair from the residual, and note how deep it is.

    While a rod is `sticking`, bristles hold any load: those that held before, or all.
    """
    r, i = wp.tid()
    if active[r] == 0:
        return
    for k in range(partner_count[r, i]):
        j = partner[r, i, k]
        c = pair_contact(
            law[r], radius, rest_length, piece, step[r], dof, dof_before, bristle[r, i, k],
            load[r, i, k], sliding[r, i, k], sticking[r], r, i, j,
        )  # fmt: skip
        depth_out[r, i, k] = radius[r, i] + radius[r, j] - c.near.distance
        if c.force > ZERO:
            if c.slid > ZERO and load[r, i, k] > ZERO:
                overloaded_out[r] = 1
            pressure = -c.force / c.near.distance
            push = pressure * c.near.gap
            kind = piece[r, i]
            m = edge_motion(kind, c.near.first, c.near.s, -radius[r, i], c.normal)
            add_edge_force(gradient, kind, r, i, push, pressure * c.near.first_turn, m, c.pull)
            kind = piece[r, j]
            m = edge_motion(kind, c.near.second, c.near.t, radius[r, j], c.normal)
            add_edge_force(gradient, kind, r, j, -push, pressure * c.near.second_turn, m, -c.pull)


@wp.kernel
def find_touching(
    # Model:
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    piece: wp.array2d(dtype=wp.int32),
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
        near = nearest_of_edges(dof, rest_length, piece, r, i, j)
        depth = radius[r, i] + radius[r, j] - near.distance
        if depth > ZERO:
            n = near.gap / wp.max(wp.length(near.gap), wp.float64(1.0e-12))
            motion = surface_motion(dof, dof_before, piece[r, i], r, i, near.s, -radius[r, i], n)
            motion = motion - surface_motion(
                dof, dof_before, piece[r, j], r, j, near.t, radius[r, j], n
            )
            note_touch(touching_out, r, depth, -wp.dot(motion, n), radius[r, i])


@wp.kernel
def hold_loads(
    starting: wp.array(dtype=wp.int32),
    load: wp.array3d(dtype=wp.float64),
    held_out: wp.array3d(dtype=wp.float64),
):
    """A step begins with the loads of the last."""
    r, i, k = wp.tid()
    if starting[r] != 0:
        held_out[r, i, k] = load[r, i, k]


@wp.kernel
def renew_loads(
    # Model:
    law: wp.array(dtype=Law),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    piece: wp.array2d(dtype=wp.int32),
    # State in:
    step: wp.array(dtype=wp.float64),
    converged: wp.array(dtype=wp.int32),
    renewals: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    bristle: wp.array3d(dtype=wp.vec2d),
    sliding: wp.array3d(dtype=wp.int32),
    # State in and out:
    held: wp.array3d(dtype=wp.float64),
    # State out:
    renewed_out: wp.array(dtype=wp.int32),
):
    """Where a rod is in balance, take the loads anew that bound what slides and are out of date.
    A pair that meets in this step rubs from the next one on."""
    r, i = wp.tid()
    if converged[r] == 0 or renewals[r] >= MOST_RENEWALS:
        return
    for k in range(partner_count[r, i]):
        j = partner[r, i, k]
        old = held[r, i, k]
        if old == ZERO:
            continue
        c = pair_contact(
            law[r], radius, rest_length, piece, step[r], dof, dof_before, bristle[r, i, k], old,
            sliding[r, i, k], SLIPPING, r, i, j,
        )  # fmt: skip
        if c.force > ZERO and wp.abs(c.force - old) > STALE * wp.max(c.force, old):
            mu = wp.where(sliding[r, i, k] != 0, law[r].kinetic_friction, law[r].static_friction)
            wanted = wp.length(c.pull) + law[r].stiffness * c.slid
            if mu > ZERO and wanted > mu * wp.min(c.force, old):
                held[r, i, k] = c.force
                wp.atomic_max(renewed_out, r, 1)


@wp.kernel
def begin_sticking(
    starting: wp.array(dtype=wp.int32),
    rejected: wp.array(dtype=wp.int32),
    sticking_out: wp.array(dtype=wp.int32),
    overloaded_out: wp.array(dtype=wp.int32),
    renewals_out: wp.array(dtype=wp.int32),
):
    """The first iteration of a step takes bristles that held to hold any load, as an elastic
    predictor: Newton then meets the kink of Coulomb's law from the side of the solution. When a
    step has failed, also those that slid, and loads stay those of the last step: a shorter one
    changes them less."""
    r = wp.tid()
    if starting[r] != 0:
        sticking_out[r] = wp.where(rejected[r] != 0, EVERY, HELD)
        overloaded_out[r] = 0
        renewals_out[r] = wp.where(rejected[r] != 0, MOST_RENEWALS, 0)


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
    law: wp.array(dtype=Law),
    radius: wp.array2d(dtype=wp.float64),
    rest_length: wp.array2d(dtype=wp.float64),
    piece: wp.array2d(dtype=wp.int32),
    # State in:
    step: wp.array(dtype=wp.float64),
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    partner_count: wp.array2d(dtype=wp.int32),
    partner: wp.array3d(dtype=wp.int32),
    held: wp.array3d(dtype=wp.float64),
    # State in and out:
    bristle: wp.array3d(dtype=wp.vec2d),
    load: wp.array3d(dtype=wp.float64),
    sliding: wp.array3d(dtype=wp.int32),
    slip: wp.array2d(dtype=wp.float64),
    force: wp.array2d(dtype=wp.vec3d),
    penetration: wp.array(dtype=wp.float64),
):
    """After an accepted step: let overloaded bristles slide; note forces, slip and penetration."""
    r, i = wp.tid()
    if accepted[r] == 0:
        return
    for k in range(partner_count[r, i]):
        j = partner[r, i, k]
        c = pair_contact(
            law[r], radius, rest_length, piece, step[r], dof, dof_before, bristle[r, i, k],
            held[r, i, k], sliding[r, i, k], SLIPPING, r, i, j,
        )  # fmt: skip
        bristle[r, i, k] = c.bristle
        load[r, i, k] = c.force
        sliding[r, i, k] = 0
        if c.force > ZERO:
            if c.slid > ZERO:
                sliding[r, i, k] = 1
                wp.atomic_add(slip, r, i, c.slid)
                wp.atomic_add(slip, r, j, c.slid)
            total = (c.force / c.near.distance) * c.near.gap - c.pull
            for n in range(piece_size(piece[r, i])):
                wp.atomic_add(force, r, i + n, c.near.first_weight[n] * total)
            for n in range(piece_size(piece[r, j])):
                wp.atomic_add(force, r, j + n, -c.near.second_weight[n] * total)
            wp.atomic_max(penetration, r, radius[r, i] + radius[r, j] - c.near.distance)
