"""Internal damping: Kelvin-Voigt in strains of the material, as a shape at rest that flows.

The strains of a node are s = (kappa_1, kappa_2, tau), integrated over its Voronoi length l. A
Kelvin-Voigt material has the moments B ((s + eta ds/dt) / l - s0); with ds/dt = (c_0 s + c_1 s_n +
c_2 s_(n-1)) / dt that is an elastic rod of stiffness B (1 + eta c_0 / dt) with another shape at
rest, so its forces are those of a potential for the length of a step, and as strains do not change
in rigid motion they do not oppose it (Bergou et al. 2010). The stretch of an edge flows alike: a
spring k ((x - x0) + eta dx/dt) of x = |e| / l - 1 is one of another stiffness and rest length. A
rod that softens has the moment-curvature law of `wrod.kernels.elastic.softened_bending` in (s + eta
ds/dt) / l - s0: with one eta for both bendings the elastic rod has the same law, its c times
(1 + eta c_0 / dt)^2.

Viscous moments that relax within a time theta, M + theta dM/dt = B eta ds/dt, are those of q = s -
theta dq/dt in place of s (a spring in series with the dashpot: Zener's solid with the elastic one).
So eta becomes eta / (1 + theta c_0 / dt), and what is remembered is q.
"""

import warp as wp
from wrod.kernels.elastic.curvature import component, stencil
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, edge
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.stepping.pace import Pace


@wp.func
def strain(
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    r: int,
    i: int,
) -> wp.vec3d:
    s = stencil(dof, director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    twist = dof[r, 4 * i + 3] - dof[r, 4 * i - 1] + reference_twist[r, i]
    return wp.vec3d(first.kappa, second.kappa, twist)


@wp.func
def measured(
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    r: int,
    i: int,
) -> wp.vec4d:
    """Strains of a node, none at the ends, and |e| of the edge after it."""
    s = wp.vec3d(ZERO, ZERO, ZERO)
    last = (dof.shape[1] + 1) / 4 - 1
    if i > 0 and i < last:
        s = strain(dof, director, reference_twist, r, i)
    length = ZERO
    if i < last:
        length = wp.length(edge(dof, r, i))
    return wp.vec4d(s[0], s[1], s[2], length)


@wp.func
def times_of(times: wp.vec4d, rate: wp.float64):
    """Viscous times of bending and twisting as moments that relax leave them, and the share left,
    for rates of (rate s)."""
    relaxed = ONE / (ONE + times[3] * rate)
    return relaxed * wp.vec3d(times[0], times[1], times[2]), relaxed


@wp.func
def relaxed_strain(
    c: wp.vec3d, theta: wp.float64, now: wp.vec4d, before: wp.vec4d, older: wp.vec4d
) -> wp.vec4d:
    """q of strains `now`; `c`: of rates. Stretching does not relax."""
    q = (now - theta * (c[1] * before + c[2] * older)) / (ONE + theta * c[0])
    return wp.vec4d(q[0], q[1], q[2], now[3])


@wp.kernel
def measure_strains(
    # State in:
    active: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    # State out: (rod, node), its last component |e| of the edge after the node
    strain_out: wp.array2d(dtype=wp.vec4d),
):
    r, i = wp.tid()
    if active[r] == 0:
        return
    strain_out[r, i] = measured(dof, director, reference_twist, r, i)


@wp.kernel
def relax_strains(
    # State in:
    pace: Pace,
    relaxation: wp.array2d(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    # State out:
    strain_out: wp.array2d(dtype=wp.vec4d),
    strain_older_out: wp.array2d(dtype=wp.vec4d),
):
    """What viscous moments that relax remember of an accepted step."""
    r, i = wp.tid()
    if pace.accepted[r] == 0:
        return
    now = measured(dof, director, reference_twist, r, i)
    before = strain_out[r, i]
    older = strain_older_out[r, i]
    theta = relaxation[wp.min(r, relaxation.shape[0] - 1), i]
    q = relaxed_strain(pace.coefficient[r] / pace.span[r], theta, now, before, older)
    ratio = pace.step[r] / pace.span[r]
    if ratio > ONE:
        # A midpoint step goes straight on from where its forces are.
        q = before + ratio * (q - before)
    strain_out[r, i] = q
    strain_older_out[r, i] = before


@wp.kernel
def shift_strains(
    # State in:
    accepted: wp.array(dtype=wp.int32),
    strain: wp.array2d(dtype=wp.vec4d),
    # State out:
    strain_older_out: wp.array2d(dtype=wp.vec4d),
):
    r, i = wp.tid()
    if accepted[r] != 0:
        strain_older_out[r, i] = strain[r, i]


@wp.kernel
def flow_stretching(
    # Model:
    model: ElasticModel,
    viscous_time: wp.array2d(dtype=wp.vec4d),
    # State in:
    pace: Pace,
    strain: wp.array2d(dtype=wp.vec4d),
    strain_older: wp.array2d(dtype=wp.vec4d),
    # Out:
    flown: ElasticModel,
):
    """Stiffness and rest length of the elastic edges that stand for the viscous ones this step."""
    r, i = wp.tid()
    if pace.starting[r] == 0:
        return
    k = model.stretching[r, i]
    rest = model.rest_length[r, i]
    flown.rest_length[r, i] = rest
    flown.stretching[r, i] = k
    eta = viscous_time[r, i][3]
    if eta == ZERO or k == ZERO:
        return
    c = pace.coefficient[r]
    dt = pace.span[r]
    factor = ONE + eta * c[0] / dt
    # c_0 + c_1 + c_2 = 0: the history of |e| / l - 1 is that of |e| / l, and c_0.
    history = (c[0] + (c[1] * strain[r, i][3] + c[2] * strain_older[r, i][3]) / rest) / dt
    stretch = ONE - eta * history / factor
    flown.rest_length[r, i] = stretch * rest
    flown.stretching[r, i] = factor * stretch * k


@wp.kernel
def flow_bending(
    # Model:
    model: ElasticModel,
    viscous_time: wp.array2d(dtype=wp.vec4d),
    relaxation: wp.array2d(dtype=wp.float64),
    # State in:
    pace: Pace,
    strain: wp.array2d(dtype=wp.vec4d),
    strain_older: wp.array2d(dtype=wp.vec4d),
    # In and out:
    flown: ElasticModel,
):
    """The same of bending and twisting, for edges whose rest lengths have flown."""
    r, j = wp.tid()
    if pace.starting[r] == 0:
        return
    i = j + 1
    length = HALF * (model.rest_length[r, i - 1] + model.rest_length[r, i])
    # Moments per integrated strain must not know of lengths that only stretching has changed.
    grown = HALF * (flown.rest_length[r, i - 1] + flown.rest_length[r, i]) / length
    eta = viscous_time[r, i]
    c = pace.coefficient[r]
    dt = pace.span[r]
    eta = eta / (ONE + relaxation[wp.min(r, relaxation.shape[0] - 1), i] * c[0] / dt)
    history = (c[1] * strain[r, i] + c[2] * strain_older[r, i]) / (dt * length)
    f1 = ONE + eta[0] * c[0] / dt
    f2 = ONE + eta[1] * c[0] / dt
    f3 = ONE + eta[2] * c[0] / dt
    b = model.bending[r, i]
    rest = model.natural_curvature[r, i]
    flown.bending[r, i] = wp.vec2d(grown * f1 * b[0], grown * f2 * b[1])
    # What twist must not soften does not flow.
    flown.invariant[r, i] = grown * b
    flown.natural_curvature[r, i] = wp.vec2d(
        (rest[0] - eta[0] * history[0]) / (grown * f1),
        (rest[1] - eta[1] * history[1]) / (grown * f2),
    )
    law = model.softening[r, i]
    flown.softening[r, i] = wp.vec2d(law[0] * (f1 * f1 * grown * grown), law[1])
    flown.twisting[r, i] = grown * f3 * model.twisting[r, i]
    flown.natural_twist[r, i] = (model.natural_twist[r, i] - eta[2] * history[2]) / (grown * f3)
