"""Grasps of naturally curved rods against a continuous Kirchhoff rod solved by collocation."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from wrod.grasps.mesh import WEIGHT
from wrod.grasps.optimal import solve_grasps


def kirchhoff_grasp(ls, kappa, ks, natural, torsion, guess):
    """q' = (1 + n.t/k_s) t, t' = w x t, d' = w x d, m' = -q' x n, n = (0, n_y, n_z) + w s z.

    The curvature vector is w = m_bending + m_twisting / torsion + t x (c_1 d_1 + c_2 d_2). From the
    frame (x, y, z) and m = kappa z - t x (c_1 y + c_2 z), without twisting moment, at the contact
    to no bending moment at the grip. `natural` are (c_1, c_2); the guess is that of a straight rod.
    """

    def rhs(s, y, p, c):
        _, t, m, d = y.reshape(4, 3, -1)
        n = np.stack([0 * s, p[0] + 0 * s, p[1] + WEIGHT * s])
        dq = (1 + (n * t).sum(0) / ks) * t
        twist = (m * t).sum(0)
        own = c[0] * np.cross(t, d, axis=0) + c[1] * np.cross(t, np.cross(t, d, axis=0), axis=0)
        w = m + (1 / torsion - 1) * twist * t + own
        dm = -np.cross(dq, n, axis=0)
        return np.concatenate([dq, np.cross(w, t, axis=0), dm, np.cross(w, d, axis=0)])

    def ends(a, b, p, c):
        start = np.array([0, 0, 0, 1, 0, 0, 0, c[1], kappa - c[0], 0, 1, 0])
        across = np.cross(b[9:12], b[3:6])
        return np.concatenate([a - start, [b[6:9] @ b[9:12], b[6:9] @ across]])

    s, shape, force = guess
    t = np.gradient(shape, s, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    m = np.cross(t, np.gradient(t, s, axis=0))
    y = np.concatenate([shape.T, t.T, m.T, np.cross([0.0, 0.0, 1.0], t).T])
    p = -force[1:]
    for share in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.hypot(*natural) * ls / 0.7))):
        c = share * np.asarray(natural)
        found = solve_bvp(
            lambda s, y, p, c=c: rhs(s, y, p, c),
            lambda a, b, p, c=c: ends(a, b, p, c),
            s, y, p=p, tol=1e-7, max_nodes=20000,
        )  # fmt: skip
        assert found.success, found.message
        s, y, p = found.x, found.y, found.p
    end = y[:, -1]
    rotation = np.stack([end[3:6], end[9:12], np.cross(end[3:6], end[9:12])], axis=1)
    return end[:3], Rotation.from_matrix(rotation), np.array([0, *-p])


@pytest.mark.parametrize(
    "ls, kappa, ks, natural, poisson",
    [
        (3.0, 0.7, 300.0, (0.3, 0.0), 0.5),
        (6.0, 2.2, 150.0, (-0.2, 0.1), 0.3),
        (14.0, -0.6, 15000.0, (0.13, 0.0), 0.5),
        (9.0, 0.0, 900.0, (0.13, 0.05), 0.0),
    ],
)
def test_curved_grasp_of_the_continuum(ls, kappa, ks, natural, poisson):
    straight = solve_grasps(ls, kappa, ks)
    grasps = solve_grasps(ls, kappa, ks, natural_curvature=natural, poisson=poisson)
    assert grasps.converged.all()
    position, rotation, force = kirchhoff_grasp(
        ls, kappa, ks, natural, 1 / (1 + poisson),
        (straight.arc_length[0], straight.shape[0], straight.force[0]),
    )  # fmt: skip
    # The effect is more than an order above the tolerance.
    assert np.abs(position - straight.position[0]).max() > 0.04
    assert np.abs(grasps.position[0] - position).max() < 2e-3
    turn = (Rotation.from_rotvec(grasps.rotation[0]).inv() * rotation).magnitude()
    assert turn < 3e-3
    assert np.abs(grasps.force[0] - force).max() < 2e-3
