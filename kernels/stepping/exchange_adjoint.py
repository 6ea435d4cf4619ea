"""The adjoint of a simulator's step around that of its rods' steps: what a loss wants of arrays
that the simulator holds (`wrod.kernels.stepping.exchange`, `carrying`), wanted of rods, and back.

A rotation is differentiated by rotation vectors g, dL = g . omega; of its quaternion q that is
2 (g, 0) q, and back half the vector of dL/dq q*. A unit tangent t that turns by dt, and a frame
that turns about it by dphi, turn by t x dt + dphi t.
"""

import warp as wp
from wrod.kernels.elastic.assembly import add_edge_vector, add_vector
from wrod.kernels.elastic.frames import HALF, ONE, TWO, ZERO, edge, node, put_node, rotate
from wrod.kernels.stepping.bodies import Hold, turn_to
from wrod.kernels.stepping.carrying import as_pose
from wrod.kernels.stepping.exchange import OutsideNode, capsule_turn
from wrod.kernels.stepping.model_adjoint import WantedModel
from wrod.kernels.stepping.trace import OneStep, Wanted, left_of


@wp.kernel
def want_written(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    capsule: wp.array2d(dtype=wp.int32),
    # State in:
    count: wp.array(dtype=wp.int32),
    dof: wp.array2d(dtype=wp.float64),
    director: wp.array2d(dtype=wp.vec3d),
    by_node_q: wp.array(dtype=wp.vec3d),
    by_node_qd: wp.array(dtype=wp.vec3d),
    by_director: wp.array(dtype=wp.vec3d),
    by_spin: wp.array(dtype=wp.float64),
    # State in and out:
    by_body_q: wp.array2d(dtype=wp.float32),
    now: Wanted,
):
    """Of `write_state`, whose poses were overwritten. Launched over (row, node)."""
    r, b = wp.tid()
    p = place[r, b]
    if count[r] == 0 or p.ghost != 0:
        return
    add_vector(now.dof, r, 4 * b, by_node_q[p.node])
    add_vector(now.velocity, r, 4 * b, by_node_qd[p.node])
    if p.owns == 0:
        return
    e = edge(dof, r, b)
    length = wp.length(e)
    t = e / length
    m = rotate(director[r, b], t, dof[r, 4 * b + 3])
    g = by_director[p.edge]
    turn = wp.dot(g, wp.cross(t, m))
    along = -(wp.dot(g, t) / length) * m
    body = capsule[r, b]
    if body >= 0:
        q = capsule_turn(t, m)
        middle = wp.vec3d()
        wanted = wp.quatd()
        for c in range(7):
            value = wp.float64(by_body_q[body, c])
            by_body_q[body, c] = float(0.0)
            if c < 3:
                middle[c] = value
            else:
                wanted[c - 3] = value
        spin = by_turn(wanted, q)
        turn += wp.dot(spin, t)
        along += wp.cross(spin, t) / length
        add_vector(now.dof, r, 4 * b, HALF * middle)
        add_vector(now.dof, r, 4 * b + 4, HALF * middle)
    add_edge_vector(now.dof, r, b, along)
    now.dof[r, 4 * b + 3] = now.dof[r, 4 * b + 3] + turn
    now.velocity[r, 4 * b + 3] = now.velocity[r, 4 * b + 3] + by_spin[p.edge]


@wp.func
def by_turn(wanted: wp.quatd, q: wp.quatd) -> wp.vec3d:
    """What is wanted of a rotation's quaternion q, of its rotation vector."""
    d = wanted * wp.quat_inverse(q)
    return HALF * wp.vec3d(d[0], d[1], d[2])


@wp.func
def jacobian(v: wp.vec3d) -> wp.mat33d:
    """Left Jacobian of the rotation by v."""
    angle = wp.length(v)
    a = HALF - angle * angle / wp.float64(24.0)
    b = ONE / wp.float64(6.0) - angle * angle / wp.float64(120.0)
    if angle > wp.float64(1.0e-3):
        a = (ONE - wp.cos(angle)) / (angle * angle)
        b = (angle - wp.sin(angle)) / (angle * angle * angle)
    k = wp.skew(v)
    return wp.identity(3, dtype=wp.float64) + a * k + b * (k * k)


@wp.func
def turned_back(v: wp.vec3d, angle_of: wp.vec3d) -> wp.vec3d:
    """v, turned back by a rotation vector."""
    angle = wp.length(angle_of)
    if angle == ZERO:
        return v
    return wp.quat_rotate_inv(wp.quat_from_axis_angle(angle_of / angle, angle), v)


@wp.func
def want_pose(
    by_body_q: wp.array2d(dtype=wp.float32),
    body: int,
    pose: wp.transform,
    force: wp.vec3d,
    torque: wp.vec3d,
):
    """Add what is wanted of a body's place, and of its turn by a rotation vector."""
    q = wp.quatd(wp.transform_get_rotation(pose))
    # A quaternion counts as if it were normalised.
    wanted = wp.quatd(torque[0], torque[1], torque[2], ZERO) * q
    size = TWO / wp.dot(q, q)
    for c in range(3):
        wp.atomic_add(by_body_q, body, c, float(force[c]))
    for c in range(4):
        wp.atomic_add(by_body_q, body, 3 + c, float(size * wanted[c]))


@wp.kernel
def want_poses(
    # Model:
    hold: wp.array2d(dtype=Hold),
    place: wp.array2d(dtype=OutsideNode),
    duration: wp.float64,
    # State in:
    step: OneStep,
    changed: wp.array(dtype=wp.int32),
    body_q: wp.array(dtype=wp.transform),
    rotation_before: wp.array2d(dtype=wp.quatd),
    held: wp.array2d(dtype=wp.float64),
    # State in and out:
    anchor: wp.array2d(dtype=wp.float64),
    by_rest_length: wp.array2d(dtype=wp.float64),
    by_body_q: wp.array2d(dtype=wp.float32),
):
    """Of `carry_held`: of what is held at the end of a row's step, to its body's pose and, if that
    is not the last one, to where it was (`anchor`, by nodes and frames) when the simulator's step
    began."""
    r, k = wp.tid()
    h = hold[r, k]
    if step.active[r] == 0 or h.kind == 0 or h.slot >= 0:
        return
    turn = h.rotation
    arm = wp.vec3d(ZERO, ZERO, ZERO)
    if h.body >= 0:
        pose = as_pose(body_q[h.body])
        turn = pose.rotation * h.rotation
        arm = wp.quat_rotate(pose.rotation, h.position)
    left = wp.clamp(left_of(step, r) / duration, ZERO, ONE)
    force = node(held, r, h.node)
    torque = wp.vec3d(ZERO, ZERO, ZERO)
    if h.kind == 2:
        other = node(held, r, h.other)
        force = force + other
        t = step.tangent[r, h.edge]
        torque = held[r, 4 * h.edge + 3] * t + h.reach * wp.cross(t, other)
        ghost = wp.float64(place[r, h.other].ghost)  # which lies a rest length away
        wp.atomic_add(by_rest_length, r, h.edge, ghost * wp.dot(other, t))
        if changed[r] == 0 and left > ZERO:
            before = rotation_before[r, k]
            way = turn_to(before, turn)
            gone = wp.transpose(jacobian(left * way)) * torque
            inverse = wp.inverse(jacobian(way))
            start = left * (wp.transpose(inverse) * gone)
            torque = turned_back(torque, left * way) - left * (inverse * gone)
            u = wp.quat_rotate(before, wp.vec3d(ONE, ZERO, ZERO))
            add_edge_vector(anchor, r, h.edge, wp.cross(start, u) / wp.abs(h.reach))
            wp.atomic_add(anchor, r, 4 * h.edge + 3, wp.dot(start, u))
    add_vector(anchor, r, 4 * h.node, left * force)
    if h.body < 0:
        return
    force = (ONE - left) * force
    g = torque + wp.cross(arm, force)
    want_pose(by_body_q, h.body, body_q[h.body], force, g)


@wp.kernel
def want_anchored(
    # State in:
    anchor: wp.array2d(dtype=wp.float64),
    # State in and out:
    now: Wanted,
):
    """Launched over (row, dof)."""
    r, a = wp.tid()
    now.dof[r, a] = now.dof[r, a] + anchor[r, a]


@wp.kernel
def want_frames_read(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    # State in:
    changed: wp.array(dtype=wp.int32),
    step: OneStep,
    director: wp.array(dtype=wp.vec3d),
    # State in and out:
    now: Wanted,
    by_director: wp.array(dtype=wp.vec3d),
    by_spin: wp.array(dtype=wp.float64),
):
    """Of `read_frames`, and of edges that went on from the step before, `step` being the first of
    this one: what is left in `now` of the latter is wanted of the end of the step before. Launched
    over (row, edge)."""
    r, b = wp.tid()
    p = place[r, b]
    a = 4 * b + 3
    if changed[r] == 0 and p.owns == 0:
        return
    if p.edge >= 0:
        t = step.tangent_before[r, b]
        m = rotate(step.director_before[r, b], t, step.dof_before[r, a])
        side = wp.cross(t, m)
        turn = now.dof[r, a]
        if changed[r] != 0:
            # The reference frame is the edge's.
            turn += now.turn[r, b]
            d = director[p.edge]
            turn = turn / wp.length(d - wp.dot(d, t) * t)
            length = wp.length(edge(step.dof_before, r, b))
            add_edge_vector(now.dof, r, b, (-turn * wp.dot(d, t) / length) * side)
        wp.atomic_add(by_director, p.edge, turn * side)
        wp.atomic_add(by_spin, p.edge, now.velocity[r, a])
    now.dof[r, a] = ZERO
    now.velocity[r, a] = ZERO
    if changed[r] != 0:
        now.turn[r, b] = ZERO


@wp.kernel
def want_ghosts_read(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    rest_length: wp.array2d(dtype=wp.float64),
    # State in:
    changed: wp.array(dtype=wp.int32),
    step: OneStep,
    # State in and out:
    now: Wanted,
    by_rest_length: wp.array2d(dtype=wp.float64),
):
    """Of `read_state`: nodes in clamps lie where the rods' end edges aim. Launched over
    (row, node)."""
    r, b = wp.tid()
    p = place[r, b]
    if changed[r] == 0 or p.ghost == 0:
        return
    held = b - p.ghost
    first = wp.where(p.ghost < 0, held, held - 1)
    e = edge(step.dof_before, r, first)
    length = wp.length(e)
    t = e / length
    behind = wp.where(p.ghost < 0, b, b - 1)
    rest = rest_length[r, behind]
    wanted = node(now.dof, r, b)
    wp.atomic_add(by_rest_length, r, behind, wp.float64(p.ghost) * wp.dot(wanted, t))
    v = (wp.float64(p.ghost) * rest / length) * (wanted - wp.dot(wanted, t) * t)
    add_edge_vector(now.dof, r, first, v)
    add_vector(now.dof, r, 4 * held, wanted)
    add_vector(now.velocity, r, 4 * held, node(now.velocity, r, b))
    put_node(now.dof, r, b, wp.vec3d(ZERO, ZERO, ZERO))
    put_node(now.velocity, r, b, wp.vec3d(ZERO, ZERO, ZERO))


@wp.kernel
def want_nodes_read(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    # State in and out:
    now: Wanted,
    by_node_q: wp.array(dtype=wp.vec3d),
    by_node_qd: wp.array(dtype=wp.vec3d),
):
    """Of `read_state`, after `want_ghosts_read`. Launched over (row, node)."""
    r, b = wp.tid()
    p = place[r, b]
    if p.ghost != 0:
        return
    by_node_q[p.node] = by_node_q[p.node] + node(now.dof, r, b)
    by_node_qd[p.node] = by_node_qd[p.node] + node(now.velocity, r, b)
    put_node(now.dof, r, b, wp.vec3d(ZERO, ZERO, ZERO))
    put_node(now.velocity, r, b, wp.vec3d(ZERO, ZERO, ZERO))


@wp.kernel
def want_properties(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    world: wp.array(dtype=wp.int32),
    bending_share: wp.array2d(dtype=wp.float64),
    natural_share: wp.array2d(dtype=wp.float64),
    # State in:
    model: WantedModel,
    # State in and out:
    by_stretching: wp.array(dtype=wp.float64),
    by_bending: wp.array(dtype=wp.vec2d),
    by_twisting: wp.array(dtype=wp.float64),
    by_curvature: wp.array(dtype=wp.vec2d),
    by_twist: wp.array(dtype=wp.float64),
    by_mass: wp.array(dtype=wp.float64),
    by_gravity: wp.array2d(dtype=wp.float32),
):
    """Of rows to the simulator's model. What a row's node has is a share of what its node there has
    (`wrod.rods.discretisation.of_free_part`). Launched over (row, node)."""
    r, b = wp.tid()
    p = place[r, b]
    if b == 0:
        for c in range(3):
            wp.atomic_add(by_gravity, world[r], c, float(model.gravity[r][c]))
    if p.ghost != 0:
        return
    bent = bending_share[r, b]
    at_rest = natural_share[r, b]
    by_bending[p.node] = by_bending[p.node] + bent * model.bending[r, b]
    by_twisting[p.node] = by_twisting[p.node] + bent * model.twisting[r, b]
    by_curvature[p.node] = by_curvature[p.node] + at_rest * model.natural_curvature[r, b]
    by_twist[p.node] = by_twist[p.node] + at_rest * model.natural_twist[r, b]
    if by_mass.shape[0] > 0:
        by_mass[p.node] = by_mass[p.node] + model.node_mass[r, b]
    if p.owns != 0:
        by_stretching[p.edge] = by_stretching[p.edge] + model.stretching[r, b]


@wp.kernel
def want_friction(
    # Model:
    shape: wp.array2d(dtype=wp.int32),
    # State in:
    by_friction: wp.array2d(dtype=wp.float64),
    # State in and out:
    by_material_mu: wp.array(dtype=wp.float32),
):
    """Of rows' shapes, to the simulator's. Launched over (row, shape)."""
    r, k = wp.tid()
    if shape[r, k] >= 0:
        wp.atomic_add(by_material_mu, shape[r, k], float(by_friction[r, k]))


@wp.kernel
def want_of_rods(
    # Model:
    rod: wp.array2d(dtype=wp.int32),
    edge: wp.array2d(dtype=wp.int32),
    radius: wp.array(dtype=wp.float64),
    # State in:
    model: WantedModel,
    # State in and out:
    by_internal_damping: wp.array(dtype=wp.float64),
    by_air_damping: wp.array(dtype=wp.float64),
    by_radius: wp.array(dtype=wp.float64),
    by_rest_length: wp.array(dtype=wp.float64),
):
    """Of nodes' viscous times, air damping and radii, to those of their rod, and of rest lengths
    (none for "consistent" inertia) to those of `edge` (row, edge). Launched over (row, node)."""
    r, b = wp.tid()
    wp.atomic_add(by_radius, rod[r, b], model.radius[r, b] / radius[rod[r, b]])
    if b < edge.shape[1] and by_rest_length.shape[0] > 0:
        wp.atomic_add(by_rest_length, edge[r, b], model.rest_length[r, b])
    t = model.viscous_time[r, b]
    wp.atomic_add(by_internal_damping, rod[r, b], t[0] + t[1] + t[2] + t[3])
    wp.atomic_add(by_air_damping, rod[r, b], model.air[r, b])
