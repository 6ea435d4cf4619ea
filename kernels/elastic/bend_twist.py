"""Bending that twists: E = l G . e (tau / l - tau0), e the excess curvatures.

A section whose layers or strands are laid at an angle couples its curvatures with its twist
(Dias & Audoly 2014). G = (G_1, G_2) [force length^2] is per node; the rod is stable at rest where
G_1^2 / B_1 + G_2^2 / B_2 < C.
"""

import warp as wp
from wrod.kernels.elastic.frames import ZERO
from wrod.kernels.elastic.section import Response, make_section_energy


@wp.func
def bend_twist(excess: wp.vec3d, stiffness: wp.vec3d, coupling: wp.vec2d) -> Response:
    curved = coupling[0] * excess[0] + coupling[1] * excess[1]
    out = Response()
    out.energy = curved * excess[2]
    out.moment = wp.vec3d(coupling[0] * excess[2], coupling[1] * excess[2], curved)
    g = coupling[0]
    h = coupling[1]
    out.tangent = wp.mat33d(ZERO, ZERO, g, ZERO, ZERO, h, g, h, ZERO)
    return out


bend_twist_energy = make_section_energy(bend_twist, wp.vec2d)
