"""The numbers that a touching pair depends on, degrees of freedom of its nodes and edges, and how
what it does to these follows each: see `wrod.kernels.contact.pair_adjoint`.
"""

import warp as wp
from wrod.kernels.contact.pair_sides import Piece, Side, TouchingPair
from wrod.kernels.contact.pair_tangent import Follow, LawWay, Way, follow_pair
from wrod.kernels.contact.segments import (
    EDGE,
    piece_bends,
    piece_chord,
    piece_size,
    piece_slopes,
    piece_weights,
)
from wrod.kernels.elastic.frames import ONE

# Of a pair: of each piece three nodes and the angles of the edges after them.
NUMBERS = wp.constant(24)
OF_PIECE = wp.constant(12)


@wp.struct
class Turns:
    """By how much edges turn in a step against reference frames, at its end and at its start, by
    where their last nodes are (rod, edge)."""

    by_end: wp.array2d(dtype=wp.vec3d)
    by_start: wp.array2d(dtype=wp.vec3d)


@wp.func
def way_of(turns: Turns, kind: int, r: int, i: int, n: int, c: int, at_start: bool) -> Way:
    """Degree of freedom c of node n of piece i changes by one."""
    out = Way()
    if c == 3:
        out.spin[n] = wp.where(at_start, -ONE, ONE)
        return out
    if at_start:
        out.before[c, n] = ONE
    else:
        out.now[c, n] = ONE
    for q in range(piece_size(kind) - 1):
        if n == q or n == q + 1:
            by = turns.by_end[r, i + q]
            if at_start:
                by = turns.by_start[r, i + q]
            out.spin[q] = wp.where(n == q, by[c], -by[c])
    return out


@wp.func
def has(t: TouchingPair, b: int) -> bool:
    """Whether a pair has number b."""
    size = piece_size(wp.where(b < OF_PIECE, t.first.kind, t.second.kind))
    n = b % OF_PIECE / 4
    return n < size and (b % 4 < 3 or n < size - 1)


@wp.func
def number_node(b: int, i: int, j: int) -> int:
    return wp.where(b < OF_PIECE, i, j) + b % OF_PIECE / 4


@wp.func
def follow_number(
    t: TouchingPair, turns: Turns, r: int, i: int, j: int, b: int, at_start: bool
) -> Follow:
    """How a pair follows number b, of the end of a step or its start."""
    first = Way()
    second = Way()
    n = b % OF_PIECE / 4
    if b < OF_PIECE:
        first = way_of(turns, t.first.kind, r, i, n, b % 4, at_start)
    else:
        second = way_of(turns, t.second.kind, r, j, n, b % 4, at_start)
    return follow_pair(t, first, second, LawWay())


@wp.func
def on_node(p: Piece, at: Side, change: Side, ds: wp.float64, n: int) -> wp.vec4d:
    """How the residuals of node n of a piece, and of the edge after it, change."""
    weight = piece_weights(p.kind, p.s)
    slope = piece_slopes(p.kind, p.s)
    bend = piece_bends(p.kind)
    chord = piece_chord(p.kind)
    f = weight[n] * change.force + (ds * slope[n]) * at.force + slope[n] * change.lever
    f = f + (ds * bend[n]) * at.lever + chord[n] * change.turn
    spin = wp.float64(0.0)
    if n == 0:
        spin = change.spin
    if p.kind != EDGE:
        if n == 0:
            spin = (ONE - p.s) * change.spin - ds * at.spin
        elif n == 1:
            spin = p.s * change.spin + ds * at.spin
    return wp.vec4d(f[0], f[1], f[2], spin)


@wp.func
def pair_node(w: int, i: int, j: int) -> int:
    """Node w of six of a pair, three of each piece."""
    return wp.where(w < 3, i, j) + w % 3


@wp.func
def on_number_node(t: TouchingPair, f: Follow, w: int) -> wp.vec4d:
    """How the residuals of node w change; not if the pair has none."""
    out = wp.vec4d()
    if w < 3 and w < piece_size(t.first.kind):
        out = on_node(t.first, t.on_first, f.first, f.ds, w)
    if w >= 3 and w - 3 < piece_size(t.second.kind):
        out = on_node(t.second, t.on_second, f.second, f.dt, w - 3)
    return out


@wp.func
def of_residuals(
    t: TouchingPair, f: Follow, x: wp.array3d(dtype=wp.float64), p: int, r: int, i: int, j: int
) -> wp.float64:
    """How the residuals change, along vector p of x (rod, p, dof)."""
    out = wp.float64(0.0)
    for w in range(6):
        change = on_number_node(t, f, w)
        for c in range(4):
            a = 4 * pair_node(w, i, j) + c
            if a < x.shape[2]:
                out += x[r, p, a] * change[c]
    return out
