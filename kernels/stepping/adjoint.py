"""The adjoint of an implicit step: what a loss wants of its end, wanted of its starts instead.

A step solves r(y_n, y_(n-1), y_(n-2), v_(n-1), v_(n-2); p) = 0 on what is free. Backwards,

    A_n^T w = dL/dy_n,    dL/dp -= w . dr/dp,    dL/dy_(n-1) -= w . dr/dy_(n-1), ...,

A_n the matrix of the step: one solution, whatever is differentiated by.

Edges are differentiated by the turn phi of their frames about them, from frames that the step's end
carries along. Forces know nothing else; but inertia is of the angles theta = phi - psi to reference
frames, and those turn by psi as they are carried in time along edges that move,

    dpsi_n = dpsi_(n-1) + b . de_n + a . de_(n-1),    b = -(t_(n-1) x t_n) / ((1 + cos) |e_n|),

which makes A_n unsymmetric, by the edges' inertia about themselves. So does that a frame which goes
along two turns of its edge, d and then d', turns by t . (d x d') / (2 |e|^2) against one that goes
along both at once, where inertia leaves a moment about the edge.
"""

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ONE, TWO, ZERO, edge
from wrod.kernels.linear.banded_lu import ALONE, make_assembly, substitute_lanes
from wrod.kernels.linear.skyline_lu import make_filling
from wrod.kernels.stepping.dynamics import difference, drag_matrix, velocity_of
from wrod.kernels.stepping.trace import OneStep, Wanted

SIX = wp.constant(wp.float64(6.0))
# Residuals of the nodes at an edge's head and tail by where they are.
EdgeBlock = wp.types.matrix(shape=(6, 6), dtype=wp.float64)
# Residual of an edge's angle by where its nodes are.
RollBlock = wp.types.vector(length=6, dtype=wp.float64)


@wp.func
def holonomy(before: wp.vec3d, after: wp.vec3d, length: wp.float64) -> wp.vec3d:
    """By how much a frame turns that is carried from one tangent to another, by the last node of
    the second's edge."""
    return (-ONE / ((ONE + wp.dot(before, after)) * length)) * wp.cross(before, after)


@wp.kernel
def measure_turns(
    # State in:
    step: OneStep,
    # Out:
    by_end_out: wp.array2d(dtype=wp.vec3d),
    by_start_out: wp.array2d(dtype=wp.vec3d),
):
    """b and a of each edge."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    t = step.tangent_before[r, i]
    u = step.tangent[r, i]
    by_end_out[r, i] = holonomy(t, u, wp.length(edge(step.dof, r, i)))
    by_start_out[r, i] = -holonomy(u, t, wp.length(edge(step.dof_before, r, i)))


@wp.func
def turned(by: wp.array2d(dtype=wp.vec3d), turn: wp.array2d(dtype=wp.float64), r: int, i: int):
    """What is wanted of node i because of how far frames are wanted to turn."""
    out = wp.vec3d(ZERO, ZERO, ZERO)
    if i > 0:
        out += turn[r, i - 1] * by[r, i - 1]
    if i < by.shape[1]:
        out -= turn[r, i] * by[r, i]
    return out


@wp.kernel
def want_turns(
    # State in:
    step: OneStep,
    # State in and out:
    now: Wanted,
):
    """An edge's spin knows its angle, which is less the more its reference frame has turned."""
    r, i = wp.tid()
    if step.active[r] != 0:
        spin = (step.coefficient[r][0] / step.span[r]) * now.velocity[r, 4 * i + 3]
        now.turn[r, i] = now.turn[r, i] - spin


@wp.kernel
def load_wanted(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    # State in:
    step: OneStep,
    now: Wanted,
    by_end: wp.array2d(dtype=wp.vec3d),
    # Out:
    wanted_out: wp.array2d(dtype=wp.float64),
    x_out: wp.array3d(dtype=ALONE),
):
    """dL/dy_n, velocities told by differences. Launched over (rod, node)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    rate_now = step.coefficient[r][0] / step.span[r]
    from_turns = turned(by_end, now.turn, r, i)
    for k in range(4):
        a = 4 * i + k
        if a < free.shape[1]:
            value = now.dof[r, a] + rate_now * now.velocity[r, a]
            if k < 3:
                value += from_turns[k]
            wanted_out[r, a] = value
            x_out[r, 0, a] = ALONE(wp.where(free[r, a] != 0, value, ZERO))


@wp.struct
class StepMatrix:
    """A_n^T: the Hessian, and what makes it unsymmetric; see `weigh_spins`, and
    `wrod.kernels.contact.plane_adjoint` for `coupling`, `wrod.kernels.contact.edge_adjoint` for
    `block`, `wrod.kernels.contact.rolling_adjoint` for those of rolling, and
    `wrod.kernels.stepping.inelastic_adjoint` for `skew` and `rate`, which may have no columns."""

    hessian: wp.array3d(dtype=wp.float64)
    spin_inertia: wp.array2d(dtype=wp.float64)
    moment: wp.array2d(dtype=wp.vec3d)
    by_end: wp.array2d(dtype=wp.vec3d)
    coupling: wp.array2d(dtype=wp.mat33d)
    block: wp.array2d(dtype=EdgeBlock)
    roll: wp.array2d(dtype=wp.float64)
    roll_with_next: wp.array2d(dtype=wp.float64)
    roll_of_node: wp.array2d(dtype=wp.vec3d)
    roll_of_edge: wp.array2d(dtype=RollBlock)
    skew: wp.array2d(dtype=wp.float64)
    rate: wp.array3d(dtype=wp.vec2d)


@wp.func
def roll_entry(m: StepMatrix, r: int, i: int, e: int, c: int) -> wp.float64:
    """Residual of the angle of edge e by node i, where bristles keep the roll: by the turn of
    reference frames, and by the normal force."""
    value = wp.float64(0.0)
    for n in range(3):
        other = e - 1 + n
        if other >= 0 and other < m.by_end.shape[1] and (i == other or i == other + 1):
            stiffness = m.roll[r, e]
            if n == 0:
                stiffness = m.roll_with_next[r, other]
            elif n == 2:
                stiffness = m.roll_with_next[r, e]
            value += wp.where(i == other, stiffness, -stiffness) * m.by_end[r, other][c]
    if i == e or i == e + 1:
        value += m.roll_of_node[r, i][c]
        if m.roll_of_edge.shape[1] > 0:
            value += m.roll_of_edge[r, e][3 * (i - e) + c]
    return value


@wp.func
def entry(m: StepMatrix, r: int, a: int, b: int) -> wp.float64:
    value = m.hessian[r, wp.max(a, b), wp.abs(a - b)]
    if a % 4 < 3 and b % 4 < 3 and wp.abs(a / 4 - b / 4) < 2:
        around = wp.vec3d(ZERO, ZERO, ZERO)
        i = wp.min(a, b) / 4
        if a / 4 != b / 4:
            around -= m.moment[r, i]
        else:
            if i > 0:
                around += m.moment[r, i - 1]
            if i < m.moment.shape[1]:
                around += m.moment[r, i]
            if m.coupling.shape[1] > 0:
                value += m.coupling[r, i][b % 4, a % 4]
        value += wp.skew(around)[a % 4, b % 4]
        if m.block.shape[1] > 0:
            for e in range(wp.max(wp.max(a, b) / 4 - 1, 0), wp.min(i + 1, m.block.shape[1])):
                value += m.block[r, e][3 * (b / 4 - e) + b % 4, 3 * (a / 4 - e) + a % 4]
    if a % 4 < 3 and b % 4 == 3:
        e = b / 4
        if a / 4 == e:
            value += m.spin_inertia[r, e] * m.by_end[r, e][a % 4]
        elif a / 4 == e + 1:
            value -= m.spin_inertia[r, e] * m.by_end[r, e][a % 4]
        if m.roll.shape[1] > 0:
            value += roll_entry(m, r, a / 4, e, a % 4)
    if m.skew.shape[1] > 0:
        last = wp.min(wp.min(a, b) / 4 + 1, m.skew.shape[1] - 2)
        for i in range(wp.max((wp.max(a, b) - 3) / 4, 1), last + 1):
            first = m.rate[r, i, a - 4 * (i - 1)]
            other = m.rate[r, i, b - 4 * (i - 1)]
            value += m.skew[r, i] * (other[0] * first[1] - other[1] * first[0])
    return value


assemble = make_assembly(StepMatrix, entry)
fill_coupled = make_filling(StepMatrix, entry)


@wp.kernel
def weigh_spins(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    # State in:
    step: OneStep,
    # Out:
    spin_inertia_out: wp.array2d(dtype=wp.float64),
    moment_out: wp.array2d(dtype=wp.vec3d),
):
    """The edges' inertia about themselves on the matrix's diagonal, and their moment of inertia
    over 2 |e|^2, along the edge."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    k = 4 * i + 3
    c = step.coefficient[r]
    dt = step.span[r]
    rate_now = c[0] / dt
    air = air_damping[r]
    spin_inertia_out[r, i] = mass[r, k] * rate_now * (rate_now + air)
    spin = difference(c, dt, step.dof[r, k], step.dof_before[r, k], step.dof_older[r, k])
    faster = difference(c, dt, spin, step.velocity[r, k], step.velocity_older[r, k])
    e = edge(step.dof, r, i)
    moment_out[r, i] = (mass[r, k] * (faster + air * spin) / (TWO * wp.length_sq(e))) * (
        step.tangent[r, i]
    )


@wp.kernel
def solve(
    # In:
    active: wp.array(dtype=wp.int32),
    factor: wp.array3d(dtype=wp.float64),
    # In and out:
    x: wp.array3d(dtype=ALONE),
):
    """All right-hand sides. Launched over (rod, lane) in blocks of a warp."""
    r, _lane = wp.tid()
    if active[r] != 0:
        for j in range(x.shape[1]):
            substitute_lanes(factor, r, j, x)


@wp.func
def solved(x: wp.array3d(dtype=ALONE), r: int, i: int) -> wp.vec3d:
    return wp.vec3d(x[r, 0, 4 * i][0], x[r, 0, 4 * i + 1][0], x[r, 0, 4 * i + 2][0])


@wp.kernel
def want_held(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    # State in:
    active: wp.array(dtype=wp.int32),
    m: StepMatrix,
    wanted: wp.array2d(dtype=wp.float64),
    x: wp.array3d(dtype=ALONE),
    # Out:
    held_out: wp.array2d(dtype=wp.float64),
):
    """What is wanted of what is not free. Launched over (rod, dof)."""
    r, a = wp.tid()
    value = ZERO
    if active[r] != 0 and free[r, a] == 0:
        value = wanted[r, a]
        n = free.shape[1]
        for b in range(wp.max(a - HALF_BANDWIDTH, 0), wp.min(a + HALF_BANDWIDTH + 1, n)):
            value -= entry(m, r, a, b) * x[r, 0, b][0]
    held_out[r, a] = value


@wp.kernel
def want_turns_before(
    # State in:
    active: wp.array(dtype=wp.int32),
    spin_inertia: wp.array2d(dtype=wp.float64),
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    now: Wanted,
):
    """What the step itself wants of how far reference frames have turned in all, on top."""
    r, i = wp.tid()
    if active[r] != 0:
        now.turn[r, i] = now.turn[r, i] + spin_inertia[r, i] * x[r, 0, 4 * i + 3][0]


@wp.kernel
def want_before(
    # Model:
    mass: wp.array2d(dtype=wp.float64),
    edge_mass: wp.array2d(dtype=wp.float64),
    air_damping: wp.array(dtype=wp.float64),
    drag: wp.array2d(dtype=wp.vec2d),
    # State in:
    step: OneStep,
    now: Wanted,
    by_start: wp.array2d(dtype=wp.vec3d),
    x: wp.array3d(dtype=ALONE),
    # State in and out:
    before: Wanted,
    older: Wanted,
):
    """Through differences of configurations and velocities, and through frames that were carried
    along, to the starts of the step. Launched over (rod, node); `edge_mass` and `drag` may have no
    columns."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    c = step.coefficient[r]
    dt = step.span[r]
    w = solved(x, r, i)
    less = wp.vec3d(ZERO, ZERO, ZERO)
    if edge_mass.shape[1] > 0:
        if i > 0:
            less += (edge_mass[r, i - 1] / SIX) * (w - solved(x, r, i - 1))
        if i < edge_mass.shape[1]:
            less += (edge_mass[r, i] / SIX) * (w - solved(x, r, i + 1))
    dragged = wp.vec3d(ZERO, ZERO, ZERO)
    if drag.shape[1] > 0:
        v = velocity_of(step, r, i)
        dragged = drag_matrix(v, drag[r, i][0], drag[r, i][1]) * w
    from_turns = turned(by_start, now.turn, r, i)
    for k in range(4):
        a = 4 * i + k
        if a < mass.shape[1]:
            pushed = mass[r, a] * x[r, 0, a][0]
            slowed = air_damping[r] * pushed
            if k < 3:
                pushed -= less[k]
                slowed += dragged[k]
            # dL/dv_n, with what the step itself wants of it.
            velocity = now.velocity[r, a] - (c[0] / dt) * pushed - slowed
            first = (c[1] / dt) * velocity
            second = (c[2] / dt) * velocity
            if k < 3:
                before.dof[r, a] = before.dof[r, a] + first + from_turns[k]
            else:
                before.dof[r, a] = before.dof[r, a] + first
                before.turn[r, i] = before.turn[r, i] + now.turn[r, i] - first
                older.turn[r, i] = older.turn[r, i] - second
            older.dof[r, a] = older.dof[r, a] + second
            before.velocity[r, a] = before.velocity[r, a] - (c[1] / dt) * pushed
            older.velocity[r, a] = older.velocity[r, a] - (c[2] / dt) * pushed


@wp.kernel
def want_still(
    # Model:
    free: wp.array2d(dtype=wp.int32),
    moved: wp.array2d(dtype=wp.int32),
    # State in:
    active: wp.array(dtype=wp.int32),
    by_end: wp.array2d(dtype=wp.vec3d),
    by_start: wp.array2d(dtype=wp.vec3d),
    held: wp.array2d(dtype=wp.float64),
    # State in and out:
    before: Wanted,
    # Out:
    held_out: wp.array2d(dtype=wp.float64),
):
    """What is neither free nor moved stays where it was: nodes, and angles to reference frames,
    which turn with the edges. Launched over (rod, node)."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    end = wp.vec3d(ZERO, ZERO, ZERO)
    start = wp.vec3d(ZERO, ZERO, ZERO)
    for n in range(2):
        e = i - 1 + n
        if e >= 0 and e < by_end.shape[1]:
            a = 4 * e + 3
            if free[r, a] == 0 and moved[r, a] == 0:
                sign = wp.where(n == 0, ONE, -ONE)
                end += (sign * held[r, a]) * by_end[r, e]
                start += (sign * held[r, a]) * by_start[r, e]
    for k in range(4):
        a = 4 * i + k
        if a < free.shape[1]:
            value = wp.float64(0.0)
            if free[r, a] == 0:
                value = held[r, a]
                if k < 3:
                    value += end[k]
            if moved[r, a] == 0:
                before.dof[r, a] = before.dof[r, a] + value
                value = ZERO
            if k < 3:
                before.dof[r, a] = before.dof[r, a] + start[k]
            held_out[r, a] = value
