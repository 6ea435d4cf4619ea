"""Where rigid bodies that move with rods meet each other and whatever else a simulator's collision
detection finds.

A contact is a pair of points, each fixed to its body for the step, and a normal from the first body
to the second; the first one moves with rods.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO
from wrod.kernels.stepping.bodies import Body, BodyMotion
from wrod.kernels.stepping.carrying import Pose, as_pose, from_pose, on_the_way

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
def pose_in_row(body: wp.array2d(dtype=Body), x: BodyMotion, r: int, s: int) -> Pose:
    out = Pose()
    out.rotation = x.turn[r, s]
    out.position = x.place[r, s] - wp.quat_rotate(out.rotation, body[r, s].centre)
    return out


@wp.func
def into_pose(x: Pose, p: wp.vec3d) -> wp.vec3d:
    return wp.quat_rotate_inv(x.rotation, p - x.position)


@wp.func
def where_met(m: Meeting, point: wp.vec3d, point_there: wp.vec3d) -> wp.vec3d:
    """Where bodies press whose points are there. What is round stays above it as it rolls on."""
    if m.reach_there > m.reach:
        return point_there - m.reach_there * m.normal
    return point + m.reach * m.normal


@wp.func
def entry(table: wp.array(dtype=wp.int32), i: int) -> int:
    if i < 0:
        return -1
    return table[i]


@wp.kernel
def read_contacts(
    # Model:
    owned: Owned,
    own: wp.array2d(dtype=Body),
    # State in:
    detected: Detected,
    capacity: int,
    now: BodyMotion,
    body_q: wp.array(dtype=wp.transform),
    before: wp.array(dtype=Meeting),
    bristle_before: wp.array(dtype=wp.vec3d),
    # State out:
    meeting_out: wp.array(dtype=Meeting),
    bristle_out: wp.array(dtype=wp.vec3d),
    source_out: wp.array(dtype=wp.int32),
):
    """Take contacts of our bodies up; friction goes on from the nearest one of the same shapes
    (`source`, -1: from none)."""
    i = wp.tid()
    m = Meeting()
    m.row = -1
    source_out[i] = -1
    bristle_out[i] = wp.vec3d(ZERO, ZERO, ZERO)
    if i >= wp.min(detected.count[0], capacity):
        meeting_out[i] = m
        return
    shape = detected.shape0[i]
    there = detected.shape1[i]
    point = wp.vec3d(detected.point0[i])
    point_there = wp.vec3d(detected.point1[i])
    reach = wp.float64(detected.margin0[i])
    reach_there = wp.float64(detected.margin1[i])
    normal = wp.normalize(wp.vec3d(detected.normal[i]))
    body = entry(detected.shape_body, shape)
    if entry(owned.slot, body) < 0:
        shape = detected.shape1[i]
        there = detected.shape0[i]
        point = wp.vec3d(detected.point1[i])
        point_there = wp.vec3d(detected.point0[i])
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
    mine = pose_in_row(own, now, m.row, m.slot)
    its = pose_of(body_q, m.body)
    if m.other >= 0:
        its = pose_in_row(own, now, m.row, m.other)
    place = where_met(m, from_pose(mine, point), from_pose(its, point_there))
    m.grip = into_pose(mine, place)
    m.grip_there = into_pose(its, place)
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
    source_out[i] = nearest
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
