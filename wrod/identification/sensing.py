"""What markers and the wrist sensor see of a batch of clamped rods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wrod.batch import RodBatch
from wrod.identification.layout import COMPLEX_STEP, node_part
from wrod.identification.setup import Setup


@dataclass
class Prediction:
    """What a model predicts; every array may carry a parameter's rate as imaginary part.

    Attributes:
        position: (C, T, M, 3) markers [m].
        frame: (C, T, M, 3, 3) columns m1, m2, tangent there.
        force, torque: (C, T, 3) of the gripper on the rod, about its end [N], [N m].
    """

    position: np.ndarray
    frame: np.ndarray
    force: np.ndarray
    torque: np.ndarray


def observe(batch: RodBatch, setups: Sequence[Setup], step, reaction_rate) -> Prediction:
    """Markers, frames and wrench in the batch's state, its gradient being evaluated.

    Args:
        step: (rod, dof) rates of the degrees of freedom, which become imaginary parts.
        reaction_rate: (rod, dof) rates of the unbalanced forces.
    """
    i, trials = 1j * COMPLEX_STEP, len(setups[0].clamp_position)
    principal = np.repeat([s.principal_angle for s in setups], trials)[:, None]
    q = batch.positions() + i * node_part(step)
    tangent, m1 = _edge_frames(batch, step, principal)
    gradient = batch.derivatives.gradient.numpy() + i * reaction_rate
    force = gradient[:, -7:-4] + gradient[:, -3:]
    arm = q[:, -1] - q[:, -2]
    torque = np.cross(arm, gradient[:, -3:]) + gradient[:, -4:-3] * tangent[:, -1]
    # The banded Hessian is symmetric. The rate of the gradient in the frames that moved along
    # also holds the holonomy of turning the end's tangent, half the twisting moment across it.
    torque = torque - 0.5j * np.real(gradient[:, -4:-3]) * np.imag(tangent[:, -1])
    shape = (len(setups), trials)
    markers, frames = [], []
    for c, setup in enumerate(setups):
        rods = slice(c * trials, (c + 1) * trials)
        weights = _marker_weights(setup)
        markers.append(np.einsum("mn,tnk->tmk", weights, q[rods]))
        frames.append(_frames_at(weights, tangent[rods], m1[rods]))
    return Prediction(
        np.stack(markers),
        np.stack(frames),
        force.reshape(*shape, 3),
        torque.reshape(*shape, 3),
    )


def _edge_frames(batch: RodBatch, step: np.ndarray, principal: np.ndarray):
    """(rod, edge, 3) tangents and m1 of every edge, rates as imaginary parts."""
    i = 1j * COMPLEX_STEP
    q = batch.positions()
    edge, edge_rate = np.diff(q, axis=1), np.diff(node_part(step), axis=1)
    length = np.linalg.norm(edge, axis=2, keepdims=True)
    t = edge / length
    t_rate = (edge_rate - np.sum(edge_rate * t, axis=2, keepdims=True) * t) / length
    p = batch.material_directors()
    angle, spin = (
        -np.real(principal)[..., None],
        (step[:, 3::4] - np.imag(principal) / COMPLEX_STEP),
    )
    m1 = np.cos(angle) * p[:, :, 0] + np.sin(angle) * p[:, :, 1]
    m1_rate = spin[..., None] * np.cross(t, m1) - np.sum(t_rate * m1, axis=2, keepdims=True) * t
    return t + i * t_rate, m1 + i * m1_rate


def _marker_weights(setup: Setup) -> np.ndarray:
    """(M, node) weights of the nodes, ghosts included, in each marker's position.

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
    weights = np.zeros((len(u), n + 3), dtype=u.dtype)
    np.put_along_axis(weights, nodes, shares, axis=1)
    return weights


def _lagrange(x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(M, k) weights of the polynomial through (M, k) nodes at (M, 1) places."""
    gaps = nodes[:, :, None] - nodes[:, None, :] + np.eye(nodes.shape[1])
    factors = (x[:, :, None] - nodes[:, None, :]) / gaps
    same = np.eye(nodes.shape[1], dtype=bool)
    return np.prod(np.where(same, 1.0, factors), axis=2)


def _frames_at(weights: np.ndarray, tangent: np.ndarray, m1: np.ndarray) -> np.ndarray:
    """(T, M, 3, 3) frames: those of the edges averaged at nodes, interpolated, orthonormalised."""

    def at_markers(edges):
        padded = np.concatenate([edges[:, :1], edges, edges[:, -1:]], axis=1)
        return np.einsum("mn,tnk->tmk", weights, 0.5 * (padded[:, 1:] + padded[:, :-1]))

    t, d = at_markers(tangent), at_markers(m1)
    t = t / np.sqrt(np.sum(t * t, axis=2, keepdims=True))
    d = d - np.sum(d * t, axis=2, keepdims=True) * t
    d = d / np.sqrt(np.sum(d * d, axis=2, keepdims=True))
    return np.stack([d, np.cross(t, d), t], axis=3)
