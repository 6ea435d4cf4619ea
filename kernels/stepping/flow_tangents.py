"""Tangents of a rod's strains, and what they feel of its shape at rest: of its own rate, and of the
flow that internal damping makes of it (`viscosity`), which remembers the strains of two steps, or
what moments that relax leave of them."""

from typing import Any

import warp as wp
from wrod.kernels.elastic.curvature import component, stencil
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.viscosity import times_of


@wp.func
def is_under_way(pace: Pace, begin: wp.array2d(dtype=wp.float64), r: int, p: int) -> bool:
    """Whether a step of the rod was accepted, and its pack has begun."""
    return pace.accepted[r] != 0 and pace.time[r] >= begin[r, p]


@wp.func
def along(g: wp.vec3d, x: wp.array3d(dtype=Any), r: int, p: int, i: int):
    """Of the edge after node i, times g."""
    a = 4 * i
    return (
        g[0] * (x[r, p, a + 4] - x[r, p, a])
        + g[1] * (x[r, p, a + 5] - x[r, p, a + 1])
        + g[2] * (x[r, p, a + 6] - x[r, p, a + 2])
    )


@wp.struct
class Strains:
    """How the two curvatures and the twist at a node (rows), and the length of the edge after it,
    answer to the edges around it; and what moments they make by flowing.

    Attributes:
        before, after: by the vectors of the edges.
        angle_before, angle_after: by their angles.
        tangent: of the edge after.
        flow: bending moments by what damping remembers of the curvatures.
        natural: bending moments by the natural curvature.
        twist, pull: the like, by what it remembers of the twist and of the length.
    """

    before: wp.mat33d
    after: wp.mat33d
    angle_before: wp.vec3d
    angle_after: wp.vec3d
    tangent: wp.vec3d
    flow: wp.mat22d
    natural: wp.mat22d
    twist: wp.float64
    pull: wp.float64


@wp.func
def strains_at(
    dof: wp.array2d(dtype=wp.float64), director: wp.array2d(dtype=wp.vec3d), r: int, i: int
) -> Strains:
    """Their answers to edges alone; at the first node to the edge after it."""
    out = Strains()
    out.tangent = wp.normalize(edge(dof, r, i))
    if i > 0:
        s = stencil(dof, director, r, i)
        first = component(s, 0)
        second = component(s, 1)
        binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
        out.before = wp.matrix_from_rows(first.e, second.e, binormal) / s.length_e
        out.after = wp.matrix_from_rows(first.f, second.f, binormal) / s.length_f
        out.angle_before = wp.vec3d(first.te, second.te, -ONE)
        out.angle_after = wp.vec3d(first.tf, second.tf, ONE)
    return out


@wp.func
def strain_rate(s: Strains, x: wp.array3d(dtype=Any), r: int, p: int, i: int, k: int):
    """Of curvature or twist k at node i > 0."""
    a = 4 * i
    rate = s.angle_before[k] * x[r, p, a - 1] + s.angle_after[k] * x[r, p, a + 3]
    for m in range(3):
        rate += s.before[k, m] * (x[r, p, a + m] - x[r, p, a - 4 + m])
        rate += s.after[k, m] * (x[r, p, a + 4 + m] - x[r, p, a + m])
    return rate


@wp.kernel
def linearise_flow(
    # Model:
    model: ElasticModel,
    viscous_time: wp.array2d(dtype=wp.vec4d),
    relaxation: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    strain_before: wp.array2d(dtype=wp.vec4d),
    strain_older: wp.array2d(dtype=wp.vec4d),
    # Out:
    strains_out: wp.array2d(dtype=Strains),
):
    """At node i and the edge after it, at the end of the step."""
    r, i = wp.tid()
    if pace.accepted[r] == 0:
        return
    out = strains_at(dof, director, r, i)
    c = pace.coefficient[r] / pace.step[r]
    times = viscous_time[r, i]
    theta = relaxation[wp.min(r, relaxation.shape[0] - 1), i]
    eta, _ = times_of(wp.vec4d(times[0], times[1], times[2], theta), c[0])
    h = model.rest_length[r, i]
    out.pull = times[3] * model.stretching[r, i] / h
    if i > 0:
        length = HALF * (model.rest_length[r, i - 1] + h)
        # Of the grip's node a share of the cell is beyond the grip.
        share = ONE
        if i == model.rest_length.shape[1] - 1:
            share = HALF * model.rest_length[r, i - 1] / length
        b = model.bending[r, i]
        law = model.softening[r, i]
        moment = wp.diag(b)
        if law[0] != ZERO:
            # M = B e (r + (1 - r) / D), D = 1 + 2 c (B_1 e_1^2 + B_2 e_2^2) / (B_1 + B_2).
            s = stencil(dof, director, r, i)
            first = component(s, 0)
            second = component(s, 1)
            was = strain_before[r, i]
            past = strain_older[r, i]
            flow_1 = c[0] * first.kappa + c[1] * was[0] + c[2] * past[0]
            flow_2 = c[0] * second.kappa + c[1] * was[1] + c[2] * past[1]
            natural = model.natural_curvature[r, i]
            pulled = wp.vec2d(
                b[0] * ((first.kappa + eta[0] * flow_1) / length - natural[0]),
                b[1] * ((second.kappa + eta[1] * flow_2) / length - natural[1]),
            )
            by = TWO * law[0] / (b[0] + b[1])
            d = ONE + by * (pulled[0] * pulled[0] / b[0] + pulled[1] * pulled[1] / b[1])
            secant = law[1] + (ONE - law[1]) / d
            fall = -(ONE - law[1]) / (d * d) * TWO * by
            moment = secant * moment + fall * wp.outer(pulled, pulled)
        out.flow = moment * wp.diag(wp.vec2d(eta[0], eta[1])) / length
        out.natural = -share * moment
        out.twist = eta[2] * model.twisting[r, i] / length
    strains_out[r, i] = out


@wp.kernel
def measure_strain_rates(
    # Model:
    begin: wp.array2d(dtype=wp.float64),
    relaxation: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    strains: wp.array2d(dtype=Strains),
    x: wp.array3d(dtype=Any),
    # State in and out: (rod, pack, 4 i + k), curvatures, twist and |e| after node i
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
):
    """Rates of the strains at the end of the step, of curvatures and twist as moments that relax
    remember them (`viscosity.relaxed_strain`); shifts those of the step before."""
    r, p, i = wp.tid()
    if not is_under_way(pace, begin, r, p):
        return
    a = 4 * i
    c = pace.coefficient[r] / pace.step[r]
    theta = relaxation[wp.min(r, relaxation.shape[0] - 1), i]
    share = ONE / (ONE + theta * c[0])
    s = strains[r, i]
    older[r, p, a + 3] = now[r, p, a + 3]
    now[r, p, a + 3] = along(s.tangent, x, r, p, i)
    if i == 0:
        return
    for k in range(3):
        was = now[r, p, a + k]
        past = c[1] * was + c[2] * older[r, p, a + k]
        older[r, p, a + k] = was
        now[r, p, a + k] = share * (strain_rate(s, x, r, p, i, k) - theta * past)


@wp.func
def moments(
    s: Strains,
    c: wp.vec3d,
    natural_rate: wp.array3d(dtype=Any),
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
    kept: wp.array3d(dtype=Any),
    r: int,
    p: int,
    i: int,
):
    """Rates of the two bending moments and of the torque at node i by what is remembered."""
    a = 4 * i
    kappa_1 = c[1] * now[r, p, a] + c[2] * older[r, p, a]
    kappa_2 = c[1] * now[r, p, a + 1] + c[2] * older[r, p, a + 1]
    torque = s.twist * (c[1] * now[r, p, a + 2] + c[2] * older[r, p, a + 2])
    n_1 = natural_rate[r, p, 0]
    n_2 = natural_rate[r, p, 1]
    first = s.flow[0, 0] * kappa_1 + s.flow[0, 1] * kappa_2
    second = s.flow[1, 0] * kappa_1 + s.flow[1, 1] * kappa_2
    first += s.natural[0, 0] * n_1 + s.natural[0, 1] * n_2
    second += s.natural[1, 0] * n_1 + s.natural[1, 1] * n_2
    if kept.shape[2] > 0:
        first += kept[r, p, 2 * i]
        second += kept[r, p, 2 * i + 1]
    return first, second, torque


@wp.func
def answer(by: wp.mat33d, k: int, m0: Any, m1: Any, m2: Any):
    """Column k of a matrix times three moments."""
    return by[0, k] * m0 + by[1, k] * m1 + by[2, k] * m2


@wp.kernel
def load_flow(
    # Model:
    begin: wp.array2d(dtype=wp.float64),
    # Rates of the natural curvature towards both principal directions:
    natural_rate: wp.array3d(dtype=Any),
    # State in:
    pace: Pace,
    free: wp.array2d(dtype=wp.int32),
    strains: wp.array2d(dtype=Strains),
    now: wp.array3d(dtype=Any),
    older: wp.array3d(dtype=Any),
    # Moments of bends that remember, (rod, pack, 2 i + k), or empty:
    kept: wp.array3d(dtype=Any),
    # In and out:
    x: wp.array3d(dtype=Any),
):
    """Minus the rates of what the moments at the nodes and the pull of the edges ask of node i and
    of the angle of the edge after it, by what the rod is at rest and by strains that damping and
    bends remember."""
    r, p, i = wp.tid()
    if not is_under_way(pace, begin, r, p):
        return
    c = pace.coefficient[r] / pace.step[r]
    a = 4 * i
    # On the vectors of the edges before and after, and on the angle after.
    e0 = type(x[r, p, a])()
    e1 = type(x[r, p, a])()
    e2 = type(x[r, p, a])()
    f0 = type(x[r, p, a])()
    f1 = type(x[r, p, a])()
    f2 = type(x[r, p, a])()
    if i < strains.shape[1] - 1:
        s = strains[r, i]
        m0, m1, m2 = moments(s, c, natural_rate, now, older, kept, r, p, i)
        pull = s.pull * (c[1] * now[r, p, a + 3] + c[2] * older[r, p, a + 3])
        e0 = answer(s.before, 0, m0, m1, m2)
        e1 = answer(s.before, 1, m0, m1, m2)
        e2 = answer(s.before, 2, m0, m1, m2)
        f0 = answer(s.after, 0, m0, m1, m2) + s.tangent[0] * pull
        f1 = answer(s.after, 1, m0, m1, m2) + s.tangent[1] * pull
        f2 = answer(s.after, 2, m0, m1, m2) + s.tangent[2] * pull
        angle = s.angle_after[0] * m0 + s.angle_after[1] * m1 + s.angle_after[2] * m2
        if i + 1 < strains.shape[1] - 1:
            q = strains[r, i + 1]
            q0, q1, q2 = moments(q, c, natural_rate, now, older, kept, r, p, i + 1)
            f0 += answer(q.before, 0, q0, q1, q2)
            f1 += answer(q.before, 1, q0, q1, q2)
            f2 += answer(q.before, 2, q0, q1, q2)
            angle += q.angle_before[0] * q0 + q.angle_before[1] * q1 + q.angle_before[2] * q2
        if free[r, a + 3] != 0:
            x[r, p, a + 3] = x[r, p, a + 3] - angle
    if i > 0:
        o = strains[r, i - 1]
        o0, o1, o2 = moments(o, c, natural_rate, now, older, kept, r, p, i - 1)
        drawn = o.pull * (c[1] * now[r, p, a - 1] + c[2] * older[r, p, a - 1])
        e0 += answer(o.after, 0, o0, o1, o2) + o.tangent[0] * drawn
        e1 += answer(o.after, 1, o0, o1, o2) + o.tangent[1] * drawn
        e2 += answer(o.after, 2, o0, o1, o2) + o.tangent[2] * drawn
    if free[r, a] != 0:
        x[r, p, a] = x[r, p, a] + (f0 - e0)
        x[r, p, a + 1] = x[r, p, a + 1] + (f1 - e1)
        x[r, p, a + 2] = x[r, p, a + 2] + (f2 - e2)


def of_vector(dtype: type, *kernels: wp.Kernel) -> None:
    """Build kernels for arrays of vectors of that type, where they take any."""
    for kernel in kernels:
        known = kernel.adj.arg_types.values()
        wp.overload(
            kernel,
            [
                wp.array(dtype=dtype, ndim=t.ndim) if getattr(t, "dtype", None) is Any else t
                for t in known
            ],
        )
