"""Grasps against a continuous Kirchhoff rod solved by collocation (SciPy), not by elements."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from wrod.grasps.mesh import WEIGHT, rest_lengths
from wrod.grasps.optimal import solve_grasps


def kirchhoff_grasp(ls, kappa, ks, guess):
    """q' = (1 + n.t/k_s) t, t' = m x t, m' = -q' x n, n = (0, n_y, n_z) + w s z; no twist.

    From q = 0, t = x, m = kappa z at the contact to m = 0 at the grip; also carries a director.
    """

    def rhs(s, y, p):
        _, t, m, d = y.reshape(4, 3, -1)
        n = np.stack([0 * s, p[0] + 0 * s, p[1] + WEIGHT * s])
        dq = (1 + (n * t).sum(0) / ks) * t
        dm = -np.cross(dq, n, axis=0)
        return np.concatenate([dq, np.cross(m, t, axis=0), dm, np.cross(m, d, axis=0)])

    def ends(a, b, p):
        start = np.array([0, 0, 0, 1, 0, 0, 0, 0, kappa, 0, 1, 0])
        return np.concatenate([a - start, b[6:8]])

    s, shape, force = guess
    t = np.gradient(shape, s, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    m = np.cross(t, np.gradient(t, s, axis=0))
    side = np.cross([0.0, 0.0, 1.0], t)
    y = np.concatenate([shape.T, t.T, m.T, side.T])
    found = solve_bvp(rhs, ends, s, y, p=-force[1:], tol=1e-8, max_nodes=20000)
    assert found.success, found.message
    end = found.y[:, -1]
    rotation = np.stack([end[3:6], end[9:12], np.cross(end[3:6], end[9:12])], axis=1)
    return end[:3], Rotation.from_matrix(rotation).as_rotvec(), np.array([0, *-found.p])


@pytest.mark.parametrize(
    "ls, kappa, ks",
    [
        (1.2, 0.7, 300.0),
        (2.5, 3.3, 8000.0),
        (6.0, 2.2, 150.0),
        (14.0, 0.2, 15000.0),
        (23.0, 1.4, 900.0),
        (49.0, 2.9, 4000.0),
    ],
)
def test_grasp_of_the_continuum(ls, kappa, ks):
    grasps = solve_grasps(ls, kappa, ks)
    nodes = grasps.shape.shape[1]
    s = np.concatenate([[0.0], np.cumsum(rest_lengths(np.array([ls]), nodes - 1)[0])])
    position, rotation, force = kirchhoff_grasp(
        ls, kappa, ks, (s, grasps.shape[0], grasps.force[0])
    )
    assert np.abs(grasps.position[0] - position).max() < 2e-3
    assert np.abs(grasps.rotation[0] - rotation).max() < 2e-3
    assert np.abs(grasps.force[0] - force).max() < 2e-3
