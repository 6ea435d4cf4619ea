"""What follows from a rod's tangents by model parameters: rates of its strains, and of what markers
on it show; see `motion_tangents`."""

import warp as wp
from wrod.kernels.elastic.curvature import component, stencil
from wrod.kernels.elastic.frames import HALF, ONE
from wrod.kernels.stepping.motion import frame_of
from wrod.kernels.stepping.motion_tangents import column_node
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.viscosity import measured, relaxed_strain

wp.set_module_options({"enable_backward": False})


@wp.kernel
def measure_strain_tangents(
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    tangent: wp.array3d(dtype=wp.float64),
    per_thread: int,
    strain_out: wp.array3d(dtype=wp.vec3d),
):
    """Rates of the strains along every column of `tangent`."""
    r, i_, group = wp.tid()
    if accepted[r] == 0:
        return
    i = i_ + 1
    s = stencil(dof, director, r, i)
    first = component(s, 0)
    second = component(s, 1)
    binormal = wp.cross(s.t, s.u) / (ONE + wp.dot(s.t, s.u))
    last = wp.min(tangent.shape[1], (group + 1) * per_thread)
    for j in range(group * per_thread, last):
        middle = column_node(tangent, r, j, i)
        de = (middle - column_node(tangent, r, j, i - 1)) / s.length_e
        df = (column_node(tangent, r, j, i + 1) - middle) / s.length_f
        te = tangent[r, j, 4 * i - 1]
        tf = tangent[r, j, 4 * i + 3]
        kappa_1 = wp.dot(first.e, de) + wp.dot(first.f, df) + first.te * te + first.tf * tf
        kappa_2 = wp.dot(second.e, de) + wp.dot(second.f, df) + second.te * te + second.tf * tf
        strain_out[r, j, i] = wp.vec3d(kappa_1, kappa_2, tf - te + wp.dot(binormal, de + df))


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
    strain_new: wp.array3d(dtype=wp.vec3d),
    per_thread: int,
    # In and out:
    strain: wp.array3d(dtype=wp.vec3d),
    strain_older: wp.array3d(dtype=wp.vec3d),
):
    """Rates of the strains that viscous moments remember (`viscosity.relax_strains`)."""
    r, i_, group = wp.tid()
    if pace.accepted[r] == 0:
        return
    i = i_ + 1
    c = pace.coefficient[r] / pace.step[r]
    theta = viscous_time[wp.min(r, viscous_time.shape[0] - 1), i][3]
    now = measured(dof, director, reference_twist, r, i)
    new = relaxed_strain(c, theta, now, strain_before[r, i], strain_before_older[r, i])
    flow = c[0] * new + c[1] * strain_before[r, i] + c[2] * strain_before_older[r, i]
    for j in range(group * per_thread, wp.min(strain.shape[1], (group + 1) * per_thread)):
        past = c[1] * strain[r, j, i] + c[2] * strain_older[r, j, i]
        moved = strain_new[r, j, i] - theta * past
        moved -= viscous_time_rate[j, i][3] * wp.vec3d(flow[0], flow[1], flow[2])
        strain_older[r, j, i] = strain[r, j, i]
        strain[r, j, i] = moved / (ONE + theta * c[0])


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
    """Rates of what `wrod.kernels.stepping.motion.observe` sees."""
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
