"""Room to iterate grasps in."""

import warp as wp


@wp.struct
class Scratch:
    """What the iteration of a rod needs while it runs; one slot a thread."""

    stiffness: wp.array3d(dtype=wp.float64)
    load: wp.array3d(dtype=wp.float64)
    factor: wp.array3d(dtype=wp.float64)
    condensed: wp.array2d(dtype=wp.float64)
    motion: wp.array3d(dtype=wp.float64)
    saved: wp.array3d(dtype=wp.float64)
