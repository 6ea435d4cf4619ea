"""Meshes of the suspended rod. Dimensionless."""

import numpy as np

from wrod.rods.discretisation import cells

WEIGHT = 0.5  # per length in k_b / L_gb^2 per L_gb, by the definition of L_gb
# What the mirror y -> -y of the contact frame does to vectors, and to rotation vectors.
MIRROR, MIRROR_ROTATION = np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])
# Length over which edges stay short: a fraction of the boundary layer at the contact.
_GRADING = 0.3
# Share of a mesh's edges that a naturally curved rod's grip gets, against the contact's.
_GRIP_SHARE = 0.4


def rest_lengths(suspended_length: np.ndarray, edge_count: int) -> np.ndarray:
    """(n, edge_count) rest lengths: short in the boundary layer at the contact, longer above.

    Nodes stand at s = a ((1 + l/a)^xi - 1), xi = 0, 1/N, ..., 1: halving the edges refines the
    same map, so the solution has an error expansion in 1/N^2.
    """
    length = np.asarray(suspended_length, dtype=np.float64)[:, None]
    xi = np.linspace(0.0, 1.0, edge_count + 1)
    return np.diff(_GRADING * np.expm1(xi * np.log1p(length / _GRADING)), axis=1)


def two_sided_rest_lengths(suspended_length: np.ndarray, edge_count: int) -> np.ndarray:
    """(n, edge_count) rest lengths for naturally curved rods: short at the grip as well.

    There the rod's own curvature gives way to a straight hang over a length of sqrt(k_b / tension).
    Nodes are even in xi = ln(1 + s/a) + c ln((b + l) / (b + l - s)), a smooth map again.
    """
    length = np.asarray(suspended_length, dtype=np.float64)[:, None]
    end = length + np.sqrt(1.0 / (WEIGHT * length))

    def rate(s):
        """ds / dxi."""
        return 1.0 / (1.0 / (_GRADING + s) + _GRIP_SHARE / (end - s))

    def share(s):
        return np.log1p(s / _GRADING) - _GRIP_SHARE * np.log1p(-s / end)

    xi = np.linspace(0.0, 1.0, edge_count + 1) * share(length)
    s = half = 0.5 * np.broadcast_to(length, xi.shape)
    for _ in range(16):  # near by bisection
        half = 0.5 * half
        s = s + np.where(share(s) > xi, -half, half)
    for _ in range(4):  # to the last bit by Newton's method
        s = s - (share(s) - xi) * rate(s)
    s[:, 0], s[:, -1] = 0.0, length[:, 0]
    return np.diff(s, axis=1)


def node_weights(rest: np.ndarray) -> np.ndarray:
    """(n, edge + 1) weight of every node: half that of the edges around it."""
    return WEIGHT * cells(rest)


def tolerance(rest: np.ndarray, stretching: np.ndarray, least: float) -> np.ndarray:
    """(n,) forces that count as none, at least `least`: what rounding positions leaves in the
    stiffest edge, and in the sharpest bend."""
    shortest, length = rest.min(axis=1), rest.sum(axis=1)
    rounding = stretching / shortest * length + 4.0 / shortest**3 * np.minimum(length, 5.0)
    return np.maximum(least, 8 * np.finfo(float).eps * rounding)


def ghost(curvature: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) half the angle between the first edge and one behind the contact that holds the
    pattern's curvature there, and (n, 1, 3) the node behind."""
    half = np.arctan(0.5 * curvature * rest[:, 0])
    back = np.stack([np.cos(half), -np.sin(half), np.zeros_like(half)], axis=1)
    return half, (-rest[:, :1] * back)[:, None]
