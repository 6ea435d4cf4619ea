"""Configurations of a batch of rods, and the derivatives of their energies there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod.kernels.elastic.assembly import HALF_BANDWIDTH


@dataclass
class RodState:
    """Configuration of every rod of a batch (Warp arrays).

    Attributes:
        dof: (rod, 4 node - 1) degrees of freedom [q_0, theta^0, q_1, ...].
        tangent: (rod, node - 1) unit tangents that the reference frames belong to.
        director: (rod, node - 1) first reference directors.
        reference_twist: (rod, node) angle of the reference frames across each inner node [rad].
    """

    dof: wp.array
    tangent: wp.array
    director: wp.array
    reference_twist: wp.array

    @classmethod
    def zeros(cls, rod_count: int, node_count: int, device: str) -> RodState:
        edges = (rod_count, node_count - 1)
        return cls(
            wp.zeros((rod_count, 4 * node_count - 1), dtype=wp.float64, device=device),
            wp.zeros(edges, dtype=wp.vec3d, device=device),
            wp.zeros(edges, dtype=wp.vec3d, device=device),
            wp.zeros((rod_count, node_count), dtype=wp.float64, device=device),
        )

    def assign(self, other: RodState) -> None:
        wp.copy(self.dof, other.dof)
        wp.copy(self.tangent, other.tangent)
        wp.copy(self.director, other.director)
        wp.copy(self.reference_twist, other.reference_twist)


@dataclass
class Derivatives:
    """Energy (rod,), gradient (rod, dof) and lower band of the Hessian (rod, dof, 11), which both
    are parts of one array."""

    energy: wp.array
    gradient: wp.array
    hessian: wp.array
    _both: wp.array

    @classmethod
    def zeros(cls, rod_count: int, dof_count: int, device: str) -> Derivatives:
        count, width = rod_count * dof_count, HALF_BANDWIDTH + 1
        both = wp.zeros(count * (width + 1), dtype=wp.float64, device=device)
        return cls(
            wp.zeros(rod_count, dtype=wp.float64, device=device),
            both[count * width :].reshape((rod_count, dof_count)),
            both[: count * width].reshape((rod_count, dof_count, width)),
            both,
        )

    def clear(self, order: int) -> None:
        """Set the gradient to zero (`order` 1), and the Hessian too (`order` 2)."""
        (self._both if order == 2 else self.gradient).zero_()


def node_positions(dof: np.ndarray) -> np.ndarray:
    """(rod, node, 3) positions out of (rod, 4 node - 1) degrees of freedom."""
    padded = np.zeros((len(dof), dof.shape[1] + 1), dtype=dof.dtype)  # `np.pad` takes much longer
    padded[:, :-1] = dof
    return padded.reshape(len(dof), -1, 4)[:, :, :3]


def full_hessian(band: np.ndarray) -> np.ndarray:
    """Dense symmetric (..., dof, dof) matrices out of lower bands (..., dof, 11)."""
    n = band.shape[-2]
    dense = np.zeros((*band.shape[:-1], n))
    for k in range(min(band.shape[-1], n)):
        rows = np.arange(k, n)
        dense[..., rows, rows - k] = dense[..., rows - k, rows] = band[..., k:, k]
    return dense
