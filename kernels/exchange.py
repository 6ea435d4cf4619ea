"""Rods between a simulator's flat arrays, one rod after the other, and the rows of a batch.

A clamped end has one node more in the batch than outside: the rod is thought to go on into the
clamp by an edge, whose direction is the clamp's, which places the clamp at the first node with an
error of second order in the edge.
"""

import warp as wp
from wrod.kernels.contact import Shape
from wrod.kernels.frames import ONE, ZERO, node, parallel_transport, rotate, signed_angle

wp.set_module_options({"enable_backward": False})


@wp.struct
class Span:
    """Where a rod of a batch stands outside: first node and edge, their numbers, and how many nodes
    of the batch come before (0 or 1)."""

    node: int
    edge: int
    count: int
    lead: int


@wp.kernel
def find_changes(
    # Model:
    span: wp.array(dtype=Span),
    # State in:
    node_q: wp.array(dtype=wp.vec3d),
    node_qd: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    edge_spin: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    written_director: wp.array2d(dtype=wp.vec3d),
    # State out:
    changed_out: wp.array(dtype=wp.int32),
):
    """Say of which rods the state is not what `write_state` last gave out."""
    r, i = wp.tid()
    s = span[r]
    if i >= s.count:
        return
    b = s.lead + i
    same = node_q[s.node + i] == node(dof, r, b) and node_qd[s.node + i] == node(velocity, r, b)
    if same and i < s.count - 1:
        e = s.edge + i
        same = edge_spin[e] == velocity[r, 4 * b + 3] and edge_director[e] == written_director[r, b]
    if not same:
        changed_out[r] = 1


@wp.kernel
def read_state(
    # Model:
    span: wp.array(dtype=Span),
    rest_length: wp.array2d(dtype=wp.float64),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    node_q: wp.array(dtype=wp.vec3d),
    node_qd: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    edge_spin: wp.array(dtype=wp.float64),
    # State out:
    dof_out: wp.array2d(dtype=wp.float64),
    velocity_out: wp.array2d(dtype=wp.float64),
    tangent_out: wp.array2d(dtype=wp.vec3d),
    director_out: wp.array2d(dtype=wp.vec3d),
    twist_out: wp.array2d(dtype=wp.float64),
):
    """Configuration and velocity of the chosen rods; reference frames are the material ones."""
    r, b = wp.tid()
    if chosen[r] == 0:
        return
    s = span[r]
    i = wp.clamp(b - s.lead, 0, s.count - 1)
    e = wp.clamp(b - s.lead, 0, s.count - 2)
    t = wp.normalize(node_q[s.node + e + 1] - node_q[s.node + e])
    q = node_q[s.node + i]
    v = node_qd[s.node + i]
    if b < s.lead:
        q = q - rest_length[r, 0] * t
    if b - s.lead >= s.count:
        q = q + rest_length[r, b - 1] * t
    for c in range(3):
        dof_out[r, 4 * b + c] = q[c]
        velocity_out[r, 4 * b + c] = v[c]
    twist_out[r, b] = ZERO
    if b < tangent_out.shape[1]:
        d = edge_director[s.edge + e]
        dof_out[r, 4 * b + 3] = ZERO
        velocity_out[r, 4 * b + 3] = edge_spin[s.edge + e]
        tangent_out[r, b] = t
        director_out[r, b] = wp.normalize(d - wp.dot(d, t) * t)


@wp.kernel
def write_state(
    # Model:
    span: wp.array(dtype=Span),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    director: wp.array2d(dtype=wp.vec3d),
    force: wp.array2d(dtype=wp.vec3d),
    # State out:
    node_q_out: wp.array(dtype=wp.vec3d),
    node_qd_out: wp.array(dtype=wp.vec3d),
    node_contact_f_out: wp.array(dtype=wp.vec3d),
    edge_director_out: wp.array(dtype=wp.vec3d),
    edge_spin_out: wp.array(dtype=wp.float64),
    written_director_out: wp.array2d(dtype=wp.vec3d),
):
    r, i = wp.tid()
    s = span[r]
    if i >= s.count:
        return
    b = s.lead + i
    node_q_out[s.node + i] = node(dof, r, b)
    node_qd_out[s.node + i] = node(velocity, r, b)
    node_contact_f_out[s.node + i] = force[r, b]
    if i < s.count - 1:
        d = rotate(director[r, b], tangent[r, b], dof[r, 4 * b + 3])
        edge_director_out[s.edge + i] = d
        edge_spin_out[s.edge + i] = velocity[r, 4 * b + 3]
        written_director_out[r, b] = d


@wp.kernel
def place_capsules(
    # Model:
    span: wp.array(dtype=Span),
    first_body: wp.array(dtype=wp.int32),
    # State in:
    node_q: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    # State out:
    body_q_out: wp.array(dtype=wp.transform),
):
    """Put a body at the middle of every edge, x along the director and z along the edge."""
    r, i = wp.tid()
    s = span[r]
    if first_body[r] < 0 or i >= s.count - 1:
        return
    a = node_q[s.node + i]
    b = node_q[s.node + i + 1]
    z = wp.normalize(b - a)
    d = edge_director[s.edge + i]
    x = wp.normalize(d - wp.dot(d, z) * z)
    turn = wp.quat_from_matrix(wp.matrix_from_cols(x, wp.cross(z, x), z))
    middle = wp.float64(0.5) * (a + b)
    body_q_out[first_body[r] + i] = wp.transform(
        wp.vec3(float(middle[0]), float(middle[1]), float(middle[2])),
        wp.quat(float(turn[0]), float(turn[1]), float(turn[2]), float(turn[3])),
    )


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
    carried = parallel_transport(director_before[r, e], tangent_before[r, e], tangent)
    angle = dof[r, 4 * e + 3]
    # Continuous beyond a turn.
    dof[r, 4 * e + 3] = angle + signed_angle(rotate(carried, tangent, angle), aim, tangent)
    beyond = place - rest_length[r, e] * tangent
    if side == 1:
        beyond = place + rest_length[r, e] * tangent
    other = end - 1 + 2 * side
    for c in range(3):
        dof[r, 4 * other + c] = beyond[c]
