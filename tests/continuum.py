"""Optimal grasps of a continuous Kirchhoff rod by collocation (SciPy), not by elements.

`python tests/continuum.py` writes `tests/data/continuum_grasps.json`, which tests of grasps and
controllers compare with in every clone.
"""

import json
from pathlib import Path

import numpy as np
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from wrod.grasps.mesh import WEIGHT, rest_lengths
from wrod.grasps.optimal import solve_grasps

STORED = Path(__file__).parent / "data" / "continuum_grasps.json"
# (l_s, kappa, k_s) over the range that occurs: ends, middle, both turns.
INPUTS = (
    (1.1, 0.0, 2087.0), (1.1, 3.2, 400.0), (2.0, -1.0, 15000.0), (3.5, 2.6, 2087.0),
    (5.0, 0.5, 506.0), (5.0, 1.0, 1600.0), (8.0, 0.0, 2087.0), (8.0, -2.0, 2087.0),
    (13.0, 1.5, 150.0), (17.68, 0.5, 2087.0), (27.0, 3.0, 8000.0), (48.0, 1.0, 1156.0),
)  # fmt: skip


def kirchhoff_grasp(ls, kappa, ks, guess, tolerance=1e-8):
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
    found = solve_bvp(rhs, ends, s, y, p=-force[1:], tol=tolerance, max_nodes=100000)
    assert found.success, found.message
    end = found.y[:, -1]
    rotation = np.stack([end[3:6], end[9:12], np.cross(end[3:6], end[9:12])], axis=1)
    return end[:3], Rotation.from_matrix(rotation).as_rotvec(), np.array([0, *-found.p])


def guess_of(ls, kappa, ks):
    """Arc length, shape and force to start collocation from: those of the discrete rod."""
    grasps = solve_grasps(ls, kappa, ks)
    nodes = grasps.shape.shape[1]
    s = np.concatenate([[0.0], np.cumsum(rest_lengths(np.array([ls]), nodes - 1)[0])])
    return s, grasps.shape[0], grasps.force[0]


def main():
    entries = []
    for inputs in INPUTS:
        found = kirchhoff_grasp(*inputs, guess_of(*inputs), tolerance=1e-9)
        names = ("position", "rotation", "force")
        entries.append(
            dict(zip(("ls", "kappa", "ks"), inputs, strict=True))
            | {name: part.tolist() for name, part in zip(names, found, strict=True)}
        )
        print(inputs)
    STORED.write_text(json.dumps(entries, indent=1) + "\n")


if __name__ == "__main__":
    main()
