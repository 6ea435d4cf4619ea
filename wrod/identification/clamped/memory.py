"""Rods that keep a share of the bend that the trial before gave them."""

import numpy as np

from wrod.identification.effect import Effect, Parameter


class Memory(Effect):
    """A rod that keeps a share of the curvature that the trial before gave it.

    Args:
        bent: (T, n + 1, 2) curvature dt/ds along (m1, m2) in the trial before each, at equidistant
            nodes from clamp to clamp; none before the first [1/m].
    """

    name = "memory"
    title = "share that the rod keeps of the curvature of the trial before"
    reference = (
        "natural curvature in proportion to the curvature of the trial before, none at first"
    )
    parameters = (Parameter("kept_share", "", 0.2),)
    # Other effects see the rod before it is another one in each trial.
    stage = 2

    def __init__(self, bent: np.ndarray):
        self.bent = bent

    def apply(self, setup, values):
        place = np.linspace(0.0, 1.0, self.bent.shape[1])
        before = [
            np.stack([np.interp(setup.fraction, place, own) for own in bent.T], axis=1)
            for bent in self.bent[setup.trials]
        ]
        setup.natural_curvature = setup.natural_curvature + values[0] * np.stack(before)


def bent_before(frames: np.ndarray, tangents: np.ndarray, length: float) -> np.ndarray:
    """(T, n + 1, 2) `bent` in the trial before each, not at all before the first."""
    own = bent(frames, tangents, length)
    return np.concatenate([np.zeros_like(own[:1]), own[:-1]])


def bent(frames: np.ndarray, tangents: np.ndarray, length: float) -> np.ndarray:
    """(T, n + 1, 2) curvature along (m1, m2) at the nodes [1/m].

    Args:
        frames: (T, n + 1, 3, 3) material frames at the nodes between the clamps.
        tangents: (T, n + 2, 3) of the edges, those inside the clamps among them.
        length: between the clamps [m].
    """
    cell = np.full(tangents.shape[1] - 1, length / (tangents.shape[1] - 2))
    cell[[0, -1]] *= 0.5  # what is inside a clamp does not bend
    # Twice the tangent of half the angle between two edges, as the energy has it.
    mean = 0.5 * np.linalg.norm(tangents[:, 1:] + tangents[:, :-1], axis=2, keepdims=True)
    turning = np.diff(tangents, axis=1) / mean / cell[:, None]
    return np.einsum("tni,tnij->tnj", turning, frames[..., :2])
