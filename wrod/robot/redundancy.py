"""The freedom that a grip pose leaves the arm, spent on the whole path at once.

Each pose of a seven-joint arm leaves one motion of the elbow. Those motions at all samples are
chosen together: short steps, distance from joint limits, obstacles and singularities. Gauss-Newton
on the smoothness, gradient of the rest, and after each step a Newton projection back onto the grip
poses.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from wrod.robot.collision import CollisionModel, between
from wrod.robot.kinematics import free_motions, manipulability, refine
from wrod.robot.model import Robot

LIMIT_ROOM = 0.35  # [rad] joints are pushed to stay this far inside their limits
GAP_ROOM = 0.035  # [m] links are pushed to stay this far apart
# Nearer than this a path is refused or nearly so: far dearer than what is only uncomfortable.
_LEAST_LIMIT_ROOM, _LEAST_GAP = 0.06, 0.012  # [rad], [m]
MANIPULABILITY_ROOM = 0.04  # below this a pose counts as close to a singularity


@dataclass(frozen=True)
class Surroundings:
    """What the arm may not touch, in its base frame.

    Attributes:
        table_height: [m].
        contact: (N, 3) points of the laid rod, in laying order [m].
        laid: (K,) how many of them lie at each sample of the path.
        rod_radius: [m].
        other: another arm's capsules, or obstacles, at each sample: (K, C, 3) starts, (K, C, 3)
            ends, (C,) radii [m].
        other_name: what they are called.
        hanging: (K, P, 3) points of the suspended rod at each sample, without what is between the
            fingers [m].
    """

    table_height: float
    contact: np.ndarray
    laid: np.ndarray
    rod_radius: float
    other: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    other_name: str = "other arm"
    hanging: np.ndarray | None = None


def gaps(model: CollisionModel, positions, around: Surroundings) -> dict:
    """Gaps [m] at joint positions (K, n), as torch tensors: "links" (K, pairs), "table" and
    "laid rod" (K, low capsules), and where they are there "hanging rod" (K, capsules before the
    hand) and the other arm or obstacles (K, moving capsules).

    The laid rod lies on the table: poses that keep `GAP_ROOM` above it need no closer look, and
    get the height above the rod for their gap.
    """
    start, end = model.points(model.robot.jacobian.frames(positions))
    return {kind: gap(start, end, slice(None)) for kind, gap in _kinds(model, around).items()}


def _kinds(model: CollisionModel, around: Surroundings) -> dict[str, Callable]:
    """Each kind of `gaps` by itself: of the capsules' ends (B, C, 3) at these rows of samples."""
    import torch

    def table(start, end, _):
        return model.table_distances(start, end, around.table_height)

    def laid(start, end, rows):
        gap = table(start, end, rows) - around.rod_radius
        close = torch.nonzero(gap.detach().amin(1) < GAP_ROOM).squeeze(1)
        if len(close) == 0:
            return gap
        points, count = torch.from_numpy(around.contact), torch.from_numpy(around.laid[rows])
        near = model.laid_distances(
            start[close], end[close], points, count[close], around.rod_radius
        )
        return gap.index_copy(0, close, near)

    def beside(mine, first, last, radius):
        def gap(start, end, rows):
            ends = start[:, mine], end[:, mine]
            return between(*ends, model.radius[mine], first[rows], last[rows], radius).amin(-1)

        return gap

    kinds = {"links": lambda start, end, _: model.self_distances(start, end), "table": table}
    kinds["laid rod"] = laid
    if around.other is not None:
        kinds[around.other_name] = beside(model.moving, *around.other)
    if around.hanging is not None and len(model.before_hand):
        points = around.hanging
        thick = np.full(points.shape[1] - 1, around.rod_radius)
        kinds["hanging rod"] = beside(model.before_hand, points[:, :-1], points[:, 1:], thick)
    return kinds


class PathCost:
    """What a joint path (K, n) costs: long steps, and nearness to limits, obstacles, singularities.

    Args:
        robot, model: the arm.
        count: K.
        limit_weight: of what is nearer to a limit than `_LEAST_LIMIT_ROOM`, and of steps beyond
            `longest`.
        longest: step of a joint between two samples [rad] that costs no more than its square.
        singular_weight: of singularities.
    """

    def __init__(
        self,
        robot: Robot,
        model: CollisionModel,
        count: int,
        limit_weight: float = 1000.0,
        longest: float = np.inf,
        singular_weight: float = 200.0,
    ):
        import torch

        self.robot, self.model = robot, model
        self.limit_weight, self.longest = limit_weight, longest
        self.singular_weight = singular_weight
        joints = len(robot.lower)
        differences = sparse.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count))
        self.differences = sparse.kron(differences, sparse.eye(joints)).tocsc()
        self.smooth = (self.differences.T @ self.differences * (count / 4.0)).tocsc()
        self._lower, self._upper = torch.from_numpy(robot.lower), torch.from_numpy(robot.upper)

    def penalty(self, q: np.ndarray, around: Surroundings, gradient: bool = False):
        """All but the steps' squares, and its gradient (K, n) where that is asked for."""
        import torch

        variable = torch.from_numpy(q).requires_grad_(gradient)
        jacobian = self.robot.jacobian
        with torch.no_grad():
            frames = jacobian.frames(variable)
            singular = torch.nonzero(
                manipulability(jacobian.of(frames)[0]) < MANIPULABILITY_ROOM
            ).squeeze(1)
        with torch.set_grad_enabled(gradient):
            room = torch.minimum(variable - self._lower, self._upper - variable)
            cost = 20.0 * (LIMIT_ROOM - room).clamp_min(0).square().sum()
            near = (_LEAST_LIMIT_ROOM - room).clamp_min(0).square().sum()
            if np.isfinite(self.longest):
                steps = (variable[1:] - variable[:-1]).abs() - self.longest
                near = near + steps.clamp_min(0).square().sum()
            cost = cost + self.limit_weight * near
            if len(singular):
                measure = manipulability(jacobian(variable[singular])[0])
                lacking = (MANIPULABILITY_ROOM - measure).square().sum()
                cost = cost + self.singular_weight * lacking
        value, slope = self._nearness(frames, around, gradient)
        if gradient:
            cost.backward()
            return float(cost.detach()) + value, (variable.grad + slope).numpy()
        return float(cost) + value, None

    def _nearness(self, frames, around: Surroundings, gradient: bool):
        """What small gaps cost at joints' frames, and the gradient (K, n) where that is asked for:
        only samples that come near anything are looked at with derivatives."""
        import torch

        with torch.no_grad():
            points = self.model.points(frames)
        slopes = tuple(torch.zeros_like(p) for p in points)
        value = 0.0
        for gap in _kinds(self.model, around).values():
            with torch.no_grad():
                found = gap(*points, slice(None))
            rows = torch.nonzero((found < GAP_ROOM).any(1)).squeeze(1)
            if len(rows) == 0:
                continue
            near = [p[rows].requires_grad_(gradient) for p in points]
            with torch.set_grad_enabled(gradient):
                found = gap(*near, rows.numpy()) if gradient else found[rows]
                cost = 2000.0 * (GAP_ROOM - found).clamp_min(0).square().sum()
                cost = cost + 4e4 * (_LEAST_GAP - found).clamp_min(0).square().sum()
            value += float(cost.detach())
            if gradient:
                for slope, part in zip(slopes, torch.autograd.grad(cost, near), strict=True):
                    slope[rows] += part
        return value, self.model.by_joints(frames, points, slopes) if gradient else None

    def total(self, q: np.ndarray, around: Surroundings) -> float:
        flat = q.reshape(-1)
        return 0.5 * float(flat @ (self.smooth @ flat)) + self.penalty(q, around)[0]

    def gradient(self, q: np.ndarray, around: Surroundings) -> np.ndarray:
        """(K n,) of `total`."""
        return self.smooth @ q.reshape(-1) + self.penalty(q, around, True)[1].reshape(-1)

    def curvature(self, q: np.ndarray) -> sparse.csc_matrix:
        """Second derivatives (K n, K n) of steps and limits; obstacles are left out."""
        room = np.minimum(q - self.robot.lower, self.robot.upper - q).reshape(-1)
        stiff = 40.0 * (room < LIMIT_ROOM) + 2.0 * self.limit_weight * (room < _LEAST_LIMIT_ROOM)
        long = 2.0 * self.limit_weight * (np.abs(self.differences @ q.reshape(-1)) > self.longest)
        steps = self.differences.T @ sparse.diags(long) @ self.differences
        return (self.smooth + sparse.diags(stiff) + steps).tocsc()


def improve(
    robot: Robot,
    model: CollisionModel,
    positions: np.ndarray,
    targets: np.ndarray,
    around: Surroundings,
    iterations: int = 25,
) -> np.ndarray:
    """Joint path (K, n) [rad] near `positions` through the same grasp poses (K, 4, 4), better.

    Args:
        positions: (K, n) start, on the poses or near them [rad].
        targets: (K, 4, 4) grasp poses in the base frame [m].
        around: obstacles at the same samples.
        iterations: at most.
    """
    count, joints = positions.shape
    q, _ = refine(robot, positions, targets)
    if joints == 6:
        return q
    cost = PathCost(robot, model, count)
    damping, value = 1.0, cost.total(q, around)
    for _ in range(iterations):
        free = free_motions(robot, q)
        reduced = free.T @ cost.gradient(q, around)
        hessian = (free.T @ cost.smooth @ free).tocsc()
        gained = False
        for _ in range(6):
            lifted = hessian + damping * sparse.eye(hessian.shape[0], format="csc")
            move = -(free @ splu(lifted.tocsc()).solve(reduced)).reshape(count, joints)
            move *= 0.25 / max(0.25, np.abs(move).max())
            trial, error = refine(robot, q + move, targets, iterations=4)
            if np.abs(error).max() < 1e-6:
                candidate = cost.total(trial, around)
                if candidate < value:
                    gained = True
                    break
            damping *= 4.0
        if not gained:
            break
        improvement = value - candidate
        q, value, damping = trial, candidate, max(damping / 4.0, 1e-3)
        if improvement < 1e-4 * (1e-3 + value):
            break
    return q
