"""What two warps of a block share that solve a banded system from its two ends (`banded_ends`).

A snippet of device code that its user's begins with: words for what lanes of a warp do, which on a
GPU are instructions and on a CPU loops over ends and lanes, and the windows of the band that are
looked at.
"""

# Threads of a block: a warp for each end.
ENDS = 64

# Two steps of Newton's from a GPU's estimate; what is not normal is nobody's pivot.
RECIPROCAL = """
#if defined(__CUDA_ARCH__)
    auto reciprocal = [](double value) {
        double guess;
        asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(guess) : "d"(value));
        guess = fma(guess, fma(-value, guess, 1.0), guess);
        return fma(guess, fma(-value, guess, 1.0), guess);
    };
#else
    auto reciprocal = [](double value) { return 1.0 / value; };
#endif
"""

WINDOWS = (
    RECIPROCAL
    + """
#if defined(__CUDA_ARCH__)
#define WROD_SHARED __shared__
#define WROD_ENDS for (int end = threadIdx.x / 32, once = 1; once; once = 0)
#define WROD_LANES for (int lane = threadIdx.x % 32, once_ = 1; once_; once_ = 0)
#define WROD_SYNC() __syncwarp()
#define WROD_MEET() __syncthreads()
#define WROD_LANE_VALUE(type, name) type name = 0
#define WROD_OWN(name) name
#define WROD_LANE_ARRAY(type, name, size) type name[size] = {}
#define WROD_OWN_ENTRY(name, m) name[m]
#define WROD_FROM(name, source) __shfl_sync(0xffffffffu, name, source)
#define WROD_BALLOT(bits, name) bits = __ballot_sync(0xffffffffu, name)
#define WROD_SEND(to, from) \\
    asm volatile("cp.async.ca.shared.global [%0], [%1], 8;" \\
                 ::"r"((unsigned)__cvta_generic_to_shared(to)), "l"(from))
#define WROD_ARRIVE() \\
    asm volatile("cp.async.wait_all;" ::: "memory"); \\
    __syncwarp()
#else
#define WROD_SHARED
#define WROD_ENDS for (int end = 0; end < 2; ++end)
#define WROD_LANES for (int lane = 0; lane < 32; ++lane)
#define WROD_SYNC()
#define WROD_MEET()
#define WROD_LANE_VALUE(type, name) type name[32] = {}
#define WROD_OWN(name) name[lane]
#define WROD_LANE_ARRAY(type, name, size) type name[size][32] = {}
#define WROD_OWN_ENTRY(name, m) name[m][lane]
#define WROD_FROM(name, source) name[source]
#define WROD_BALLOT(bits, name) \\
    bits = 0; \\
    for (int lane = 0; lane < 32; ++lane) bits |= (unsigned)(name[lane] != 0) << lane
#define WROD_SEND(to, from) *(to) = *(from)
#define WROD_ARRIVE()
#endif
    const int BAND = 11, REACH = 10, CHUNK = 32, ROWS = CHUNK + REACH;
    // A window holds rows of the entries (a, a - k), k = 0...10, of what is left, then of L and D;
    // then the rows' diagonal as it was, against which pivots that cancel are measured; then their
    // right side.
    const int SIZE = ROWS * BAND, RIGHT = SIZE + ROWS;
    WROD_SHARED double windows[2][RIGHT + ROWS];
    WROD_SHARED double arrivals[2][ROWS * BAND];
    // Four columns of L D and of L below their diagonal block, and of the right-hand side.
    WROD_SHARED double products[2][44];
    WROD_SHARED double scaleds[2][44];
    WROD_SHARED int counts[2];
"""
)
