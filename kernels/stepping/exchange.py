"""Rods between a simulator's flat arrays, one rod after the other, and the rows of a batch.

A clamped end has one node more in the batch than outside: the rod is thought to go on into the
clamp by an edge, whose direction is the clamp's, which places the clamp at the first node with an
error of second order in the edge.
"""

import warp as wp
from wrod.kernels.elastic.frames import ZERO, node, rotate

wp.set_module_options({"enable_backward": False})


@wp.struct
class Span:
    """Where a rod of a batch stands outside: first node and edge, their numbers, and how many nodes
    of the batch come before (0 or 1)."""

    node: int
    edge: int
    count: int
    lead: int


@wp.kernel
def find_changes(
    # Model:
    span: wp.array(dtype=Span),
    # State in:
    node_q: wp.array(dtype=wp.vec3d),
    node_qd: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    edge_spin: wp.array(dtype=wp.float64),
    dof: wp.array2d(dtype=wp.float64),
    velocity: wp.array2d(dtype=wp.float64),
    written_director: wp.array2d(dtype=wp.vec3d),
    # State out:
    changed_out: wp.array(dtype=wp.int32),
):
    """Say of which rods the state is not what `write_state` last gave out."""
    r, i = wp.tid()
    s = span[r]
    if i >= s.count:
        return
    b = s.lead + i
    same = node_q[s.node + i] == node(dof, r, b) and node_qd[s.node + i] == node(velocity, r, b)
    if same and i < s.count - 1:
        e = s.edge + i
        same = edge_spin[e] == velocity[r, 4 * b + 3] and edge_director[e] == written_director[r, b]
    if not same:
        changed_out[r] = 1


@wp.kernel
def read_state(
    # Model:
    span: wp.array(dtype=Span),
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
    tangent_out: wp.array2d(dtype=wp.vec3d),
    director_out: wp.array2d(dtype=wp.vec3d),
    twist_out: wp.array2d(dtype=wp.float64),
):
    """Configuration and velocity of the chosen rods; reference frames are the material ones."""
    r, b = wp.tid()
    if chosen[r] == 0:
        return
    s = span[r]
    i = wp.clamp(b - s.lead, 0, s.count - 1)
    e = wp.clamp(b - s.lead, 0, s.count - 2)
    t = wp.normalize(node_q[s.node + e + 1] - node_q[s.node + e])
    q = node_q[s.node + i]
    v = node_qd[s.node + i]
    if b < s.lead:
        q = q - rest_length[r, 0] * t
    if b - s.lead >= s.count:
        q = q + rest_length[r, b - 1] * t
    for c in range(3):
        dof_out[r, 4 * b + c] = q[c]
        velocity_out[r, 4 * b + c] = v[c]
    twist_out[r, b] = ZERO
    if b < tangent_out.shape[1]:
        d = edge_director[s.edge + e]
        dof_out[r, 4 * b + 3] = ZERO
        velocity_out[r, 4 * b + 3] = edge_spin[s.edge + e]
        tangent_out[r, b] = t
        director_out[r, b] = wp.normalize(d - wp.dot(d, t) * t)


@wp.kernel
def write_state(
    # Model:
    span: wp.array(dtype=Span),
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
):
    r, i = wp.tid()
    s = span[r]
    if i >= s.count:
        return
    b = s.lead + i
    node_q_out[s.node + i] = node(dof, r, b)
    node_qd_out[s.node + i] = node(velocity, r, b)
    node_contact_f_out[s.node + i] = shape_force[r, b] + rod_force[r, b]
    if i < s.count - 1:
        d = rotate(director[r, b], tangent[r, b], dof[r, 4 * b + 3])
        edge_director_out[s.edge + i] = d
        edge_spin_out[s.edge + i] = velocity[r, 4 * b + 3]
        written_director_out[r, b] = d


@wp.kernel
def place_capsules(
    # Model:
    span: wp.array(dtype=Span),
    first_body: wp.array(dtype=wp.int32),
    # State in:
    node_q: wp.array(dtype=wp.vec3d),
    edge_director: wp.array(dtype=wp.vec3d),
    # State out:
    body_q_out: wp.array(dtype=wp.transform),
):
    """Put a body at the middle of every edge, x along the director and z along the edge."""
    r, i = wp.tid()
    s = span[r]
    if first_body[r] < 0 or i >= s.count - 1:
        return
    a = node_q[s.node + i]
    b = node_q[s.node + i + 1]
    z = wp.normalize(b - a)
    d = edge_director[s.edge + i]
    x = wp.normalize(d - wp.dot(d, z) * z)
    turn = wp.quat_from_matrix(wp.matrix_from_cols(x, wp.cross(z, x), z))
    middle = wp.float64(0.5) * (a + b)
    body_q_out[first_body[r] + i] = wp.transform(
        wp.vec3(float(middle[0]), float(middle[1]), float(middle[2])),
        wp.quat(float(turn[0]), float(turn[1]), float(turn[2]), float(turn[3])),
    )
