"""Whether a rod keeps an equilibrium that collocation has found: conjugate points.

Collocation and its continuation find equilibria of any kind. Between clamps one is stable as long
as no conjugate point lies within the rod: no place at which a rod that leaves the first clamp with
another force and moment, changed by little, stands again where it stood, position and frame. That
is Jacobi's condition for the second variation of the energy (Gelfand and Fomin 1963, ch. 5; for
rods Manning, Rogers and Maddocks 1998). Loads have to be conservative.
A rod with a symmetry may pass two such places at once, which no sign tells.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

# Parts of the rod, and of them over which what leaves the clamp is taken as it grows.
_INTERVALS, _TOGETHER = 400, 8
_STEP = 1e-6
# The places nearest to the first clamp, where nothing has moved yet.
_SKIPPED = 0.02


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of vectors (3, ...); NumPy's own takes twice as long for so few."""
    (x, y, z), (u, v, w) = a, b
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])


def conjugate_points(rhs: Callable, solution: Callable) -> int:
    """Sign changes of the determinant of (position, turn) by (force, moment at the first clamp),
    along the rod; none: stable.

    Args:
        rhs: (u (K,), y (13, K)) -> dy/du (13, K) of position, quaternion, force and moment.
        solution: u (K,) -> y (13, K) of the equilibrium, u from 0 to 1.
    """
    u = (np.arange(_INTERVALS) + 0.5) / _INTERVALS
    y = solution(u)
    size, force, moment = np.ptp(y[:3]), np.abs(y[7:10]).max(), np.abs(y[10:]).max()
    force = max(force, moment / size)
    scale = np.repeat([size, 1.0, force, force * size], [3, 4, 3, 3])
    # By each number, to and fro: all at once, as for so few points a call costs more than it does.
    by = _STEP * np.concatenate([np.diag(scale), -np.diag(scale)], axis=1)
    rates = rhs(np.tile(u, 26), (y[:, None] + by[:, :, None]).reshape(13, -1))
    ahead, back = rates.reshape(13, 2, 13, _INTERVALS).swapaxes(0, 1)
    matrix = np.moveaxis((ahead - back) / (2.0 * _STEP * scale[:, None]), 2, 0)
    # In units of each number, so that the determinant of what is alike in size is taken.
    forward = expm(matrix * (scale / scale[:, None]) / _INTERVALS)
    moved = np.zeros((13, _INTERVALS, 6))
    last = np.eye(13)[:, 7:]
    for k in range(_INTERVALS):
        moved[:, k] = last = forward[k] @ last
        if k % _TOGETHER == 0:
            # Only the sign is wanted, so that what grows most does not hide the rest.
            last, upper = np.linalg.qr(last)
            last *= np.sign(np.diag(upper))
    turn = _turn(solution((np.arange(_INTERVALS) + 1.0) / _INTERVALS)[3:7, :, None], moved[3:7])
    signs = np.linalg.slogdet(np.concatenate([moved[:3], turn]).transpose(1, 0, 2))[0]
    return int((np.diff(signs[int(_SKIPPED * _INTERVALS) :]) != 0).sum())


def _turn(q: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """(3, K, n) rotation vectors of changes (4, K, n) of quaternions (4, K, 1)."""
    real, vector = q[0], q[1:]
    # Twice the vector part of the change times the inverse.
    return 2.0 * (real * moved[1:] - vector * moved[0] - cross(moved[1:], vector))
