"""Walks along one rod, shared by the lanes of a warp on a GPU.

Kernels that walk along whole rods are launched over (rod, lane) in blocks of `lanes(device)`: on a
GPU each of 32 lanes takes every 32nd degree of freedom, on a CPU one lane takes all.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

WARP = 32


def lanes(device: str) -> int:
    """Lanes that a device walks along a rod with, and threads of a block that does so."""
    return 1 if wp.get_device(device).is_cpu else WARP


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int reach = 16; reach > 0; reach /= 2) {
        const double other = __shfl_xor_sync(0xffffffffu, value, reach);
        // Comparisons with a NaN are false, so that one is not lost.
        if (!(other <= value) && isfinite(value)) value = other;
    }
#endif
    return value;
""")
def largest_of_lanes(value: wp.float64) -> wp.float64:
    """Largest of the lanes' values, in every lane; not finite where one of them is not."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int reach = 16; reach > 0; reach /= 2)
        value += __shfl_xor_sync(0xffffffffu, value, reach);
#endif
    return value;
""")
def sum_of_lanes(value: wp.float64) -> wp.float64:
    """Sum of the lanes' values, in every lane."""
    ...
