"""What markers and the wrist sensor see of a batch of clamped rods."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from wrod.identification.clamped.layout import COMPLEX_STEP
from wrod.identification.clamped.setup import ClampedSetup
from wrod.rods.batch import RodBatch
from wrod.rods.state import node_positions

# Degrees of freedom that the gripper holds: two nodes and the angle between them.
END = 7


@dataclass
class Prediction:
    """What a model predicts; every array may carry a parameter's rate as imaginary part.

    Attributes:
        position: (C, T, M, 3) markers [m].
        force, torque: (C, T, 3) of the gripper on the rod, about its end [N], [N m].
        frames: of each candidate that was observed what works out (T, M, 3, 3) columns m1, m2,
            tangent at the markers; few effects of what cameras report look at them.
    """

    position: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    frames: dict[int, Callable[[], np.ndarray]]


class View:
    """The state that a batch is in, its gradient being evaluated, for one or more observations."""

    def __init__(self, batch: RodBatch):
        self.position = batch.positions()
        edge = np.diff(self.position, axis=1)
        self.length = np.linalg.norm(edge, axis=2, keepdims=True)
        self.tangent = edge / self.length
        self.director = batch.material_directors()
        self.gradient = batch.derivatives.gradient.numpy()[:, -END:].copy()
        self._shares: dict[tuple, tuple] = {}

    def observe(
        self,
        setups: Sequence[ClampedSetup],
        step: np.ndarray,
        reaction_rate: np.ndarray,
        wanted: Sequence[bool] | None = None,
    ) -> Prediction:
        """Markers, frames and wrench.

        Args:
            setups: one for each candidate.
            step: (rod, dof) rates of the degrees of freedom, which become imaginary parts.
            reaction_rate: (rod, END) rates of the unbalanced forces at the gripper.
            wanted: candidates to observe; zeros stand for the others. Default: all.
        """
        count, trials = len(setups), len(setups[0].clamp_position)
        markers = len(setups[0].marker_arc_length)
        result = Prediction(
            np.zeros((count, trials, markers, 3), dtype=complex),
            np.zeros((count, trials, 3), dtype=complex),
            np.zeros((count, trials, 3), dtype=complex),
            {},
        )
        i = 1j * COMPLEX_STEP
        for c in range(count) if wanted is None else np.flatnonzero(wanted).tolist():
            rods, setup = slice(c * trials, (c + 1) * trials), setups[c]
            rate = node_positions(step[rods])
            q, tangent = self.position[rods] + i * rate, self._tangents(rods, rate, -1)[:, 0]
            gradient = self.gradient[rods] + i * reaction_rate[rods]
            result.force[c] = gradient[:, -7:-4] + gradient[:, -3:]
            arm = q[:, -1] - q[:, -2]
            torque = np.cross(arm, gradient[:, -3:]) + gradient[:, -4:-3] * tangent
            # The banded Hessian is symmetric. The rate of the gradient in the frames that moved
            # along also holds the holonomy of turning the end's tangent, half the twisting moment
            # across it.
            torque -= 0.5j * np.real(gradient[:, -4:-3]) * np.imag(tangent)
            result.torque[c] = torque
            # Set-ups share what no effect has changed.
            seen = id(setup.marker_arc_length), id(setup.length)
            if seen not in self._shares:
                self._shares[seen] = setup, *_marker_shares(setup)
            nodes, shares = self._shares[seen][1:]
            result.position[c] = _at(q, nodes, shares)
            own = rods, step[rods], setup.principal_angle
            result.frames[c] = partial(self._frames_at, *own, nodes, shares)
        return result

    def _tangents(self, rods: slice, rate: np.ndarray, first: int = 0) -> np.ndarray:
        """(T, edge, 3) tangents of the edges from `first` on, rates as imaginary parts, of nodes'
        rates."""
        t = self.tangent[rods, first:]
        rate = rate[:, -t.shape[1] :] - rate[:, -t.shape[1] - 1 : -1]
        across = rate - np.sum(rate * t, axis=2, keepdims=True) * t
        return t + 1j * COMPLEX_STEP * across / self.length[rods, first:]

    def _frames_at(self, rods, step, principal: complex, nodes, shares) -> np.ndarray:
        """(T, M, 3, 3) frames at the markers, rates as imaginary parts."""
        tangent = self._tangents(rods, node_positions(step))
        t, t_rate, p = np.real(tangent), np.imag(tangent), self.director[rods]
        angle, spin = -np.real(principal), COMPLEX_STEP * step[:, 3::4] - np.imag(principal)
        m1 = np.cos(angle) * p[:, :, 0] + np.sin(angle) * p[:, :, 1]
        m2 = np.cos(angle) * p[:, :, 1] - np.sin(angle) * p[:, :, 0]
        m1_rate = spin[..., None] * m2 - np.sum(t_rate * m1, axis=2, keepdims=True) * t
        return _frames_at(tangent, m1 + 1j * m1_rate, nodes, shares)


def _marker_shares(setup: ClampedSetup) -> tuple[np.ndarray, np.ndarray]:
    """(M, 4) nodes, ghosts included, around each marker and their weights in its position.

    Cubic Lagrange between the clamps; beyond one, inside a gripper, along its ghost edge.
    """
    n = len(setup.fraction) - 1
    u = setup.marker_arc_length / setup.length * n
    where = np.real(u)
    nodes = np.clip(np.floor(where) - 1, 0, n - 3).astype(int)[:, None] + np.arange(1, 5)
    shares = _lagrange(u[:, None] + 1, nodes)
    outside = (where < -1e-9) | (where > n + 1e-9)
    if outside.any():
        nodes[outside, :2] = np.where(where[outside] < 0, 0, n + 1)[:, None] + np.arange(2)
        shares[outside] = 0.0
        shares[outside, :2] = _lagrange(u[outside, None] + 1, nodes[outside, :2])
    return nodes, shares


def _at(values: np.ndarray, nodes: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """(T, M, 3) values at the markers out of (T, node, 3)."""
    return np.sum(values[:, nodes] * shares[:, :, None], axis=2)


def _lagrange(x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(M, k) weights of the polynomial through (M, k) nodes at (M, 1) places."""
    gaps = nodes[:, :, None] - nodes[:, None, :] + np.eye(nodes.shape[1])
    factors = (x[:, :, None] - nodes[:, None, :]) / gaps
    same = np.eye(nodes.shape[1], dtype=bool)
    return np.prod(np.where(same, 1.0, factors), axis=2)


def _frames_at(tangent, m1, nodes, shares) -> np.ndarray:
    """(T, M, 3, 3) frames: those of the edges averaged at nodes, a clamp's at its node,
    interpolated, orthonormalised."""

    def at_markers(edges):
        middle = 0.5 * (edges[:, 2:-1] + edges[:, 1:-2])
        first, last = edges[:, :1], edges[:, -1:]
        return _at(np.concatenate([first, first, middle, last, last], axis=1), nodes, shares)

    t, d = at_markers(tangent), at_markers(m1)
    t = t / np.sqrt(np.sum(t * t, axis=2, keepdims=True))
    d = d - np.sum(d * t, axis=2, keepdims=True) * t
    d = d / np.sqrt(np.sum(d * d, axis=2, keepdims=True))
    return np.stack([d, np.cross(t, d), t], axis=3)
