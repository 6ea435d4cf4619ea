"""Rods between a simulator's flat arrays, one rod after the other, and the rows of a batch.

A clamped end has one node more in the batch than outside: the rod is thought to go on into the
clamp by an edge, whose direction is the clamp's, which places the clamp at the first node with an
error of second order in the edge. A row may hold several rods, end to end, with an edge between
them that is cut.
"""

import warp as wp
from wrod.kernels.elastic.frames import ZERO, node, put_node, rotate


@wp.struct
class OutsideNode:
    """What a node of a row is outside: node `node`. The edge after it has the frame of edge `edge`
    (-1: of none), and is that edge where `owns` is 1. A node in a clamp (`ghost` is not 0) stands
    for the one that the clamp holds: it lies `ghost` rest lengths from it, in the direction of the
    edge that begins at node `along`."""

    node: int
    edge: int
    owns: int
    along: int
    ghost: int


@wp.func
def pull_of(
    body: int, body_f: wp.array(dtype=wp.spatial_vector), e: wp.vec3d, side: wp.float64
) -> wp.vec3d:
    """What the wrench on the capsule of an edge e does to the node at its head (side -1) or tail
    (1): half of the force, and a couple for what of the torque is across the edge."""
    out = wp.vec3d()
    if body >= 0:
        w = body_f[body]
        force = wp.vec3d(wp.spatial_top(w))
        torque = wp.vec3d(wp.spatial_bottom(w))
        out = wp.float64(0.5) * force + (side / wp.dot(e, e)) * wp.cross(torque, e)
    return out


@wp.kernel
def find_changes(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    body: wp.array2d(dtype=wp.int32),
    # State in:
    node_q: wp.array(dtype=wp.vec3d),
    node_qd: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    edge_spin: wp.array(dtype=wp.float64),
    body_f: wp.array(dtype=wp.spatial_vector),
    dof: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    written_director: wp.array2d(dtype=wp.vec3d),
    # State out:
    load_out: wp.array2d(dtype=wp.vec3d),
    changed_out: wp.array(dtype=wp.int32),
):
    """Give the nodes the forces on the capsules beside them, and say of which rows the state is not
    what `write_state` last gave out. Launched over (row, node)."""
    r, b = wp.tid()
    q = node(dof, r, b)
    load = wp.vec3d()
    if b < body.shape[1]:
        load += pull_of(body[r, b], body_f, node(dof, r, b + 1) - q, wp.float64(-1.0))
    if b > 0:
        load += pull_of(body[r, b - 1], body_f, q - node(dof, r, b - 1), wp.float64(1.0))
    load_out[r, b] = load
    p = place[r, b]
    if p.ghost != 0:
        return
    same = node_q[p.node] == q and node_qd[p.node] == node(velocity, r, b)
    if same and p.owns != 0:
        same = edge_spin[p.edge] == velocity[r, 4 * b + 3]
        same = same and edge_director[p.edge] == written_director[r, b]
    if not same:
        changed_out[r] = 1


@wp.kernel
def read_state(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    rest_length: wp.array2d(dtype=wp.float64),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    node_q: wp.array(dtype=wp.vec3d),
    node_qd: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    edge_spin: wp.array(dtype=wp.float64),
    # State out:
    dof_out: wp.array2d(dtype=wp.float64),
    velocity_out: wp.array2d(dtype=wp.float64),
):
    """Configuration and velocity of the chosen rows; `read_frames` follows."""
    r, b = wp.tid()
    if chosen[r] == 0:
        return
    p = place[r, b]
    q = node_q[p.node]
    if p.ghost != 0:
        t = wp.normalize(node_q[p.along + 1] - node_q[p.along])
        edge = wp.where(p.ghost < 0, b, b - 1)
        q = q + (wp.float64(p.ghost) * rest_length[r, edge]) * t
    put_node(dof_out, r, b, q)
    put_node(velocity_out, r, b, node_qd[p.node])
    if b < rest_length.shape[1]:
        dof_out[r, 4 * b + 3] = ZERO
        velocity_out[r, 4 * b + 3] = ZERO
        if p.edge >= 0:
            velocity_out[r, 4 * b + 3] = edge_spin[p.edge]


@wp.kernel
def read_frames(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    # State in:
    chosen: wp.array(dtype=wp.int32),
    edge_director: wp.array(dtype=wp.vec3d),
    dof: wp.array2d(dtype=wp.float64),
    # State out:
    tangent_out: wp.array2d(dtype=wp.vec3d),
    director_out: wp.array2d(dtype=wp.vec3d),
    twist_out: wp.array2d(dtype=wp.float64),
):
    """Reference frames of the chosen rows: the material ones. Launched over (row, node)."""
    r, b = wp.tid()
    if chosen[r] == 0:
        return
    twist_out[r, b] = ZERO
    if b == tangent_out.shape[1]:
        return
    t = wp.normalize(node(dof, r, b + 1) - node(dof, r, b))
    d = wp.vec3d(t[1], t[2], t[0])
    if place[r, b].edge >= 0:
        d = edge_director[place[r, b].edge]
    d = d - wp.dot(d, t) * t
    if wp.length(d) < wp.float64(1.0e-9):
        d = wp.cross(t, wp.vec3d(t[2], -t[0], t[1]))
    tangent_out[r, b] = t
    director_out[r, b] = wp.normalize(d)


@wp.func
def capsule_turn(z: wp.vec3d, director: wp.vec3d) -> wp.quatd:
    """Rotation of a body on an edge, x along the director and z along the edge."""
    x = wp.normalize(director - wp.dot(director, z) * z)
    return wp.quat_from_matrix(wp.matrix_from_cols(x, wp.cross(z, x), z))


@wp.kernel
def write_state(
    # Model:
    place: wp.array2d(dtype=OutsideNode),
    body: wp.array2d(dtype=wp.int32),
    # State in:
    dof: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    tangent: wp.array2d(dtype=wp.vec3d),
    director: wp.array2d(dtype=wp.vec3d),
    shape_force: wp.array2d(dtype=wp.vec3d),
    rod_force: wp.array2d(dtype=wp.vec3d),
    # State out:
    node_q_out: wp.array(dtype=wp.vec3d),
    node_qd_out: wp.array(dtype=wp.vec3d),
    node_contact_f_out: wp.array(dtype=wp.vec3d),
    edge_director_out: wp.array(dtype=wp.vec3d),
    edge_spin_out: wp.array(dtype=wp.float64),
    written_director_out: wp.array2d(dtype=wp.vec3d),
    body_q_out: wp.array(dtype=wp.transform),
):
    """What rods do, with a body at the middle of every edge that has one. Launched over
    (row, node)."""
    r, b = wp.tid()
    p = place[r, b]
    if p.ghost != 0:
        return
    q = node(dof, r, b)
    node_q_out[p.node] = q
    node_qd_out[p.node] = node(velocity, r, b)
    node_contact_f_out[p.node] = shape_force[r, b] + rod_force[r, b]
    if p.owns != 0:
        d = rotate(director[r, b], tangent[r, b], dof[r, 4 * b + 3])
        edge_director_out[p.edge] = d
        edge_spin_out[p.edge] = velocity[r, 4 * b + 3]
        written_director_out[r, b] = d
        if body[r, b] >= 0:
            u = node(dof, r, b + 1)
            turn = capsule_turn(wp.normalize(u - q), d)
            middle = wp.float64(0.5) * (q + u)
            body_q_out[body[r, b]] = wp.transform(wp.vec3(middle), wp.quat(turn))
