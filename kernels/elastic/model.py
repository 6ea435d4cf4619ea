"""What the elastic energy of rods depends on besides their state."""

import warp as wp


@wp.struct
class ElasticModel:
    """Lengths, stiffnesses and shapes at rest.

    Attributes:
        rest_length, stretching: (rod, edge) rest length and stretching stiffness.
        bending: (rod, node) in both principal directions.
        invariant: (rod, node) of bending's invariant (`wrod.kernels.elastic.bending`): that of the
            material, where `bending` stands for a viscous material in a step.
        natural_curvature, softening: (rod, node), of both directions, and of the law.
        twisting, natural_twist: (rod, node).
    """

    rest_length: wp.array2d(dtype=wp.float64)
    stretching: wp.array2d(dtype=wp.float64)
    bending: wp.array2d(dtype=wp.vec2d)
    invariant: wp.array2d(dtype=wp.vec2d)
    natural_curvature: wp.array2d(dtype=wp.vec2d)
    softening: wp.array2d(dtype=wp.vec2d)
    twisting: wp.array2d(dtype=wp.float64)
    natural_twist: wp.array2d(dtype=wp.float64)
