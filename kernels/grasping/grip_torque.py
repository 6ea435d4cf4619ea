"""The torque of the grip: it acts along the tangent there, half an edge beyond the last edge's.

Without a bending moment the last half edge has the curvature that it has at rest, so that the
grip's tangent is u + p, p = g/2 (k_1 m_1 + k_2 m_2) in the last edge's frame (u, m_1, m_2). What
holds the roll holds the spin about that tangent: where the last edge e turns, its frame spins about
u by c . de, c = (g/2) (k_1 m_2 - k_2 m_1) / |e|, and the torque M adds the force M c to the edge's.

A torque that follows a tangent has no energy. What its stiffness lacks of symmetry couples only the
last edge and its angle with the force on that edge,

    A = M ([u]/2 - u w' - w u' - p w') / |e|^2,  b = -M p / |e|,  w = |e| c,

where [u]/2 is what frames carried along a path spin against those carried straight. So the
elimination takes the symmetric rest, and `add_torque` puts A and b into what it left; so does
`condense_torque` where another load has been eliminated.
"""

import warp as wp
from wrod.kernels.elastic.frames import HALF, ONE, ZERO

mat43d = wp.types.matrix(shape=(4, 3), dtype=wp.float64)
mat83d = wp.types.matrix(shape=(8, 3), dtype=wp.float64)
# Columns of the frontal elimination's rows, in blocks of four.
FIRST = wp.constant(12)
RHS = wp.constant(16)
INVERSE = wp.constant(17)


@wp.struct
class GripTorque:
    """The torque of a grip, as `add_torque` has put it into a system."""

    # A and b.
    by_edge: wp.mat33d
    by_angle: wp.vec3d
    # Of unit forces on the last edge, forward in the last eliminated block; how the last edge
    # changes with the border's unknowns without A and b; and what these bring of the force there:
    # (1 + A G)^-1 A by the edge's change, (1 + A G)^-1 b by its angle's, G the edge's compliance.
    forward: mat43d
    by_border: mat83d
    turned_by: wp.mat33d
    turned: wp.vec3d


@wp.func
def add_torque(
    moment: wp.float64,
    edge: wp.vec3d,
    spin: wp.vec3d,
    slot: int,
    edges: int,
    # State in and out, of `kernels.linear.frontal`, blocks of 4:
    factor: wp.array3d(dtype=wp.float64),
    condensed: wp.array2d(dtype=wp.float64),
) -> GripTorque:
    """Put A and b into the last eliminated block's rows and the border's system (Woodbury); `spin`
    is c."""
    q = GripTorque()
    length = wp.length(edge)
    u = edge / length
    w = length * spin
    p = wp.cross(w, u)
    row = 4 * (edges - 1)
    own = (edges - 3) % 3 * 4
    last = (edges - 2) % 3 * 4
    # Forward substitution of unit forces on the last edge, which pull its beginning back.
    forward = mat43d()
    for k in range(3):
        forward[1 + k, k] = -ONE
    for t in range(4):
        for m in range(t + 1, 4):
            share = factor[slot, row + t, own + m] * factor[slot, row + t, INVERSE]
            for k in range(3):
                forward[m, k] -= share * forward[t, k]
    # Change of the last edge by the border's unknowns, by what is out of balance and by the forces.
    by_border = mat83d()
    rest = wp.vec3d(ZERO, ZERO, ZERO)
    give = wp.mat33d()
    for k in range(3):
        by_border[5 + k, k] = ONE
    for t in range(4):
        inverse = factor[slot, row + t, INVERSE]
        for k in range(3):
            scaled = inverse * forward[t, k]
            for m in range(4):
                by_border[m, k] -= scaled * factor[slot, row + t, FIRST + m]
                by_border[4 + m, k] -= scaled * factor[slot, row + t, last + m]
            rest[k] = rest[k] - scaled * factor[slot, row + t, RHS]
            for i in range(3):
                give[k, i] += scaled * forward[t, i]
    # The force on the edge that they bring.
    a = HALF * wp.skew(u) - wp.outer(u, w) - wp.outer(w, u) - wp.outer(p, w)
    a = (moment / (length * length)) * a
    solve = wp.inverse(wp.identity(3, dtype=wp.float64) + a * give)
    q.by_edge = a
    q.by_angle = (-moment / length) * p
    q.forward = forward
    q.by_border = by_border
    q.turned_by = solve * a
    q.turned = solve * q.by_angle
    force = q.turned_by * wp.transpose(by_border)
    for k in range(3):
        force[k, 4] += q.turned[k]
    still = q.turned_by * rest
    for n in range(8):
        column = wp.where(n < 4, FIRST + n, last + n - 4)
        for t in range(4):
            for k in range(3):
                factor[slot, row + t, column] += forward[t, k] * force[k, n]
        for m in range(8):
            for k in range(3):
                condensed[slot, 8 * m + n] += by_border[m, k] * force[k, n]
    for t in range(4):
        for k in range(3):
            factor[slot, row + t, RHS] += forward[t, k] * still[k]
    for m in range(8):
        for k in range(3):
            condensed[slot, 64 + m] += by_border[m, k] * still[k]
    return q


@wp.func
def load_torque(
    q: GripTorque,
    motion: wp.array3d(dtype=wp.float64),
    slot: int,
    edges: int,
    # State in and out:
    load: wp.array3d(dtype=wp.float64),
):
    """Add what the torque's force changes by when the blocks move by `motion`."""
    turn = motion[slot, edges, 0]
    change = wp.vec3d(ZERO, ZERO, ZERO)
    for k in range(3):
        change[k] = motion[slot, edges, 1 + k] - motion[slot, edges - 1, 1 + k]
    force = q.by_edge * change + turn * q.by_angle
    for k in range(3):
        load[slot, edges, 1 + k] = load[slot, edges, 1 + k] + force[k]
        load[slot, edges - 1, 1 + k] = load[slot, edges - 1, 1 + k] - force[k]


@wp.func
def condense_torque(
    q: GripTorque,
    factor: wp.array3d(dtype=wp.float64),
    load: wp.array3d(dtype=wp.float64),
    slot: int,
    edges: int,
    # State in and out:
    condensed: wp.array2d(dtype=wp.float64),
):
    """Put right what `kernels.linear.frontal`'s `condense`, which takes rows for columns, has made
    of a load: the rows hold the force that the border brings, the columns want the edge's."""
    rest = wp.vec3d(ZERO, ZERO, ZERO)
    for t in range(4):
        scaled = load[slot, edges - 1, t] * factor[slot, 4 * (edges - 1) + t, INVERSE]
        for k in range(3):
            rest[k] = rest[k] - scaled * q.forward[t, k]
    away = q.by_border * ((q.turned_by - wp.transpose(q.turned_by)) * rest)
    away[4] = away[4] - wp.dot(q.turned, rest)
    for m in range(8):
        condensed[slot, 64 + m] += away[m]
