"""What follows from a rod's tangents by model parameters: rates of its strains, and of what markers
on it show; see `motion_tangents`."""

import warp as wp
from wrod.kernels.elastic.curvature import stencil
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.stepping.flow_tangents import along, strain_rate, strains_at
from wrod.kernels.stepping.motion_tangents import column_node
from wrod.kernels.stepping.observed import frame_of
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.viscosity import measured, relaxed_strain


@wp.kernel
def measure_strain_tangents(
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array3d(dtype=wp.float64),
    per_thread: int,
    # Out: (rod, column, node), as in `wrod.kernels.stepping.viscosity.measure_strains`
    strain_out: wp.array3d(dtype=wp.vec4d),
):
    """Rates of the strains along every column of `tangent`."""
    r, i, group = wp.tid()
    if accepted[r] == 0:
        return
    s = strains_at(dof, director, r, i)
    for j in range(group * per_thread, wp.min(tangent.shape[1], (group + 1) * per_thread)):
        out = wp.vec4d(ZERO, ZERO, ZERO, along(s.tangent, tangent, r, j, i))
        if i > 0:
            for k in range(3):
                out[k] = strain_rate(s, tangent, r, j, i, k)
        strain_out[r, j, i] = out


@wp.kernel
def shift_strain_tangents(
    # Model:
    viscous_time: wp.array2d(dtype=wp.vec4d),
    viscous_time_rate: wp.array2d(dtype=wp.vec4d),
    # State in:
    pace: Pace,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    reference_twist: wp.array2d(dtype=wp.float64),
    strain_before: wp.array2d(dtype=wp.vec4d),
    strain_before_older: wp.array2d(dtype=wp.vec4d),
    strain_new: wp.array3d(dtype=wp.vec4d),
    per_thread: int,
    # In and out:
    strain: wp.array3d(dtype=wp.vec4d),
    strain_older: wp.array3d(dtype=wp.vec4d),
):
    """Rates of the strains that viscous moments remember (`viscosity.relax_strains`)."""
    r, i, group = wp.tid()
    if pace.accepted[r] == 0:
        return
    c = pace.coefficient[r] / pace.step[r]
    theta = viscous_time[wp.min(r, viscous_time.shape[0] - 1), i][3]
    now = measured(dof, director, reference_twist, r, i)
    new = relaxed_strain(c, theta, now, strain_before[r, i], strain_before_older[r, i])
    flow = c[0] * new + c[1] * strain_before[r, i] + c[2] * strain_before_older[r, i]
    for j in range(group * per_thread, wp.min(strain.shape[1], (group + 1) * per_thread)):
        before = strain[r, j, i]
        moved = relaxed_strain(c, theta, strain_new[r, j, i], before, strain_older[r, j, i])
        faster = viscous_time_rate[j, i][3] / (ONE + theta * c[0])
        strain_older[r, j, i] = before
        strain[r, j, i] = moved - faster * wp.vec4d(flow[0], flow[1], flow[2], ZERO)


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
    accepted: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    substeps: int,
    rate: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array3d(dtype=wp.float64),
    per_thread: int,
    # Out: (rod, frame, marker, column)
    rate_out: wp.array4d(dtype=wp.vec3d),
):
    """Rates of what `wrod.kernels.stepping.observed.observe` sees."""
    r, k, group = wp.tid()
    frame = frame_of(accepted[r], time[r], substeps, rate)
    if frame < 0:
        return
    i = place[k]
    s = stencil(dof, director, r, i)
    o = offset[wp.min(r, offset.shape[0] - 1), k]
    for j in range(group * per_thread, wp.min(tangent.shape[1], (group + 1) * per_thread)):
        d = offset_rate[j, k]
        e = column_node(tangent, r, j, i) - column_node(tangent, r, j, i - 1)
        f = column_node(tangent, r, j, i + 1) - column_node(tangent, r, j, i)
        e = (e - wp.dot(e, s.t) * s.t) / s.length_e
        f = (f - wp.dot(f, s.u) * s.u) / s.length_f
        shift = d[0] * (s.m1e + s.m1f) + d[1] * (s.m2e + s.m2f) + d[2] * (s.t + s.u)
        shift += turned_shift(o, s.t, s.m1e, s.m2e, e, tangent[r, j, 4 * i - 1])
        shift += turned_shift(o, s.u, s.m1f, s.m2f, f, tangent[r, j, 4 * i + 3])
        rate_out[r, frame, k, j] = column_node(tangent, r, j, i) + HALF * shift
