"""Tangents of a rod's motion by model parameters.

A parameter's tangent (rod, column, dof) solves the linearised step with the step's own matrix. Its
angles are those of the material frame against frames parallel-transported from the nominal motion.
A thread works on `per_thread` columns one after the other: what they share is computed once.
Arrays of the model with a leading axis of one are shared by all rods; rates of the elastic model
are of each column, or of each rod's.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH, add_edge_gradient
from wrod.kernels.elastic.curvature import component, invariant_gradient, stencil
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge, node
from wrod.kernels.linear.banded import banded_entry
from wrod.kernels.stepping.dynamics import difference, drag_force, drag_matrix
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.viscosity import strain, times_of


@wp.func
def column_node(x: wp.array3d(dtype=wp.float64), r: int, j: int, i: int) -> wp.vec3d:
    return wp.vec3d(x[r, j, 4 * i], x[r, j, 4 * i + 1], x[r, j, 4 * i + 2])


@wp.func
def law_denominator(b: wp.vec3d, excess: wp.vec3d, c: wp.float64) -> wp.float64:
    """1 + c sum_k B_k e_k^2 / B over the two bendings, B their mean stiffness."""
    squares = b[0] * excess[0] * excess[0] + b[1] * excess[1] * excess[1]
    return ONE + TWO * c * squares / (b[0] + b[1])


@wp.func
def law_denominator_rate(
    b: wp.vec3d,
    b_rate: wp.vec3d,
    excess: wp.vec3d,
    excess_rate: wp.vec3d,
    c: wp.float64,
    c_rate: wp.float64,
) -> wp.float64:
    total = b[0] + b[1]
    squares = b[0] * excess[0] * excess[0] + b[1] * excess[1] * excess[1]
    change = b_rate[0] * excess[0] * excess[0] + b_rate[1] * excess[1] * excess[1]
    change += TWO * (b[0] * excess[0] * excess_rate[0] + b[1] * excess[1] * excess_rate[1])
    change -= squares * (b_rate[0] + b_rate[1]) / total
    return TWO * (c_rate * squares + c * change) / total


@wp.kernel
def inertial_tangents(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    spin_inertia: wp.float64,
    linear_drag: wp.array2d(dtype=wp.float64),
    quadratic_drag: wp.array2d(dtype=wp.float64),
    gravity: wp.array2d(dtype=wp.vec3d),
    mass_rate: wp.array2d(dtype=wp.float64),
    linear_drag_rate: wp.array2d(dtype=wp.float64),
    quadratic_drag_rate: wp.array2d(dtype=wp.float64),
    gravity_rate: wp.array2d(dtype=wp.vec3d),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    before: wp.array2d(dtype=wp.float64),
    older: wp.array2d(dtype=wp.float64),
    velocity_before: wp.array2d(dtype=wp.float64),
    velocity_older: wp.array2d(dtype=wp.float64),
    tangent_before: wp.array3d(dtype=wp.float64),
    tangent_older: wp.array3d(dtype=wp.float64),
    velocity_tangent_before: wp.array3d(dtype=wp.float64),
    velocity_tangent_older: wp.array3d(dtype=wp.float64),
    per_thread: int,
    # Out:
    right_hand_side_out: wp.array3d(dtype=wp.float64),
):
    """Minus the rate of inertia, weight and drag at a fixed configuration at the step's end."""
    r, i, group = wp.tid()
    if pace.accepted[r] == 0:
        return
    c = pace.coefficient[r]
    dt = pace.step[r]
    m = wp.min(r, mass.shape[0] - 1)
    zero = wp.vec3d(ZERO, ZERO, ZERO)
    v = difference(c, dt, node(dof, r, i), node(before, r, i), node(older, r, i))
    a = difference(c, dt, v, node(velocity_before, r, i), node(velocity_older, r, i))
    g = gravity[m, i]
    damping = drag_matrix(v, linear_drag[m, i], quadratic_drag[m, i])
    last_column = wp.min(right_hand_side_out.shape[1], (group + 1) * per_thread)
    for j in range(group * per_thread, last_column):
        was = column_node(tangent_before, r, j, i)
        dv = difference(c, dt, zero, was, column_node(tangent_older, r, j, i))
        was = column_node(velocity_tangent_before, r, j, i)
        da = difference(c, dt, dv, was, column_node(velocity_tangent_older, r, j, i))
        force = mass[m, i] * (da - gravity_rate[j, i]) + mass_rate[j, i] * (a - g)
        force += damping * dv
        force += drag_force(v, linear_drag_rate[j, i], quadratic_drag_rate[j, i])
        for n in range(3):
            right_hand_side_out[r, j, 4 * i + n] = -force[n]
        if i < mass.shape[1] - 1:
            k = 4 * i + 3
            spin = difference(c, dt, ZERO, tangent_before[r, j, k], tangent_older[r, j, k])
            spun = velocity_tangent_before[r, j, k]
            faster = difference(c, dt, spin, spun, velocity_tangent_older[r, j, k])
            right_hand_side_out[r, j, k] = -spin_inertia * faster


@wp.kernel
def elastic_tangents(
    # Model:
    rest_length: wp.array2d(dtype=wp.float64),
    stretching: wp.array2d(dtype=wp.float64),
    stiffness: wp.array2d(dtype=wp.vec3d),
    rest_strain: wp.array2d(dtype=wp.vec3d),
    viscous_time: wp.array2d(dtype=wp.vec4d),
    softening: wp.array2d(dtype=wp.vec2d),
    rest_length_rate: wp.array2d(dtype=wp.float64),
    stretching_rate: wp.array2d(dtype=wp.float64),
    stiffness_rate: wp.array2d(dtype=wp.vec3d),
    rest_strain_rate: wp.array2d(dtype=wp.vec3d),
    viscous_time_rate: wp.array2d(dtype=wp.vec4d),
    softening_rate: wp.array2d(dtype=wp.vec2d),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    strain_before: wp.array2d(dtype=wp.vec4d),
    strain_older: wp.array2d(dtype=wp.vec4d),
    strain_tangent_before: wp.array3d(dtype=wp.vec4d),
    strain_tangent_older: wp.array3d(dtype=wp.vec4d),
    per_thread: int,
    # In and out: (rod x column, dof)
    right_hand_side: wp.array2d(dtype=wp.float64),
):
    """Minus the rate of the elastic and viscous forces at a fixed configuration. The time of the
    first bending damps stretching, too; the last is that in which viscous moments relax."""
    r, i, group = wp.tid()
    if pace.accepted[r] == 0:
        return
    c = pace.coefficient[r] / pace.step[r]
    columns = right_hand_side.shape[0] // pace.accepted.shape[0]
    shared = stiffness_rate.shape[0] == columns
    first_column = group * per_thread
    last_column = wp.min(columns, first_column + per_thread)
    before = strain_before[r, i]
    older = strain_older[r, i]
    # The edge after node i stretches.
    e = edge(dof, r, i)
    length_e = wp.length(e)
    rest_e = rest_length[r, i]
    stretch = length_e / rest_e - ONE
    m = wp.min(r, stiffness.shape[0] - 1)
    damped = viscous_time[m, i][0]
    stretching_flow = (c[0] * length_e + c[1] * before[3] + c[2] * older[3]) / rest_e
    for j in range(first_column, last_column):
        row = r * columns + j
        q = wp.where(shared, j, row)
        past = c[1] * strain_tangent_before[r, j, i] + c[2] * strain_tangent_older[r, j, i]
        faster = (past[3] - stretching_flow * rest_length_rate[q, i]) / rest_e
        pull = stretching_rate[q, i] * (stretch + damped * stretching_flow)
        pull -= stretching[m, i] * length_e / (rest_e * rest_e) * rest_length_rate[q, i]
        pull += stretching[m, i] * (viscous_time_rate[q, i][0] * stretching_flow + damped * faster)
        for d in range(3):
            wp.atomic_add(right_hand_side, row, 4 * i + d, pull * e[d] / length_e)
            wp.atomic_add(right_hand_side, row, 4 * i + 4 + d, -pull * e[d] / length_e)
    if i == 0:
        return
    length = HALF * (rest_length[r, i - 1] + rest_length[r, i])
    now = strain(dof, director, reference_twist, r, i)
    remembered = c[1] * before + c[2] * older
    flow = c[0] * now + wp.vec3d(remembered[0], remembered[1], remembered[2])
    s = stencil(dof, director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
    b = stiffness[m, i]
    mean = HALF * (b[0] + b[1]) / length
    k_e, k_f, k_te, k_tf = invariant_gradient(s, first, second)
    eta, relaxed = times_of(viscous_time[m, i], c[0])
    total = (now + wp.cw_mul(eta, flow)) / length
    excess = total - rest_strain[m, i]
    law = softening[m, i]
    one = law_denominator(b, excess, law[0])
    secant = law[1] + (ONE - law[1]) / one
    for j in range(first_column, last_column):
        row = r * columns + j
        q = wp.where(shared, j, row)
        length_rate = HALF * (rest_length_rate[q, i - 1] + rest_length_rate[q, i])
        past = c[1] * strain_tangent_before[r, j, i] + c[2] * strain_tangent_older[r, j, i]
        flow_rate = wp.vec3d(past[0], past[1], past[2])
        b_rate = stiffness_rate[q, i]
        t = viscous_time_rate[q, i]
        eta_rate = wp.vec3d(t[0], t[1], t[2]) - (t[3] * c[0]) * eta
        change = relaxed * wp.cw_mul(eta_rate, flow) + wp.cw_mul(eta, flow_rate)
        change = change / length - total * (length_rate / length) - rest_strain_rate[q, i]
        moment = wp.cw_mul(b_rate, excess) + wp.cw_mul(b, change)
        law_rate = softening_rate[q, i]
        if law[0] != ZERO or law_rate[0] != ZERO:
            one_rate = law_denominator_rate(b, b_rate, excess, change, law[0], law_rate[0])
            secant_rate = law_rate[1] * (ONE - ONE / one) - (ONE - law[1]) * one_rate / (one * one)
            for k in range(2):
                moment[k] = secant * moment[k] + secant_rate * b[k] * excess[k]
        invariant = (HALF * (b_rate[0] + b_rate[1]) - mean * length_rate) / length
        g_e = moment[0] * first.e + moment[1] * second.e + moment[2] * binormal + invariant * k_e
        g_f = moment[0] * first.f + moment[1] * second.f + moment[2] * binormal + invariant * k_f
        add_edge_gradient(right_hand_side, row, i, -g_e / s.length_e, -g_f / s.length_f)
        g_te = moment[0] * first.te + moment[1] * second.te - moment[2] + invariant * k_te
        g_tf = moment[0] * first.tf + moment[1] * second.tf + moment[2] + invariant * k_tf
        wp.atomic_add(right_hand_side, row, 4 * i - 1, -g_te)
        wp.atomic_add(right_hand_side, row, 4 * i + 3, -g_tf)


@wp.kernel
def held_tangents(
    # In: columns with any rates, of the held nodes (rod, frame, column, 4), and of the rolls
    # (column, 2)
    moves: wp.array(dtype=wp.int32),
    held_rate: wp.array4d(dtype=wp.vec3d),
    roll_rate: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    grip_tangent: wp.array3d(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    pace: Pace,
    first_frame: int,
    frame_rate: wp.float64,
    # Out:
    step_out: wp.array3d(dtype=wp.float64),
):
    r, j, k = wp.tid()
    if pace.accepted[r] == 0 or moves[j] == 0:
        return
    f = first_frame + int(wp.round(pace.time[r] * frame_rate))
    n = (dof.shape[1] + 1) / 4
    first = wp.where(k == 0, 0, n - 2)
    near = held_rate[r, f, j, 2 * k]
    far = held_rate[r, f, j, 2 * k + 1]
    for c in range(3):
        step_out[r, j, 4 * first + c] = near[c]
        step_out[r, j, 4 * first + 4 + c] = far[c]
    t = tangent[r, first]
    g = grip_tangent[r, f, k]
    turned = (far - near) / wp.length(edge(dof, r, first))
    # Carrying the director from the grip to a tangent that turns leaves it half this spin.
    spin = wp.dot(wp.cross(g, t), turned) / (ONE + wp.dot(g, t))
    step_out[r, j, 4 * first + 3] = roll_rate[j, k] - spin


@wp.kernel
def subtract_held(
    accepted: wp.array(dtype=wp.int32),
    moves: wp.array(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    held: wp.array3d(dtype=wp.float64),
    rows: int,
    per_thread: int,
    # In and out:
    x: wp.array3d(dtype=wp.float64),
):
    """Take the matrix times what is held, nodes and angle of the edge at each end, from x."""
    r, k, group = wp.tid()
    if accepted[r] == 0:
        return
    n = held.shape[2]
    first = int(0)
    a = int(k)
    if k >= rows:
        first = n - 7
        a = n - 1 - (k - rows)
    start = wp.max(first, a - HALF_BANDWIDTH)
    end = wp.min(first + 7, a + HALF_BANDWIDTH + 1)
    for j in range(group * per_thread, wp.min(held.shape[1], (group + 1) * per_thread)):
        if moves[j] == 0:
            continue
        value = ZERO
        for b in range(start, end):
            value += banded_entry(hessian, r, a, b) * held[r, j, b]
        wp.atomic_sub(x, r, j, a, value)


@wp.kernel
def finish_tangents(
    pace: Pace,
    solution: wp.array3d(dtype=wp.float64),
    held: wp.array3d(dtype=wp.float64),
    per_thread: int,
    # In and out:
    tangent: wp.array3d(dtype=wp.float64),
    older: wp.array3d(dtype=wp.float64),
    velocity: wp.array3d(dtype=wp.float64),
    velocity_older: wp.array3d(dtype=wp.float64),
):
    """Shift the tangents' history by a step; a thread works on `per_thread` numbers of a column."""
    r, j, part = wp.tid()
    if pace.accepted[r] == 0:
        return
    c = pace.coefficient[r]
    for a in range(part * per_thread, wp.min(held.shape[2], (part + 1) * per_thread)):
        now = solution[r, j, a] + held[r, j, a]
        v = c[0] * now + c[1] * tangent[r, j, a] + c[2] * older[r, j, a]
        velocity_older[r, j, a] = velocity[r, j, a]
        velocity[r, j, a] = v / pace.step[r]
        older[r, j, a] = tangent[r, j, a]
        tangent[r, j, a] = now
