"""The adjoint of how bodies carry the shapes that rods touch (`carrying.carry_shapes`): see
`exchange_adjoint`.

On the way from pose b to pose a a body is turned by exp(f v) b, where exp(v) b = a: a turn of a by
w_a and of b by w_b changes v by J(v)^-1 (w_a - exp(v) w_b), and turns what is on the way by
f J(f v) dv + exp(f v) w_b, J the left Jacobian of a rotation vector.
"""

import warp as wp
from wrod.kernels.contact.edge_adjoint import WantedShapes
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.stepping.bodies import turn_to, turned_by
from wrod.kernels.stepping.carrying import Pose, as_pose
from wrod.kernels.stepping.exchange_adjoint import jacobian, turned_back, want_pose
from wrod.kernels.stepping.trace import OneStep, left_of


@wp.kernel
def find_begun(
    # In:
    step: OneStep,
    # Out:
    time_out: wp.array(dtype=wp.float64),
):
    """When the step began. Launched over (row,)."""
    r = wp.tid()
    time_out[r] = step.time[r] - step.whole[r]


@wp.struct
class WantedPoses:
    """Of a body at the start and at the end of the simulator's step: of its place, and of its turn
    by rotation vectors."""

    before: wp.vec3d
    turn_before: wp.vec3d
    after: wp.vec3d
    turn_after: wp.vec3d


@wp.func
def on_the_way_back(
    before: Pose, way: wp.vec3d, left: wp.float64, arm: wp.vec3d, force: wp.vec3d, torque: wp.vec3d
) -> WantedPoses:
    """Of a shape at `arm` from its body's place, in the body's frame, while the part `left` of the
    body's turn `way` is ahead: what is wanted of the shape, wanted of the body's poses."""
    f = ONE - left
    arm_now = wp.quat_rotate(turned_by(f * way, before.rotation), arm)
    g = torque + wp.cross(arm_now, force)
    out = WantedPoses()
    out.before = left * force
    out.after = f * force
    out.turn_after = (
        f * (wp.transpose(wp.inverse(jacobian(way))) * wp.transpose(jacobian(f * way))) * g
    )
    out.turn_before = turned_back(g, f * way) - turned_back(out.turn_after, way)
    return out


@wp.func
def want_carrier(
    body: int,
    r: int,
    duration: wp.float64,
    step: OneStep,
    changed: wp.array(dtype=wp.int32),
    body_before: wp.array(dtype=wp.transform),
    body_q: wp.array(dtype=wp.transform),
    arm: wp.vec3d,
    force: wp.vec3d,
    torque: wp.vec3d,
    force_at_start: wp.vec3d,
    torque_at_start: wp.vec3d,
    by_body_before: wp.array2d(dtype=wp.float32),
    by_body_q: wp.array2d(dtype=wp.float32),
):
    """Of what a body carries at `arm`, at the end of a row's step and at its start, to the body's
    poses at the end of the simulator's step and at its start."""
    before = as_pose(body_before[body])
    if changed[r] != 0:
        before = as_pose(body_q[body])
    way = turn_to(as_pose(body_q[body]).rotation, before.rotation)
    left = left_of(step, r)
    start = wp.clamp((left + step.span[r]) / duration, ZERO, ONE)
    end = wp.clamp(left / duration, ZERO, ONE)
    a = on_the_way_back(before, way, end, arm, force, torque)
    b = on_the_way_back(before, way, start, arm, force_at_start, torque_at_start)
    want_pose(by_body_q, body, body_q[body], a.after + b.after, a.turn_after + b.turn_after)
    moved = a.before + b.before
    turned = a.turn_before + b.turn_before
    if changed[r] != 0:
        want_pose(by_body_q, body, body_q[body], moved, turned)
    else:
        want_pose(by_body_before, body, body_before[body], moved, turned)


@wp.kernel
def want_carriers(
    # Model:
    carrier: wp.array2d(dtype=wp.int32),
    place: wp.array2d(dtype=wp.vec3d),
    duration: wp.float64,
    # State in:
    step: OneStep,
    changed: wp.array(dtype=wp.int32),
    body_before: wp.array(dtype=wp.transform),
    body_q: wp.array(dtype=wp.transform),
    # State in and out:
    wanted: WantedShapes,
    by_body_before: wp.array2d(dtype=wp.float32),
    by_body_q: wp.array2d(dtype=wp.float32),
):
    """Of shapes at the end of a row's step and at its start, which are wanted no more then, to
    their bodies' poses at the end of the simulator's step and at its start. Launched over
    (row, shape)."""
    r, k = wp.tid()
    body = carrier[r, k]
    if step.active[r] == 0 or body < 0:
        return
    want_carrier(
        body, r, duration, step, changed, body_before, body_q, place[r, k], wanted.place[r, k],
        wanted.turn[r, k], wanted.place_at_start[r, k], wanted.turn_at_start[r, k],
        by_body_before, by_body_q,
    )  # fmt: skip
    none = wp.vec3d(ZERO, ZERO, ZERO)
    wanted.place[r, k] = none
    wanted.turn[r, k] = none
    wanted.place_at_start[r, k] = none
    wanted.turn_at_start[r, k] = none


@wp.kernel
def add_poses(
    # In:
    wanted: wp.array2d(dtype=wp.float32),
    # State in and out:
    by_body_q: wp.array2d(dtype=wp.float32),
):
    """Launched over (body, 7)."""
    b, c = wp.tid()
    by_body_q[b, c] = by_body_q[b, c] + wanted[b, c]
