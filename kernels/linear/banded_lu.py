"""Banded factorisation without pivoting of a matrix that is symmetric but for its nodes' blocks.

The matrix is a Hessian (`wrod.kernels.elastic.assembly`) plus a 3 x 3 block of each node, such as
what friction takes from the normal force. `factor[r, a, 10 + k]` holds U[a, a + k], 1 / U[a, a] for
k = 0, and `factor[r, a, 10 - k]` L[a, a - k]; entries outside the matrix are zero.
"""

from typing import Any

import warp as wp
from wrod.kernels.elastic.assembly import HALF_BANDWIDTH
from wrod.kernels.elastic.frames import ONE, ZERO
from wrod.kernels.linear.banded_lanes import SWEEP

BAND = wp.constant(2 * 10 + 1)
# A right-hand side by itself, as a GPU has them.
ALONE = wp.types.vector(length=1, dtype=wp.float64)


@wp.struct
class NodeCoupled:
    """A Hessian (rod, dof, 11) and what is added to it in each node's block (rod, node)."""

    hessian: wp.array3d(dtype=wp.float64)
    coupling: wp.array2d(dtype=wp.mat33d)


@wp.func
def node_coupled_entry(m: NodeCoupled, r: int, a: int, b: int) -> wp.float64:
    value = m.hessian[r, wp.max(a, b), wp.abs(a - b)]
    if a / 4 == b / 4 and a % 4 < 3 and b % 4 < 3:
        value += m.coupling[r, a / 4][a % 4, b % 4]
    return value


def make_assembly(matrix: type, entry: wp.Function) -> wp.Kernel:
    """What writes a struct's matrix, whose `entry` (row, column) of a rod is asked for."""

    @wp.kernel(module="unique", enable_backward=False)
    def assemble(
        # In:
        active: wp.array(dtype=wp.int32),
        free: wp.array2d(dtype=wp.int32),
        m: matrix,
        # Out:
        factor_out: wp.array3d(dtype=wp.float64),
    ):
        """The matrix, where `factorise` takes it from. Rows that are not free are those of the
        identity; their columns are kept, which is how what is prescribed moves the rest. Launched
        over (rod, dof)."""
        r, a = wp.tid()
        if active[r] == 0:
            return
        n = free.shape[1]
        for k in range(BAND):
            b = a + k - HALF_BANDWIDTH
            value = wp.float64(0.0)
            if free[r, a] == 0:
                value = wp.where(b == a, ONE, ZERO)
            elif b >= 0 and b < n:
                value = entry(m, r, a, b)
            factor_out[r, a, k] = value

    return assemble


assemble = make_assembly(NodeCoupled, node_coupled_entry)


# A window of 42 rows, 32 whose pivots are due and the 10 below them, goes down the matrix. Row `at`
# holds entries (a, a - 10 + k), k = 0...20. A pivot updates the 100 entries below and to the right
# of it at once, four a lane; left of the diagonal they stay L times the pivot until they are
# written.
_FACTORISE = (
    SWEEP
    + """
    const int ROW = 21, WIDE = 22;
    const int n = factor.shape[1];
    double* rows = factor.data + (size_t)r * n * ROW;
    WROD_SHARED double wide[42 * 22];
    // Reciprocals of the pivots of the 10 rows before the window and of its first 32:
    WROD_SHARED double inverses[42];
#define WROD_WIDE(at, k) wide[(at) * WIDE + (k)]
#define WROD_ROWS(at, first, count) \\
    for (int m = lane; m < (count) * ROW; m += 32) { \\
        const int k = m % ROW, row = m / ROW, a = (first) + row; \\
        WROD_WIDE((at) + row, k) = a < n ? rows[a * ROW + k] : (k == REACH ? 1.0 : 0.0); \\
    }

    WROD_SYNC();
    WROD_LANES {
        WROD_ROWS(0, 0, CHUNK + REACH)
        for (int m = lane; m < 42; m += 32) inverses[m] = 0.0;
    }
    WROD_SYNC();
    for (int base = 0; base < n; base += CHUNK) {
        const int count = n - base < CHUNK ? n - base : CHUNK;
        for (int t = 0; t < count; ++t) {
            const double inverse = 1.0 / WROD_WIDE(t, REACH);
            WROD_LANES {
                _Pragma("unroll") for (int m = 0; m < 4; ++m) {
                    const int i = (lane + 32 * m) / REACH + 1, j = (lane + 32 * m) % REACH + 1;
                    if (i <= REACH)
                        WROD_WIDE(t + i, REACH - i + j) -=
                            WROD_WIDE(t + i, REACH - i) * inverse * WROD_WIDE(t, REACH + j);
                }
                if (lane == 31) inverses[REACH + t] = inverse;
            }
            WROD_SYNC();
        }
        WROD_LANES {
            for (int m = lane; m < count * ROW; m += 32) {
                const int k = m % ROW, t = m / ROW;
                double value = WROD_WIDE(t, k);
                if (k < REACH) value *= inverses[t + k];
                if (k == REACH) value = inverses[REACH + t];
                rows[base * ROW + m] = value;
            }
        }
        WROD_SYNC();
        WROD_LANES {
            for (int m = lane; m < REACH * WIDE; m += 32) wide[m] = wide[CHUNK * WIDE + m];
            if (lane < REACH) inverses[lane] = inverses[CHUNK + lane];
        }
        WROD_SYNC();
        WROD_LANES { WROD_ROWS(REACH, base + CHUNK + REACH, CHUNK) }
        WROD_SYNC();
    }
"""
)


@wp.func_native(_FACTORISE)
def factorise_rod(r: int, factor: wp.array3d(dtype=wp.float64)): ...


@wp.kernel
def factorise(
    # In:
    active: wp.array(dtype=wp.int32),
    # In and out:
    factor: wp.array3d(dtype=wp.float64),
):
    """A = L U in place of what `assemble` wrote, launched over (rod, lane) in blocks of a warp."""
    r, _lane = wp.tid()
    if active[r] != 0:
        factorise_rod(r, factor)


@wp.func
def substitute(factor: wp.array3d(dtype=wp.float64), r: int, p: int, x: wp.array3d(dtype=Any)):
    """Solve L U x = x in place. What is outside the matrix multiplies its first or last unknown by
    zero, so that all rows are of one length. What was found last comes last: a row then waits for
    the one before by one product instead of ten."""
    n = x.shape[2]
    for a in range(n):
        value = x[r, p, a]
        for m in range(10):
            value -= factor[r, a, m] * x[r, p, wp.max(a - 10 + m, 0)]
        x[r, p, a] = value
    for back in range(n):
        a = n - 1 - back
        value = x[r, p, a]
        for m in range(10):
            value -= factor[r, a, 20 - m] * x[r, p, wp.min(a + 10 - m, n - 1)]
        x[r, p, a] = factor[r, a, 10] * value


# The window holds what the chunk's rows have left of the diagonal, then what they have from it on.
_SUBSTITUTE = (
    SWEEP
    + """
    const int ROW = 21;
    const int n = factor.shape[1];
    const double* rows = factor.data + (size_t)r * n * ROW;
    double* solution = (double*)x.data + ((size_t)r * x.shape[1] + p) * n;
    WROD_LANE_VALUE(double, value);
    WROD_LANE_VALUE(double, known);
    for (int base = 0; base < n; base += CHUNK) {
        WROD_SYNC();
        WROD_LANES {
            WROD_OWN(value) = base + lane < n ? solution[base + lane] : 0.0;
            _Pragma("unroll") for (int m = lane; m < CHUNK * REACH; m += 32) {
                const int k = m % REACH, row = m / REACH, a = base + row;
                WROD_AT(row, REACH - k) = a < n ? rows[a * ROW + k] : 0.0;
            }
        }
        WROD_SYNC();
        WROD_FORWARD()
        WROD_LANES {
            WROD_OWN(known) = WROD_OWN(value);
            if (base + lane < n) solution[base + lane] = WROD_OWN(value);
        }
    }
    WROD_LANES { WROD_OWN(known) = 0.0; }
    for (int base = (n - 1) / CHUNK * CHUNK; base >= 0; base -= CHUNK) {
        WROD_SYNC();
        WROD_LANES {
            WROD_OWN(value) = base + lane < n ? solution[base + lane] : 0.0;
            _Pragma("unroll") for (int m = lane; m < CHUNK * BAND; m += 32) {
                const int k = m % BAND, row = m / BAND, a = base + row;
                WROD_AT(row, k) = a < n ? rows[a * ROW + REACH + k] : 0.0;
            }
        }
        WROD_SYNC();
        WROD_BACKWARD(lane, lane, WROD_AT(t, 0))
        WROD_LANES {
            WROD_OWN(known) = WROD_OWN(value) * WROD_AT(lane, 0);
            if (base + lane < n) solution[base + lane] = WROD_OWN(known);
        }
    }
"""
)


@wp.func_native(_SUBSTITUTE)
def substitute_lanes(
    factor: wp.array3d(dtype=wp.float64), r: int, p: int, x: wp.array3d(dtype=ALONE)
):
    """`substitute` for one right-hand side a warp."""
    ...
