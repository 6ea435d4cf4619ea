"""How Newton's method is led over the kink of Coulomb's law.

Friction that is bounded by L pulls by L b / max(|b|, l), b a bristle's stretch and l its stretch at
the bound. Its derivative knows nothing of what lies beyond the kink: from one that slides, Newton
goes to where it slides the other way, and back. So each bristle has a dual w, that is to be
b / max(|b|, l) in the end and, linearised together with it, leads the iteration (Chan, Golub and
Mulet 1999, of total variation; Hueeber, Stadler and Wohlmuth 2008, of contact). What is put into
the matrix is symmetric, at least zero, and the derivative where both agree.
"""

from typing import Any

import warp as wp
from wrod.kernels.contact.law import ContactStep
from wrod.kernels.elastic.frames import HALF, ONE, ZERO

_TINY = wp.constant(wp.float64(1.0e-30))


@wp.func
def next_dual(dual: Any, before: Any, now: Any, limit: wp.float64):
    """Dual of a bristle that is stretched by `now`, linearised about what it was `before`."""
    size = wp.length(before)
    out = now / wp.max(limit, _TINY)
    if size > limit:
        way = before / size
        change = now - before
        out = (now - HALF * (wp.dot(way, change) * dual + wp.dot(dual, change) * way)) / size
    return out / wp.max(wp.length(out), ONE)


@wp.func
def follow_dual(
    step: ContactStep, now: wp.vec3d, limit: wp.float64, slides: bool, r: int, k: int, i: int
) -> wp.vec3d:
    """Dual in an iteration of a bristle that is stretched by `now`: it goes on from iteration to
    iteration from what was held at the start of the step. What holds has its dual by its stretch
    alone: of most bristles nothing is written."""
    none = wp.vec3d()
    if step.iteration[r] < 0:
        return next_dual(none, none, now, limit)
    before = step.stretch[r, k, i]
    slid = wp.length_sq(before) > ZERO
    w = wp.vec3d()
    if step.iteration[r] == 0:
        w = next_dual(none, none, step.bristle[r, k, i], limit)
    else:
        if slid:
            w = step.dual[r, k, i]
        w = next_dual(w, before, now, limit)
    if slides:
        step.dual[r, k, i] = w
        step.stretch[r, k, i] = now
    elif slid:
        step.stretch[r, k, i] = none
    return w


@wp.func
def bristle_stiffness(
    stretch: wp.vec3d, dual: wp.vec3d, normal: wp.vec3d, stiffness: wp.float64, limit: wp.float64
) -> wp.mat33d:
    """What a bristle that slides at a stretch of `limit` adds to the matrix of an iteration; one
    without friction never holds."""
    across = wp.identity(3, dtype=wp.float64) - wp.outer(normal, normal)
    size = wp.length(stretch)
    if size <= limit and limit > ZERO:
        return stiffness * across
    size = wp.max(size, _TINY)
    half = wp.outer(dual, (HALF / size) * stretch)
    return (stiffness * limit / size) * (across - half - wp.transpose(half))
