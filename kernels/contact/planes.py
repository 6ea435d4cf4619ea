"""Contact of a rod's nodes with planes, by the law of `wrod.kernels.contact.law`."""

import warp as wp
from wrod.kernels.contact.duals import bristle_stiffness, follow_dual
from wrod.kernels.contact.law import (
    ContactStep,
    Touchable,
    coefficient,
    friction_factor,
    normal_force,
    note_touch,
    present_force,
    return_mapping,
)
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


@wp.func
def plane_distance(shape: Shape, q: wp.vec3d) -> wp.vec4d:
    """Signed distance from a plane and its outward normal, in the world frame."""
    n = wp.quat_rotate(shape.rotation, wp.vec3d(ZERO, ZERO, ONE))
    return wp.vec4d(wp.dot(q - shape.position, n), n[0], n[1], n[2])


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
def mean_angle(dof: wp.array2d(dtype=wp.float64), r: int, i: int) -> wp.float64:
    last = (dof.shape[1] + 1) // 4 - 1
    before = wp.max(i - 1, 0)
    after = wp.min(i, last - 1)
    return HALF * (dof[r, 4 * before + 3] + dof[r, 4 * after + 3])


@wp.func
def touch(m: Touchable, step: ContactStep, r: int, k: int, i: int) -> Touch:
    """Node i and shape k of rod r."""
    out = Touch()
    shape = m.shapes[r, k]
    if shape.kind != PLANE:
        # Edges touch all else: `wrod.kernels.contact.edges`.
        return out
    q = node(step.dof, r, i)
    distance = plane_distance(shape, q)
    out.depth = m.radius[r, i] - distance[0]
    law = normal_force(out.depth, m.stiffness[r, i], m.skin[r, i])
    out.force = law[0]
    out.slope = law[1]
    n = wp.vec3d(distance[1], distance[2], distance[3])
    out.normal = n
    if out.force > ZERO:
        last = (step.dof.shape[1] + 1) // 4 - 1
        along = node(step.dof, r, wp.min(i + 1, last)) - node(step.dof, r, wp.max(i - 1, 0))
        out.spin = (m.rolling[r] * m.radius[r, i]) * wp.cross(n, wp.normalize(along))
        spun = mean_angle(step.dof, r, i) - mean_angle(step.dof_before, r, i)
        moved = q - node(step.dof_before, r, i) - shape_displacement(shape, q)
        b = step.bristle[r, k, i] + moved + spun * out.spin
        out.bristle = b - wp.dot(b, n) * n
        out.closing = -wp.dot(moved, n)
    return out


@wp.kernel
def contact(
    # Model:
    model: Touchable,
    # State in and out:
    step: ContactStep,
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
):
    """Subtract contact forces from the residual and add their stiffness to the matrix, but for how
    a sliding node's friction depends on its normal force, which is not symmetric."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        c = touch(model, step, r, k, i)
        if c.force > ZERO:
            mu = coefficient(model, step.sliding[r, k, i], r, k)
            mu = mu * friction_factor(model.field, model.place, node(step.dof, r, i))[0]
            law = present_force(model, c.depth, c.closing, step.span[r], r, i)
            n = c.normal
            stiffness = model.stiffness[r, i]
            held = return_mapping(c.bristle, n, stiffness, mu * law[0])
            limit = mu * law[0] / stiffness
            w = follow_dual(step, c.bristle, limit, held.slides > ZERO, r, k, i)
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
    # State in and out:
    step: ContactStep,
    slip: wp.array2d(dtype=wp.float64),
    # State out:
    force_out: wp.array2d(dtype=wp.vec3d),
):
    """After an accepted step: let overloaded bristles slide, and note forces and slip."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    total = wp.vec3d(ZERO, ZERO, ZERO)
    for k in range(model.shapes.shape[1]):
        c = touch(model, step, r, k, i)
        mu = coefficient(model, step.sliding[r, k, i], r, k)
        mu = mu * friction_factor(model.field, model.place, node(step.dof, r, i))[0]
        step.sliding[r, k, i] = 0
        b = wp.vec3d(ZERO, ZERO, ZERO)
        if c.force > ZERO:
            law = present_force(model, c.depth, c.closing, step.span[r], r, i)
            held = return_mapping(c.bristle, c.normal, model.stiffness[r, i], mu * law[0])
            if held.slides > ZERO:
                step.sliding[r, k, i] = 1
                slip[r, i] = slip[r, i] + held.slides
            b = held.pull / model.stiffness[r, i]
            total = total + law[0] * c.normal - held.pull
        step.bristle[r, k, i] = b
    force_out[r, i] = total


@wp.kernel
def find_touching(
    # Model:
    model: Touchable,
    # State in:
    step: ContactStep,
    # State out:
    touching_out: wp.array(dtype=wp.int32),
):
    """Say of the chosen rods whether nodes touch a plane (1), and whether in an impact (2)."""
    r, i = wp.tid()
    if step.active[r] == 0:
        return
    for k in range(model.shapes.shape[1]):
        c = touch(model, step, r, k, i)
        if c.force > ZERO:
            note_touch(touching_out, r, c.depth, c.closing, model.radius[r, i])


@wp.kernel
def forget_friction(
    # State in:
    chosen: wp.array(dtype=wp.int32),
    # State out:
    step: ContactStep,
):
    """Unload the bristles of the chosen rods."""
    r, k, i = wp.tid()
    if chosen[r] != 0:
        step.bristle[r, k, i] = wp.vec3d(ZERO, ZERO, ZERO)
        step.sliding[r, k, i] = 0
        step.turned[r, k, i] = ZERO
