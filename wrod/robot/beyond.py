"""Where an arm meets what hangs beyond its grip."""

from dataclasses import dataclass

import numpy as np

from wrod.planning.beyond import Beyond
from wrod.robot.collision import CollisionModel, segment_distance
from wrod.robot.joint_path import JointPath
from wrod.robot.placement import Placement


@dataclass(frozen=True)
class Met:
    """The link that meets it nearest to the grip, how far from that [m], and the length that is
    laid when any does for the first time [m]."""

    link: str
    free: float
    laid: float


def met_beyond(path: JointPath, beyond: Beyond, clearance: float = 0.005) -> Met | None:
    """Where capsules around the arm's links come nearer than `clearance` [m] to what hangs beyond
    the grip, as capsules; those that hold it left out. None where none does."""
    model = CollisionModel(path.robot)
    return met_at(model, path.node_positions, path.placement, beyond, clearance)


def met_at(
    model: CollisionModel,
    positions: np.ndarray,
    placement: Placement,
    beyond: Beyond,
    clearance: float,
) -> Met | None:
    """`met_beyond` of joint positions (T, n) [rad] at the trajectory's nodes."""
    import torch

    with torch.no_grad():
        q = torch.from_numpy(positions[beyond.nodes])
        start, end = model.points(model.robot.jacobian.frames(q))
        rod = torch.from_numpy(placement.to_base(beyond.shape))
        gap = segment_distance(
            start[:, :, None], end[:, :, None], rod[:, None, :-1], rod[:, None, 1:]
        ).numpy()
    gap -= model.radius[:, None] + beyond.radius
    gap[:, (gap[:, :, 0] < clearance).all(axis=0)] = np.inf  # they hold it
    gap[np.repeat((beyond.shape[:, None, 1:, 2] < 0.0), gap.shape[1], axis=1)] = np.inf
    near = np.argwhere(gap < clearance)
    if len(near) == 0:
        return None
    pose, link, piece = near[near[:, 2].argmin()]
    steps = np.linalg.norm(np.diff(beyond.shape[pose, : piece + 1], axis=0), axis=1)
    laid = beyond.laid[near[:, 0].min()]
    return Met(model.links[link], float(steps.sum()), float(laid))
