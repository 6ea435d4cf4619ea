"""Frames of a discrete rod: parallel transport, reference frames, reference twist.

The degrees of freedom of a rod with n nodes are one row `[q_0, theta^0, q_1, ..., theta^(n-2),
q_(n-1)]` of length 4n - 1 (Bergou et al. 2010): node i starts at column 4 i, the angle of edge i
stands at 4 i + 3. Edge i runs from node i to node i + 1.
"""

import warp as wp

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
TWO = wp.constant(wp.float64(2.0))
HALF = wp.constant(wp.float64(0.5))


@wp.func
def node(dof: wp.array2d(dtype=wp.float64), r: int, i: int) -> wp.vec3d:
    return wp.vec3d(dof[r, 4 * i], dof[r, 4 * i + 1], dof[r, 4 * i + 2])


@wp.func
def put_node(dof: wp.array2d(dtype=wp.float64), r: int, i: int, q: wp.vec3d):
    for c in range(3):
        dof[r, 4 * i + c] = q[c]


@wp.func
def edge(dof: wp.array2d(dtype=wp.float64), r: int, i: int) -> wp.vec3d:
    return node(dof, r, i + 1) - node(dof, r, i)


@wp.func
def parallel_transport(v: wp.vec3d, t: wp.vec3d, u: wp.vec3d) -> wp.vec3d:
    """Turn `v` by the smallest rotation that takes the unit vector `t` to the unit vector `u`."""
    axis = wp.cross(t, u)
    cosine = wp.dot(t, u)
    # 1/(1 + cos) is (1 - cos)/sin^2 without the cancellation; it grows only for a fold by 180 deg,
    # where the rotation is not unique and any finite answer serves.
    factor = ONE / wp.max(ONE + cosine, wp.float64(1.0e-12))
    return cosine * v + wp.cross(axis, v) + (factor * wp.dot(axis, v)) * axis


@wp.func
def signed_angle(v: wp.vec3d, w: wp.vec3d, axis: wp.vec3d) -> wp.float64:
    """Angle from `v` to `w` about the unit vector `axis`, in (-pi, pi]."""
    return wp.atan2(wp.dot(axis, wp.cross(v, w)), wp.dot(v, w))


@wp.func
def rotate(v: wp.vec3d, axis: wp.vec3d, angle: wp.float64) -> wp.vec3d:
    """Turn `v`, perpendicular to the unit vector `axis`, by `angle` about it."""
    return wp.cos(angle) * v + wp.sin(angle) * wp.cross(axis, v)


@wp.func
def angle_towards(
    aim: wp.vec3d,
    tangent: wp.vec3d,
    angle: wp.float64,
    tangent_before: wp.vec3d,
    director_before: wp.vec3d,
) -> wp.float64:
    """Angle at which an edge that has come to `tangent` has its first material director along
    `aim`; continuous with `angle` beyond a turn."""
    carried = parallel_transport(director_before, tangent_before, tangent)
    return angle + signed_angle(rotate(carried, tangent, angle), aim, tangent)


@wp.kernel
def transport_reference_frames(
    # State in:
    active: wp.array(dtype=wp.int32),
    dof_in: wp.array2d(dtype=wp.float64),
    tangent_in: wp.array2d(dtype=wp.vec3d),
    director_in: wp.array2d(dtype=wp.vec3d),
    # State out:
    tangent_out: wp.array2d(dtype=wp.vec3d),
    director_out: wp.array2d(dtype=wp.vec3d),
):
    """Time-parallel transport: carry each edge's reference director to its new tangent."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    t = wp.normalize(edge(dof_in, r, i))
    d = parallel_transport(director_in[r, i], tangent_in[r, i], t)
    d = d - wp.dot(d, t) * t  # rounding must not build up over thousands of steps
    tangent_out[r, i] = t
    director_out[r, i] = wp.normalize(d)


@wp.kernel
def reference_twist(
    # State in:
    active: wp.array(dtype=wp.int32),
    tangent_in: wp.array2d(dtype=wp.vec3d),
    director_in: wp.array2d(dtype=wp.vec3d),
    twist_in: wp.array2d(dtype=wp.float64),
    # State out:
    twist_out: wp.array2d(dtype=wp.float64),
):
    """Angle of the reference frames across node i + 1, continuous with `twist_in` beyond a turn."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    u = tangent_in[r, i + 1]
    carried = parallel_transport(director_in[r, i], tangent_in[r, i], u)
    before = rotate(carried, u, twist_in[r, i + 1])
    twist_out[r, i + 1] = twist_in[r, i + 1] + signed_angle(before, director_in[r, i + 1], u)


@wp.kernel
def set_configuration(
    # In:
    position: wp.array2d(dtype=wp.vec3d),
    angle: wp.array2d(dtype=wp.float64),
    # Out:
    dof_out: wp.array2d(dtype=wp.float64),
):
    r, i = wp.tid()
    put_node(dof_out, r, i, position[r, i])
    if i < position.shape[1] - 1:
        dof_out[r, 4 * i + 3] = angle[r, i]


@wp.func
def across(t: wp.vec3d) -> wp.vec3d:
    """Some vector that is well away from the direction of `t`."""
    if wp.abs(t[0]) <= wp.abs(t[1]) and wp.abs(t[0]) <= wp.abs(t[2]):
        return wp.vec3d(ONE, ZERO, ZERO)
    if wp.abs(t[1]) <= wp.abs(t[2]):
        return wp.vec3d(ZERO, ONE, ZERO)
    return wp.vec3d(ZERO, ZERO, ONE)


# Where directors come from: anywhere across the first edge, given for it, given for every edge.
ANY_DIRECTOR = wp.constant(0)
FIRST_DIRECTOR = wp.constant(1)
EVERY_DIRECTOR = wp.constant(2)


@wp.kernel
def set_reference_frames(
    # In:
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    source: int,
    # Out:
    tangent_out: wp.array2d(dtype=wp.vec3d),
    director_out: wp.array2d(dtype=wp.vec3d),
    problem_out: wp.array(dtype=wp.int32),
):
    """Frames of a new configuration: directors as given, or carried along the rod without twist.

    `problem_out` is 1 where neighbouring nodes coincide, 2 where a director is along its edge.
    """
    r = wp.tid()
    for i in range(tangent_out.shape[1]):
        e = edge(dof, r, i)
        length = wp.length(e)
        if not (length > ZERO):
            problem_out[r] = 1
        t = e / length
        d = t
        if source == EVERY_DIRECTOR:
            d = director[r, i]
        elif i > 0:
            d = parallel_transport(director_out[r, i - 1], tangent_out[r, i - 1], t)
        elif source == FIRST_DIRECTOR:
            d = director[r, 0]
        else:
            d = wp.cross(t, across(t))
        d = d - wp.dot(d, t) * t
        size = wp.length(d)
        if not (size > wp.float64(1.0e-9)) and problem_out[r] == 0:
            problem_out[r] = 2
        tangent_out[r, i] = t
        director_out[r, i] = d / size
