"""Batched kinematics of the grasp: pose errors, Newton steps, null spaces, inverse kinematics."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from wrod.robot.model import Robot

if TYPE_CHECKING:
    import torch

# Of inverse kinematics from far away: steps that keep no joint's range, and that keep all, and the
# farthest that a joint turns in one [rad].
_FREE_STEPS, _KEPT_STEPS, _FARTHEST = 40, 10, 0.8


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Many small matrices are slower on several threads, by far on a busy machine."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def pose_error(pose: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Twist that takes `pose` to `target`, both (..., 4, 4): (..., 6) as [m] and [rad], base frame.

    Exact in direction, and in length up to 90 degrees (sine of the angle beyond small ones).
    """
    import torch

    position = target[..., :3, 3] - pose[..., :3, 3]
    relative = target[..., :3, :3] @ pose[..., :3, :3].mT
    axis = 0.5 * torch.stack(
        [
            relative[..., 2, 1] - relative[..., 1, 2],
            relative[..., 0, 2] - relative[..., 2, 0],
            relative[..., 1, 0] - relative[..., 0, 1],
        ],
        -1,
    )
    cosine = 0.5 * (relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0)
    sine = axis.norm(dim=-1)
    angle = torch.atan2(sine, cosine)
    scale = torch.where(sine > 1e-9, angle / sine.clamp_min(1e-12), torch.ones_like(sine))
    return torch.cat([position, axis * scale.unsqueeze(-1)], -1)


def newton_step(
    robot: Robot, positions: torch.Tensor, target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """One least-norm step of the grasp towards `target`.

    Args:
        positions: (B, n) joint positions [rad].
        target: (B, 4, 4) poses of the grasp in the base frame [m].

    Returns:
        step (B, n) [rad], Jacobian (B, 6, n), error (B, 6) before the step.
    """
    import torch

    jacobian, pose = robot.jacobian(positions)
    error = pose_error(pose, target)
    eye = torch.eye(6, dtype=positions.dtype)
    # Damping keeps the step finite at a singularity; it grows with the error (Levenberg), so that
    # far targets do not throw the arm about.
    level = 1e-8 + 0.05 * error.square().sum(-1)[:, None, None]
    solved = torch.linalg.solve(jacobian @ jacobian.mT + level * eye, error.unsqueeze(-1))
    return (jacobian.mT @ solved).squeeze(-1), jacobian, error


def null_projection(jacobian: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    """Part of `vector` (B, n) that does not move the grasp; `jacobian` is (B, 6, n)."""
    import torch

    eye = torch.eye(6, dtype=vector.dtype)
    along = (jacobian @ vector.unsqueeze(-1)).squeeze(-1)
    solved = torch.linalg.solve(jacobian @ jacobian.mT + 1e-8 * eye, along.unsqueeze(-1))
    return vector - (jacobian.mT @ solved).squeeze(-1)


def free_motions(robot: Robot, positions: np.ndarray) -> sparse.csc_matrix:
    """(B n, B (n - 6)) orthonormal motions of joints (B, n) that leave every grasp where it is."""
    import torch

    with torch.no_grad():
        jacobian = robot.jacobian(torch.from_numpy(positions))[0]
        _, _, right = torch.linalg.svd(jacobian, full_matrices=True)
    count, joints = positions.shape
    if joints == 6:
        return sparse.csc_matrix((6 * count, 0))
    return sparse.block_diag(list(right[:, 6:, :].mT.numpy()), format="csc")


def manipulability(jacobian: torch.Tensor) -> torch.Tensor:
    """sqrt(det(J J^T)) (Yoshikawa), 0 at a singularity; `jacobian` (..., 6, n) -> (...)."""
    import torch

    return torch.linalg.det(jacobian @ jacobian.mT).clamp_min(0.0).sqrt()


def refine(
    robot: Robot, positions: np.ndarray, target: np.ndarray, iterations: int = 12
) -> tuple[np.ndarray, np.ndarray]:
    """Newton iterations from nearby joint positions onto grasp poses, least motion.

    Args:
        positions: (B, n) start [rad].
        target: (B, 4, 4) [m].

    Returns:
        joint positions (B, n) and the remaining error (B, 6) [m], [rad].
    """
    import torch

    q = torch.from_numpy(np.array(positions, dtype=np.float64))
    goal = torch.from_numpy(np.ascontiguousarray(target, dtype=np.float64))
    with torch.no_grad():
        for _ in range(iterations):
            step, _, error = newton_step(robot, q, goal)
            if error.abs().max() < 1e-10:
                break
            size = step.abs().amax(-1, keepdim=True)
            q = q + step * (0.3 / size.clamp_min(0.3))
        pose = robot.jacobian.pose(robot.jacobian.frames(q))
        return q.numpy(), pose_error(pose, goal).numpy()


def grasp_poses(robot: Robot, positions: np.ndarray) -> np.ndarray:
    """Poses (B, 4, 4) of the grasp in the base frame [m] at joint positions (B, n) [rad]."""
    import torch

    q = torch.from_numpy(np.array(np.atleast_2d(positions), dtype=np.float64))
    with torch.no_grad():
        return robot.jacobian.pose(robot.jacobian.frames(q)).numpy()


def ranges(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Width and middle of each joint's range (n,) [rad]; very wide about 0 for continuous ones."""
    turns = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower, upper = np.where(turns, robot.lower, -500.0), np.where(turns, robot.upper, 500.0)
    return upper - lower, (upper + lower) / 2


def solve_poses(
    robot: Robot, target: np.ndarray, seeds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse kinematics of several poses from several seeds each: Newton steps wherever they
    lead, then, turned and clamped into the joints' ranges, within these.

    Args:
        target: (P, 4, 4) poses of the grasp in the base frame [m].
        seeds: (S, n) joint positions to start from [rad].

    Returns:
        joint positions (P, S, n) [rad] and whether each reached its pose (P, S) within 1e-4.
    """
    import torch

    goals = torch.from_numpy(np.repeat(target, len(seeds), axis=0))
    q = torch.from_numpy(np.tile(np.asarray(seeds, dtype=np.float64), (len(target), 1)))
    lower, upper = torch.from_numpy(robot.lower), torch.from_numpy(robot.upper)
    middle = torch.from_numpy(ranges(robot)[1])
    with torch.no_grad():
        for steps, kept in ((_FREE_STEPS, False), (_KEPT_STEPS, True)):
            if kept:
                turned = middle + (q - middle + np.pi).remainder(2 * np.pi) - np.pi
                q = turned.clamp(lower, upper)
            left = torch.arange(len(q))
            for _ in range(steps):
                step, _, error = newton_step(robot, q[left], goals[left])
                off = _far(error)
                left, step = left[off], step[off]
                if len(left) == 0:
                    break
                size = step.abs().amax(-1, keepdim=True)
                moved = q[left] + step * (_FARTHEST / size.clamp_min(_FARTHEST))
                q[left] = moved.clamp(lower, upper) if kept else moved
        missed = _far(pose_error(robot.jacobian.pose(robot.jacobian.frames(q)), goals))
    shape = len(target), len(seeds)
    return q.reshape(*shape, -1).numpy(), ~missed.reshape(shape).numpy()


def _far(error: torch.Tensor) -> torch.Tensor:
    """(B,) whether pose errors (B, 6) are more than 1e-4 [m] or [rad]."""
    return (error[:, :3].norm(dim=-1) > 1e-4) | (error[:, 3:].norm(dim=-1) > 1e-4)
