"""The joint spline of a path: knots as close together as its accuracy asks."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from wrod.robot.grip import TURN_LENGTH
from wrod.robot.kinematics import grasp_poses, pose_error, refine
from wrod.robot.model import Robot

COARSEST = 0.0015  # [m] of travel between two knots, at first
_HALVINGS = 5
_WANTED = 3e-5  # [m] of miss between knots, a radian counting TURN_LENGTH; reports refuse 1e-4
_LOST = 2e-3  # [m] a pose missed by more at a knot is out of reach: more knots do not help
_NEIGHBOURS = 2  # spans on each side that are halved too, so that their lengths change gently


def joint_spline(
    robot: Robot,
    targets: Callable[[np.ndarray], np.ndarray],
    coarse: np.ndarray,
    positions: np.ndarray,
    knots: np.ndarray,
) -> tuple[BSpline, np.ndarray]:
    """Quintic spline of joint positions over the travel, through solved poses.

    Where it misses the poses half way between its knots, as it does where the grip turns back
    within millimetres, the spans around are halved.

    Args:
        robot: the arm.
        targets: travel (K,) [m] -> grasp poses (K, 4, 4) in the base frame.
        coarse, positions: travel (C,) [m] of joint positions (C, n) [rad] to start from.
        knots: travel [m] of the first knots.

    Returns:
        The spline, and the travel [m] of its knots.
    """
    filled, _ = refine(robot, CubicSpline(coarse, positions)(knots), targets(knots))
    for _ in range(_HALVINGS):
        spline = make_interp_spline(knots, filled, k=5)
        middle = (knots[:-1] + knots[1:]) / 2
        guess = spline(middle)
        goals = targets(middle)
        solved, _ = refine(robot, guess, goals)
        missed = _miss(robot, guess, goals)
        reached = _miss(robot, solved, goals) < _LOST
        wide = np.flatnonzero((missed > _WANTED) & reached)
        if len(wide) == 0:
            break
        halved = np.unique(
            np.clip(wide[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1), 0, len(middle) - 1)
        )
        order = np.argsort(np.concatenate([knots, middle[halved]]), kind="stable")
        knots = np.concatenate([knots, middle[halved]])[order]
        filled = np.concatenate([filled, solved[halved]])[order]
    return make_interp_spline(knots, filled, k=5), knots


def _miss(robot: Robot, positions: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(K,) distance from the poses [m], a radian counting `TURN_LENGTH`."""
    import torch

    error = pose_error(
        torch.from_numpy(grasp_poses(robot, positions)), torch.from_numpy(targets)
    ).numpy()
    return np.hypot(
        np.linalg.norm(error[:, :3], axis=1), TURN_LENGTH * np.linalg.norm(error[:, 3:], axis=1)
    )
