"""Implicit steps of rods with viscous strains and drag.

The strains of a node are s = (kappa_1, kappa_2, tau), integrated over its Voronoi length l. A
Kelvin-Voigt material has the moments B ((s + eta ds/dt) / l - s0); with ds/dt = (c_0 s + c_1 s_n +
c_2 s_(n-1)) / dt that is an elastic rod of stiffness B (1 + eta c_0 / dt) with another shape at
rest, so its forces are those of a potential and do not oppose rigid rotations (Bergou et al. 2010).
A rod that softens has the moment-curvature law of `wrod.kernels.elastic.softened_bending` in
(s + eta ds/dt) / l - s0: with one eta for both bendings the elastic rod has the same law, its
c times (1 + eta c_0 / dt)^2.

Arrays of the model with a leading axis of one are shared by all rods.
"""

import warp as wp
from wrod.kernels.elastic.curvature import stencil
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, node, parallel_transport, signed_angle
from wrod.kernels.stepping.viscosity import strain

wp.set_module_options({"enable_backward": False})


@wp.kernel
def measure_strains(
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    strain_out: wp.array2d(dtype=wp.vec3d),
):
    r, j = wp.tid()
    strain_out[r, j + 1] = strain(dof, director, reference_twist, r, j + 1)


@wp.kernel
def set_viscous_rest(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.vec3d),
    rest_strain: wp.array2d(dtype=wp.vec3d),
    viscous_time: wp.array2d(dtype=wp.vec3d),
    softening: wp.array2d(dtype=wp.vec2d),
    # State in:
    coefficient: wp.vec3d,
    dt: wp.float64,
    strain_before: wp.array2d(dtype=wp.vec3d),
    strain_older: wp.array2d(dtype=wp.vec3d),
    # Out:
    bending_out: wp.array2d(dtype=wp.vec2d),
    natural_curvature_out: wp.array2d(dtype=wp.vec2d),
    softening_out: wp.array2d(dtype=wp.vec2d),
    twisting_out: wp.array2d(dtype=wp.float64),
    natural_twist_out: wp.array2d(dtype=wp.float64),
):
    """Stiffness and shape at rest of the elastic rod that stands for the viscous one this step."""
    r, j = wp.tid()
    i = j + 1
    m = wp.min(r, stiffness.shape[0] - 1)
    b = stiffness[m, i]
    rest = rest_strain[m, i]
    eta = viscous_time[m, i]
    length = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    history = (coefficient[1] * strain_before[r, i] + coefficient[2] * strain_older[r, i]) / (
        dt * length
    )
    bending_factor = ONE + eta[0] * coefficient[0] / dt
    law = softening[m, i]
    softening_out[r, i] = wp.vec2d(law[0] * bending_factor * bending_factor, law[1])
    for k in range(3):
        factor = ONE + eta[k] * coefficient[0] / dt
        b[k] = b[k] * factor
        rest[k] = (rest[k] - eta[k] * history[k]) / factor
    bending_out[r, i] = wp.vec2d(b[0], b[1])
    natural_curvature_out[r, i] = wp.vec2d(rest[0], rest[1])
    twisting_out[r, i] = b[2]
    natural_twist_out[r, i] = rest[2]


@wp.func
def rate(
    coefficient: wp.vec3d, dt: wp.float64, now: wp.vec3d, before: wp.vec3d, older: wp.vec3d
) -> wp.vec3d:
    return (coefficient[0] * now + coefficient[1] * before + coefficient[2] * older) / dt


@wp.func
def drag_force(v: wp.vec3d, linear: wp.float64, quadratic: wp.float64) -> wp.vec3d:
    return (linear + quadratic * wp.length(v)) * v


@wp.func
def drag_matrix(v: wp.vec3d, linear: wp.float64, quadratic: wp.float64) -> wp.mat33d:
    speed = wp.length(v)
    d = (linear + quadratic * speed) * wp.identity(3, dtype=wp.float64)
    if speed > ZERO:
        d += (quadratic / speed) * wp.outer(v, v)
    return d


@wp.kernel
def add_motion(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    linear_drag: wp.array2d(dtype=wp.float64),
    quadratic_drag: wp.array2d(dtype=wp.float64),
    gravity: wp.array2d(dtype=wp.vec3d),
    spin_inertia: wp.float64,
    # State in:
    coefficient: wp.vec3d,
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    before: wp.array2d(dtype=wp.float64),
    older: wp.array2d(dtype=wp.float64),
    velocity_before: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    # State in and out:
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Add inertia, weight and drag to the elastic gradient and Hessian of a step."""
    r, i = wp.tid()
    m = wp.min(r, mass.shape[0] - 1)
    v = rate(coefficient, dt, node(dof, r, i), node(before, r, i), node(older, r, i))
    a = rate(coefficient, dt, v, node(velocity_before, r, i), node(velocity_older, r, i))
    g = gravity[m, i]
    force = mass[m, i] * (a - g) + drag_force(v, linear_drag[m, i], quadratic_drag[m, i])
    per_step = coefficient[0] / dt
    d = drag_matrix(v, linear_drag[m, i], quadratic_drag[m, i])
    for c in range(3):
        gradient[r, 4 * i + c] = gradient[r, 4 * i + c] + force[c]
        for e in range(c + 1):
            value = per_step * d[c, e]
            if e == c:
                value += per_step * per_step * mass[m, i]
            hessian[r, 4 * i + c, c - e] = hessian[r, 4 * i + c, c - e] + value
    if i < mass.shape[1] - 1:
        k = 4 * i + 3
        spin = (coefficient[0] * dof[r, k] + coefficient[1] * before[r, k]) / dt
        spin += coefficient[2] * older[r, k] / dt
        turn = coefficient[0] * spin + coefficient[1] * velocity_before[r, k]
        turn += coefficient[2] * velocity_older[r, k]
        gradient[r, k] = gradient[r, k] + spin_inertia * turn / dt
        hessian[r, k, 0] = hessian[r, k, 0] + spin_inertia * per_step * per_step


@wp.kernel
def move_held(
    # In: held nodes (rod, frame, 4) and frame of each grip (rod, frame, 2): tangent and director
    held: wp.array3d(dtype=wp.vec3d),
    time: int,
    # In and out:
    dof: wp.array2d(dtype=wp.float64),
):
    """Put the two nodes at each end where they are at a time."""
    r, k = wp.tid()
    n = (dof.shape[1] + 1) / 4
    i = wp.where(k < 2, k, n - 4 + k)
    for c in range(3):
        dof[r, 4 * i + c] = held[r, time, k][c]


@wp.kernel
def roll_held(
    # In:
    director: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array2d(dtype=wp.vec3d),
    grip_tangent: wp.array3d(dtype=wp.vec3d),
    grip_director: wp.array3d(dtype=wp.vec3d),
    free: wp.array2d(dtype=wp.int32),
    time: int,
    # In and out:
    dof: wp.array2d(dtype=wp.float64),
):
    """Turn the held edges to their grips: the grip's director, carried to the edge's tangent."""
    r, k = wp.tid()
    edges = tangent.shape[1]
    i = wp.where(k == 0, 0, edges - 1)
    if free[r, 4 * i + 3] != 0:
        return
    t = tangent[r, i]
    d = parallel_transport(grip_director[r, time, k], grip_tangent[r, time, k], t)
    angle = signed_angle(director[r, i], d, t)
    turn = TWO * wp.float64(3.14159265358979323846)
    dof[r, 4 * i + 3] = angle + turn * wp.round((dof[r, 4 * i + 3] - angle) / turn)


@wp.kernel
def hold_angles(
    anchor: wp.array2d(dtype=wp.float64),
    stiffness: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Springs that hold the angles where they were."""
    r, i = wp.tid()
    k = 4 * i + 3
    gradient[r, k] = gradient[r, k] + stiffness * (dof[r, k] - anchor[r, k])
    hessian[r, k, 0] = hessian[r, k, 0] + stiffness


@wp.kernel
def finish_motion(
    coefficient: wp.vec3d,
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    # In and out:
    before: wp.array2d(dtype=wp.float64),
    older: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
):
    """Shift the history by a step."""
    r, a = wp.tid()
    v = coefficient[0] * dof[r, a] + coefficient[1] * before[r, a] + coefficient[2] * older[r, a]
    velocity_older[r, a] = velocity[r, a]
    velocity[r, a] = v / dt
    older[r, a] = before[r, a]
    before[r, a] = dof[r, a]


@wp.kernel
def extrapolate(
    step: wp.float64,
    velocity: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    growth: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
):
    """Newton starts where the last change of velocity leads."""
    r, a = wp.tid()
    change = velocity[r, a] - velocity_older[r, a]
    dof[r, a] = dof[r, a] + step * (velocity[r, a] + growth * change)


@wp.kernel
def observe(
    # In: node (marker) and offset (column 0: the model's) of every marker
    place: wp.array(dtype=wp.int32),
    offset: wp.array2d(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    frame: int,
    # Out: (rod, frame, marker)
    position_out: wp.array3d(dtype=wp.vec3d),
):
    """Markers beside the centreline: offsets in the mean frame of the edges around their nodes."""
    r, k = wp.tid()
    i = place[k]
    s = stencil(dof, director, r, i)
    o = offset[wp.min(r, offset.shape[0] - 1), k]
    shift = o[0] * (s.m1e + s.m1f) + o[1] * (s.m2e + s.m2f) + o[2] * (s.t + s.u)
    position_out[r, frame, k] = node(dof, r, i) + HALF * shift
