"""Two pieces of rods that touch: edges are capsules, pieces of a spline are tubes.

See `wrod.kernels.contact.rods` for the forces, and `wrod.kernels.contact.segments` for the shortest
way between two pieces.
"""

import warp as wp
from wrod.kernels.contact.duals import bristle_stiffness, next_dual
from wrod.kernels.contact.law import damped_force
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
from wrod.kernels.elastic.assembly import add_component, add_vector
from wrod.kernels.elastic.frames import ONE, TWO, ZERO, node


@wp.struct
class PairLaw:
    """What all pairs of a rod share: stiffness, that of bristles, skin, relaxation time of the
    normal force, from which depth on, over what way and by how much it hardens, and the
    coefficients of friction."""

    stiffness: wp.float64
    tangential: wp.float64
    skin: wp.float64
    relaxation: wp.float64
    hard_depth: wp.float64
    hard_skin: wp.float64
    hardening: wp.float64
    static_friction: wp.float64
    kinetic_friction: wp.float64


@wp.struct
class Pieces:
    """What may touch: (rod,) laws; (rod, piece) radii (0: touches nothing), rest lengths and kinds,
    see `wrod.kernels.contact.segments`."""

    law: wp.array(dtype=PairLaw)
    radius: wp.array2d(dtype=wp.float64)
    rest_length: wp.array2d(dtype=wp.float64)
    kind: wp.array2d(dtype=wp.int32)


@wp.struct
class Rubbing:
    """Friction in a step: (rod, piece, partner) bristles in the pair's own frame, loads that bound
    them, and whether they slid in the last step; (rod,) number of the present iteration. From
    iteration to iteration: how each was stretched, and its dual (`wrod.kernels.contact.duals`)."""

    bristle: wp.array3d(dtype=wp.vec2d)
    load: wp.array3d(dtype=wp.float64)
    sliding: wp.array3d(dtype=wp.int32)
    iteration: wp.array(dtype=wp.int32)
    stretch: wp.array3d(dtype=wp.vec2d)
    dual: wp.array3d(dtype=wp.vec2d)


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
    tangential: wp.mat33d
    bristle: wp.vec2d
    stretched: wp.vec2d
    limit: wp.float64
    slid: wp.float64


@wp.func
def piece_nodes(dof: wp.array2d(dtype=wp.float64), kind: int, r: int, i: int) -> wp.mat33d:
    """Nodes of piece i as columns; of an edge the second one twice."""
    last = i + piece_size(kind) - 1
    return wp.matrix_from_cols(node(dof, r, i), node(dof, r, i + 1), node(dof, r, last))


@wp.func
def nearest_of_edges(
    m: Pieces, dof: wp.array2d(dtype=wp.float64), r: int, i: int, j: int
) -> Nearest:
    a = SMOOTHING * m.rest_length[r, i] * m.rest_length[r, i]
    b = SMOOTHING * m.rest_length[r, j] * m.rest_length[r, j]
    first = m.kind[r, i]
    second = m.kind[r, j]
    if first == EDGE and second == EDGE:
        return nearest(
            node(dof, r, i), node(dof, r, i + 1), node(dof, r, j), node(dof, r, j + 1), a, b
        )
    return nearest_of_pieces(
        piece_nodes(dof, first, r, i), piece_nodes(dof, second, r, j), first, second, a, b
    )


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
def relative_motion(
    m: Pieces,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    near: Nearest,
    n: wp.vec3d,
    r: int,
    i: int,
    j: int,
) -> wp.vec3d:
    """Motion in this step of the surface of piece i on that of piece j, where they are nearest."""
    first = surface_motion(dof, dof_before, m.kind[r, i], r, i, near.s, -m.radius[r, i], n)
    return first - surface_motion(dof, dof_before, m.kind[r, j], r, j, near.t, m.radius[r, j], n)


@wp.func
def repulsion(law: PairLaw, depth: wp.float64, closing: wp.float64, dt: wp.float64) -> wp.vec2d:
    """Normal force of a pair and its slope. What hardens adds as much damping as there is."""
    out = damped_force(depth, closing, law.relaxation, dt, law.stiffness, law.skin)
    if law.hardening > ZERO:
        hard = law.hardening * law.stiffness
        lag = law.relaxation / law.hardening
        out += damped_force(depth - law.hard_depth, closing, lag, dt, hard, law.hard_skin)
    return out


@wp.func
def pair_contact(
    m: Pieces,
    rubbing: Rubbing,
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    begins: bool,
    r: int,
    i: int,
    j: int,
    k: int,
) -> Pair:
    """Piece i and its partner k, piece j. What rubs does so until its load is taken anew, also
    apart; where a step `begins`, it is no softer than it was."""
    out = Pair()
    law = m.law[r]
    sliding = rubbing.sliding[r, i, k]
    near = nearest_of_edges(m, dof, r, i, j)
    out.near = near
    p = m.radius[r, i] + m.radius[r, j] - near.distance
    load = rubbing.load[r, i, k]
    if p > ZERO or load > ZERO:
        # Centrelines that cross have no normal; the step is refused for its depth anyway.
        n = near.gap / wp.max(wp.length(near.gap), wp.float64(1.0e-12))
        out.normal = n
        e1 = first_tangent(wp.normalize(near.first), n)
        e2 = wp.cross(n, e1)
        motion = relative_motion(m, dof, dof_before, near, n, r, i, j)
        normal = repulsion(law, p, -wp.dot(motion, n), dt)
        out.force = normal[0]
        out.slope = normal[1]
        if begins:
            pressed = wp.sqrt(TWO * load / (law.stiffness * law.skin))
            out.slope = wp.max(out.slope, law.stiffness * wp.min(ONE, pressed))
        bristle = rubbing.bristle[r, i, k]
        b1 = bristle[0] + wp.dot(motion, e1)
        b2 = bristle[1] + wp.dot(motion, e2)
        stretch = b1 * e1 + b2 * e2
        size = wp.length(stretch)
        mu = wp.where(sliding != 0, law.kinetic_friction, law.static_friction)
        limit = mu * load / law.tangential
        out.limit = limit
        dual = rubbing.dual[r, i, k]
        w = dual[0] * e1 + dual[1] * e2
        out.tangential = bristle_stiffness(stretch, w, n, law.tangential, limit)
        out.stretched = wp.vec2d(b1, b2)
        shrink = wp.float64(1.0)
        if size > limit:
            out.slid = size - limit
            shrink = limit / size
        out.bristle = shrink * out.stretched
        stretch = shrink * stretch
        out.pull = law.tangential * stretch
    return out


@wp.func
def note_stretch(rubbing: Rubbing, c: Pair, begins: bool, r: int, i: int, k: int):
    """Bring the dual of a pair's friction to the present iteration; a step begins with that of the
    last."""
    none = wp.vec2d(ZERO, ZERO)
    if begins:
        rubbing.dual[r, i, k] = next_dual(none, none, rubbing.bristle[r, i, k], c.limit)
    else:
        before = rubbing.stretch[r, i, k]
        rubbing.dual[r, i, k] = next_dual(rubbing.dual[r, i, k], before, c.stretched, c.limit)
    rubbing.stretch[r, i, k] = c.stretched


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
        add_vector(gradient, r, 4 * (i + k), force)
    spin = wp.dot(m.spin, pull)
    add_component(gradient, r, 4 * i + 3, (ONE - m.share) * spin)
    if kind != EDGE:
        add_component(gradient, r, 4 * i + 7, m.share * spin)
