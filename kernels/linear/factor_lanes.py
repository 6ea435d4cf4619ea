"""Banded factorisation on a GPU, one rod a warp: the same L and D as `banded`, for several
right-hand sides or one that comes later.

The rows are eliminated as `banded_ends` does it, but from their first on.
"""

import warp as wp
from wrod.kernels.linear.two_warps import COUNT, ELIMINATE

_ONE = """
    const int SIDES = 1;
    const size_t begin = (size_t)r * hessian.shape[1] + first;
    const double* right = nullptr;
    double* solution = nullptr;
"""


@wp.func_native(_ONE + ELIMINATE + COUNT)
def factorise_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    r: int,
    first: int,
    n: int,
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.kernel
def factorise(
    # In:
    segment: wp.array(dtype=wp.vec2i),
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Out:
    factor_out: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """`banded.factorise`, launched over (rod, segment, lane) in blocks of a warp."""
    r, s, _lane = wp.tid()
    if active[r] != 0:
        part = segment[s]
        factorise_rod(free, hessian, shift, r, part[0], part[1], factor_out, negative_pivots_out)
