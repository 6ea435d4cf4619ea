"""What a recording says of a rod in motion: where its grips hold it, and where its markers are."""

import warp as wp
from wrod.kernels.elastic.curvature import stencil
from wrod.kernels.elastic.frames import HALF, angle_towards, node, parallel_transport
from wrod.kernels.stepping.dynamics import advance_of
from wrod.kernels.stepping.pace import Pace
from wrod.kernels.stepping.trace import OneStep


@wp.kernel
def hold_ends(
    # Model: held nodes (rod, frame, 4) and frame of each grip (rod, frame, 2): tangent and director
    held: wp.array3d(dtype=wp.vec3d),
    grip_tangent: wp.array3d(dtype=wp.vec3d),
    grip_director: wp.array3d(dtype=wp.vec3d),
    first: int,
    rate: wp.float64,
    # State in:
    running: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    tangent_before: wp.array2d(dtype=wp.vec3d),
    director_before: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    dof: wp.array2d(dtype=wp.float64),
):
    """Put the edge at each end where its grip is at the end of the step, the time of a frame after
    the `first`: with the grip's director, carried to the edge's tangent."""
    r, k = wp.tid()
    if running[r] == 0:
        return
    f = first + int(wp.round((time[r] + step[r]) * rate))
    edges = tangent_before.shape[1]
    i = wp.where(k == 0, 0, edges - 1)
    q = held[r, f, 2 * k]
    p = held[r, f, 2 * k + 1]
    for c in range(3):
        dof[r, 4 * i + c] = q[c]
        dof[r, 4 * i + 4 + c] = p[c]
    t = wp.normalize(p - q)
    aim = parallel_transport(grip_director[r, f, k], grip_tangent[r, f, k], t)
    dof[r, 4 * i + 3] = angle_towards(
        aim, t, dof[r, 4 * i + 3], tangent_before[r, i], director_before[r, i]
    )


@wp.kernel
def lead_nodes(
    growth: wp.float64,
    # State in:
    starting: wp.array(dtype=wp.int32),
    # State in and out:
    step: OneStep,
):
    """Shift the free nodes by as much as the grips are from where they were expected, interpolated
    along the rod. Launched over (rod, free node), when the ends are where they are held.

    Grips change their pace from frame to frame: where the rod does not come along, the edges at the
    grips are stretched, which costs Newton's method an iteration in every step."""
    r, k = wp.tid()
    if starting[r] == 0:
        return
    last = step.dof.shape[1] / 4 - 1
    i = k + 2
    share = wp.float64(k + 1) / wp.float64(last - 1)
    for c in range(3):
        here = beyond_expected(growth, step, r, 4 + c)
        there = beyond_expected(growth, step, r, 4 * last + c)
        step.dof[r, 4 * i + c] += here + share * (there - here)


@wp.func
def beyond_expected(growth: wp.float64, step: OneStep, r: int, a: int) -> wp.float64:
    return step.dof[r, a] - step.dof_before[r, a] - advance_of(growth, step, r, a)


@wp.func
def frame_of(chosen: int, time: wp.float64, substeps: int, rate: wp.float64) -> int:
    """Frame at a time after the second one; -1 between frames and for rods that are not chosen."""
    taken = substeps + int(wp.round(time * rate))
    if chosen == 0 or taken % substeps != 0:
        return -1
    return taken / substeps


@wp.kernel
def observe(
    # In: node (marker) and offset (column 0: the model's) of every marker
    place: wp.array(dtype=wp.int32),
    offset: wp.array2d(dtype=wp.vec3d),
    accepted: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    substeps: int,
    rate: wp.float64,
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    # Out: (rod, frame, marker)
    position_out: wp.array3d(dtype=wp.vec3d),
):
    """Markers beside the centreline: offsets in the mean frame of the edges around their nodes; of
    rods whose step has ended on a frame."""
    r, k = wp.tid()
    frame = frame_of(accepted[r], time[r], substeps, rate)
    if frame < 0:
        return
    i = place[k]
    s = stencil(dof, director, r, i)
    o = offset[wp.min(r, offset.shape[0] - 1), k]
    shift = o[0] * (s.m1e + s.m1f) + o[1] * (s.m2e + s.m2f) + o[2] * (s.t + s.u)
    position_out[r, frame, k] = node(dof, r, i) + HALF * shift


@wp.kernel
def go_on(
    # Model: number of the last step to take
    last: wp.array(dtype=wp.int32),
    rate: wp.float64,
    # State in and out:
    pace: Pace,
):
    """Let rods that have taken a step take the next: they need not wait for each other."""
    r = wp.tid()
    taken = int(wp.round(pace.time[r] * rate))
    if pace.accepted[r] == 0 or taken >= last[0]:
        return
    pace.until[r] = wp.float64(taken + 1) / rate
    pace.running[r] = 1
    pace.starting[r] = 1
