"""What the adjoint of a step wants of the rods' properties, and of strains that they remember.

Forces are moments times the gradients of strains (`wrod.kernels.elastic`), so that of the solution
w only the rates of strains along it count.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_component, add_edge_gradient, add_edge_vector
from wrod.kernels.elastic.curvature import (
    add_component_rate,
    component,
    invariant_gradient,
    stencil,
)
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge, node
from wrod.kernels.elastic.model import ElasticModel
from wrod.kernels.elastic.softened_bending import softening_law
from wrod.kernels.linear.banded_lu import ALONE
from wrod.kernels.stepping.adjoint import solved
from wrod.kernels.stepping.dynamics import difference, velocity_of
from wrod.kernels.stepping.trace import OneStep, Wanted
from wrod.kernels.stepping.viscosity import strain


@wp.struct
class WantedModel:
    """Derivatives of a loss by properties of rods; that by the radius is by its logarithm, of what
    each node and the edge after it have of it; `viscous_time` without columns where nothing is
    viscous."""

    rest_length: wp.array2d(dtype=wp.float64)
    radius: wp.array2d(dtype=wp.float64)
    stretching: wp.array2d(dtype=wp.float64)
    bending: wp.array2d(dtype=wp.vec2d)
    natural_curvature: wp.array2d(dtype=wp.vec2d)
    twisting: wp.array2d(dtype=wp.float64)
    natural_twist: wp.array2d(dtype=wp.float64)
    node_mass: wp.array2d(dtype=wp.float64)
    air: wp.array2d(dtype=wp.float64)
    viscous_time: wp.array2d(dtype=wp.vec4d)
    gravity: wp.array(dtype=wp.vec3d)


@wp.func
def remember(
    step: OneStep, before: Wanted, older: Wanted, r: int, i: int, k: int, value: wp.float64
):
    """Add to what is wanted of a strain's rate at node i."""
    c = step.coefficient[r]
    rate_now = value / step.span[r]
    s = before.strain[r, i]
    s[k] = s[k] + c[1] * rate_now
    before.strain[r, i] = s
    s = older.strain[r, i]
    s[k] = s[k] + c[2] * rate_now
    older.strain[r, i] = s


@wp.kernel
def want_stretching(
    # Model:
    rod: ElasticModel,
    viscous_time: wp.array2d(dtype=wp.vec4d),
    # State in:
    step: OneStep,
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    before: Wanted,
    older: Wanted,
    model: WantedModel,
):
    """Of the edges. Launched over (rod, edge). `viscous_time` has no columns where nothing is
    viscous."""
    r, i = wp.tid()
    if step.active[r] == 0 or rod.stretching[r, i] == ZERO:
        return
    e = edge(step.dof, r, i)
    length = wp.length(e)
    rest = rod.rest_length[r, i]
    stretched = wp.dot(e, solved(x, r, i + 1) - solved(x, r, i)) / length
    stretch = length / rest - ONE
    if viscous_time.shape[1] > 0:
        eta = viscous_time[r, i][3] / rest
        history = step.strain[r, i][3], step.strain_older[r, i][3]
        c = step.coefficient[r]
        flow = difference(c, step.span[r], length, history[0], history[1])
        stretch += eta * flow
        wanted = -stretched * rod.stretching[r, i] * eta
        length += viscous_time[r, i][3] * flow
        times = model.viscous_time[r, i]
        times[3] = times[3] - stretched * rod.stretching[r, i] * flow / rest
        model.viscous_time[r, i] = times
        remember(step, before, older, r, i, 3, wanted)
    model.stretching[r, i] = model.stretching[r, i] - stretched * stretch
    by_rest = stretched * rod.stretching[r, i] * length / (rest * rest)
    wp.atomic_add(model.rest_length, r, i, by_rest)


@wp.kernel
def want_bending(
    # Model:
    rod: ElasticModel,
    viscous_time: wp.array2d(dtype=wp.vec4d),
    # State in:
    step: OneStep,
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    before: Wanted,
    older: Wanted,
    model: WantedModel,
):
    """Of bending and twisting. Launched over (rod, inner node)."""
    r, j = wp.tid()
    i = j + 1
    if step.active[r] == 0 or rod.bending[r, i][0] == ZERO:
        return
    s = stencil(step.dof, step.director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    middle = solved(x, r, i)
    de = (middle - solved(x, r, i - 1)) / s.length_e
    df = (solved(x, r, i + 1) - middle) / s.length_f
    te = x[r, 0, 4 * i - 1][0]
    tf = x[r, 0, 4 * i + 3][0]
    binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
    bent = wp.vec2d(
        wp.dot(first.e, de) + wp.dot(first.f, df) + first.te * te + first.tf * tf,
        wp.dot(second.e, de) + wp.dot(second.f, df) + second.te * te + second.tf * tf,
    )
    twisted = tf - te + wp.dot(binormal, de + df)
    k_e, k_f, k_te, k_tf = invariant_gradient(s, first, second)
    invariant = wp.dot(k_e, de) + wp.dot(k_f, df) + k_te * te + k_tf * tf

    length = HALF * (rod.rest_length[r, i - 1] + rod.rest_length[r, i])
    now = strain(step.dof, step.director, step.twist, r, i)
    flow = wp.vec3d(ZERO, ZERO, ZERO)
    if viscous_time.shape[1] > 0:
        b = step.strain[r, i]
        o = step.strain_older[r, i]
        flow = difference(
            step.coefficient[r], step.span[r], now, wp.vec3d(b[0], b[1], b[2]),
            wp.vec3d(o[0], o[1], o[2]),
        )  # fmt: skip
        eta = viscous_time[r, i]
        now += wp.vec3d(eta[0] * flow[0], eta[1] * flow[1], eta[2] * flow[2])
    stiffness = rod.bending[r, i]
    natural = rod.natural_curvature[r, i]
    excess = wp.vec2d(now[0] / length - natural[0], now[1] / length - natural[1])
    law = rod.softening[r, i]
    response = softening_law(excess, stiffness, law)
    by_excess = bent * response.tangent
    # The moment by the stiffnesses: as a linear rod's, and as the curvature counts for softening.
    mean = HALF * (stiffness[0] + stiffness[1])
    q = wp.dot(wp.cw_mul(stiffness, excess), excess) / mean
    one = ONE + law[0] * q
    secant = law[1] + (ONE - law[1]) / one
    softened = wp.dot(wp.cw_mul(bent, stiffness), excess)
    softened *= -(ONE - law[1]) * law[0] / (one * one * mean)
    wanted = model.bending[r, i]
    curvature = model.natural_curvature[r, i]
    for k in range(2):
        wanted[k] = (
            wanted[k]
            - secant * bent[k] * excess[k]
            - softened * (excess[k] * excess[k] - HALF * q)
            - HALF * invariant / length
        )
        curvature[k] = curvature[k] + by_excess[k]
    model.bending[r, i] = wanted
    model.natural_curvature[r, i] = curvature
    c = rod.twisting[r, i]
    # Moments are of strains over the length of the node's cell.
    by_length = wp.dot(by_excess, wp.vec2d(now[0], now[1])) + twisted * c * now[2]
    by_length = (by_length + mean * invariant) / (length * length)
    wp.atomic_add(model.rest_length, r, i - 1, HALF * by_length)
    wp.atomic_add(model.rest_length, r, i, HALF * by_length)
    over = now[2] / length - rod.natural_twist[r, i]
    model.twisting[r, i] = model.twisting[r, i] - twisted * over
    model.natural_twist[r, i] = model.natural_twist[r, i] + twisted * c
    if viscous_time.shape[1] > 0:
        eta = viscous_time[r, i] / length
        times = model.viscous_time[r, i]
        for k in range(2):
            times[k] = times[k] - by_excess[k] * flow[k] / length
        times[2] = times[2] - twisted * c * flow[2] / length
        model.viscous_time[r, i] = times
        for k in range(2):
            remember(step, before, older, r, i, k, -by_excess[k] * eta[k])
        remember(step, before, older, r, i, 2, -twisted * c * eta[2])


@wp.kernel
def want_masses(
    # Model:
    air_of_mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    stillest: wp.array(dtype=wp.int32),
    mass: wp.array2d(dtype=wp.float64),
    node_mass: wp.array2d(dtype=wp.float64),
    load_factor: wp.array(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d),
    rest_length: wp.array2d(dtype=wp.float64),
    spin_share: wp.array2d(dtype=wp.float64),
    piece: wp.array(dtype=wp.int32),
    # State in:
    step: OneStep,
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    spins: wp.array2d(dtype=wp.float64),
    model: WantedModel,
):
    """Of gravity, of air damping, of which spinning edges know that of node `stillest` (rod,), and
    of the nodes' masses, but for their part of the edges' inertia: that is collected in `spins`
    (rod, piece). `spin_share` (rod, edge) is an edge's inertia per mass of its piece of the row.
    And of lengths and radii by that inertia, at a given density. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    w = solved(x, r, i)
    load = load_factor[r]
    wp.atomic_add(model.gravity, r, load * node_mass[r, i] * w)
    c = step.coefficient[r]
    dt = step.span[r]
    v = velocity_of(step, r, i)
    a = difference(c, dt, v, node(step.velocity, r, i), node(step.velocity_older, r, i))
    weight = wp.dot(w, a + air_of_mass[r, i] * v - load * gravity[r])
    model.node_mass[r, i] = model.node_mass[r, i] - weight
    wp.atomic_sub(model.air, r, i, node_mass[r, i] * wp.dot(w, v))
    if i < spin_share.shape[1]:
        k = 4 * i + 3
        spin = difference(c, dt, step.dof[r, k], step.dof_before[r, k], step.dof_older[r, k])
        faster = difference(c, dt, spin, step.velocity[r, k], step.velocity_older[r, k])
        inertia = x[r, 0, k][0] * (faster + air_damping[r] * spin)
        wp.atomic_sub(model.air, r, stillest[r], mass[r, k] * x[r, 0, k][0] * spin)
        wp.atomic_sub(spins, r, piece[i], spin_share[r, i] * inertia)
        # It goes with the length, and with the square of the radius.
        wp.atomic_sub(model.rest_length, r, i, mass[r, k] * inertia / rest_length[r, i])
        model.radius[r, i] = model.radius[r, i] - TWO * mass[r, k] * inertia


@wp.kernel
def share_spins(
    # Model:
    density: wp.array2d(dtype=wp.float64),
    # In:
    piece: wp.array(dtype=wp.int32),
    spins: wp.array2d(dtype=wp.float64),
    # In and out:
    model: WantedModel,
):
    """What is wanted of the masses of the row's pieces, over their lengths: of nodes, and of those
    edges (`density` is mass over length, 0 where there is no rod). Launched over (rod, node)."""
    r, i = wp.tid()
    wanted = spins[r, piece[i]]
    model.node_mass[r, i] = model.node_mass[r, i] + wanted
    if i < density.shape[1]:
        model.rest_length[r, i] = model.rest_length[r, i] - density[r, i] * wanted


@wp.kernel
def want_strained(
    # State in:
    active: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    now: Wanted,
):
    """What is wanted of the strains of a configuration, wanted of itself. Launched over
    (rod, node)."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    wanted = now.strain[r, i]
    now.strain[r, i] = wp.vec4d()
    last = now.strain.shape[1] - 1
    if i < last:
        t = wp.normalize(edge(dof, r, i))
        add_edge_vector(now.dof, r, i, wanted[3] * t)
    if i == 0 or i == last:
        return
    s = stencil(dof, director, r, i)
    add_component_rate(now.dof, r, i, s, component(s, 0), wanted[0])
    add_component_rate(now.dof, r, i, s, component(s, 1), wanted[1])
    turn = (wanted[2] / (ONE + wp.dot(s.t, s.u))) * wp.cross(s.t, s.u)
    add_edge_gradient(now.dof, r, i, turn / s.length_e, turn / s.length_f)
    add_component(now.dof, r, 4 * i - 1, -wanted[2])
    add_component(now.dof, r, 4 * i + 3, wanted[2])
