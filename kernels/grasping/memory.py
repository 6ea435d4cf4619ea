"""What a rod that remembers goes through while it is laid, from its grasps one after the other.

Laying is slow, so that of a material point's past the curvatures in the grasps before count alone.
"""

import warp as wp
from wrod.kernels.elastic.curvature import excess_curvature
from wrod.kernels.elastic.frames import HALF, ZERO
from wrod.kernels.elastic.inelastic import Flow, Inelastic, flow
from wrod.kernels.grasping.general_rod import before_contact, director
from wrod.kernels.grasping.straight_rod import point


# Of their own modules: what they share with the solver takes minutes to compile.
@wp.kernel(module="unique", enable_backward=False)
def read_curvature(
    # In:
    edges: int,
    rest: wp.array2d(dtype=wp.float64),
    curvature: wp.array(dtype=wp.float64),
    state: wp.array3d(dtype=wp.float64),
    # Out:
    bent_out: wp.array2d(dtype=wp.vec2d),
):
    """Both components of the nodes' curvature in the material frames, but for the grip's."""
    r = wp.tid()
    h = rest[r, 0]
    s = before_contact(curvature[r], h, state, r)
    for j in range(edges):
        f = point(state, r, j + 1) - point(state, r, j)
        s.length_f = wp.length(f)
        s.u = f / s.length_f
        s.m1f = director(state, r, j)
        s.m2f = wp.cross(s.u, s.m1f)
        g = rest[r, j]
        bent_out[r, j] = excess_curvature(s, HALF * (h + g), wp.vec2d(ZERO, ZERO))
        s.t = s.u
        s.length_e = s.length_f
        s.m1e = s.m1f
        s.m2e = s.m2f
        h = g


@wp.kernel(module="unique", enable_backward=False)
def follow_flow(
    # In:
    excess: wp.array2d(dtype=wp.vec2d),
    weight: wp.array(dtype=wp.vec2d),
    # State in and out:
    node: wp.array(dtype=Inelastic),
    # Out:
    lagging_out: wp.array2d(dtype=wp.vec2d),
    tangent_out: wp.array2d(dtype=wp.vec2d),
):
    """z of points that are bent from one excess curvature to the next (step, point), and by how
    much each of its components changes with that of the last excess."""
    p = wp.tid()
    here = node[p]
    for i in range(excess.shape[0]):
        now = Flow()
        now = flow(here, excess[i, p], weight[p])
        here.excess = excess[i, p]
        here.lagging = now.z
        lagging_out[i, p] = now.z
        tangent_out[i, p] = wp.vec2d(now.tangent[0, 0], now.tangent[1, 1])
    node[p] = here
