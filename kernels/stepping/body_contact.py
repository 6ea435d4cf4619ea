"""Contact of rigid bodies that move with rods, in the same implicit step, where they meet
(`body_meetings`).

Normal force and friction are those of rods (`wrod.kernels.contact.law`). Both bodies get the
force at the same point, so that momentum is conserved.
"""

import warp as wp
from wrod.kernels.contact.law import IMPACT_WAY, damped_force, note_touch, return_mapping
from wrod.kernels.elastic.frames import ZERO
from wrod.kernels.stepping.bodies import Body, BodyMotion
from wrod.kernels.stepping.body_meetings import Meeting, pose_in_row, pose_of, where_met
from wrod.kernels.stepping.carrying import Pose, from_pose


@wp.struct
class Press:
    """How deep bodies are in each other and by how much deeper than at the start of the step, how
    far the first has gone over the other, and where they press; where the points are that tell the
    depth, and those that friction holds."""

    depth: wp.float64
    closing: wp.float64
    moved: wp.vec3d
    place: wp.vec3d
    point: wp.vec3d
    point_there: wp.vec3d
    grip: wp.vec3d
    grip_there: wp.vec3d


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
    out.point = from_pose(mine, m.point)
    out.point_there = from_pose(its, m.point_there)
    out.grip = from_pose(mine, m.grip)
    out.grip_there = from_pose(its, m.grip_there)
    moved = out.grip - from_pose(was, m.grip)
    moved = moved - out.grip_there + from_pose(its_was, m.grip_there)
    out.moved = moved - wp.dot(moved, m.normal) * m.normal
    out.place = where_met(m, out.point, out.point_there)
    return out


@wp.struct
class Push:
    """Normal force and its slope, friction's pull on the bristle, its stiffness, and how it grows
    with the normal force."""

    force: wp.float64
    slope: wp.float64
    pull: wp.vec3d
    tangential: wp.mat33d
    coupling: wp.vec3d


@wp.func
def hold(m: Meeting, p: Press, bristle: wp.vec3d, dt: wp.float64) -> Push:
    out = Push()
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
def add_wrench(load: wp.array3d(dtype=wp.float64), r: int, s: int, g: wp.vec3d, arm: wp.vec3d):
    """Add g, at `arm` from the body's centre, and its torque."""
    t = wp.cross(arm, g)
    for c in range(3):
        wp.atomic_add(load, r, s, c, g[c])
        wp.atomic_add(load, r, s, 3 + c, t[c])


@wp.func
def add_push(push: wp.array3d(dtype=wp.float64), r: int, s: int, g: wp.vec3d, arm: wp.vec3d):
    add_wrench(push, r, s, g, arm)
    wp.atomic_add(push, r, s, 6, wp.length(g))


@wp.func(inline=False)
def add_block(
    matrix: wp.array3d(dtype=wp.float64),
    r: int,
    s: int,
    s_other: int,
    g: wp.mat33d,
    arm: wp.vec3d,
    arm_other: wp.vec3d,
):
    """J^T G J' of the motions of two bodies, where J = [1, -arm x]."""
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


@wp.func
def add_stiffness(
    matrix: wp.array3d(dtype=wp.float64), m: Meeting, p: Press, h: Push, now: BodyMotion
):
    """To how what both bodies feel grows as they move, the arms as they are."""
    r = m.row
    normal = wp.outer(h.slope * m.normal + h.coupling, m.normal)
    mine = now.place[r, m.slot]
    arm = p.place - mine
    add_block(matrix, r, m.slot, m.slot, normal, arm, p.point - mine)
    add_block(matrix, r, m.slot, m.slot, h.tangential, arm, p.grip - mine)
    if m.other >= 0:
        its = now.place[r, m.other]
        arm_there = p.place - its
        add_block(matrix, r, m.other, m.other, normal, arm_there, p.point_there - its)
        add_block(matrix, r, m.other, m.other, h.tangential, arm_there, p.grip_there - its)
        add_block(matrix, r, m.slot, m.other, -normal, arm, p.point_there - its)
        add_block(matrix, r, m.slot, m.other, -h.tangential, arm, p.grip_there - its)
        add_block(matrix, r, m.other, m.slot, -normal, arm_there, p.point - mine)
        add_block(matrix, r, m.other, m.slot, -h.tangential, arm_there, p.grip - mine)


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
    add_push(push_out, r, m.slot, g, p.place - now.place[r, m.slot])
    if m.other >= 0:
        add_push(push_out, r, m.other, -g, p.place - now.place[r, m.other])
    add_stiffness(matrix_out, m, p, h, now)


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
    centre = from_pose(pose_of(body_q, m.body), wp.vec3d(body_com[m.body]))
    wp.atomic_add(force, m.body, force_in[i])
    wp.atomic_add(torque, m.body, wp.cross(place[i] - centre, force_in[i]))
