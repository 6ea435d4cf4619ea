"""Contact of a rod's nodes with planes, and Coulomb friction that sticks.

Normal force: zero apart, quadratic over a thin skin, then linear in the penetration p, so that its
slope is continuous. Friction: an elastic bristle between rod and shape carries the load while it
sticks; where the load exceeds mu N the bristle slides on (return mapping, as in elastoplasticity),
so that a node that sticks does not creep however long it is loaded.

While the penetration p grows or shrinks at a rate, the normal force is that of p + tau dp/dt, never
attractive: a Kelvin-Voigt solid, whose tau decides how fast things bounce off each other. In a step
that begins apart only the part in touch counts.

A node that stuck at the end of the last step slides at the static coefficient, one that slid at the
kinetic one: within a step the law is fixed, and Newton converges.
"""

import warp as wp
from wrod.kernels.contact.duals import bristle_stiffness, follow_dual
from wrod.kernels.contact.shapes import PLANE, Shape, shape_displacement
from wrod.kernels.elastic.assembly import (
    add_column,
    add_component,
    add_diagonal_block,
    add_entry,
    add_row,
    add_vector,
)
from wrod.kernels.elastic.frames import HALF, ONE, ZERO, node

wp.set_module_options({"enable_backward": False})

# Way on which a rod meets something in a step of which two-step differences may still reach over
# it, over the radius: what they throw back then is lost in the contact's own give.
IMPACT_WAY = wp.constant(wp.float64(0.1))


@wp.struct
class Touchable:
    """What pieces of rods, nodes or edges, may touch, and how: (rod, shape) shapes, coefficients of
    friction, and those that keep the roll (below 0 where it is free); (rod, piece) radius (an edge
    of radius 0 touches nothing), stiffness, skin, relaxation time; (rod,) 1 where friction turns
    the rod; and how friction varies over x and y, see `friction_factor`. Where shapes move with the
    rods: (rod, shape) weight that one edge is to bear, and (rod, shape, edge) 1 where an edge does
    not touch a shape; otherwise empty. Where others move them by forces: (rod, shape) stiffness
    that all edges may have on its body together (0: any), which body, (body,) edges near it."""

    shapes: wp.array2d(dtype=Shape)
    static_friction: wp.array2d(dtype=wp.float64)
    kinetic_friction: wp.array2d(dtype=wp.float64)
    roll_friction: wp.array2d(dtype=wp.float64)
    radius: wp.array2d(dtype=wp.float64)
    stiffness: wp.array2d(dtype=wp.float64)
    skin: wp.array2d(dtype=wp.float64)
    relaxation: wp.array2d(dtype=wp.float64)
    rest_length: wp.array2d(dtype=wp.float64)
    rolling: wp.array(dtype=wp.float64)
    field: wp.array2d(dtype=wp.float64)
    place: wp.vec4d
    burden: wp.array2d(dtype=wp.float64)
    firmest: wp.array2d(dtype=wp.float64)
    bearer: wp.array2d(dtype=wp.int32)
    near: wp.array(dtype=wp.int32)
    apart: wp.array3d(dtype=wp.int8)


@wp.func
def plane_distance(shape: Shape, q: wp.vec3d) -> wp.vec4d:
    """Signed distance from a plane and its outward normal, in the world frame."""
    n = wp.quat_rotate(shape.rotation, wp.vec3d(ZERO, ZERO, ONE))
    return wp.vec4d(wp.dot(q - shape.position, n), n[0], n[1], n[2])


@wp.func
def normal_force(p: wp.float64, stiffness: wp.float64, skin: wp.float64) -> wp.vec2d:
    """Force at the penetration p and its slope."""
    if p <= ZERO:
        return wp.vec2d(ZERO, ZERO)
    if p < skin:
        return wp.vec2d(HALF * stiffness * p * p / skin, stiffness * p / skin)
    return wp.vec2d(stiffness * (p - HALF * skin), stiffness)


@wp.func
def damped_force(
    depth: wp.float64,
    closing: wp.float64,
    relaxation: wp.float64,
    dt: wp.float64,
    stiffness: wp.float64,
    skin: wp.float64,
) -> wp.vec2d:
    """Force at a penetration that has grown by `closing` in the time dt, and its slope."""
    lag = relaxation / dt
    law = normal_force(depth + lag * wp.min(closing, depth), stiffness, skin)
    return wp.vec2d(law[0], (ONE + lag) * law[1])


@wp.struct
class Touch:
    """Normal force at rest, its slope, depth and by how much it has grown in this step, outward
    normal, stretch of the bristle before return mapping, and the direction in which the rod's
    surface moves when it spins (radius times n x t)."""

    depth: wp.float64
    closing: wp.float64
    force: wp.float64
    slope: wp.float64
    normal: wp.vec3d
    bristle: wp.vec3d
    spin: wp.vec3d


@wp.func
def present_force(
    m: Touchable, depth: wp.float64, closing: wp.float64, dt: wp.float64, r: int, i: int
) -> wp.vec2d:
    """`damped_force` of a piece."""
    return damped_force(depth, closing, m.relaxation[r, i], dt, m.stiffness[r, i], m.skin[r, i])


@wp.func
def coefficient(m: Touchable, sliding: int, r: int, k: int) -> wp.float64:
    """Of friction: what slid goes on sliding at the kinetic one."""
    return wp.where(sliding != 0, m.kinetic_friction[r, k], m.static_friction[r, k])


@wp.func
def mean_angle(dof: wp.array2d(dtype=wp.float64), r: int, i: int) -> wp.float64:
    last = (dof.shape[1] + 1) // 4 - 1
    before = wp.max(i - 1, 0)
    after = wp.min(i, last - 1)
    return HALF * (dof[r, 4 * before + 3] + dof[r, 4 * after + 3])


@wp.func
def touch(
    m: Touchable,
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle_before: wp.vec3d,
    r: int,
    k: int,
    i: int,
) -> Touch:
    """Node i and shape k of rod r."""
    out = Touch()
    shape = m.shapes[r, k]
    if shape.kind != PLANE:
        # Edges touch all else: `wrod.kernels.contact.edges`.
        return out
    q = node(dof, r, i)
    distance = plane_distance(shape, q)
    out.depth = m.radius[r, i] - distance[0]
    law = normal_force(out.depth, m.stiffness[r, i], m.skin[r, i])
    out.force = law[0]
    out.slope = law[1]
    n = wp.vec3d(distance[1], distance[2], distance[3])
    out.normal = n
    if out.force > ZERO:
        last = (dof.shape[1] + 1) // 4 - 1
        along = node(dof, r, wp.min(i + 1, last)) - node(dof, r, wp.max(i - 1, 0))
        out.spin = (m.rolling[r] * m.radius[r, i]) * wp.cross(n, wp.normalize(along))
        spun = mean_angle(dof, r, i) - mean_angle(dof_before, r, i)
        moved = q - node(dof_before, r, i) - shape_displacement(shape, q)
        b = bristle_before + moved + spun * out.spin
        out.bristle = b - wp.dot(b, n) * n
        out.closing = -wp.dot(moved, n)
    return out


@wp.struct
class Bristle:
    """What a bristle holds: its pull and its stiffness (a matrix), and by how much it slides."""

    pull: wp.vec3d
    tangential: wp.mat33d
    slides: wp.float64


@wp.func
def return_mapping(
    bristle: wp.vec3d, normal: wp.vec3d, stiffness: wp.float64, limit: wp.float64
) -> Bristle:
    """Coulomb's return mapping: a bristle of that stretch pulls by `limit` at most."""
    out = Bristle()
    across = wp.identity(3, dtype=wp.float64) - wp.outer(normal, normal)
    k = wp.float64(stiffness)
    size = wp.length(bristle)
    if stiffness * size > limit:
        k = limit / size
        across = across - wp.outer(bristle, bristle) / (size * size)
        out.slides = size - limit / stiffness
    out.pull = k * bristle
    out.tangential = k * across
    return out


@wp.func
def friction_factor(field: wp.array2d(dtype=wp.float64), place: wp.vec4d, q: wp.vec3d) -> wp.vec3d:
    """Bilinear value at q of a field (y, x) over the plane z = 0, and its derivatives by x and y;
    `place` is its first point and its spacing. Constant beyond its border."""
    nx = field.shape[1]
    ny = field.shape[0]
    if nx == 1 and ny == 1:
        return wp.vec3d(field[0, 0], ZERO, ZERO)
    u = (q[0] - place[0]) / place[2]
    v = (q[1] - place[1]) / place[3]
    inside_x = wp.where(u > ZERO and u < wp.float64(nx - 1), ONE, ZERO)
    inside_y = wp.where(v > ZERO and v < wp.float64(ny - 1), ONE, ZERO)
    u = wp.clamp(u, ZERO, wp.float64(nx - 1))
    v = wp.clamp(v, ZERO, wp.float64(ny - 1))
    i = wp.min(int(u), nx - 2)
    j = wp.min(int(v), ny - 2)
    u = u - wp.float64(i)
    v = v - wp.float64(j)
    low = field[j, i] + u * (field[j, i + 1] - field[j, i])
    high = field[j + 1, i] + u * (field[j + 1, i + 1] - field[j + 1, i])
    by_u = (ONE - v) * (field[j, i + 1] - field[j, i])
    by_u += v * (field[j + 1, i + 1] - field[j + 1, i])
    return wp.vec3d(
        low + v * (high - low), inside_x * by_u / place[2], inside_y * (high - low) / place[3]
    )


@wp.kernel
def contact(
    # Model:
    model: Touchable,
    # State in:
    step: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    bristle: wp.array3d(dtype=wp.vec3d),
    sliding: wp.array3d(dtype=wp.int32),
    iteration: wp.array(dtype=wp.int32),
    # State in and out:
    stretch: wp.array3d(dtype=wp.vec3d),
    dual: wp.array3d(dtype=wp.vec3d),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Subtract contact forces from the residual and add their stiffness to the matrix, but for how
    a sliding node's friction depends on its normal force, which is not symmetric. Its dual goes on
    from `iteration` to iteration from what the bristle held; below 0 the step has ended."""
    r, i = wp.tid()
    if active[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        c = touch(model, dof, dof_before, bristle[r, k, i], r, k, i)
        if c.force > ZERO:
            mu = coefficient(model, sliding[r, k, i], r, k)
            mu = mu * friction_factor(model.field, model.place, node(dof, r, i))[0]
            law = present_force(model, c.depth, c.closing, step[r], r, i)
            n = c.normal
            stiffness = model.stiffness[r, i]
            held = return_mapping(c.bristle, n, stiffness, mu * law[0])
            limit = mu * law[0] / stiffness
            w = follow_dual(
                iteration[r], bristle[r, k, i], c.bristle, limit, held.slides > ZERO, stretch,
                dual, r, k, i,
            )  # fmt: skip
            tangential = bristle_stiffness(c.bristle, w, n, stiffness, limit)
            add_vector(gradient, r, 4 * i, held.pull - law[0] * n)
            add_diagonal_block(hessian, r, 4 * i, tangential + law[1] * wp.outer(n, n))
            if model.rolling[r] > ZERO:
                add_spin(gradient, hessian, r, i, c.spin, held.pull, tangential)


@wp.func
def add_spin(
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    r: int,
    i: int,
    spin: wp.vec3d,
    pull: wp.vec3d,
    block: wp.mat33d,
):
    """The torque of friction on the angles of the edges around node i: half each, all at an end."""
    a = 4 * i
    last = gradient.shape[1] // 4
    share = wp.where(i > 0 and i < last, HALF, ONE)
    coupling = share * (block * spin)
    torque = share * wp.dot(pull, spin)
    stiffness = share * wp.dot(coupling, spin)
    if i > 0:
        add_component(gradient, r, a - 1, torque)
        add_entry(hessian, r, a - 1, 0, stiffness)
        add_column(hessian, r, a, a - 1, coupling)
    if i < last:
        add_component(gradient, r, a + 3, torque)
        add_entry(hessian, r, a + 3, 0, stiffness)
        add_row(hessian, r, a + 3, a, coupling)
    if i > 0 and i < last:
        add_entry(hessian, r, a + 3, 4, stiffness)


@wp.kernel
def settle_friction(
    # Model:
    model: Touchable,
    # State in:
    step: wp.array(dtype=wp.float64),
    accepted: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State in and out:
    bristle: wp.array3d(dtype=wp.vec3d),
    sliding: wp.array3d(dtype=wp.int32),
    slip: wp.array2d(dtype=wp.float64),
    # State out:
    force_out: wp.array2d(dtype=wp.vec3d),
):
    """After an accepted step: let overloaded bristles slide, and note forces and slip."""
    r, i = wp.tid()
    if accepted[r] == 0:
        return
    total = wp.vec3d(ZERO, ZERO, ZERO)
    for k in range(model.shapes.shape[1]):
        c = touch(model, dof, dof_before, bristle[r, k, i], r, k, i)
        mu = coefficient(model, sliding[r, k, i], r, k)
        mu = mu * friction_factor(model.field, model.place, node(dof, r, i))[0]
        sliding[r, k, i] = 0
        b = wp.vec3d(ZERO, ZERO, ZERO)
        if c.force > ZERO:
            law = present_force(model, c.depth, c.closing, step[r], r, i)
            held = return_mapping(c.bristle, c.normal, model.stiffness[r, i], mu * law[0])
            if held.slides > ZERO:
                sliding[r, k, i] = 1
                slip[r, i] = slip[r, i] + held.slides
            b = held.pull / model.stiffness[r, i]
            total = total + law[0] * c.normal - held.pull
        bristle[r, k, i] = b
    force_out[r, i] = total


@wp.func
def note_touch(
    touching: wp.array(dtype=wp.int32),
    r: int,
    depth: wp.float64,
    closing: wp.float64,
    radius: wp.float64,
):
    """An impact (2) is what was apart and comes nearer by more than a part of the radius; all else
    that is within reach touches (1)."""
    if closing > depth and closing > IMPACT_WAY * radius:
        wp.atomic_max(touching, r, 2)
    else:
        wp.atomic_max(touching, r, 1)


@wp.kernel
def find_touching(
    # Model:
    model: Touchable,
    # State in:
    chosen: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    dof_before: wp.array2d(dtype=wp.float64),
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether nodes touch a plane (1), and whether in an impact (2)."""
    r, i = wp.tid()
    if chosen[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        c = touch(model, dof, dof_before, wp.vec3d(), r, k, i)
        if c.force > ZERO:
            note_touch(touching_out, r, c.depth, c.closing, model.radius[r, i])


@wp.kernel
def forget_friction(
    # In:
    chosen: wp.array(dtype=wp.int32),
    # State out:
    bristle_out: wp.array3d(dtype=wp.vec3d),
    sliding_out: wp.array3d(dtype=wp.int32),
):
    """Unload the bristles of the chosen rods."""
    r, k, i = wp.tid()
    if chosen[r] != 0:
        bristle_out[r, k, i] = wp.vec3d(ZERO, ZERO, ZERO)
        sliding_out[r, k, i] = 0
