"""Where a plan's grasps come from: one function per method, from inputs to poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class GraspInputs:
    """What a grasp source is given: (T,) dimensionless lengths and curvatures of all nodes."""

    suspended_length: np.ndarray
    curvature: np.ndarray
    stretch_ratio: float
    closure: str
    device: str | None
    progress: Callable[[int, int], None] | None


@dataclass(frozen=True)
class GraspPoses:
    """What a grasp source returns, in the contact frame and dimensionless.

    position, rotation (vector) and force are (T, 3); converged and stable are (T,) or None where
    the source does not say; shape is (T, nodes, 3) or None.
    """

    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    converged: np.ndarray | None = None
    stable: np.ndarray | None = None
    shape: np.ndarray | None = None


def _intuitive(inputs: GraspInputs) -> GraspPoses:
    """Grip straight above the contact, the rod hanging from it (Takizawa et al. 2015)."""
    length = inputs.suspended_length
    count = len(length)
    position = np.column_stack([np.zeros((count, 2)), length])
    rotation = np.tile([0.0, -np.pi / 2.0, 0.0], (count, 1))
    return GraspPoses(position, rotation, np.full((count, 3), np.nan))


def _numeric(inputs: GraspInputs) -> GraspPoses:
    """Optimal grasps from the rod solver."""
    from wrod.grasps import solve_grasps

    count = len(inputs.suspended_length)
    watch = inputs.progress
    grasps = solve_grasps(
        inputs.suspended_length,
        inputs.curvature,
        inputs.stretch_ratio,
        closure=inputs.closure,
        device=inputs.device,
        progress=None if watch is None else lambda done: watch(done, count),
    )
    return GraspPoses(
        grasps.position,
        grasps.rotation,
        grasps.force,
        grasps.converged,
        grasps.stable,
        grasps.shape,
    )


# A source takes the dimensionless inputs of every node and returns poses in the contact frame.
SOURCES: dict[str, Callable[[GraspInputs], GraspPoses]] = {
    "numeric": _numeric,
    "intuitive": _intuitive,
}
