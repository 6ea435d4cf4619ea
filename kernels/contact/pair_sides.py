"""What a touching pair is made of, and what its two pieces feel: see
`wrod.kernels.contact.pair_tangent`.
"""

import warp as wp
from wrod.kernels.contact.pair_contact import (
    Pair,
    PairLaw,
    Pieces,
    Rubbing,
    pair_contact,
    piece_nodes,
    relative_motion,
)
from wrod.kernels.contact.segments import EDGE
from wrod.kernels.elastic.frames import ONE, ZERO


@wp.struct
class Piece:
    """A piece in a pair: its nodes at both ends of a step, how far its edges turn in it, kind,
    where on it the point of contact is, and the arm from there to the surface, along the normal."""

    now: wp.mat33d
    before: wp.mat33d
    spin: wp.vec2d
    kind: int
    s: wp.float64
    arm: wp.float64


@wp.struct
class Side:
    """What a piece feels, or how that changes: a force at the point of contact, what turns the
    curve there, what turns its chord, and a moment about it."""

    force: wp.vec3d
    lever: wp.vec3d
    turn: wp.vec3d
    spin: wp.float64


@wp.struct
class TouchingPair:
    """A pair that touches, all that it is made of; what each side feels, motion of its surfaces,
    directions in which its bristle is told, and its bristle after the step."""

    pair: Pair
    law: PairLaw
    dt: wp.float64
    first: Piece
    second: Piece
    on_first: Side
    on_second: Side
    motion: wp.vec3d
    depth: wp.float64
    along: wp.vec3d
    aside: wp.vec3d
    limit: wp.float64
    slides: int


@wp.func
def across(v: wp.vec3d, t: wp.vec3d) -> wp.vec3d:
    return v - wp.dot(v, t) * t


@wp.func
def piece_of(
    m: Pieces, dof: wp.array2d(dtype=wp.float64), dof_before: wp.array2d(dtype=wp.float64),
    r: int, i: int, s: wp.float64, sign: wp.float64,
) -> Piece:  # fmt: skip
    out = Piece()
    out.kind = m.kind[r, i]
    out.now = piece_nodes(dof, out.kind, r, i)
    out.before = piece_nodes(dof_before, out.kind, r, i)
    out.spin[0] = dof[r, 4 * i + 3] - dof_before[r, 4 * i + 3]
    if out.kind != EDGE:
        out.spin[1] = dof[r, 4 * i + 7] - dof_before[r, 4 * i + 7]
    out.s = s
    out.arm = sign * m.radius[r, i]
    return out


@wp.func
def what_it_feels(p: Piece, e: wp.vec3d, n: wp.vec3d, push: wp.vec3d, pull: wp.vec3d) -> Side:
    """As `wrod.kernels.contact.pair_contact.add_edge_force` spreads it."""
    out = Side()
    length = wp.length(e)
    t = e / length
    out.force = push + pull
    out.lever = (p.arm / length) * across(wp.dot(t, n) * pull - wp.dot(t, pull) * n, t)
    out.spin = p.arm * wp.dot(wp.cross(t, n), pull)
    return out


@wp.func(inline=False)
def touching_of(
    m: Pieces, rubbing: Rubbing, dt: wp.float64, dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64), r: int, i: int, j: int, k: int,
) -> TouchingPair:  # fmt: skip
    out = TouchingPair()
    c = pair_contact(m, rubbing, dt, dof, dof_before, False, r, i, j, k)
    out.pair = c
    near = c.near
    out.law = m.law[r]
    out.dt = dt
    out.first = piece_of(m, dof, dof_before, r, i, near.s, -ONE)
    out.second = piece_of(m, dof, dof_before, r, j, near.t, ONE)
    out.depth = m.radius[r, i] + m.radius[r, j] - near.distance
    pressure = -c.force / near.distance
    push = pressure * near.gap
    out.on_first = what_it_feels(out.first, near.first, c.normal, push, c.pull)
    out.on_second = what_it_feels(out.second, near.second, c.normal, -push, -c.pull)
    out.on_first.turn = (pressure * near.small) * near.first_turn
    out.on_second.turn = (pressure * near.small) * near.second_turn
    out.motion = relative_motion(m, dof, dof_before, near, c.normal, r, i, j)
    load = rubbing.load[r, i, k]
    if load > ZERO and c.slid > ZERO:
        out.slides = 1
    out.limit = c.limit
    if load == ZERO:
        out.limit = ZERO
    return out
