"""Factorisations of matrices that are symmetric but for their nodes' blocks."""

import numpy as np
import pytest
import warp as wp
from wrod.kernels.linear import banded_lu
from wrod.kernels.stepping import deployment_tangents as kernels
from wrod.kernels.stepping.pace import Pace


@pytest.mark.parametrize("nodes", [4, 9, 31])
def test_solutions_are_those_of_the_whole_matrix(nodes):
    """Eight right-hand sides in one thread, and one in each warp, of two matrices."""
    n, rng = 4 * nodes - 1, np.random.default_rng(nodes)
    hessian = rng.standard_normal((2, n, 11))
    hessian[:, :, 0] += 20.0
    coupling = rng.standard_normal((2, nodes, 3, 3))
    free = (rng.random((2, n)) > 0.2).astype(np.int32)
    x = rng.standard_normal((2, n, 8))
    whole = banded_lu.NodeCoupled()
    whole.hessian = wp.array(hessian, dtype=wp.float64, device="cpu")
    whole.coupling = wp.array(coupling, dtype=wp.mat33d, device="cpu")
    rods = wp.ones(2, dtype=wp.int32, device="cpu")
    factor = wp.zeros((2, n, banded_lu.BAND), dtype=wp.float64, device="cpu")
    given = [rods, wp.array(free, device="cpu"), whole]
    wp.launch(banded_lu.assemble, (2, n), inputs=given, outputs=[factor], device="cpu")
    wp.launch(banded_lu.factorise, (2, 1), inputs=[rods], outputs=[factor], device="cpu")
    matrix = np.zeros((2, n, n))
    for a in range(n):
        for b in range(max(0, a - 10), min(n, a + 11)):
            matrix[:, a, b] = hessian[:, max(a, b), abs(a - b)]
            if a // 4 == b // 4 and a % 4 < 3 and b % 4 < 3:
                matrix[:, a, b] += coupling[:, a // 4, a % 4, b % 4]
    for r, a in zip(*np.nonzero(free == 0), strict=True):
        matrix[r, a] = np.eye(n)[a]
    wanted = np.linalg.solve(matrix, x)
    pace = Pace()
    pace.accepted, pace.time = rods, wp.zeros(2, dtype=wp.float64, device="cpu")
    packed, alone = kernels.vector_of(kernels.PACK), banded_lu.ALONE
    for vector, kernel in ((packed, kernels.solve_tangents), (alone, kernels.solve_tangents_lanes)):
        size = vector._length_
        packs = 8 // size
        dim = (2, packs) if size > 1 else (2, packs, 1)
        columns = x.reshape(2, n, packs, size).transpose(0, 2, 1, 3)
        solution = wp.array(np.ascontiguousarray(columns), dtype=vector, device="cpu")
        begin = wp.zeros((2, packs), dtype=wp.float64, device="cpu")
        inputs = [begin, pace, factor]
        wp.launch(kernel, dim, inputs=inputs, outputs=[solution], device="cpu")
        found = solution.numpy().reshape(2, packs, n, size).transpose(0, 2, 1, 3).reshape(x.shape)
        np.testing.assert_allclose(found, wanted, atol=1e-12)
