"""Where a plan's grasps come from: one function per method, from inputs to poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Nodes handed to a solver at a time when someone watches the progress.
_CHUNK = 32


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
    """Optimal grasps from the rod solver; right turns are the mirror images of left ones."""
    from wrod.grasps import solve_grasps

    count = len(inputs.suspended_length)
    chunk = count if inputs.progress is None else _CHUNK
    parts = []
    for first in range(0, count, chunk):
        part = slice(first, min(first + chunk, count))
        grasps = solve_grasps(
            inputs.suspended_length[part],
            np.abs(inputs.curvature[part]),
            np.full(part.stop - part.start, inputs.stretch_ratio),
            closure=inputs.closure,
            device=inputs.device,
        )
        parts.append(grasps)
        if inputs.progress is not None:
            inputs.progress(part.stop - part.start, count)

    def joined(name: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(grasps, name)) for grasps in parts])

    has_shape = all(getattr(grasps, "shape", None) is not None for grasps in parts)
    poses = GraspPoses(
        *(joined(name) for name in ("position", "rotation", "force", "converged", "stable")),
        shape=joined("shape") if has_shape else None,
    )
    return mirrored(poses, inputs.curvature < 0.0)


def mirrored(poses: GraspPoses, where: np.ndarray) -> GraspPoses:
    """Poses with those at `where` (T,) reflected in the contact frame's xz plane."""
    side = np.where(where, -1.0, 1.0)
    position, rotation, force = poses.position.copy(), poses.rotation.copy(), poses.force.copy()
    position[:, 1] *= side
    force[:, 1] *= side
    rotation[:, 0] *= side
    rotation[:, 2] *= side
    shape = poses.shape
    if shape is not None:
        shape = shape.copy()
        shape[:, :, 1] *= side[:, None]
    return GraspPoses(position, rotation, force, poses.converged, poses.stable, shape)


# A source takes the dimensionless inputs of every node and returns poses in the contact frame.
SOURCES: dict[str, Callable[[GraspInputs], GraspPoses]] = {
    "numeric": _numeric,
    "intuitive": _intuitive,
}
