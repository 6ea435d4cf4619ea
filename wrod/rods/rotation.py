"""Rotation vectors, and how they change with an angular velocity (SciPy does the rotations)."""

import numpy as np
from scipy.spatial.transform import Rotation


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


def transport(v: np.ndarray, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Turn (..., 3) vectors by the smallest rotation from unit vectors t to u; analytic."""
    axis = np.cross(t, u)
    cosine = np.sum(t * u, axis=-1, keepdims=True)
    along = np.sum(axis * v, axis=-1, keepdims=True) / (1.0 + cosine)
    return cosine * v + np.cross(axis, v) + along * axis
