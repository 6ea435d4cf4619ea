"""Refusing inputs of grasps that are out of bounds, on the device where they are."""

import warp as wp


@wp.kernel
def find_outside(
    # In:
    value: wp.array(dtype=wp.float64),
    low: wp.float64,
    high: wp.float64,
    # Out:
    first_out: wp.array(dtype=wp.int32),
):
    """Index of the first value that is not between two limits."""
    i = wp.tid()
    if not (value[i] >= low and value[i] <= high):
        wp.atomic_min(first_out, 0, i)
