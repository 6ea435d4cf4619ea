"""Implicit steps of rods with viscous strains and drag, and their tangents by model parameters.

The strains of a node are s = (kappa_1, kappa_2, tau), integrated over its Voronoi length l. A
Kelvin-Voigt material has the moments B ((s + eta ds/dt) / l - s0); with ds/dt = (c_0 s + c_1 s_n +
c_2 s_(n-1)) / dt that is an elastic rod of stiffness B (1 + eta c_0 / dt) with another shape at
rest, so its forces are those of a potential and do not oppose rigid rotations (Bergou et al. 2010).

A parameter's tangent (rod, column, dof) solves the linearised step with the step's own matrix. Its
angles are those of the material frame against frames parallel-transported from the nominal motion.
Arrays of the model with a leading axis of one are shared by all rods.
"""

import warp as wp
from wrod.kernels.assembly import add_edge_gradient
from wrod.kernels.curvature import component, stencil
from wrod.kernels.frames import HALF, ONE, TWO, ZERO, edge, node, parallel_transport, signed_angle

wp.set_module_options({"enable_backward": False})


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
def measure_strain_tangents(
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array3d(dtype=wp.float64),
    strain_out: wp.array3d(dtype=wp.vec3d),
):
    """Rates of the strains along every column of `tangent`."""
    r, i_, j = wp.tid()
    i = i_ + 1
    s = stencil(dof, director, r, i)
    de = wp.vec3d(ZERO, ZERO, ZERO)
    df = wp.vec3d(ZERO, ZERO, ZERO)
    for c in range(3):
        de[c] = tangent[r, j, 4 * i + c] - tangent[r, j, 4 * i - 4 + c]
        df[c] = tangent[r, j, 4 * i + 4 + c] - tangent[r, j, 4 * i + c]
    te = tangent[r, j, 4 * i - 1]
    tf = tangent[r, j, 4 * i + 3]
    first = component(s, 0)
    second = component(s, 1)
    de = de / s.length_e
    df = df / s.length_f
    kappa_1 = wp.dot(first.e, de) + wp.dot(first.f, df) + first.te * te + first.tf * tf
    kappa_2 = wp.dot(second.e, de) + wp.dot(second.f, df) + second.te * te + second.tf * tf
    binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
    strain_out[r, j, i] = wp.vec3d(kappa_1, kappa_2, tf - te + wp.dot(binormal, de + df))


@wp.kernel
def set_viscous_rest(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.vec3d),
    rest_strain: wp.array2d(dtype=wp.vec3d),
    viscous_time: wp.array2d(dtype=wp.vec3d),
    # State in:
    coefficient: wp.vec3d,
    dt: wp.float64,
    strain_before: wp.array2d(dtype=wp.vec3d),
    strain_older: wp.array2d(dtype=wp.vec3d),
    # Out:
    bending_out: wp.array2d(dtype=wp.vec2d),
    natural_curvature_out: wp.array2d(dtype=wp.vec2d),
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


@wp.func
def column_node(x: wp.array3d(dtype=wp.float64), r: int, j: int, i: int) -> wp.vec3d:
    return wp.vec3d(x[r, j, 4 * i], x[r, j, 4 * i + 1], x[r, j, 4 * i + 2])


@wp.kernel
def inertial_tangents(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    linear_drag: wp.array2d(dtype=wp.float64),
    quadratic_drag: wp.array2d(dtype=wp.float64),
    gravity: wp.array2d(dtype=wp.vec3d),
    mass_rate: wp.array2d(dtype=wp.float64),
    linear_drag_rate: wp.array2d(dtype=wp.float64),
    quadratic_drag_rate: wp.array2d(dtype=wp.float64),
    gravity_rate: wp.array2d(dtype=wp.vec3d),
    spin_inertia: wp.float64,
    # State in:
    coefficient: wp.vec3d,
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    before: wp.array2d(dtype=wp.float64),
    older: wp.array2d(dtype=wp.float64),
    velocity_before: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    tangent_before: wp.array3d(dtype=wp.float64),
    tangent_older: wp.array3d(dtype=wp.float64),
    velocity_tangent_before: wp.array3d(dtype=wp.float64),
    velocity_tangent_older: wp.array3d(dtype=wp.float64),
    # Out:
    right_hand_side_out: wp.array3d(dtype=wp.float64),
):
    """Minus the rate of inertia, weight and drag at a fixed configuration at the step's end."""
    r, i, j = wp.tid()
    m = wp.min(r, mass.shape[0] - 1)
    zero = wp.vec3d(ZERO, ZERO, ZERO)
    v = rate(coefficient, dt, node(dof, r, i), node(before, r, i), node(older, r, i))
    a = rate(coefficient, dt, v, node(velocity_before, r, i), node(velocity_older, r, i))
    g = gravity[m, i]
    dv = rate(
        coefficient,
        dt,
        zero,
        column_node(tangent_before, r, j, i),
        column_node(tangent_older, r, j, i),
    )
    da = rate(
        coefficient,
        dt,
        dv,
        column_node(velocity_tangent_before, r, j, i),
        column_node(velocity_tangent_older, r, j, i),
    )
    force = mass[m, i] * (da - gravity_rate[j, i]) + mass_rate[j, i] * (a - g)
    force += drag_matrix(v, linear_drag[m, i], quadratic_drag[m, i]) * dv
    force += drag_force(v, linear_drag_rate[j, i], quadratic_drag_rate[j, i])
    for c in range(3):
        right_hand_side_out[r, j, 4 * i + c] = -force[c]
    if i < mass.shape[1] - 1:
        k = 4 * i + 3
        spin = (
            coefficient[1] * tangent_before[r, j, k] + coefficient[2] * tangent_older[r, j, k]
        ) / dt
        turn = coefficient[0] * spin + coefficient[1] * velocity_tangent_before[r, j, k]
        turn += coefficient[2] * velocity_tangent_older[r, j, k]
        right_hand_side_out[r, j, k] = -spin_inertia * turn / dt


@wp.kernel
def elastic_tangents(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stretching: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.vec3d),
    rest_strain: wp.array2d(dtype=wp.vec3d),
    viscous_time: wp.array2d(dtype=wp.vec3d),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    stretching_rate: wp.array2d(dtype=wp.float64),
    stiffness_rate: wp.array2d(dtype=wp.vec3d),
    rest_strain_rate: wp.array2d(dtype=wp.vec3d),
    viscous_time_rate: wp.array2d(dtype=wp.vec3d),
    # State in:
    coefficient: wp.vec3d,
    dt: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    strain_before: wp.array2d(dtype=wp.vec3d),
    strain_older: wp.array2d(dtype=wp.vec3d),
    strain_tangent_before: wp.array3d(dtype=wp.vec3d),
    strain_tangent_older: wp.array3d(dtype=wp.vec3d),
    # In and out: (rod x column, dof)
    right_hand_side: wp.array2d(dtype=wp.float64),
):
    """Minus the rate of the elastic and viscous forces at a fixed configuration."""
    r, i, j = wp.tid()
    columns = stiffness_rate.shape[0]
    row = r * columns + j
    # The edge after node i stretches.
    e = edge(dof, r, i)
    length_e = wp.length(e)
    rest_e = rest_length[r, i]
    excess = length_e / rest_e - ONE
    m = wp.min(r, stiffness.shape[0] - 1)
    pull = stretching_rate[j, i] * excess
    pull -= stretching[m, i] * length_e / (rest_e * rest_e) * rest_length_rate[j, i]
    for c in range(3):
        wp.atomic_add(right_hand_side, row, 4 * i + c, pull * e[c] / length_e)
        wp.atomic_add(right_hand_side, row, 4 * i + 4 + c, -pull * e[c] / length_e)
    if i == 0:
        return
    length = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    length_rate = HALF * (rest_length_rate[j, i - 1] + rest_length_rate[j, i])
    now = strain(dof, director, reference_twist, r, i)
    flow = rate(coefficient, dt, now, strain_before[r, i], strain_older[r, i])
    flow_rate = rate(
        coefficient,
        dt,
        wp.vec3d(ZERO, ZERO, ZERO),
        strain_tangent_before[r, j, i],
        strain_tangent_older[r, j, i],
    )
    b = stiffness[m, i]
    b_rate = stiffness_rate[j, i]
    eta = viscous_time[m, i]
    eta_rate = viscous_time_rate[j, i]
    rest = rest_strain[m, i]
    rest_rate = rest_strain_rate[j, i]
    moment = wp.vec3d(ZERO, ZERO, ZERO)
    for k in range(3):
        total = (now[k] + eta[k] * flow[k]) / length
        change = (eta_rate[k] * flow[k] + eta[k] * flow_rate[k]) / length
        change -= total * length_rate / length + rest_rate[k]
        moment[k] = b_rate[k] * (total - rest[k]) + b[k] * change
    s = stencil(dof, director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
    g_e = (moment[0] * first.e + moment[1] * second.e + moment[2] * binormal) / s.length_e
    g_f = (moment[0] * first.f + moment[1] * second.f + moment[2] * binormal) / s.length_f
    add_edge_gradient(right_hand_side, row, i, -g_e, -g_f)
    g_te = moment[0] * first.te + moment[1] * second.te - moment[2]
    g_tf = moment[0] * first.tf + moment[1] * second.tf + moment[2]
    wp.atomic_add(right_hand_side, row, 4 * i - 1, -g_te)
    wp.atomic_add(right_hand_side, row, 4 * i + 3, -g_tf)


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
def held_tangents(
    # In: rates of the held nodes (rod, frame, column, 4) and of the rolls (column, 2)
    held_rate: wp.array4d(dtype=wp.vec3d),
    roll_rate: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    grip_tangent: wp.array3d(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    free: wp.array2d(dtype=wp.int32),
    time: int,
    # Out:
    step_out: wp.array3d(dtype=wp.float64),
):
    r, j, k = wp.tid()
    n = (dof.shape[1] + 1) / 4
    first = wp.where(k == 0, 0, n - 2)
    near = held_rate[r, time, j, 2 * k]
    far = held_rate[r, time, j, 2 * k + 1]
    for c in range(3):
        step_out[r, j, 4 * first + c] = near[c]
        step_out[r, j, 4 * first + 4 + c] = far[c]
    if free[r, 4 * first + 3] == 0:
        t = tangent[r, first]
        g = grip_tangent[r, time, k]
        turned = (far - near) / wp.length(edge(dof, r, first))
        # Carrying the director from the grip to a tangent that turns leaves it half this spin.
        spin = wp.dot(wp.cross(g, t), turned) / (ONE + wp.dot(g, t))
        step_out[r, j, 4 * first + 3] = roll_rate[j, k] - spin


@wp.kernel
def subtract_product(
    free: wp.array2d(dtype=wp.int32),
    product: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=wp.float64),
):
    r, j, a = wp.tid()
    x[r, j, a] = x[r, j, a] - product[r, j, a]


@wp.kernel
def finish_tangents(
    free: wp.array2d(dtype=wp.int32),
    coefficient: wp.vec3d,
    dt: wp.float64,
    solution: wp.array3d(dtype=wp.float64),
    held: wp.array3d(dtype=wp.float64),
    # In and out:
    tangent: wp.array3d(dtype=wp.float64),
    older: wp.array3d(dtype=wp.float64),
    velocity: wp.array3d(dtype=wp.float64),
    velocity_older: wp.array3d(dtype=wp.float64),
):
    """Shift the tangents' history by a step."""
    r, j, a = wp.tid()
    now = solution[r, j, a] + held[r, j, a]
    v = coefficient[0] * now + coefficient[1] * tangent[r, j, a] + coefficient[2] * older[r, j, a]
    velocity_older[r, j, a] = velocity[r, j, a]
    velocity[r, j, a] = v / dt
    older[r, j, a] = tangent[r, j, a]
    tangent[r, j, a] = now


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


@wp.func
def turned_shift(
    o: wp.vec3d, t: wp.vec3d, m1: wp.vec3d, m2: wp.vec3d, dt: wp.vec3d, spin: wp.float64
) -> wp.vec3d:
    """Rate of o_1 m1 + o_2 m2 + o_3 t as t turns by dt and the frame spins."""
    d1 = spin * m2 - wp.dot(dt, m1) * t
    d2 = -spin * m1 - wp.dot(dt, m2) * t
    return o[0] * d1 + o[1] * d2 + o[2] * dt


@wp.kernel
def observe_tangents(
    place: wp.array(dtype=wp.int32),
    offset: wp.array2d(dtype=wp.vec3d),
    offset_rate: wp.array2d(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array3d(dtype=wp.float64),
    frame: int,
    # Out: (rod, frame, marker, column)
    rate_out: wp.array4d(dtype=wp.vec3d),
):
    r, k, j = wp.tid()
    i = place[k]
    s = stencil(dof, director, r, i)
    o = offset[wp.min(r, offset.shape[0] - 1), k]
    d = offset_rate[j, k]
    e = column_node(tangent, r, j, i) - column_node(tangent, r, j, i - 1)
    f = column_node(tangent, r, j, i + 1) - column_node(tangent, r, j, i)
    e = (e - wp.dot(e, s.t) * s.t) / s.length_e
    f = (f - wp.dot(f, s.u) * s.u) / s.length_f
    shift = d[0] * (s.m1e + s.m1f) + d[1] * (s.m2e + s.m2f) + d[2] * (s.t + s.u)
    shift += turned_shift(o, s.t, s.m1e, s.m2e, e, tangent[r, j, 4 * i - 1])
    shift += turned_shift(o, s.u, s.m1f, s.m2f, f, tangent[r, j, 4 * i + 3])
    rate_out[r, frame, k, j] = column_node(tangent, r, j, i) + HALF * shift
