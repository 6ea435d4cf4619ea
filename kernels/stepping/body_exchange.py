"""Bodies between a simulator, in its precision, and the steps of rods that they hold."""

import warp as wp
from wrod.kernels.elastic.frames import ZERO, node, put_node
from wrod.kernels.stepping.bodies import Body, BodyMotion, Hold, inertia_of, spin_of, tangent_of
from wrod.kernels.stepping.carrying import as_pose, from_pose


@wp.kernel
def carry_velocity(
    # Model:
    body: wp.array2d(dtype=Body),
    hold: wp.array2d(dtype=Hold),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    before: BodyMotion,
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    velocity_out: wp.array2d(dtype=wp.float64),
):
    """What bodies hold moves with them."""
    r, k = wp.tid()
    h = hold[r, k]
    if chosen[r] == 0 or h.kind == 0 or h.slot < 0:
        return
    spin = spin_of(body[r, h.slot], before.turn[r, h.slot], before.momentum[r, h.slot])
    for n in range(h.kind):
        i = wp.where(n == 0, h.node, h.other)
        arm = node(dof, r, i) - before.place[r, h.slot]
        v = before.velocity[r, h.slot] + wp.cross(spin, arm)
        put_node(velocity_out, r, i, v)
    if h.kind == 2:
        velocity_out[r, 4 * h.edge + 3] = wp.dot(spin, tangent_of(h, before.turn[r, h.slot]))


@wp.kernel
def find_moved_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    body_q: wp.array(dtype=wp.transform),
    body_qd: wp.array(dtype=wp.spatial_vector),
    written_q: wp.array2d(dtype=wp.transform),
    written_qd: wp.array2d(dtype=wp.spatial_vector),
    # State out:
    changed_out: wp.array(dtype=wp.int32),
):
    """Say of which rows a body is not where `write_bodies` last put it."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    pose = body_q[b.index]
    speed = body_qd[b.index]
    written_pose = written_q[r, s]
    written_speed = written_qd[r, s]
    for k in range(7):
        if pose[k] != written_pose[k]:
            changed_out[r] = 1
    for k in range(6):
        if speed[k] != written_speed[k]:
            changed_out[r] = 1


@wp.kernel
def read_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    body_q: wp.array(dtype=wp.transform),
    body_qd: wp.array(dtype=wp.spatial_vector),
    body_f: wp.array(dtype=wp.spatial_vector),
    # State out:
    now: BodyMotion,
    before: BodyMotion,
    force_out: wp.array2d(dtype=wp.vec3d),
    torque_out: wp.array2d(dtype=wp.vec3d),
):
    """Pose and velocity of the bodies of the chosen rows, and the forces on all."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    force_out[r, s] = wp.vec3d(wp.spatial_top(body_f[b.index]))
    torque_out[r, s] = wp.vec3d(wp.spatial_bottom(body_f[b.index]))
    if chosen[r] == 0:
        return
    pose = as_pose(body_q[b.index])
    turn = pose.rotation
    place = from_pose(pose, b.centre)
    now.place[r, s] = place
    now.turn[r, s] = turn
    before.place[r, s] = place
    before.turn[r, s] = turn
    before.velocity[r, s] = wp.vec3d(wp.spatial_top(body_qd[b.index]))
    before.momentum[r, s] = inertia_of(b, turn) * wp.vec3d(wp.spatial_bottom(body_qd[b.index]))


@wp.kernel
def write_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    now: BodyMotion,
    before: BodyMotion,
    # State out:
    body_q_out: wp.array(dtype=wp.transform),
    body_qd_out: wp.array(dtype=wp.spatial_vector),
    written_q_out: wp.array2d(dtype=wp.transform),
    written_qd_out: wp.array2d(dtype=wp.spatial_vector),
):
    """Give out where the bodies are, in the simulator's precision."""
    r, s = wp.tid()
    b = body[r, s]
    if b.mass == ZERO:
        return
    q = now.turn[r, s]
    origin = now.place[r, s] - wp.quat_rotate(q, b.centre)
    pose = wp.transform(wp.vec3(origin), wp.quat(q))
    v = wp.vec3(before.velocity[r, s])
    w = wp.vec3(spin_of(b, q, before.momentum[r, s]))
    speed = wp.spatial_vector(v[0], v[1], v[2], w[0], w[1], w[2])
    body_q_out[b.index] = pose
    body_qd_out[b.index] = speed
    written_q_out[r, s] = pose
    written_qd_out[r, s] = speed
