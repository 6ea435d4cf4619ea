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

_INTERVALS = 400
_STEP = 1e-6
# The places nearest to the first clamp, where nothing has moved yet.
_SKIPPED = 0.02


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of vectors (3, K); NumPy's own takes twice as long for so few."""
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
    matrix = np.empty((_INTERVALS, 13, 13))
    for j in range(13):
        step = np.zeros((13, 1))
        step[j] = _STEP * scale[j]
        matrix[:, :, j] = (rhs(u, y + step) - rhs(u, y - step)).T / (2.0 * step[j])
    # In units of each number, so that the determinant of what is alike in size is taken.
    forward = expm(matrix * (scale / scale[:, None]) / _INTERVALS)
    moved = np.zeros((13, 6))
    moved[7:] = np.eye(6)
    ends = solution((np.arange(_INTERVALS) + 1.0) / _INTERVALS)
    signs = []
    for k in range(_INTERVALS):
        # Only the sign is wanted, so that what grows most does not hide the rest.
        moved, upper = np.linalg.qr(forward[k] @ moved)
        moved = moved * np.sign(np.diag(upper))
        turn = _turn(ends[3:7, k], moved[3:7])
        signs.append(np.linalg.slogdet(np.concatenate([moved[:3], turn]))[0])
    kept = np.array(signs)[int(_SKIPPED * _INTERVALS) :]
    return int((np.diff(kept) != 0).sum())


def _turn(q: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """(3, n) rotation vectors of changes (4, n) of a quaternion."""
    real, vector = q[0], q[1:, None]
    # Twice the vector part of the change times the inverse.
    return 2.0 * (real * moved[1:] - vector * moved[0] - cross(moved[1:], vector))
