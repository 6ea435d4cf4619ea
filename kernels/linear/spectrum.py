"""Shifting a banded Hessian by a diagonal mass, for eigenvalues by inverse iteration."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def shift_by_mass(
    # In:
    active: wp.array(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    mass: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    shifted_out: wp.array3d(dtype=wp.float64),
):
    """Diagonal of `hessian - shift * mass`; the rest of `shifted_out` is left alone."""
    r, a = wp.tid()
    if active[r] != 0:
        shifted_out[r, a, 0] = hessian[r, a, 0] - shift[r] * mass[r, a]
