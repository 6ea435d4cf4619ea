"""Systems with a border: degrees of freedom that are prescribed in the banded matrix, and unknowns
of a small system that is condensed on them."""

import warp as wp
from wrod.kernels.linear.banded import banded_entry

wp.set_module_options({"enable_backward": False})


@wp.kernel
def load_border(
    # Model:
    border: wp.array(dtype=wp.int32),
    # In:
    active: wp.array(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    hessian: wp.array3d(dtype=wp.float64),
    # Out:
    rhs_out: wp.array3d(dtype=wp.float64),
):
    """Right-hand sides: the gradient, then the Hessian's columns of the border coordinates."""
    r, j, a = wp.tid()
    if active[r] == 0:
        return
    if j == 0:
        rhs_out[r, 0, a] = gradient[r, a]
    else:
        rhs_out[r, j, a] = banded_entry(hessian, r, a, border[j - 1])


@wp.func
def worst_imbalance(
    free: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.float64),
    r: int,
    first: int,
    last: int,
) -> wp.float64:
    """Largest unbalanced force of the free degrees of freedom, and of those from `first` up to
    `last`."""
    worst = wp.float64(0.0)
    for a in range(gradient.shape[1]):
        if free[r, a] != 0 or (a >= first and a < last):
            value = wp.abs(gradient[r, a])
            # Comparisons with a NaN are false, so that one is not lost.
            if not (value <= worst) and wp.isfinite(worst):
                worst = wp.float64(value)
    return worst
