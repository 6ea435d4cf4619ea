"""The adjoint of what rigid bodies that move with rods do to each other, and to what stands still
or is moved by others, in the steps of `wrod.kernels.stepping.body_adjoint`.

What collision detection found counts as given, and so does whether a contact presses, sticks or
slides. With g the force on the second body and U the difference of the multipliers of the two
bodies' balance where g acts, -U is what is wanted of g; of its friction also what later steps want
of the bristle, which ends as the pull over the stiffness.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.stepping.bodies import Body, BodyMotion
from wrod.kernels.stepping.body_adjoint import WantedBodies, part
from wrod.kernels.stepping.body_contact import Press, Push, add_stiffness, add_wrench, hold, press
from wrod.kernels.stepping.body_meetings import Meeting, pose_in_row, pose_of
from wrod.kernels.stepping.carrying import Pose, as_pose, from_pose
from wrod.kernels.stepping.carrying_adjoint import want_carrier
from wrod.kernels.stepping.exchange_adjoint import want_pose
from wrod.kernels.stepping.trace import OneStep


@wp.kernel
def keep_bristles(
    # State in:
    meeting: wp.array(dtype=Meeting),
    accepted: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    bristle: wp.array(dtype=wp.vec3d),
    # Out: (step, meeting)
    kept: wp.array2d(dtype=wp.vec3d),
):
    """Keep what friction held where accepted steps begin, as long as there is room."""
    i = wp.tid()
    r = meeting[i].row
    if r < 0:
        return
    if accepted[r] != 0 and count[r] < kept.shape[0]:
        kept[count[r], i] = bristle[i]


@wp.func
def centre_of(x: BodyMotion, m: Meeting, slot: int) -> wp.vec3d:
    """Where a body's centre is; of what others move it does not matter."""
    if slot < 0:
        return wp.vec3d(ZERO, ZERO, ZERO)
    return x.place[m.row, slot]


@wp.func
def add_corner(
    matrix: wp.array3d(dtype=wp.float64), r: int, s: int, s_other: int, turn: int, b: wp.mat33d
):
    """To how the torque on a body grows as another one is shifted (turn 0) or turned (3)."""
    for i in range(3):
        for j in range(3):
            wp.atomic_add(matrix, r, 6 * s + 3 + i, 6 * s_other + turn + j, b[i, j])


@wp.func
def add_moved_arms(
    matrix: wp.array3d(dtype=wp.float64), m: Meeting, p: Press, g: wp.vec3d, now: BodyMotion
):
    """Derivatives of the torques by where g acts, which goes with one of the bodies."""
    carrier = m.slot
    point = p.point
    if m.reach_there > m.reach:
        carrier = m.other
        point = p.point_there
    away = wp.skew(point - centre_of(now, m, carrier))
    for n in range(2):
        s = wp.where(n == 0, m.slot, m.other)
        if s >= 0:
            turned = wp.where(n == 0, -ONE, ONE) * wp.skew(g)
            add_corner(matrix, m.row, s, s, 0, -turned)
            if carrier >= 0:
                add_corner(matrix, m.row, s, carrier, 0, turned)
                add_corner(matrix, m.row, s, carrier, 3, -turned * away)


@wp.kernel
def weigh_meetings(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    meeting: wp.array(dtype=Meeting),
    at: OneStep,
    now: BodyMotion,
    before: BodyMotion,
    there_now: wp.array(dtype=Pose),
    there_before: wp.array(dtype=Pose),
    kept: wp.array2d(dtype=wp.vec3d),
    count: wp.array(dtype=wp.int32),
    back: int,
    wanted: wp.array(dtype=wp.vec3d),
    # State in and out:
    load: wp.array3d(dtype=wp.float64),
    matrix: wp.array3d(dtype=wp.float64),
):
    """Add to the bodies' system what contact has in it, by row the equation, and to its right-hand
    side what is wanted of bristles at the end of the step."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    r = m.row
    if at.active[r] == 0:
        return
    p = press(m, body, now, before, there_now[i], there_before[i])
    if p.depth <= ZERO:
        return
    h = hold(m, p, kept[count[r] - 1 - back, i], at.span[r])
    add_stiffness(matrix, m, p, h, now)
    add_moved_arms(matrix, m, p, h.force * m.normal + h.pull, now)
    y = wanted[i] / m.stiffness
    of_grip = h.tangential * y
    of_point = wp.dot(h.coupling, y) * m.normal
    mine = now.place[r, m.slot]
    add_wrench(load, r, m.slot, of_grip, p.grip - mine)
    add_wrench(load, r, m.slot, of_point, p.point - mine)
    if m.other >= 0:
        its = now.place[r, m.other]
        add_wrench(load, r, m.other, -of_grip, p.grip_there - its)
        add_wrench(load, r, m.other, -of_point, p.point_there - its)


@wp.func
def moved_by(multiplier: wp.array2d(dtype=wp.float64), r: int, s: int, arm: wp.vec3d) -> wp.vec3d:
    return part(multiplier, r, 6 * s) + wp.cross(part(multiplier, r, 6 * s + 3), arm)


@wp.func
def add_before(before: WantedBodies, r: int, s: int, arm: wp.vec3d, g: wp.vec3d):
    wp.atomic_add(before.place, r, s, g)
    wp.atomic_add(before.turn, r, s, wp.cross(arm, g))


@wp.func
def along_slip(h: Push) -> wp.vec3d:
    """Friction's growth with the normal force, as far as it slides."""
    if h.slope > ZERO:
        return h.coupling / h.slope
    return wp.vec3d(ZERO, ZERO, ZERO)


@wp.func
def unturned(now: wp.quatd, before: wp.quatd, g: wp.vec3d) -> wp.vec3d:
    """What is wanted of a point of a body's frame by whose way in the step g is."""
    return wp.quat_rotate_inv(now, g) - wp.quat_rotate_inv(before, g)


@wp.struct
class WantedThere:
    """What is wanted of a body that others move at the end of a step or at its start: of its place,
    and of its turn by a rotation vector."""

    place: wp.vec3d
    turn: wp.vec3d


@wp.func
def wanted_there(x: Pose, m: Meeting, of_point: wp.vec3d, of_grip: wp.vec3d) -> WantedThere:
    """From what is wanted of its points."""
    out = WantedThere()
    out.place = of_point + of_grip
    out.turn = wp.cross(wp.quat_rotate(x.rotation, m.point_there), of_point)
    out.turn += wp.cross(wp.quat_rotate(x.rotation, m.grip_there), of_grip)
    return out


@wp.kernel
def want_meetings_before(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    meeting: wp.array(dtype=Meeting),
    at: OneStep,
    now: BodyMotion,
    before: BodyMotion,
    there_now: wp.array(dtype=Pose),
    there_before: wp.array(dtype=Pose),
    kept: wp.array2d(dtype=wp.vec3d),
    count: wp.array(dtype=wp.int32),
    back: int,
    multiplier: wp.array2d(dtype=wp.float64),
    duration: wp.float64,
    changed: wp.array(dtype=wp.int32),
    body_before: wp.array(dtype=wp.transform),
    body_q: wp.array(dtype=wp.transform),
    # State in and out:
    wanted: wp.array(dtype=wp.vec3d),
    grip: wp.array(dtype=wp.vec3d),
    grip_there: wp.array(dtype=wp.vec3d),
    wanted_before: WantedBodies,
    by_friction: wp.array(dtype=wp.float32),
    by_body_before: wp.array2d(dtype=wp.float32),
    by_body_q: wp.array2d(dtype=wp.float32),
):
    """From the solution to where bodies came from, to what friction held, where on the bodies, to
    its coefficients, the shapes' mean, and to the poses of bodies that others move at the start of
    the simulator's step and at its end."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    r = m.row
    if at.active[r] == 0:
        return
    y = wanted[i] / m.stiffness
    wanted[i] = wp.vec3d(ZERO, ZERO, ZERO)
    p = press(m, body, now, before, there_now[i], there_before[i])
    if p.depth <= ZERO:
        return
    h = hold(m, p, kept[count[r] - 1 - back, i], at.span[r])
    u = moved_by(multiplier, r, m.slot, p.place - now.place[r, m.slot])
    if m.other >= 0:
        u = u - moved_by(multiplier, r, m.other, p.place - now.place[r, m.other])
    of_pull = y - u
    of_bristle = h.tangential * of_pull
    way = along_slip(h)
    wanted[i] = of_bristle
    if by_friction.shape[0] > 0 and m.friction > ZERO:
        share = HALF * h.force / m.friction * wp.dot(way, of_pull)
        for k in range(2):
            wp.atomic_add(by_friction, m.shapes[k], wp.float32(share))
    of_point = h.slope * (wp.dot(u, m.normal) - wp.dot(way, of_pull)) * m.normal
    push = wp.vec3d(ZERO, ZERO, ZERO)
    if p.closing < p.depth:
        lag = m.relaxation / at.span[r]
        push = lag / (ONE + lag) * of_point
    was = pose_in_row(body, before, r, m.slot)
    centre = before.place[r, m.slot]
    add_before(wanted_before, r, m.slot, from_pose(was, m.point) - centre, push)
    add_before(wanted_before, r, m.slot, from_pose(was, m.grip) - centre, -of_bristle)
    grip[i] = grip[i] + unturned(now.turn[r, m.slot], was.rotation, of_bristle)
    if m.other >= 0:
        was = pose_in_row(body, before, r, m.other)
        centre = before.place[r, m.other]
        add_before(wanted_before, r, m.other, from_pose(was, m.point_there) - centre, -push)
        add_before(wanted_before, r, m.other, from_pose(was, m.grip_there) - centre, of_bristle)
        turned = unturned(now.turn[r, m.other], was.rotation, of_bristle)
        grip_there[i] = grip_there[i] - turned
    elif m.body >= 0:
        its = there_now[i]
        was = there_before[i]
        if m.reach_there > m.reach:  # where both press goes with it
            torque = part(multiplier, r, 6 * m.slot + 3)
            of_point = of_point + wp.cross(torque, h.force * m.normal + h.pull)
        end = wanted_there(its, m, of_point, -of_bristle)
        start = wanted_there(was, m, -push, of_bristle)
        centre = wp.vec3d(ZERO, ZERO, ZERO)
        want_carrier(
            m.body, r, duration, at, changed, body_before, body_q, centre,
            end.place, end.turn, start.place, start.turn, by_body_before, by_body_q,
        )  # fmt: skip
        grip_there[i] = grip_there[i] - unturned(its.rotation, was.rotation, of_bristle)


@wp.func
def add_held(
    wanted: WantedBodies,
    by_read: wp.array2d(dtype=wp.float32),
    m: Meeting,
    s: int,
    x: Pose,
    raw: wp.transform,
    by_grip: wp.vec3d,
    p: Press,
    at: BodyMotion,
):
    """What is wanted of where friction holds a body at x, which is where both met as the
    simulator's step began. `raw` is the pose of what others move there."""
    g = wp.quat_rotate(x.rotation, by_grip)
    carrier = m.slot
    point = p.point
    if m.reach_there > m.reach:
        carrier = m.other
        point = p.point_there
    for n in range(2):
        slot = wp.where(n == 0, s, carrier)
        place = wp.where(n == 0, p.place, point)
        force = wp.where(n == 0, -ONE, ONE) * g
        if slot >= 0:
            add_before(wanted, m.row, slot, place - at.place[m.row, slot], force)
        elif m.body >= 0:
            arm = place - as_pose(raw).position
            want_pose(by_read, m.body, raw, force, wp.cross(arm, force))


@wp.kernel
def want_grips(
    # Model:
    body: wp.array2d(dtype=Body),
    # State in:
    meeting: wp.array(dtype=Meeting),
    start: BodyMotion,
    read: wp.array(dtype=wp.transform),
    grip: wp.array(dtype=wp.vec3d),
    grip_there: wp.array(dtype=wp.vec3d),
    # State in and out:
    wanted: WantedBodies,
    by_read: wp.array2d(dtype=wp.float32),
):
    """To where bodies were as the simulator's step began, those that others move as detection
    found them (`read`)."""
    i = wp.tid()
    m = meeting[i]
    if m.row < 0:
        return
    its = pose_of(read, m.body)
    raw = wp.transform_identity()
    if m.body >= 0:
        raw = read[m.body]
    p = press(m, body, start, start, its, its)
    mine = pose_in_row(body, start, m.row, m.slot)
    add_held(wanted, by_read, m, m.slot, mine, raw, grip[i], p, start)
    if m.other >= 0:
        its = pose_in_row(body, start, m.row, m.other)
    add_held(wanted, by_read, m, m.other, its, raw, grip_there[i], p, start)


@wp.kernel
def pass_bristles(
    # In:
    meeting: wp.array(dtype=Meeting),
    source: wp.array(dtype=wp.int32),
    changed: wp.array(dtype=wp.int32),
    wanted: wp.array(dtype=wp.vec3d),
    # Out:
    earlier: wp.array(dtype=wp.vec3d),
):
    """To the contacts of the simulator's step before, of which friction went on, but for rows that
    began anew."""
    i = wp.tid()
    if meeting[i].row < 0 or source[i] < 0:
        return
    if changed[meeting[i].row] == 0:
        wp.atomic_add(earlier, source[i], wanted[i])
