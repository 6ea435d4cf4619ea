"""Bodies of a simulator that carry rods' ends and the shapes that rods touch, one step at a time.

Bodies are known at the start and at the end of the simulator's step; a rod that takes several steps
meets them on the way.
"""

import warp as wp
from wrod.kernels.contact.planes import Shape
from wrod.kernels.elastic.frames import ONE, ZERO, angle_towards, node, rotate
from wrod.kernels.stepping.exchange import Span

wp.set_module_options({"enable_backward": False})


@wp.struct
class Hold:
    """What holds an end: nothing (0), a pin (1) or a clamp (2) on `body` (-1: the world), and the
    end's place and frame (tangent, director, their cross product) in that body's frame."""

    kind: int
    body: int
    position: wp.vec3d
    rotation: wp.quatd


@wp.func
def end_node(s: Span, side: int) -> int:
    return s.lead + side * (s.count - 1)


@wp.func
def end_edge(s: Span, side: int) -> int:
    """The edge inside a clamp."""
    return s.lead - 1 + side * s.count


@wp.kernel
def note_ends(
    # Model:
    hold: wp.array2d(dtype=Hold),
    span: wp.array(dtype=Span),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    director: wp.array2d(dtype=wp.vec3d),
    # State out:
    position_out: wp.array2d(dtype=wp.vec3d),
    rotation_out: wp.array2d(dtype=wp.quatd),
):
    """Where held ends are at the start of a step."""
    r, side = wp.tid()
    if hold[r, side].kind == 0:
        return
    position_out[r, side] = node(dof, r, end_node(span[r], side))
    if hold[r, side].kind == 2:
        e = end_edge(span[r], side)
        t = tangent[r, e]
        d = rotate(director[r, e], t, dof[r, 4 * e + 3])
        rotation_out[r, side] = wp.quat_from_matrix(wp.matrix_from_cols(t, d, wp.cross(t, d)))


@wp.struct
class Pose:
    position: wp.vec3d
    rotation: wp.quatd


@wp.func
def as_pose(x: wp.transform) -> Pose:
    p = wp.transform_get_translation(x)
    q = wp.transform_get_rotation(x)
    out = Pose()
    out.position = wp.vec3d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2]))
    out.rotation = wp.normalize(
        wp.quatd(wp.float64(q[0]), wp.float64(q[1]), wp.float64(q[2]), wp.float64(q[3]))
    )
    return out


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
    out.moves = 1
    out.position_before = start.position + wp.quat_rotate(start.rotation, place[r, k])
    out.rotation_before = start.rotation * turn[r, k]
    out.position = end.position + wp.quat_rotate(end.rotation, place[r, k])
    out.rotation = end.rotation * turn[r, k]
    shape_out[r, k] = out


@wp.kernel
def carry_ends(
    # Model:
    hold: wp.array2d(dtype=Hold),
    span: wp.array(dtype=Span),
    rest_length: wp.array2d(dtype=wp.float64),
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
    """Move held ends on their way to where their bodies are when the rod's time is `until`."""
    r, side = wp.tid()
    h = hold[r, side]
    if running[r] == 0 or h.kind == 0:
        return
    place = h.position
    turn = h.rotation
    if h.body >= 0:
        body = as_pose(body_q[h.body])
        place = body.position + wp.quat_rotate(body.rotation, h.position)
        turn = body.rotation * h.rotation
    left = wp.clamp((until[r] - time[r] - step[r]) / duration, ZERO, ONE)
    place = place - left * (place - position_before[r, side])
    end = end_node(span[r], side)
    for c in range(3):
        dof[r, 4 * end + c] = place[c]
    if h.kind == 1:
        return
    # A state from outside does not tell the direction of the clamp.
    if changed[r] == 0 and left > ZERO:
        turn = turn_back(turn, rotation_before[r, side], left)
    tangent = wp.quat_rotate(turn, wp.vec3d(ONE, ZERO, ZERO))
    aim = wp.quat_rotate(turn, wp.vec3d(ZERO, ONE, ZERO))
    e = end_edge(span[r], side)
    dof[r, 4 * e + 3] = angle_towards(
        aim, tangent, dof[r, 4 * e + 3], tangent_before[r, e], director_before[r, e]
    )
    beyond = place - rest_length[r, e] * tangent
    if side == 1:
        beyond = place + rest_length[r, e] * tangent
    other = end - 1 + 2 * side
    for c in range(3):
        dof[r, 4 * other + c] = beyond[c]
