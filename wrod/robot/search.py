"""Branches of the inverse kinematics: many starts, followed along the whole path at once."""

from dataclasses import dataclass

import numpy as np

from wrod.robot.grip import TURN_LENGTH, Grip, TravelledPath, grasp_targets
from wrod.robot.kinematics import newton_step, null_projection, ranges, solve_poses
from wrod.robot.model import Robot
from wrod.robot.placement import Placement


@dataclass(frozen=True)
class Branch:
    """A joint path along the coarse samples of one placement and grip, not yet improved.

    Attributes:
        placement, grip: where and how.
        positions: (K, n) [rad].
        miss: (K,) length of the pose error, [m] and TURN_LENGTH [m] per radian.
        excess: (K,) largest violation of a joint limit [rad], negative inside.
    """

    placement: Placement
    grip: Grip
    positions: np.ndarray
    miss: np.ndarray
    excess: np.ndarray

    @property
    def cost(self) -> float:
        """Lower is better; a path that misses or leaves its limits costs most."""
        jump = np.abs(np.diff(self.positions, axis=0)).max()
        return float(
            100 * self.miss.max() + 3 * max(self.excess.max() + 0.15, 0.0) + max(jump - 0.5, 0.0)
        )


def find_branches(
    robot: Robot,
    path: TravelledPath,
    travel: np.ndarray,
    choices: list[tuple[Placement, Grip]],
    seeds: int = 10,
) -> list[Branch]:
    """Follow several inverse kinematics solutions of each choice along the path, best first.

    Args:
        travel: (K,) coarse samples of the path.
        choices: placements with grips to try.
        seeds: starts per choice.
    """
    poses = path.poses(travel)
    targets = np.stack([grasp_targets(poses, g, p.base_from_world) for p, g in choices])
    rows = follow_targets(robot, targets, seeds)
    branches = [Branch(*choices[choice], *row) for choice, *row in rows]
    return sorted(branches, key=lambda branch: branch.cost)


def follow_targets(
    robot: Robot, targets: np.ndarray, seeds: int = 10
) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Follow several inverse kinematics solutions along each of several ways of the grasp.

    A way is entered in its middle, where each is solved from the same seeds, and followed to both
    ends.

    Args:
        targets: (ways, K, 4, 4) grasp poses in the base frame [m].
        seeds: starts per way.

    Returns:
        For each branch: its way, then positions, miss and excess as in `Branch`.
    """
    middle = targets.shape[1] // 2
    rng = np.random.default_rng(0)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    inset = 0.15 * (upper - lower)
    start = rng.uniform(lower + inset, upper - inset, (seeds, len(lower)))
    solved, _ = solve_poses(robot, targets[:, middle], start)
    count = len(targets) * seeds
    q = solved.reshape(count, -1)
    goals = np.repeat(targets, seeds, axis=0)
    good = (q > robot.lower - 0.3).all(1) & (q < robot.upper + 0.3).all(1)
    index = np.flatnonzero(good)
    if len(index) == 0:
        index = np.arange(count)
    rows = zip(*_follow(robot, q[index], goals[index], middle), strict=True)
    return [(int(i) // seeds, *row) for i, row in zip(index, rows, strict=True)]


def follow_from(
    robot: Robot, targets: np.ndarray, start: np.ndarray
) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Follow the solution near joint positions (n,) [rad] along each of several ways.

    Args, Returns: see `follow_targets`; `start` is near the ways' middles.
    """
    middle = targets.shape[1] // 2
    found = _follow(robot, np.tile(start, (len(targets), 1)), targets, middle)
    return list(zip(range(len(targets)), *found, strict=True))


def _follow(robot: Robot, start: np.ndarray, targets: np.ndarray, middle: int):
    """Newton steps with a pull towards the middle of the joints' ranges in the null space.

    Args:
        start: (B, n) joint positions at sample `middle`.
        targets: (B, K, 4, 4).

    Returns:
        positions (B, K, n), miss and excess (B, K) as in `Branch`.
    """
    import torch

    goals = torch.from_numpy(np.ascontiguousarray(targets))
    first = torch.from_numpy(np.array(start))
    span, centre = map(torch.from_numpy, ranges(robot))
    batch, count = goals.shape[:2]
    positions = torch.empty((batch, count, first.shape[1]), dtype=torch.float64)
    miss = torch.empty((batch, count), dtype=torch.float64)

    def settle(q, k, iterations):
        for _ in range(iterations):
            step, jacobian, error = newton_step(robot, q, goals[:, k])
            offset = (q - centre) / span  # -0.5 .. 0.5
            pull = -0.4 * (2 * offset) ** 3  # weak inside, strong near the limits
            step = step + null_projection(jacobian, pull)
            size = step.abs().amax(-1, keepdim=True)
            q = q + step * (0.4 / size.clamp_min(0.4))
        step, jacobian, error = newton_step(robot, q, goals[:, k])
        q = q + step * (0.4 / step.abs().amax(-1, keepdim=True).clamp_min(0.4))
        positions[:, k] = q
        miss[:, k] = torch.hypot(error[:, :3].norm(dim=-1), TURN_LENGTH * error[:, 3:].norm(dim=-1))
        return q

    with torch.no_grad():
        centre_q = settle(first, middle, 15)
        for order in (range(middle + 1, count), range(middle - 1, -1, -1)):
            q = centre_q
            for k in order:
                q = settle(q, k, 2)
    excess = np.maximum(positions.numpy() - robot.upper, robot.lower - positions.numpy()).max(-1)
    return positions.numpy(), miss.numpy(), excess
