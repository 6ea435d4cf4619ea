"""Work on one rod, shared by the lanes of a warp or of a whole block on a GPU.

Kernels that walk along whole rods are launched over (rod, lane) in blocks of `lanes(device)`: on a
GPU each of 32 lanes takes every 32nd degree of freedom, or each of `CROWD` in a long row; on a CPU
one lane takes all. Those whose lanes need each other's results wait for them in between; they are
launched in blocks of `lanes(device, TEAM)`.
"""

import warp as wp

WARP = 32
# Lanes that wait for each other.
TEAM = 128
# Lanes of a row of more nodes than `LONG`.
CROWD, LONG = 256, 256
# For snippets whose lanes wait for each other: what they do each for themselves, which on a CPU are
# loops over all, and numbers that each has of its own.
TEAMWORK = f"""
    const int TEAM = {TEAM};
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_TEAM for (int lane = threadIdx.x, once = 1; once; once = 0)
#define WROD_FIRST_WARP if (threadIdx.x < 32)
#define WROD_WAIT() __syncthreads()
#define WROD_WARP_WAIT() __syncwarp()
#define WROD_LANE_ARRAY(type, name, size) type name[size]
#define WROD_OWN(name, m) name[m]
#else
#define WROD_SHARED
#define WROD_TEAM for (int lane = 0; lane < TEAM; ++lane)
#define WROD_FIRST_WARP
#define WROD_WAIT()
#define WROD_WARP_WAIT()
#define WROD_LANE_ARRAY(type, name, size) type name[size][TEAM]
#define WROD_OWN(name, m) name[m][lane]
#endif
"""


def lanes(device: str, count: int = WARP) -> int:
    """Lanes that a device works on a rod with, and threads of a block that does so."""
    return 1 if wp.get_device(device).is_cpu else count


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
""")
def wait_for_lanes():
    """Let every lane of a block see what all others have written."""
    ...


# What the warps of a block bring together: every lane reads all parts, in one order.
_SHARE = """
    if (blockDim.x > 32) {
        __shared__ TYPE parts[32];
        if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = value;
        __syncthreads();
        value = parts[0];
        for (int warp = 1; warp < blockDim.x / 32; ++warp) {
            const TYPE other = parts[warp];
            COMBINE;
        }
        __syncthreads();
    }
"""


def _over_lanes(type: str, combine: str) -> str:
    """Source of what a block's lanes make of their values by `value` and `other`."""
    share = _SHARE.replace("TYPE", type).replace("COMBINE", combine)
    return f"""
#if defined(__CUDA_ARCH__)
    for (int reach = 16; reach > 0; reach /= 2) {{
        const {type} other = __shfl_xor_sync(0xffffffffu, value, reach);
        {combine};
    }}
    {share}
#endif
    return value;
"""


@wp.func_native(_over_lanes("int", "value += other"))
def count_of_lanes(value: int) -> int:
    """Sum of the counts of a block's lanes, in every lane."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const int lane = threadIdx.x % 32;
    int sum = value;
    for (int reach = 1; reach < 32; reach *= 2) {
        const int other = __shfl_up_sync(0xffffffffu, sum, reach);
        if (lane >= reach) sum += other;
    }
    int before = sum - value;
    if (blockDim.x > 32) {
        __shared__ int parts[32];
        if (lane == 31) parts[threadIdx.x / 32] = sum;
        __syncthreads();
        for (int warp = 0; warp < threadIdx.x / 32; ++warp) before += parts[warp];
        __syncthreads();
    }
    return before;
#else
    return 0;
#endif
""")
def count_of_lanes_before(value: int) -> int:
    """Sum of the counts of the lanes before this one in its block."""
    ...


# Comparisons with a NaN are false, so that one is not lost.
@wp.func_native(_over_lanes("double", "if (!(other <= value) && isfinite(value)) value = other"))
def largest_of_lanes(value: wp.float64) -> wp.float64:
    """Largest of the lanes' values, in every lane; not finite where one of them is not."""
    ...


@wp.func_native(_over_lanes("double", "value += other"))
def sum_of_lanes(value: wp.float64) -> wp.float64:
    """Sum of the lanes' values, in every lane."""
    ...
