"""Meshes of suspended rods, the shapes that their solver starts from, and shapes of one mesh on
another; a rod a thread."""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO
from wrod.kernels.grasping.contact_edge import first_direction, half_turn
from wrod.kernels.grasping.straight_rod import WEIGHT, point, put_point

# Length over which edges stay short: a fraction of the boundary layer at the contact.
GRADING = wp.constant(wp.float64(0.3))
# Vertical force at the contact of a long rod on a straight pattern.
LONG_FORCE = wp.constant(wp.float64(0.7577))
UPRIGHT = wp.constant(wp.float64(1.5707963267948966))
THREE = wp.constant(wp.float64(3.0))
SIX = wp.constant(wp.float64(6.0))
# Grasps of so many ranges of curvature and of stretch ratio are solved side by side.
CURVATURE_BINS = wp.constant(wp.float64(16.0))
STRETCH_BINS = wp.constant(wp.float64(8.0))
# What rounding leaves unbalanced, over machine precision, and the least that is asked for.
ROUNDING = wp.constant(wp.float64(8.0 * 2.220446049250313e-16))
TOLERANCE = wp.constant(wp.float64(1.0e-9))


@wp.kernel
def lay_mesh(
    # In:
    length: wp.array(dtype=wp.float64),
    stretch_ratio: wp.array(dtype=wp.float64),
    edges: int,
    # Out:
    rest_out: wp.array2d(dtype=wp.float64),
    rest_rate_out: wp.array2d(dtype=wp.float64),
    tolerance_out: wp.array(dtype=wp.float64),
):
    """Rest lengths of a mesh that is fine at the contact, and their rates by the length; see
    `wrod.grasps.mesh.rest_lengths`. The tolerance is what rounding positions leaves: in the
    stiffest edge, over the whole rod, and in the sharpest bend, near the contact."""
    r = wp.tid()
    total = length[r]
    growth = wp.log(ONE + total / GRADING)
    s = wp.float64(0.0)
    s_rate = wp.float64(0.0)
    for i in range(edges):
        xi = wp.float64(i + 1) / wp.float64(edges)
        power = wp.exp(xi * growth)
        end = wp.where(i == edges - 1, total, GRADING * (power - ONE))
        # d/dl of a ((1 + l/a)^xi - 1).
        end_rate = xi * power / (ONE + total / GRADING)
        rest_out[r, i] = end - s
        rest_rate_out[r, i] = end_rate - s_rate
        s = end
        s_rate = end_rate
    h = rest_out[r, 0]
    rounding = stretch_ratio[r] / h * total
    rounding += wp.float64(4.0) / (h * h * h) * wp.min(total, wp.float64(5.0))
    tolerance_out[r] = wp.max(TOLERANCE, ROUNDING * rounding)


@wp.kernel
def hang_straight(
    # In:
    work: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    rest: wp.array2d(dtype=wp.float64),
    edges: int,
    # Out:
    shape_out: wp.array3d(dtype=wp.float64),
    curvature_out: wp.array(dtype=wp.float64),
    thrust_out: wp.array(dtype=wp.float64),
    family_out: wp.array2d(dtype=wp.float64),
):
    """Shape near the grasp of a straight pattern, for Newton's method to start from.

    Integrates theta'' = (F - w s) cos(theta) from the flat contact with the force that a long (or a
    short) rod has, and lets the rod hang straight from where it first stands upright.
    """
    thread = wp.tid()
    if thread >= count[0]:
        return
    r = work[thread]
    length = wp.float64(0.0)
    for i in range(edges):
        length += rest[r, i]
    force = wp.min(LONG_FORCE, WEIGHT * length * HALF)
    theta = wp.float64(0.0)
    rate = wp.float64(0.0)
    s = wp.float64(0.0)
    x = wp.float64(0.0)
    z = wp.float64(0.0)
    upright = int(0)
    put_point(shape_out, r, 0, wp.vec3d(ZERO, ZERO, ZERO))
    for i in range(edges):
        h = rest[r, i]
        theta += HALF * h * rate  # now that of the middle of the edge
        if theta >= UPRIGHT:
            upright = 1
        if upright == 1:
            theta = UPRIGHT
            rate = ZERO
        else:
            rate += h * (force - WEIGHT * (s + HALF * h)) * wp.cos(theta)
        if i > 0:
            x += h * wp.cos(theta)
            z += h * wp.sin(theta)
        else:
            x += h  # the first edge leaves the contact flat
        put_point(shape_out, r, i + 1, wp.vec3d(x, ZERO, z))
        theta += HALF * h * rate
        s += h
    curvature_out[r] = ZERO
    thrust_out[r] = ZERO
    # The family of grasps: at first along the thrust, and as steep as Gauss and Newton have it.
    for i in range(4):
        family_out[r, i] = ZERO
    family_out[r, 4] = ONE
    family_out[r, 5] = ONE


@wp.func
def between(shape: wp.array3d(dtype=wp.float64), r: int, edges: int, i: int) -> wp.vec3d:
    """Point at index i / 2, by cubics in the index."""
    j = i // 2
    if i % 2 == 0:
        return point(shape, r, j)
    # Four neighbours around the middle; at the ends the nearest four.
    first = wp.clamp(j - 1, 0, edges - 3)
    x = wp.float64(j - first) + HALF
    y = x - ONE
    z = x - TWO
    w = x - THREE
    value = (-y * z * w / SIX) * point(shape, r, first)
    value += (HALF * x * z * w) * point(shape, r, (first + 1))
    value += (-HALF * x * y * w) * point(shape, r, (first + 2))
    value += (x * y * z / SIX) * point(shape, r, (first + 3))
    return value


@wp.func
def lead_off(
    r: int,
    rest: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    family: wp.array2d(dtype=wp.float64),
    # Out:
    shape: wp.array3d(dtype=wp.float64),
    family_out: wp.array2d(dtype=wp.float64),
):
    """Where the contact's curvature leads the first edge on a new mesh, and the same family."""
    length = wp.length(point(shape, r, 1))
    put_point(shape, r, 1, length * first_direction(half_turn(curvature[r], rest[r, 0])))
    for i in range(6):
        family_out[r, i] = family[r, i]


@wp.kernel
def refine(
    # In:
    work: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    shape: wp.array3d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    thrust: wp.array(dtype=wp.float64),
    family: wp.array2d(dtype=wp.float64),
    # Solved on half the edges as well, or 0:
    ahead: int,
    coarse: wp.array3d(dtype=wp.float64),
    coarse_thrust: wp.array(dtype=wp.float64),
    # Out:
    shape_out: wp.array3d(dtype=wp.float64),
    curvature_out: wp.array(dtype=wp.float64),
    thrust_out: wp.array(dtype=wp.float64),
    family_out: wp.array2d(dtype=wp.float64),
):
    """Guess on a mesh of twice the edges. Errors fall by four from mesh to mesh: where two are
    solved, a third of their difference, over four, goes on top."""
    thread = wp.tid()
    if thread >= count[0]:
        return
    r = work[thread]
    share = wp.float64(0.25)
    for i in range(2 * edges + 1):
        x = between(shape, r, edges, i)
        if ahead != 0:
            # The difference lives on every fourth node, and is smooth: linear in between.
            a = i // 4
            b = wp.min(a + 1, edges // 2)
            f = wp.float64(i - 4 * a) * share
            before = point(shape, r, 2 * a) - point(coarse, r, a)
            after = point(shape, r, 2 * b) - point(coarse, r, b)
            x = x + share * ((ONE - f) * before + f * after)
        put_point(shape_out, r, i, x)
    pull = thrust[r]
    if ahead != 0:
        pull += share * (pull - coarse_thrust[r])
    thrust_out[r] = pull
    curvature_out[r] = curvature[r]
    lead_off(r, rest, curvature, family, shape_out, family_out)


@wp.kernel
def coarsen(
    # In:
    work: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    shape: wp.array3d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    thrust: wp.array(dtype=wp.float64),
    family: wp.array2d(dtype=wp.float64),
    # Out:
    shape_out: wp.array3d(dtype=wp.float64),
    curvature_out: wp.array(dtype=wp.float64),
    thrust_out: wp.array(dtype=wp.float64),
    family_out: wp.array2d(dtype=wp.float64),
):
    """Guess on a mesh of half the edges: every other node."""
    thread = wp.tid()
    if thread >= count[0]:
        return
    r = work[thread]
    for i in range(edges // 2 + 1):
        put_point(shape_out, r, i, point(shape, r, 2 * i))
    thrust_out[r] = thrust[r]
    curvature_out[r] = curvature[r]
    lead_off(r, rest, curvature, family, shape_out, family_out)


@wp.kernel
def list_unsolved(
    # In:
    status: wp.array(dtype=wp.int32),
    other_status: wp.array(dtype=wp.int32),
    wanted: int,
    # Out:
    work_out: wp.array(dtype=wp.int32),
    count_out: wp.array(dtype=wp.int32),
):
    """Rods whose status is not the wanted one on both meshes. Their order is of no consequence."""
    r = wp.tid()
    if status[r] != wanted or other_status[r] != wanted:
        work_out[wp.atomic_add(count_out, 0, 1)] = r


@wp.func
def share_of(value: wp.float64, least: wp.float64, most: wp.float64) -> wp.float64:
    """Where a value lies between two others on a logarithmic scale, within 0 ... 1."""
    return wp.clamp(wp.log(value / least) / wp.log(most / least), ZERO, ONE)


@wp.kernel
def expect_work(
    # In:
    length: wp.array(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    stretch_ratio: wp.array(dtype=wp.float64),
    first: int,
    # Out:
    key_out: wp.array(dtype=wp.float32),
    order_out: wp.array(dtype=wp.int32),
):
    """Rows `first` on, and keys that bring those of about the same number of iterations together,
    most first: neighbouring threads of a GPU wait for each other. By curvature in coarse bins, in
    each by stretch ratio in coarse bins, in each by length; over the studied range."""
    r = wp.tid()
    row = first + r
    bend = wp.floor(
        CURVATURE_BINS * wp.min(wp.abs(curvature[row]) / wp.float64(3.5), wp.float64(0.999))
    )
    stiff = wp.floor(
        STRETCH_BINS
        * wp.float64(0.999)
        * share_of(stretch_ratio[row], wp.float64(150.0), wp.float64(15000.0))
    )
    long = wp.float64(0.999) * share_of(length[row], ONE, wp.float64(50.0))
    key_out[r] = wp.float32(long - STRETCH_BINS * bend - stiff)
    order_out[r] = row


@wp.kernel
def take_inputs(
    # In:
    length: wp.array(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    stretch_ratio: wp.array(dtype=wp.float64),
    order: wp.array(dtype=wp.int32),
    rods: int,
    # Out:
    length_out: wp.array(dtype=wp.float64),
    stretch_ratio_out: wp.array(dtype=wp.float64),
    target_out: wp.array(dtype=wp.float64),
    weight_out: wp.array(dtype=wp.float64),
    work_out: wp.array(dtype=wp.int32),
    count_out: wp.array(dtype=wp.int32),
):
    """Inputs in the order of work; right turns are solved as left turns of the mirrored rod."""
    r = wp.tid()
    row = order[r]
    length_out[r] = length[row]
    stretch_ratio_out[r] = stretch_ratio[row]
    target_out[r] = wp.abs(curvature[row])
    weight_out[r] = WEIGHT * length[row]
    work_out[r] = r
    if r == 0:
        count_out[0] = rods
