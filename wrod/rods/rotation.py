"""Rotation vectors, and how they change with an angular velocity (SciPy does the rotations)."""

import numpy as np
from scipy.spatial.transform import Rotation

_AGAINST = 1e-12 - 1.0


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """(n, 3) rotation vectors [rad], no longer than pi, of (n, 3, 3) matrices."""
    return Rotation.from_matrix(matrix).as_rotvec()


def _cross_matrix(vector: np.ndarray) -> np.ndarray:
    zero = np.zeros(len(vector))
    x, y, z = vector.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def left_jacobian(vector: np.ndarray) -> np.ndarray:
    """(n, 3, 3) J with angular velocity = J d(vector)/dt, in the fixed frame."""
    angle = np.linalg.norm(vector, axis=1)[:, None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    k = _cross_matrix(vector)
    return np.eye(3) + a * k + b * (k @ k)


def unit(v: np.ndarray) -> np.ndarray:
    """(..., 3) vectors divided by their lengths; analytic."""
    return v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True))


def transport(v: np.ndarray, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Turn (..., 3) vectors by the smallest rotation from unit vectors t to u; analytic but where u
    is -t."""
    axis = np.cross(t, u)
    cosine = np.sum(t * u, axis=-1, keepdims=True)
    along = np.sum(axis * v, axis=-1, keepdims=True) / _fold(cosine)
    return cosine * v + np.cross(axis, v) + along * axis


def angle_about(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...,) angles [rad] about unit vectors t (..., 3) from a to b, which are across them."""
    return np.arctan2(np.sum(np.cross(t, a) * b, axis=-1), np.sum(a * b, axis=-1))


def carried(v: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(..., edge, 3) vectors (..., 3) across the first edge carried on without twist, by the unit
    tangents (..., edge, 3) of all edges; analytic."""
    before, after = t[..., :-1, :, None], t[..., 1:, :, None]
    axis = np.cross(before, after, axis=-2)
    cosine = np.sum(before * after, axis=-2, keepdims=True)
    turn = cosine * np.eye(3) + after * _row(before) - before * _row(after)
    turn = turn + axis * _row(axis) / _fold(cosine)
    out = [v]
    for k in range(turn.shape[-3]):  # one after the other, and little to do for each
        out.append((turn[..., k, :, :] @ out[-1][..., None])[..., 0])
    return np.stack(out, axis=-2)


def _fold(cosine: np.ndarray) -> np.ndarray:
    """1 + cosine, away from zero, where unit vectors point against each other."""
    return np.where(np.real(cosine) > _AGAINST, 1.0 + cosine, 1.0 + _AGAINST)


def _row(column: np.ndarray) -> np.ndarray:
    return np.swapaxes(column, -1, -2)


def node_frames(m1: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(rod, node, 3, 3) columns m1, m2, tangent, the means of the edges' (rod, edge, 3) around each
    node."""
    t, m1 = (
        np.concatenate([a[:, :1], a[:, 1:] + a[:, :-1], a[:, -1:]], axis=1) for a in (unit(t), m1)
    )
    t = unit(t)
    m1 = unit(m1 - np.sum(m1 * t, axis=2, keepdims=True) * t)
    return np.stack([m1, np.cross(t, m1), t], axis=3)


def one_hemisphere(quaternions: np.ndarray) -> np.ndarray:
    """(n, 4) the same rotations, signs flipped so that neighbours are close, as interpolation
    needs."""
    dots = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(dots < 0.0, -1.0, 1.0)]))
    return quaternions * signs[:, None]
