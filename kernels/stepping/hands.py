"""Hands that hold single edges of rods and carry them from key to key, every rod's at its own pace.

A step ends at every key: there hands feel what they hold, and lose what pulls too hard.
"""

import warp as wp
from wrod.kernels.elastic.frames import ONE, TWO, ZERO, angle_towards
from wrod.kernels.stepping.pace import Pace

THREE = wp.constant(wp.float64(3.0))


@wp.struct
class Timetable:
    """Keys at which hands are told where to be: their times (key,), the one (rod,) at which a rod
    stops, the one that it has reached, and whether it did so in this round."""

    times: wp.array(dtype=wp.float64)
    last: wp.array(dtype=wp.int32)
    reached: wp.array(dtype=wp.int32)
    arrived: wp.array(dtype=wp.int32)


@wp.struct
class PullApart:
    """Two hands that pull apart until both feel `load`, wait `settle`, and keep it up for `hold`.

    Of every hand (hand,): where it starts, its direction, its share of the faster one's way, and
    the height below which it does not go. `misses` (rod, hand, tick) is by how much it is off its
    place, over and over; `carried` (rod, hand) from the hand to the point that it holds. Hands go
    up by `lift` over a way of `rise`; `speed` is the faster one's, less within `band` of `above`
    times the load; `length` the longest way. The rest is (rod,): see `wrod.knots.pull`.
    """

    start: wp.array(dtype=wp.vec3d)
    direction: wp.array(dtype=wp.vec3d)
    share: wp.array(dtype=wp.float64)
    floor: wp.array(dtype=wp.float64)
    misses: wp.array3d(dtype=wp.vec3d)
    carried: wp.array2d(dtype=wp.vec3d)
    load: wp.float64
    settle: wp.float64
    hold: wp.float64
    above: wp.float64
    band: wp.float64
    lift: wp.float64
    rise: wp.float64
    speed: wp.float64
    length: wp.float64
    way: wp.array(dtype=wp.float64)
    pace: wp.array(dtype=wp.float64)
    strongest: wp.array(dtype=wp.float64)
    lowest: wp.array(dtype=wp.float64)
    tight_at: wp.array(dtype=wp.float64)
    tight_way: wp.array(dtype=wp.float64)
    kept: wp.array(dtype=wp.int32)


@wp.kernel
def carry(
    # Model: (rod, hand) and keys (rod, hand, key); the hand's point is at this part of its edge
    rest_length: wp.array2d(dtype=wp.float64),
    edge: wp.array2d(dtype=wp.int32),
    part: wp.array2d(dtype=wp.float64),
    times: wp.array(dtype=wp.float64),
    position: wp.array3d(dtype=wp.vec3d),
    rotation: wp.array3d(dtype=wp.quatd),
    free: wp.array2d(dtype=wp.int32),
    # State in:
    running: wp.array(dtype=wp.int32),
    time: wp.array(dtype=wp.float64),
    step: wp.array(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    tangent_before: wp.array2d(dtype=wp.vec3d),
    director_before: wp.array2d(dtype=wp.vec3d),
    # State out:
    dof_out: wp.array2d(dtype=wp.float64),
):
    """Put every held edge where its hand is at the end of the step: its point at the position, its
    tangent along the hand's x axis, its first material director along the y axis. What is free of
    it stays as it is."""
    r, h = wp.tid()
    e = edge[r, h]
    if running[r] == 0 or e < 0:
        return
    now = time[r] + step[r]
    k = wp.clamp(wp.lower_bound(times, now) - 1, 0, times.shape[0] - 2)
    x = wp.clamp((now - times[k]) / (times[k + 1] - times[k]), ZERO, ONE)
    point = wp.lerp(position[r, h, k], position[r, h, k + 1], x)
    turn = wp.quat_slerp(rotation[r, h, k], rotation[r, h, k + 1], x)
    tangent = wp.quat_rotate(turn, wp.vec3d(ONE, ZERO, ZERO))
    side = wp.quat_rotate(turn, wp.vec3d(ZERO, ONE, ZERO))
    along = rest_length[r, e] * tangent
    head = point - part[r, h] * along
    tail = point + (ONE - part[r, h]) * along
    a = 4 * e
    if free[r, a + 3] == 0:
        dof_out[r, a + 3] = angle_towards(
            side, tangent, dof_before[r, a + 3], tangent_before[r, e], director_before[r, e]
        )
    for c in range(3):
        if free[r, a + c] == 0:
            dof_out[r, a + c] = head[c]
        if free[r, a + 4 + c] == 0:
            dof_out[r, a + 4 + c] = tail[c]


@wp.func
def load_of(reaction: wp.array2d(dtype=wp.float64), r: int, e: int) -> wp.float64:
    """Force with which a hand holds an edge against slipping out; one that presses it on the table
    holds it the better."""
    force = wp.vec3d()
    for c in range(3):
        force[c] = reaction[r, 4 * e + c] + reaction[r, 4 * e + 4 + c]
    force[2] = wp.max(force[2], ZERO)
    return wp.length(force)


@wp.kernel
def arrive(
    # Model: the degrees of freedom that are free where no hand holds them
    loose: wp.array2d(dtype=wp.int32),
    strength: wp.array2d(dtype=wp.float64),
    # State in:
    reaction: wp.array2d(dtype=wp.float64),
    # State in and out:
    course: Timetable,
    pace: Pace,
    edge: wp.array2d(dtype=wp.int32),
    # State out:
    load_out: wp.array2d(dtype=wp.float64),
    free_out: wp.array2d(dtype=wp.int32),
):
    """What hands feel at a key, and lose; and the rod goes on to the next."""
    r = wp.tid()
    k = course.reached[r] + 1
    course.arrived[r] = 0
    if pace.running[r] != 0 or pace.diverged[r] != 0 or k > course.last[r]:
        return
    course.arrived[r] = 1
    course.reached[r] = k
    for h in range(edge.shape[1]):
        e = edge[r, h]
        load = ZERO
        if e >= 0:
            load = load_of(reaction, r, e)
        if load > strength[r, h]:
            load = ZERO
            edge[r, h] = -1
            for a in range(4 * e, 4 * e + 7):
                free_out[r, a] = loose[r, a]
        load_out[r, h] = load
    for h in range(edge.shape[1]):
        if edge[r, h] >= 0:
            for a in range(4 * edge[r, h], 4 * edge[r, h] + 7):
                free_out[r, a] = 0
    if k < course.last[r]:
        pace.until[r] = course.times[k + 1]
        pace.running[r] = 1
        pace.starting[r] = 1


@wp.kernel
def pull(
    # State in:
    edge: wp.array2d(dtype=wp.int32),
    load: wp.array2d(dtype=wp.float64),
    # State in and out:
    course: Timetable,
    pace: Pace,
    pulling: PullApart,
    # State out:
    position_out: wp.array3d(dtype=wp.vec3d),
):
    """Where hands that feel their loads go from the key that a rod has come to."""
    r = wp.tid()
    if course.arrived[r] == 0:
        return
    k = course.reached[r]
    now = course.times[k]
    way = pulling.way[r] + pulling.pace[r] * (now - course.times[k - 1])
    both = load[r, 0]
    ends = way >= pulling.length or k + 1 == course.times.shape[0]
    for h in range(edge.shape[1]):
        both = wp.min(both, load[r, h])
        ends = ends or edge[r, h] < 0
    pulling.way[r] = way
    pulling.strongest[r] = wp.max(pulling.strongest[r], both)
    if both >= pulling.load and not wp.isfinite(pulling.tight_at[r]):
        pulling.tight_at[r] = now
    since = now - pulling.tight_at[r]
    if since >= pulling.settle:
        pulling.lowest[r] = wp.min(pulling.lowest[r], both)
        if not wp.isfinite(pulling.tight_way[r]):
            pulling.tight_way[r] = way
    if since >= pulling.settle + pulling.hold and not ends:
        pulling.kept[r] = 1
        ends = True
    if ends:
        course.last[r] = -1  # whatever key is named next
        pace.running[r] = 0
        pace.starting[r] = 0
        return
    short = (pulling.above * pulling.load - both) / (pulling.band * pulling.load)
    pulling.pace[r] = pulling.speed * wp.clamp(short, -ONE, ONE)
    gone = way + pulling.pace[r] * (course.times[k + 1] - now)
    x = wp.clamp(gone / pulling.rise, ZERO, ONE)
    up = pulling.lift * x * x * (THREE - TWO * x)
    for h in range(edge.shape[1]):
        place = pulling.start[h] + pulling.share[h] * gone * pulling.direction[h]
        place += pulling.misses[r, h, (k + 1) % pulling.misses.shape[2]]
        place[2] = wp.max(place[2] + up, pulling.floor[h])
        position_out[r, h, k + 1] = place + pulling.carried[r, h]


@wp.kernel
def keep_tight(
    # State in:
    course: Timetable,
    pace: Pace,
    pulling: PullApart,
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    tight_out: wp.array2d(dtype=wp.float64),
):
    """Keep configurations when both hands have just come to their load."""
    r, a = wp.tid()
    if course.arrived[r] != 0 and pulling.tight_at[r] == pace.time[r]:
        tight_out[r, a] = dof[r, a]
