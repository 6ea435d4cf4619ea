"""Bodies of a simulator that carry rods' ends and the shapes that rods touch, one step at a time.

Bodies are known at the start and at the end of the simulator's step; a rod that takes several steps
meets them on the way.
"""

import warp as wp
from wrod.kernels.contact.shapes import BY_OTHERS, Shape
from wrod.kernels.elastic.frames import ONE, ZERO, angle_towards, node, put_node, rotate
from wrod.kernels.stepping.bodies import Hold


@wp.kernel
def note_held(
    # Model:
    hold: wp.array2d(dtype=Hold),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    director: wp.array2d(dtype=wp.vec3d),
    # State out:
    position_out: wp.array2d(dtype=wp.vec3d),
    rotation_out: wp.array2d(dtype=wp.quatd),
):
    """Where what is held is at the start of a step."""
    r, k = wp.tid()
    h = hold[r, k]
    if h.kind == 0 or h.slot >= 0:
        return
    position_out[r, k] = node(dof, r, h.node)
    if h.kind == 2:
        t = tangent[r, h.edge]
        d = rotate(director[r, h.edge], t, dof[r, 4 * h.edge + 3])
        rotation_out[r, k] = wp.quat_from_matrix(wp.matrix_from_cols(t, d, wp.cross(t, d)))


@wp.struct
class Pose:
    position: wp.vec3d
    rotation: wp.quatd


@wp.func
def as_pose(x: wp.transform) -> Pose:
    out = Pose()
    out.position = wp.vec3d(wp.transform_get_translation(x))
    out.rotation = wp.normalize(wp.quatd(wp.transform_get_rotation(x)))
    return out


@wp.func
def from_pose(x: Pose, p: wp.vec3d) -> wp.vec3d:
    return x.position + wp.quat_rotate(x.rotation, p)


@wp.func
def turn_back(after: wp.quatd, before: wp.quatd, left: wp.float64) -> wp.quatd:
    """Rotation when the fraction `left` of the way from `before` to `after` is still ahead."""
    if wp.dot(after, before) < ZERO:
        return wp.quat_slerp(after, -before, left)
    return wp.quat_slerp(after, before, left)


@wp.func
def on_the_way(before: Pose, after: Pose, left: wp.float64) -> Pose:
    out = Pose()
    out.position = after.position + left * (before.position - after.position)
    out.rotation = turn_back(after.rotation, before.rotation, left)
    return out


@wp.kernel
def carry_shapes(
    # Model:
    carrier: wp.array2d(dtype=wp.int32),
    place: wp.array2d(dtype=wp.vec3d),
    turn: wp.array2d(dtype=wp.quatd),
    duration: wp.float64,
    # State in:
    running: wp.array(dtype=wp.int32),
    changed: wp.array(dtype=wp.int32),
    until: wp.array(dtype=wp.float64),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    body_before: wp.array(dtype=wp.transform),
    body_q: wp.array(dtype=wp.transform),
    # State out:
    shape_out: wp.array2d(dtype=Shape),
):
    """Move shapes with their bodies, each rod's at its own time."""
    r, k = wp.tid()
    body = carrier[r, k]
    if running[r] == 0 or body < 0:
        return
    after = as_pose(body_q[body])
    before = as_pose(body_before[body])
    # A rod that starts anew finds the shapes where they are.
    if changed[r] != 0:
        before = after
    start = on_the_way(before, after, wp.clamp((until[r] - time[r]) / duration, ZERO, ONE))
    left = wp.clamp((until[r] - time[r] - step[r]) / duration, ZERO, ONE)
    end = on_the_way(before, after, left)
    out = shape_out[r, k]
    out.moves = BY_OTHERS
    out.position_before = from_pose(start, place[r, k])
    out.rotation_before = start.rotation * turn[r, k]
    out.position = from_pose(end, place[r, k])
    out.rotation = end.rotation * turn[r, k]
    shape_out[r, k] = out


@wp.kernel
def carry_held(
    # Model:
    hold: wp.array2d(dtype=Hold),
    duration: wp.float64,
    # State in:
    running: wp.array(dtype=wp.int32),
    changed: wp.array(dtype=wp.int32),
    until: wp.array(dtype=wp.float64),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    body_q: wp.array(dtype=wp.transform),
    position_before: wp.array2d(dtype=wp.vec3d),
    rotation_before: wp.array2d(dtype=wp.quatd),
    tangent_before: wp.array2d(dtype=wp.vec3d),
    director_before: wp.array2d(dtype=wp.vec3d),
    # State in and out:
    dof: wp.array2d(dtype=wp.float64),
):
    """Move what is held on its way to where its body is when the row's time is `until`."""
    r, k = wp.tid()
    h = hold[r, k]
    if running[r] == 0 or h.kind == 0 or h.slot >= 0:
        return
    place = h.position
    turn = h.rotation
    if h.body >= 0:
        body = as_pose(body_q[h.body])
        place = from_pose(body, h.position)
        turn = body.rotation * h.rotation
    left = wp.clamp((until[r] - time[r] - step[r]) / duration, ZERO, ONE)
    place = place - left * (place - position_before[r, k])
    put_node(dof, r, h.node, place)
    if h.kind == 1:
        return
    # A state from outside does not tell the direction of the clamp.
    if changed[r] == 0 and left > ZERO:
        turn = turn_back(turn, rotation_before[r, k], left)
    tangent = wp.quat_rotate(turn, wp.vec3d(ONE, ZERO, ZERO))
    aim = wp.quat_rotate(turn, wp.vec3d(ZERO, ONE, ZERO))
    e = h.edge
    dof[r, 4 * e + 3] = angle_towards(
        aim, tangent, dof[r, 4 * e + 3], tangent_before[r, e], director_before[r, e]
    )
    put_node(dof, r, h.other, place + h.reach * tangent)


@wp.kernel
def measure_loads(
    # Model:
    hold: wp.array2d(dtype=Hold),
    body_com: wp.array(dtype=wp.vec3),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    reaction: wp.array2d(dtype=wp.float64),
    body_q: wp.array(dtype=wp.transform),
    # State in and out:
    force: wp.array(dtype=wp.vec3d),
    torque: wp.array(dtype=wp.vec3d),
):
    """Add what rods did at the end of the last step to the bodies that hold them and are moved by
    others: force, and torque about the centre of mass."""
    r, k = wp.tid()
    h = hold[r, k]
    if h.kind == 0 or h.slot >= 0 or h.body < 0:
        return
    centre = from_pose(as_pose(body_q[h.body]), wp.vec3d(body_com[h.body]))
    f = wp.vec3d(ZERO, ZERO, ZERO)
    t = wp.vec3d(ZERO, ZERO, ZERO)
    for n in range(h.kind):
        i = wp.where(n == 0, h.node, h.other)
        g = node(reaction, r, i)
        f = f - g
        t = t - wp.cross(node(dof, r, i) - centre, g)
    if h.kind == 2:
        t = t - reaction[r, 4 * h.edge + 3] * tangent[r, h.edge]
    wp.atomic_add(force, h.body, f)
    wp.atomic_add(torque, h.body, t)


@wp.kernel
def measure_pushes(
    # Model:
    carrier: wp.array2d(dtype=wp.int32),
    body_com: wp.array(dtype=wp.vec3),
    # State in:
    push: wp.array2d(dtype=wp.vec3d),
    moment: wp.array2d(dtype=wp.vec3d),
    body_q: wp.array(dtype=wp.transform),
    # State in and out:
    force: wp.array(dtype=wp.vec3d),
    torque: wp.array(dtype=wp.vec3d),
):
    """Add what rods did to the bodies whose shapes they touch, likewise."""
    r, k = wp.tid()
    body = carrier[r, k]
    if body < 0:
        return
    centre = from_pose(as_pose(body_q[body]), wp.vec3d(body_com[body]))
    wp.atomic_add(force, body, push[r, k])
    wp.atomic_add(torque, body, moment[r, k] - wp.cross(centre, push[r, k]))


@wp.kernel
def add_wrenches(
    # In:
    force: wp.array(dtype=wp.vec3d),
    torque: wp.array(dtype=wp.vec3d),
    # In and out:
    body_f: wp.array(dtype=wp.spatial_vector),
):
    """Add forces and torques, in the simulator's precision."""
    b = wp.tid()
    f = force[b]
    t = torque[b]
    body_f[b] = body_f[b] + wp.spatial_vector(
        float(f[0]), float(f[1]), float(f[2]), float(t[0]), float(t[1]), float(t[2])
    )


@wp.kernel
def tell_wrenches(
    # In:
    share: wp.float64,
    force: wp.array(dtype=wp.vec3d),
    torque: wp.array(dtype=wp.vec3d),
    # In and out:
    told_force: wp.array(dtype=wp.vec3d),
    told_torque: wp.array(dtype=wp.vec3d),
):
    """Go by a share of the way from what was told to forces and torques. Launched over bodies."""
    b = wp.tid()
    told_force[b] = share * force[b] + (wp.float64(1.0) - share) * told_force[b]
    told_torque[b] = share * torque[b] + (wp.float64(1.0) - share) * told_torque[b]
