"""What a solved grasp is for its user: frame, derivatives by the inputs, judgement.

A rod that is straight at rest is not twisted: its frame comes along it from the contact, where its
z is up, by parallel transport. The grip has no bending moment, so that over the last half edge the
curvature falls linearly to zero and the rod turns by an eighth of an edge times the curvature at
the last inner node.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, parallel_transport
from wrod.kernels.grasping.closures import CONVERGED
from wrod.kernels.grasping.straight_rod import point

FOUR = wp.constant(wp.float64(4.0))
PI = wp.constant(wp.float64(3.141592653589793))
LEAST = wp.constant(wp.float64(1.0e-300))


@wp.func
def rotate_by(vector: wp.vec3d, v: wp.vec3d) -> wp.vec3d:
    """`v` turned by a rotation vector."""
    angle = wp.length(vector)
    if angle < wp.float64(1.0e-12):
        return v + wp.cross(vector, v)
    axis = vector / angle
    c = wp.cos(angle)
    return c * v + wp.sin(angle) * wp.cross(axis, v) + ((ONE - c) * wp.dot(axis, v)) * axis


@wp.func
def rotation_vector(x: wp.vec3d, y: wp.vec3d, z: wp.vec3d) -> wp.vec3d:
    """Of the rotation that takes the axes to x, y, z; no longer than pi."""
    # The quaternion by its largest component (Shepperd 1978).
    trace = x[0] + y[1] + z[2]
    w = ONE + trace
    a = ONE + x[0] - y[1] - z[2]
    b = ONE - x[0] + y[1] - z[2]
    c = ONE - x[0] - y[1] + z[2]
    q = wp.vec4d(ONE, ZERO, ZERO, ZERO)
    if w >= a and w >= b and w >= c:
        q = wp.vec4d(w, y[2] - z[1], z[0] - x[2], x[1] - y[0])
    elif a >= b and a >= c:
        q = wp.vec4d(y[2] - z[1], a, x[1] + y[0], z[0] + x[2])
    elif b >= c:
        q = wp.vec4d(z[0] - x[2], x[1] + y[0], b, y[2] + z[1])
    else:
        q = wp.vec4d(x[1] - y[0], z[0] + x[2], y[2] + z[1], c)
    q = q / wp.length(q)
    if q[0] < ZERO:
        q = -q
    v = wp.vec3d(q[1], q[2], q[3])
    size = wp.length(v)
    if size < wp.float64(1.0e-12):
        return TWO * v
    return (TWO * wp.atan2(size, q[0]) / size) * v


@wp.func
def same_way_round(v: wp.vec3d, like: wp.vec3d) -> wp.vec3d:
    """The rotation vector of the same rotation with no full turn between it and `like`: those of
    two meshes may lie on either side of half a turn."""
    axis = v / wp.max(wp.length(v), LEAST)
    turns = wp.rint(wp.dot(like - v, axis) / (TWO * PI))
    return v + (TWO * PI * turns) * axis


@wp.func
def rotation_vector_rate(vector: wp.vec3d, omega: wp.vec3d) -> wp.vec3d:
    """Rate of a rotation vector at the angular velocity `omega` in the fixed frame."""
    angle = wp.length(vector)
    c = ONE / wp.float64(12.0) + angle * angle / wp.float64(720.0)
    if angle > wp.float64(1.0e-3):
        c = ONE / (angle * angle) - HALF / (angle * wp.tan(HALF * angle))
    k = wp.cross(vector, omega)
    return omega - HALF * k + c * wp.cross(vector, k)


@wp.kernel
def read_straight(
    # In:
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    shape: wp.array3d(dtype=wp.float64),
    # Out:
    rotation_out: wp.array2d(dtype=wp.float64),
    lowest_out: wp.array(dtype=wp.float64),
    turning_out: wp.array(dtype=wp.float64),
):
    """Rotation vector at the grip, lowest node of the rod and its total turning [rad]."""
    r = wp.tid()
    lowest = wp.float64(0.0)
    turning = wp.float64(0.0)
    up = wp.vec3d(ZERO, ZERO, ONE)
    t = wp.normalize(point(shape, r, 1) - point(shape, r, 0))
    before = wp.vec3d(t)
    for j in range(1, edges):
        u = wp.normalize(point(shape, r, j + 1) - point(shape, r, j))
        up = parallel_transport(up, t, u)
        turning += wp.atan2(wp.length(wp.cross(t, u)), wp.dot(t, u))
        lowest = wp.min(lowest, shape[r, j + 1, 2])
        before = t
        t = u
    up = wp.normalize(up - wp.dot(up, t) * t)
    h = rest[r, edges - 2]
    g = rest[r, edges - 1]
    binormal = TWO / (ONE + wp.dot(before, t)) * wp.cross(before, t)
    bend = (g / (FOUR * (h + g))) * binormal
    x = rotate_by(bend, t)
    z = rotate_by(bend, up)
    v = rotation_vector(x, wp.cross(z, x), z)
    for c in range(3):
        rotation_out[r, c] = v[c]
    lowest_out[r] = wp.min(lowest, shape[r, 1, 2])
    turning_out[r] = turning


# Of its own module, as its solver is.
@wp.kernel(module="unique", enable_backward=False)
def read_general(
    # In:
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    natural_curvature: wp.array2d(dtype=wp.vec2d),
    roll: wp.array(dtype=wp.float64),
    state: wp.array3d(dtype=wp.float64),
    # Out:
    rotation_out: wp.array2d(dtype=wp.float64),
    lowest_out: wp.array(dtype=wp.float64),
    turning_out: wp.array(dtype=wp.float64),
    twist_out: wp.array(dtype=wp.float64),
):
    """As `read_straight` for a rod with directors of its own, and the twist from contact to grip;
    of the turning what is more than the rod's own at rest.

    Over the last half edge the curvature falls linearly to the natural one, and the twist goes on
    as it was. The frame stands `roll` before the first director, as at the contact.
    """
    r = wp.tid()
    lowest = wp.float64(0.0)
    turning = wp.float64(0.0)
    twist = wp.float64(0.0)
    t = wp.normalize(point(state, r, 1) - point(state, r, 0))
    before = wp.vec3d(t)
    for j in range(1, edges):
        u = wp.normalize(point(state, r, j + 1) - point(state, r, j))
        turning += wp.atan2(wp.length(wp.cross(t, u)), wp.dot(t, u))
        turning -= HALF * (rest[r, j - 1] + rest[r, j]) * wp.length(natural_curvature[r, j])
        lowest = wp.min(lowest, state[r, j + 1, 2])
        twist += state[r, j, 6]
        before = t
        t = u
    m1 = wp.vec3d(state[r, edges - 1, 3], state[r, edges - 1, 4], state[r, edges - 1, 5])
    m2 = wp.cross(t, m1)
    h = rest[r, edges - 2]
    g = rest[r, edges - 1]
    last = state[r, edges - 1, 6] * g / (h + g)
    inner = TWO / (ONE + wp.dot(before, t)) / (HALF * (h + g)) * wp.cross(before, t)
    natural = natural_curvature[r, edges]
    own = wp.cross(t, natural[0] * m1 + natural[1] * m2)
    bend = HALF * g * own + (g / wp.float64(8.0)) * (inner - own) + last * t
    up = wp.cos(roll[r]) * m1 - wp.sin(roll[r]) * m2
    x = rotate_by(bend, t)
    z = rotate_by(bend, up)
    v = rotation_vector(x, wp.cross(z, x), z)
    for c in range(3):
        rotation_out[r, c] = v[c]
    lowest_out[r] = wp.min(lowest, state[r, 1, 2])
    turning_out[r] = turning
    twist_out[r] = twist + last


@wp.func
def rotation_rate(
    rest: wp.array2d(dtype=wp.float64),
    rest_rate: wp.array2d(dtype=wp.float64),
    shape: wp.array3d(dtype=wp.float64),
    motion: wp.array3d(dtype=wp.float64),
    vector: wp.vec3d,
    r: int,
    slot: int,
    edges: int,
    along_length: wp.float64,
) -> wp.vec3d:
    """Rate of the rotation vector at the grip when the nodes move by `motion`.

    Frames that are carried along in time spin with their tangent; what twist that would bring
    between two edges, the later one turns back about its own tangent.
    """
    spin = wp.float64(0.0)
    t = wp.vec3d(ONE, ZERO, ZERO)
    t_rate = wp.vec3d(ZERO, ZERO, ZERO)
    before = wp.vec3d(ZERO, ZERO, ZERO)
    before_rate = wp.vec3d(ZERO, ZERO, ZERO)
    for j in range(edges):
        e = point(shape, r, j + 1) - point(shape, r, j)
        length = wp.length(e)
        before = t
        before_rate = t_rate
        t = e / length
        e_rate = (point(motion, slot, j + 1) - point(motion, slot, j)) / length
        t_rate = e_rate - wp.dot(e_rate, t) * t
        if j > 0:
            half = wp.cross(before, t) / (ONE + wp.dot(before, t))
            spin -= wp.dot(half, before_rate + t_rate)
    chi = ONE + wp.dot(before, t)
    chi_rate = wp.dot(before_rate, t) + wp.dot(before, t_rate)
    binormal = TWO / chi * wp.cross(before, t)
    turning = wp.cross(before_rate, t) + wp.cross(before, t_rate)
    binormal_rate = (TWO * turning - chi_rate * binormal) / chi
    h = rest[r, edges - 2]
    g = rest[r, edges - 1]
    h_rate = along_length * rest_rate[r, edges - 2]
    g_rate = along_length * rest_rate[r, edges - 1]
    fraction = g / (FOUR * (h + g))
    fraction_rate = (g_rate - g * (h_rate + g_rate) / (h + g)) / (FOUR * (h + g))
    bend = fraction * binormal
    bend_rate = fraction_rate * binormal + fraction * binormal_rate
    # Angular velocity of exp(bend): its left Jacobian's series, exact to the bend's third power.
    across = wp.cross(bend, bend_rate)
    omega = bend_rate + HALF * across + wp.cross(bend, across) / wp.float64(6.0)
    omega = omega + rotate_by(bend, wp.cross(t, t_rate) + spin * t)
    return rotation_vector_rate(vector, omega)


@wp.struct
class Level:
    """What is read from the grasps of one mesh."""

    shape: wp.array3d(dtype=wp.float64)
    rotation: wp.array2d(dtype=wp.float64)
    force: wp.array2d(dtype=wp.float64)
    jacobian: wp.array2d(dtype=wp.float64)
    # (rod, 27) derivatives of position, rotation and force by the inputs, or empty.
    rates: wp.array2d(dtype=wp.float64)
    lowest: wp.array(dtype=wp.float64)
    turning: wp.array(dtype=wp.float64)
    status: wp.array(dtype=wp.int32)
    iterations: wp.array(dtype=wp.int32)
    negative: wp.array(dtype=wp.int32)
    residual: wp.array(dtype=wp.float64)


@wp.struct
class Results:
    """`Grasps`' arrays on the device."""

    position: wp.array2d(dtype=wp.float64)
    rotation: wp.array2d(dtype=wp.float64)
    force: wp.array2d(dtype=wp.float64)
    force_jacobian: wp.array3d(dtype=wp.float64)
    position_sensitivity: wp.array3d(dtype=wp.float64)
    rotation_sensitivity: wp.array3d(dtype=wp.float64)
    force_sensitivity: wp.array3d(dtype=wp.float64)
    # Empty unless asked for, as the sensitivities.
    shape: wp.array3d(dtype=wp.float64)
    arc_length: wp.array2d(dtype=wp.float64)
    converged: wp.array(dtype=wp.bool)
    stable: wp.array(dtype=wp.bool)
    iterations: wp.array(dtype=wp.int32)
    residual: wp.array(dtype=wp.float64)


@wp.func
def mirrored(i: int, flip: wp.float64, axial: int) -> wp.float64:
    """Sign of component i in the mirror y -> -y: of vectors, and of rotation vectors (axial)."""
    if (i == 1) != (axial == 1):
        return flip
    return ONE


@wp.kernel
def judge(
    # In:
    coarse: Level,
    fine: Level,
    extrapolate: int,
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    order: wp.array(dtype=wp.int32),
    # Out:
    out: Results,
):
    """Combine both meshes (Richardson) into the results' rows, mirror right turns, and
    say which are results: admissible, stable and on the gentle branch."""
    r = wp.tid()
    row = order[r]
    c = wp.float64(0.0)
    f = wp.float64(1.0)
    if extrapolate != 0:
        c = -ONE / wp.float64(3.0)
        f = FOUR / wp.float64(3.0)
    flip = wp.where(curvature[row] < ZERO, -ONE, ONE)
    fine_vector = wp.vec3d(fine.rotation[r, 0], fine.rotation[r, 1], fine.rotation[r, 2])
    coarse_vector = wp.vec3d(coarse.rotation[r, 0], coarse.rotation[r, 1], coarse.rotation[r, 2])
    vector = f * fine_vector + c * same_way_round(coarse_vector, fine_vector)
    up = f * fine.force[r, 2] + c * coarse.force[r, 2]
    for i in range(3):
        p = mirrored(i, flip, 0)
        a = mirrored(i, flip, 1)
        out.position[row, i] = p * (
            f * fine.shape[r, edges, i] + c * coarse.shape[r, edges // 2, i]
        )
        out.rotation[row, i] = a * vector[i]
        out.force[row, i] = p * (f * fine.force[r, i] + c * coarse.force[r, i])
        for j in range(3):
            k = 3 * i + j
            value = f * fine.jacobian[r, k] + c * coarse.jacobian[r, k]
            out.force_jacobian[row, i, j] = p * mirrored(j, flip, 0) * value
            if fine.rates.shape[0] > 0:
                by = wp.where(j == 1, flip, ONE)
                value = f * fine.rates[r, k] + c * coarse.rates[r, k]
                out.position_sensitivity[row, i, j] = p * by * value
                value = f * fine.rates[r, 9 + k] + c * coarse.rates[r, 9 + k]
                out.rotation_sensitivity[row, i, j] = a * by * value
                value = f * fine.rates[r, 18 + k] + c * coarse.rates[r, 18 + k]
                out.force_sensitivity[row, i, j] = p * by * value
    if out.shape.shape[0] > 0:
        s = wp.float64(0.0)
        for j in range(edges):
            out.arc_length[row, j] = s
            s += rest[r, j]
        out.arc_length[row, edges] = s
        for j in range(edges + 1):
            for i in range(3):
                out.shape[row, j, i] = mirrored(i, flip, 0) * fine.shape[r, j, i]
    solved = fine.status[r] == CONVERGED and coarse.status[r] == CONVERGED
    stable = fine.negative[r] == 0
    gentle = fine.turning[r] < TWO * PI and fine.lowest[r] > wp.float64(-1.0e-6) and up > ZERO
    out.converged[row] = solved and stable and gentle
    out.stable[row] = stable
    out.iterations[row] = fine.iterations[r]
    out.residual[row] = fine.residual[r]
