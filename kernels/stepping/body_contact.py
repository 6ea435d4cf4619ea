"""Contact of rigid bodies that move with rods: with each other and with whatever else a simulator's
collision detection finds, in the same implicit step.

A contact is a pair of points, each fixed to its body for the step, and a normal from the first body
to the second; the first one moves with rods. Normal force and friction are those of rods
(`wrod.kernels.contact.planes`). Both bodies get the force at the same point, so that momentum is
conserved.
"""

import warp as wp
from wrod.kernels.contact.planes import IMPACT_WAY, damped_force, note_touch, return_mapping
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.stepping.bodies import Body, BodyMotion
from wrod.kernels.stepping.body_exchange import wide
from wrod.kernels.stepping.carrying import Pose, as_pose, on_the_way

wp.set_module_options({"enable_backward": False})

# Under its weight on Earth a body sinks into one point by this part of its shape's size at most,
# and over so much of it the force rises.
SINKING = wp.constant(wp.float64(1.0 / 600.0))
STANDARD_GRAVITY = wp.constant(wp.float64(9.81))


@wp.struct
class Meeting:
    """A contact of the body in place `slot` of a row (-1: of none of ours) with what is in place
    `other` of the same row, or, where that is -1, with `body` of the simulator (-1: the world).

    Of each body's own frame: where the point is that tells the depth, at the distance `reach` from
    the surface, and the point of the surface that friction holds. `shapes` says which contact it is
    from step to step."""

    row: int
    slot: int
    other: int
    body: int
    shapes: wp.vec2i
    point: wp.vec3d
    point_there: wp.vec3d
    reach: wp.float64
    reach_there: wp.float64
    grip: wp.vec3d
    grip_there: wp.vec3d
    normal: wp.vec3d
    stiffness: wp.float64
    skin: wp.float64
    relaxation: wp.float64
    friction: wp.float64


@wp.struct
class Detected:
    """Contacts as Newton's collision detection gives them, and its shapes' numbers."""

    count: wp.array(dtype=wp.int32)
    shape0: wp.array(dtype=wp.int32)
    shape1: wp.array(dtype=wp.int32)
    point0: wp.array(dtype=wp.vec3)
    point1: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)
    margin0: wp.array(dtype=wp.float32)
    margin1: wp.array(dtype=wp.float32)
    shape_body: wp.array(dtype=wp.int32)
    size: wp.array(dtype=wp.float32)
    stiffness: wp.array(dtype=wp.float32)
    friction: wp.array(dtype=wp.float32)
    damping: wp.array(dtype=wp.float64)


@wp.struct
class Owned:
    """(body,) the rows and places of the bodies that move with rods, -1 of all others; masses."""

    row: wp.array(dtype=wp.int32)
    slot: wp.array(dtype=wp.int32)
    mass: wp.array(dtype=wp.float32)


@wp.func
def pose_of(body_q: wp.array(dtype=wp.transform), body: int) -> Pose:
    if body >= 0:
        return as_pose(body_q[body])
    out = Pose()
    out.rotation = wp.quatd(ZERO, ZERO, ZERO, ONE)
    return out


@wp.func
def from_pose(x: Pose, p: wp.vec3d) -> wp.vec3d:
    return x.position + wp.quat_rotate(x.rotation, p)


@wp.func
def into_pose(x: Pose, p: wp.vec3d) -> wp.vec3d:
    return wp.quat_rotate_inv(x.rotation, p - x.position)


@wp.func
def entry(table: wp.array(dtype=wp.int32), i: int) -> int:
    if i < 0:
        return -1
    return table[i]


@wp.kernel
def read_contacts(
    # Model:
    owned: Owned,
    # State in:
    detected: Detected,
    capacity: int,
    body_q: wp.array(dtype=wp.transform),
    before: wp.array(dtype=Meeting),
    bristle_before: wp.array(dtype=wp.vec3d),
    # State out:
    meeting_out: wp.array(dtype=Meeting),
    bristle_out: wp.array(dtype=wp.vec3d),
):
    """Take contacts of our bodies up; friction goes on from the nearest one of the same shapes."""
    i = wp.tid()
    m = Meeting()
    m.row = -1
    bristle_out[i] = wp.vec3d(ZERO, ZERO, ZERO)
    if i >= wp.min(detected.count[0], capacity):
        meeting_out[i] = m
        return
    shape = detected.shape0[i]
    there = detected.shape1[i]
    point = wide(detected.point0[i])
    point_there = wide(detected.point1[i])
    reach = wp.float64(detected.margin0[i])
    reach_there = wp.float64(detected.margin1[i])
    normal = wp.normalize(wide(detected.normal[i]))
    body = entry(detected.shape_body, shape)
    if entry(owned.slot, body) < 0:
        shape = detected.shape1[i]
        there = detected.shape0[i]
        point = wide(detected.point1[i])
        point_there = wide(detected.point0[i])
        reach = wp.float64(detected.margin1[i])
        reach_there = wp.float64(detected.margin0[i])
        normal = -normal
        body = entry(detected.shape_body, shape)
    m.body = entry(detected.shape_body, there)
    if body < 0 or m.body == body:
        meeting_out[i] = m
        return
    m.row = owned.row[body]
    m.slot = owned.slot[body]
    if m.row < 0:
        meeting_out[i] = m
        return
    m.other = -1
    mass = wp.float64(owned.mass[body])
    heavier = wp.float64(mass)
    if entry(owned.row, m.body) == m.row:
        m.other = owned.slot[m.body]
        light = wp.float64(owned.mass[m.body])
        heavier = wp.max(mass, light)
        mass = mass * light / (mass + light)
    m.shapes = wp.vec2i(shape, there)
    m.point = point
    m.point_there = point_there
    m.normal = normal
    m.reach = reach
    m.reach_there = reach_there
    mine = pose_of(body_q, body)
    its = pose_of(body_q, m.body)
    middle = HALF * (
        from_pose(mine, point) + reach * normal + from_pose(its, point_there) - reach_there * normal
    )
    m.grip = into_pose(mine, middle)
    m.grip_there = into_pose(its, middle)
    size = wp.float64(detected.size[shape])
    mean = wp.float64(0.5 * (detected.stiffness[shape] + detected.stiffness[there]))
    m.stiffness = wp.max(mean, STANDARD_GRAVITY * heavier / (SINKING * size))
    m.skin = SINKING * size
    m.relaxation = HALF * (detected.damping[shape] + detected.damping[there])
    m.relaxation = m.relaxation * wp.sqrt(mass / m.stiffness)
    m.friction = wp.float64(0.5 * (detected.friction[shape] + detected.friction[there]))
    meeting_out[i] = m
    nearest = int(-1)
    least = wp.float64(0.0)
    for j in range(before.shape[0]):
        if before[j].row == m.row and before[j].shapes == m.shapes:
            apart = wp.length_sq(before[j].point - point)
            if nearest < 0 or apart < least:
                nearest = int(j)
                least = wp.float64(apart)
    if nearest >= 0:
        bristle_out[i] = bristle_before[nearest]


@wp.kernel
def clear_contacts(
    # State out:
    meeting_out: wp.array(dtype=Meeting),
):
    """Nothing touches."""
    m = Meeting()
    m.row = -1
    meeting_out[wp.tid()] = m


@wp.kernel
def carry_others(
    # Model:
    duration: wp.float64,
    # State in:
    meeting: wp.array(dtype=Meeting),
    running: wp.array(dtype=wp.int32),
    changed: wp.array(dtype=wp.int32),
    until: wp.array(dtype=wp.float64),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    body_before: wp.array(dtype=wp.transform),
    body_q: wp.array(dtype=wp.transform),
    # State out:
    before_out: wp.array(dtype=Pose),
    now_out: wp.array(dtype=Pose),
):
    """Where bodies that others move are at the start and at the end of the step of a row."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    r = m.row
    if running[r] == 0 or m.other >= 0:
        return
    after = pose_of(body_q, m.body)
    before = pose_of(body_before, m.body)
    if changed[r] != 0:
        before = after
    left = (until[r] - time[r]) / duration
    before_out[i] = on_the_way(before, after, wp.clamp(left, ZERO, ONE))
    left = left - step[r] / duration
    now_out[i] = on_the_way(before, after, wp.clamp(left, ZERO, ONE))


@wp.struct
class Press:
    """How deep bodies are in each other and by how much deeper than at the start of the step, how
    far the first has gone over the other, and where they press."""

    depth: wp.float64
    closing: wp.float64
    moved: wp.vec3d
    place: wp.vec3d


@wp.func
def pose_in_row(body: wp.array2d(dtype=Body), x: BodyMotion, r: int, s: int) -> Pose:
    out = Pose()
    out.rotation = x.turn[r, s]
    out.position = x.place[r, s] - wp.quat_rotate(out.rotation, body[r, s].centre)
    return out


@wp.func
def depth_of(m: Meeting, mine: Pose, its: Pose) -> wp.float64:
    apart = wp.dot(m.normal, from_pose(its, m.point_there) - from_pose(mine, m.point))
    return m.reach + m.reach_there - apart


@wp.func
def press(
    m: Meeting,
    body: wp.array2d(dtype=Body),
    now: BodyMotion,
    before: BodyMotion,
    there_now: Pose,
    there_before: Pose,
) -> Press:
    out = Press()
    mine = pose_in_row(body, now, m.row, m.slot)
    was = pose_in_row(body, before, m.row, m.slot)
    its = there_now
    its_was = there_before
    if m.other >= 0:
        its = pose_in_row(body, now, m.row, m.other)
        its_was = pose_in_row(body, before, m.row, m.other)
    out.depth = depth_of(m, mine, its)
    out.closing = out.depth - depth_of(m, was, its_was)
    moved = from_pose(mine, m.grip) - from_pose(was, m.grip)
    moved = moved - from_pose(its, m.grip_there) + from_pose(its_was, m.grip_there)
    out.moved = moved - wp.dot(moved, m.normal) * m.normal
    # What is round stays above where it presses as it rolls on.
    out.place = from_pose(mine, m.point) + m.reach * m.normal
    if m.reach_there > m.reach:
        out.place = from_pose(its, m.point_there) - m.reach_there * m.normal
    return out


@wp.struct
class Held:
    """Normal force and its slope, friction's pull on the bristle, its stiffness, and how it grows
    with the normal force."""

    force: wp.float64
    slope: wp.float64
    pull: wp.vec3d
    tangential: wp.mat33d
    coupling: wp.vec3d


@wp.func
def hold(m: Meeting, p: Press, bristle: wp.vec3d, dt: wp.float64) -> Held:
    out = Held()
    law = damped_force(p.depth, p.closing, m.relaxation, dt, m.stiffness, m.skin)
    out.force = law[0]
    out.slope = law[1]
    b = bristle + p.moved
    b = b - wp.dot(b, m.normal) * m.normal
    held = return_mapping(b, m.normal, m.stiffness, m.friction * law[0])
    out.pull = held.pull
    out.tangential = held.tangential
    if held.slides > ZERO:
        out.coupling = (m.friction * out.slope / wp.length(b)) * b
    return out


@wp.func
def add_wrench(push: wp.array3d(dtype=wp.float64), r: int, s: int, g: wp.vec3d, arm: wp.vec3d):
    t = wp.cross(arm, g)
    for c in range(3):
        wp.atomic_add(push, r, s, c, g[c])
        wp.atomic_add(push, r, s, 3 + c, t[c])
    wp.atomic_add(push, r, s, 6, wp.length(g))


@wp.func
def add_block(
    matrix: wp.array3d(dtype=wp.float64),
    r: int,
    s: int,
    s_other: int,
    g: wp.mat33d,
    arm: wp.vec3d,
    arm_other: wp.vec3d,
):
    """J^T G J of the motions of two bodies, where J = [1, -arm x]."""
    left = wp.skew(arm)
    right = -wp.skew(arm_other)
    g_right = g * right
    left_g = left * g
    corner = left * g_right
    for i in range(3):
        for j in range(3):
            a = 6 * s + i
            b = 6 * s_other + j
            wp.atomic_add(matrix, r, a, b, g[i, j])
            wp.atomic_add(matrix, r, a, b + 3, g_right[i, j])
            wp.atomic_add(matrix, r, a + 3, b, left_g[i, j])
            wp.atomic_add(matrix, r, a + 3, b + 3, corner[i, j])


@wp.kernel
def push_bodies(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    meeting: wp.array(dtype=Meeting),
    active: wp.array(dtype=wp.int32),
    span: wp.array(dtype=wp.float64),
    now: BodyMotion,
    before: BodyMotion,
    there_now: wp.array(dtype=Pose),
    there_before: wp.array(dtype=Pose),
    bristle: wp.array(dtype=wp.vec3d),
    # State out:
    push_out: wp.array3d(dtype=wp.float64),
    matrix_out: wp.array3d(dtype=wp.float64),
):
    """Add forces, subtracted as in residuals, and stiffness of all contacts; last of a body's push
    is how hard it is pressed in all."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    r = m.row
    if active[r] == 0:
        return
    p = press(m, body, now, before, there_now[i], there_before[i])
    if p.depth <= ZERO:
        return
    h = hold(m, p, bristle[i], span[r])
    g = h.force * m.normal + h.pull
    block = h.tangential + wp.outer(h.slope * m.normal + h.coupling, m.normal)
    arm = p.place - now.place[r, m.slot]
    add_wrench(push_out, r, m.slot, g, arm)
    add_block(matrix_out, r, m.slot, m.slot, block, arm, arm)
    if m.other >= 0:
        arm_there = p.place - now.place[r, m.other]
        add_wrench(push_out, r, m.other, -g, arm_there)
        add_block(matrix_out, r, m.other, m.other, block, arm_there, arm_there)
        add_block(matrix_out, r, m.slot, m.other, -block, arm, arm_there)
        add_block(matrix_out, r, m.other, m.slot, -block, arm_there, arm)


@wp.kernel
def find_meeting(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    meeting: wp.array(dtype=Meeting),
    chosen: wp.array(dtype=wp.int32),
    now: BodyMotion,
    before: BodyMotion,
    there_now: wp.array(dtype=Pose),
    there_before: wp.array(dtype=Pose),
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rows whether bodies touch (1), and whether in an impact (2)."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    if chosen[m.row] == 0:
        return
    p = press(m, body, now, before, there_now[i], there_before[i])
    if p.depth > ZERO:
        # Of a body that goes apart and back by more than the force rises over, all is an impact.
        note_touch(touching_out, m.row, p.depth, p.closing, m.skin / IMPACT_WAY)


@wp.kernel
def settle_meeting(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    meeting: wp.array(dtype=Meeting),
    accepted: wp.array(dtype=wp.int32),
    span: wp.array(dtype=wp.float64),
    now: BodyMotion,
    before: BodyMotion,
    there_now: wp.array(dtype=Pose),
    there_before: wp.array(dtype=Pose),
    # State in and out:
    bristle: wp.array(dtype=wp.vec3d),
    # State out:
    force_out: wp.array(dtype=wp.vec3d),
    place_out: wp.array(dtype=wp.vec3d),
):
    """After an accepted step: let overloaded bristles slide, and note what presses on the others,
    and where."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    if accepted[m.row] == 0:
        return
    p = press(m, body, now, before, there_now[i], there_before[i])
    b = wp.vec3d(ZERO, ZERO, ZERO)
    f = wp.vec3d(ZERO, ZERO, ZERO)
    if p.depth > ZERO:
        h = hold(m, p, bristle[i], span[m.row])
        b = h.pull / m.stiffness
        f = h.force * m.normal + h.pull
    bristle[i] = b
    force_out[i] = f
    place_out[i] = p.place


@wp.kernel
def forget_meeting(
    # In:
    meeting: wp.array(dtype=Meeting),
    chosen: wp.array(dtype=wp.int32),
    # State out:
    bristle_out: wp.array(dtype=wp.vec3d),
):
    """Unload the friction of the chosen rows."""
    i = wp.tid()
    if meeting[i].row < 0:
        return
    if chosen[meeting[i].row] != 0:
        bristle_out[i] = wp.vec3d(ZERO, ZERO, ZERO)


@wp.kernel
def measure_presses(
    # Model:
    body_com: wp.array(dtype=wp.vec3),
    # State in:
    meeting: wp.array(dtype=Meeting),
    force_in: wp.array(dtype=wp.vec3d),
    place: wp.array(dtype=wp.vec3d),
    body_q: wp.array(dtype=wp.transform),
    # State in and out:
    force: wp.array(dtype=wp.vec3d),
    torque: wp.array(dtype=wp.vec3d),
):
    """Add what our bodies did at the end of the last step to those that others move."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0 or m.other >= 0 or m.body < 0:
        return
    centre = from_pose(pose_of(body_q, m.body), wide(body_com[m.body]))
    wp.atomic_add(force, m.body, force_in[i])
    wp.atomic_add(torque, m.body, wp.cross(place[i] - centre, force_in[i]))
