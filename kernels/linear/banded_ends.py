"""Solution of a banded system on a GPU, two warps a rod: the same as `banded`'s, sooner.

The rows are eliminated from both ends at once (a twisted factorisation), one end by each warp, so
that half of them have to be waited for. What both leave of some rows between them is added up there
and eliminated as usual; then both go back to their ends. The right-hand side is eliminated with the
matrix. A warp takes four columns at a time: their pivots two by two, with one division's time for
both, and then all 65 numbers that these four columns change. A window of the band is in shared
memory; the rows after it are on their way meanwhile.

L and D are for these sweeps alone: those of the second end are of the reversed matrix. There are as
many negative pivots as in any factorisation.

Compiled for a CPU the same source loops over ends and lanes, to be tested without a GPU.
"""

import warp as wp
from wrod.kernels.linear.two_warps import COUNT, ELIMINATE

_TWO = """
    const int SIDES = 2;
    const size_t begin = (size_t)r * hessian.shape[1] + first;
    const double* right = gradient.data + begin;
    double* solution = x.data + (size_t)r * x.shape[1] * x.shape[2] + first;
"""
_BACK = """
    // Back to the ends: the first to where it met the second, then both. Each lane has one unknown
    // of the chunk, and learns the others.
    WROD_LANE_VALUE(double, value);
    WROD_LANE_VALUE(double, known);
    // Which of its two windows an end is at.
    int turns[2] = {0, 0};
    for (int phase = 0; phase < 2; ++phase) {
        WROD_ENDS {
            const bool begins = phase == 0 || end == 1;
            const int stop = phase == 0 ? n - other : end ? other : meet;
            const int least = phase == 0 ? meet : 0;
            int turn = end == 0 ? turns[0] : turns[1];
            if (phase == 1 || end == 0) {
                for (int base = (stop - 1) / CHUNK * CHUNK; base >= least && stop > 0;
                     base -= CHUNK) {
                    if (begins && base + CHUNK >= stop) {
                        WROD_LANES {
                            // Beyond `stop` the second end knows what the first has found.
                            const int a = base + lane, b = a + CHUNK;
                            WROD_OWN(value) = a < stop ? windows[end][RIGHT + lane]
                                : end && a < stop + REACH ? solution[WROD_PLACE(1, a)] : 0.0;
                            WROD_OWN(known) =
                                end && b < stop + REACH ? solution[WROD_PLACE(1, b)] : 0.0;
                        }
                    } else {
                        const double* last = turn ? arrivals[end] : windows[end];
                        turn = 1 - turn;
                        double* here = turn ? arrivals[end] : windows[end];
                        WROD_LANES {
                            WROD_OWN(value) = solution[WROD_PLACE(end, base + lane)];
                            for (int m = lane; m < REACH * BAND; m += 32)
                                here[CHUNK * BAND + m] = last[m];
                        }
                        WROD_ARRIVE();
                    }
                    const double* window = turn ? arrivals[end] : windows[end];
                    WROD_LANES {
                        const double* kept = WROD_KEPT(end, base - CHUNK);
                        double* there = turn ? windows[end] : arrivals[end];
                        if (base >= CHUNK) {
                            _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32)
                                WROD_SEND(there + m, kept + m);
                        }
                    }
                    const int count = stop - base < CHUNK ? stop - base : CHUNK;
                    _Pragma("unroll") for (int t = 0; t < REACH; ++t) {
                        const double found = WROD_FROM(known, t);
                        WROD_LANES {
                            const int k = CHUNK + t - lane;
                            const double entry =
                                k <= REACH && lane < count ? window[(CHUNK + t) * BAND + k] : 0.0;
                            WROD_OWN(value) -= entry * found;
                        }
                    }
                    _Pragma("unroll 8") for (int t = CHUNK - 1; t > 0; --t) {
                        const double found = WROD_FROM(value, t);
                        WROD_LANES {
                            const int k = t - lane;
                            const double entry = k > 0 && k <= REACH && lane < count
                                                     ? window[t * BAND + k] : 0.0;
                            WROD_OWN(value) -= entry * found;
                        }
                    }
                    WROD_LANES {
                        WROD_OWN(known) = WROD_OWN(value);
                        if (lane < count)
                            solution[WROD_PLACE(end, base + lane)] = WROD_OWN(value);
                    }
                    WROD_SYNC();
                }
                if (end == 0) turns[0] = turn;
            }
        }
        WROD_MEET();
    }
"""


@wp.func_native(_TWO + ELIMINATE + _BACK + COUNT)
def solve_rod(
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    r: int,
    first: int,
    n: int,
    factor_out: wp.array3d(dtype=wp.float64),
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
): ...


@wp.kernel(launch_bounds=(64, 8))
def solve(
    # In:
    segment: wp.array(dtype=wp.vec2i),
    active: wp.array(dtype=wp.int32),
    free: wp.array2d(dtype=wp.int32),
    hessian: wp.array3d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    shift: wp.array(dtype=wp.float64),
    # Scratch (rod, dof, 11):
    factor_out: wp.array3d(dtype=wp.float64),
    # Out:
    x: wp.array3d(dtype=wp.float64),
    negative_pivots_out: wp.array(dtype=wp.int32),
):
    """Solve (hessian + shift) x = gradient for the free degrees of freedom, the first column of
    `x`, and count negative pivots; the others come out as zero.

    Launched over (rod, segment, thread) in blocks of `ENDS`.
    """
    r, s, _thread = wp.tid()
    if active[r] != 0:
        part = segment[s]
        solve_rod(
            free, hessian, gradient, shift, r, part[0], part[1],
            factor_out, x, negative_pivots_out,
        )  # fmt: skip
