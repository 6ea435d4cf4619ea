"""The small system of a grasp: what is left when the rod between contact and grip is in balance.

Unknowns are the stretch of the first edge, the last block (the grip; where rods twist, the angle of
the last edge before it) and the thrust T; equations the balance of the first free block, which
makes the moment at the contact that of the pattern's curvature, f_x = -T at the grip, and one that
says where on the family of grasps to be: `along` times the unknowns' change is given. The thrust
turns round along the family, close to the grasp of least friction, so that it does not serve as
its parameter; the family's own tangent does.
"""

from typing import NamedTuple

import warp as wp
from wrod.kernels.elastic.frames import ONE, ZERO


class Border(NamedTuple):
    """The functions and the vector of unknowns of one size of block."""

    vector: type
    matrix: wp.Function
    residual: wp.Function
    grip_rate: wp.Function
    grip_gradient: wp.Function
    put_grip_gradient: wp.Function
    solve: wp.Function
    put_motion: wp.Function


_cache: dict[int, Border] = {}


def make_border(size: int) -> Border:
    """For blocks of `size`, 3 or 4."""
    if size not in _cache:
        count = size + 2
        matrix = wp.types.matrix(shape=(count, count), dtype=wp.float64)
        vector = wp.types.vector(length=count, dtype=wp.float64)
        _cache[size] = Border(
            vector,
            *_balances(size, matrix, vector),
            *_forces_at_grip(size, vector),
            _gauss(count, matrix, vector),
            _motion(size, vector),
        )
    return _cache[size]


def _balances(size: int, matrix: type, vector: type) -> tuple[wp.Function, wp.Function]:
    """The border equations' derivative and their residual."""
    count = size + 2
    first = size - 3

    @wp.func
    def border_matrix(
        condensed: wp.array2d(dtype=wp.float64), slot: int, direction: wp.vec3d, along: vector
    ) -> matrix:
        """Derivative of the border equations by the unknowns."""
        m = matrix()
        for i in range(size + 1):
            # The last balance is that of the grip along x.
            row = wp.where(i < size, i, size + first) * (2 * size)
            for c in range(3):
                m[i, 0] += condensed[slot, row + first + c] * direction[c]
            for c in range(size):
                m[i, 1 + c] = condensed[slot, row + size + c]
        m[size, size + 1] = ONE
        for c in range(count):
            m[size + 1, c] = along[c]
        return m

    @wp.func
    def border_residual(
        condensed: wp.array2d(dtype=wp.float64), slot: int, node_1: wp.vec3d, thrust: wp.float64
    ) -> vector:
        """The balances when the first node has been moved by `node_1`; 0 in the last place."""
        f = vector()
        for i in range(size + 1):
            row = wp.where(i < size, i, size + first)
            value = condensed[slot, 4 * size * size + row]
            for c in range(3):
                value += condensed[slot, row * 2 * size + first + c] * node_1[c]
            f[i] = value
        f[size] = f[size] + thrust
        return f

    return border_matrix, border_residual


def _forces_at_grip(size: int, vector: type) -> tuple[wp.Function, wp.Function, wp.Function]:
    """The gradient at the grip and its rate."""
    first = size - 3

    @wp.func
    def grip_rate(
        condensed: wp.array2d(dtype=wp.float64), slot: int, node_1: wp.vec3d, v: vector
    ) -> wp.vec3d:
        """Rate of the gradient at the grip when the first node moves by `node_1` and the last block
        as in `v`."""
        g = wp.vec3d(ZERO, ZERO, ZERO)
        for i in range(3):
            row = (size + first + i) * 2 * size
            value = wp.float64(0.0)
            for c in range(3):
                value += condensed[slot, row + first + c] * node_1[c]
            for c in range(size):
                value += condensed[slot, row + size + c] * v[1 + c]
            g[i] = value
        return g

    @wp.func
    def grip_gradient(condensed: wp.array2d(dtype=wp.float64), slot: int) -> wp.vec3d:
        k = 4 * size * size + size + first
        return wp.vec3d(condensed[slot, k], condensed[slot, k + 1], condensed[slot, k + 2])

    @wp.func
    def put_grip_gradient(condensed: wp.array2d(dtype=wp.float64), slot: int, g: wp.vec3d):
        for i in range(3):
            condensed[slot, 4 * size * size + size + first + i] = g[i]

    return grip_rate, grip_gradient, put_grip_gradient


def _gauss(count: int, matrix: type, vector: type) -> wp.Function:
    @wp.func
    def solve_border(matrix_in: matrix, rhs_in: vector) -> vector:
        """Gaussian elimination with partial pivoting."""
        m = matrix(matrix_in)
        x = vector(rhs_in)
        for p in range(count):
            best = int(p)
            for i in range(p + 1, count):
                if wp.abs(m[i, p]) > wp.abs(m[best, p]):
                    best = i
            if best != p:
                for c in range(p, count):
                    swap = m[p, c]
                    m[p, c] = m[best, c]
                    m[best, c] = swap
                swap = x[p]
                x[p] = x[best]
                x[best] = swap
            for i in range(p + 1, count):
                share = m[i, p] / m[p, p]
                for c in range(p + 1, count):
                    m[i, c] = m[i, c] - share * m[p, c]
                x[i] = x[i] - share * x[p]
        for back in range(count):
            p = count - 1 - back
            value = x[p]
            for c in range(p + 1, count):
                value -= m[p, c] * x[c]
            x[p] = value / m[p, p]
        return x

    return solve_border


def _motion(size: int, vector: type) -> wp.Function:
    first = size - 3

    @wp.func
    def put_motion(
        motion: wp.array3d(dtype=wp.float64), slot: int, edges: int, node_1: wp.vec3d, v: vector
    ):
        """The border's part of the blocks' motion: the first node moves by `node_1`, the last block
        as in `v`."""
        for c in range(size):
            motion[slot, 0, c] = ZERO
            motion[slot, 1, c] = ZERO
            motion[slot, edges, c] = v[1 + c]
        for c in range(3):
            motion[slot, 1, first + c] = node_1[c]

    return put_motion
