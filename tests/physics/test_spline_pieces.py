"""Closest points of pieces of splines: nothing near them is closer."""

import numpy as np
import warp as wp
from scipy.optimize import minimize
from wrod.kernels.contact.segments import AT_END, AT_START, SMOOTHING, SPLINE, nearest_of_pieces

KINDS = (SPLINE, SPLINE | AT_START, SPLINE | AT_END)


@wp.kernel(enable_backward=False)
def search(
    p: wp.array(dtype=wp.mat33d),
    q: wp.array(dtype=wp.mat33d),
    kind: wp.array2d(dtype=wp.int32),
    rho: wp.array2d(dtype=wp.float64),
    found: wp.array2d(dtype=wp.float64),
):
    i = wp.tid()
    near = nearest_of_pieces(p[i], q[i], kind[i, 0], kind[i, 1], rho[i, 0], rho[i, 1])
    found[i, 0] = near.s
    found[i, 1] = near.t
    found[i, 2] = near.distance


def pieces(count, rng):
    """Pairs of pieces that lie nearly along each other within a length, bent by up to a half of
    it: nodes (count, 2, 3 nodes, 3), kinds (count, 2)."""
    nodes = np.zeros((count, 2, 3, 3))
    nodes[..., 0] = np.linspace(-1, 1, 3)
    nodes += rng.normal(size=nodes.shape) * 10 ** rng.uniform(-3, -0.5, (count, 1, 1, 1))
    nodes[:, 1] += rng.uniform(-1.5, 1.5, (count, 1, 3)) * [1, 0.2, 0.2]
    return nodes, rng.choice(KINDS, (count, 2)).astype(np.int32)


def basis(kind, x):
    """Weights of a piece's nodes at x and their derivatives: (..., 3) each."""
    a = np.where(kind & AT_START, 1.0, 0.5)
    b = np.where(kind & AT_END, 1.0, 0.5)
    first, last = a * (1 - x) ** 2, b * x**2
    d_first, d_last = -2 * a * (1 - x), 2 * b * x
    weights = np.stack([first, 1 - first - last, last], axis=-1)
    return weights, np.stack([d_first, -d_first - d_last, d_last], axis=-1)


def smoothed(x, nodes, kind, rho):
    """The squared distance with its small terms at x (..., 2), and its gradient (..., 2)."""
    ends = np.array([0.0, 1.0])
    e, f = (np.diff(basis(k, ends)[0] @ q, axis=0)[0] for k, q in zip(kind, nodes, strict=True))
    along = ((e @ f) ** 2 / ((e @ e) * (f @ f))) ** 32
    at = [basis(k, y) for k, y in zip(kind, x, strict=True)]
    gap, first, second = at[0][0] @ nodes[0] - at[1][0] @ nodes[1], at[0][1], at[1][1]
    small = along * rho * (x - 0.5)
    gradient = 2 * np.array([gap @ (first @ nodes[0]), -gap @ (second @ nodes[1])]) + 2 * small
    return gap @ gap + small @ (x - 0.5), gradient


def test_nothing_near_the_closest_points_is_closer():
    """At a minimum over the unit square no turn of s or t that stays in it goes down."""
    count = 4000
    nodes, kind = pieces(count, np.random.default_rng(5))
    rho = np.full((count, 2), SMOOTHING.value)
    columns = np.ascontiguousarray(np.swapaxes(nodes, 2, 3))
    found = wp.zeros((count, 3), dtype=wp.float64)
    given = [wp.array(columns[:, i], dtype=wp.mat33d) for i in (0, 1)]
    wp.launch(search, count, inputs=[*given, wp.array(kind), wp.array(rho)], outputs=[found])
    found = found.numpy()
    jammed = []
    for i in range(count):
        x = found[i, :2]
        value, gradient = smoothed(x, nodes[i], kind[i], rho[i])
        np.testing.assert_allclose(value, found[i, 2] ** 2, rtol=1e-12, atol=1e-14)
        if np.abs(np.clip(x - gradient, 0, 1) - x).max() > 1e-7:
            jammed.append(i)
    assert len(jammed) <= count // 1000, jammed
    # A library's search from there finds nothing nearer, not even where the kernel jams.
    for i in (*jammed, *range(100)):
        best = minimize(
            smoothed, found[i, :2], (nodes[i], kind[i], rho[i]), jac=True, bounds=[(0, 1)] * 2
        )
        assert found[i, 2] ** 2 <= best.fun + 1e-9
