"""A joint path varied together with where the pattern lies and how the rod is held.

`redundancy.improve` spends the freedom that a grip pose leaves the arm. Here the poses move too:
place, table height, yaw, roll and grip angle are six more unknowns, whose columns are how the
joints follow them. Gauss-Newton over all of it; the weight of the joints' limits grows until they
are kept.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from wrod.robot.attempt import ArmTask, allowed, moved
from wrod.robot.kinematics import free_motions, refine
from wrod.robot.placement import off_pedestal
from wrod.robot.redundancy import PathCost
from wrod.robot.search import Branch

# A unit of each unknown, as `moved` has them.
_UNITS = np.array([0.1, 0.1, 0.3, 0.3, 0.2, 0.1])
_DIFFERENCE = 1e-4  # of a unit, for derivatives
_ITERATIONS, _FARTHEST = 60, 0.25  # steps, and the most that a joint moves in one [rad]
_LONGEST = 0.3  # [rad] of a joint between two samples; longer ones are singularities
_HARDER, _HARDEST = 8.0, 6e4  # growth and bound of the limits' weight
_SINGULAR = 2e4  # weight of singularities, between whose samples poses may be out of reach
_KEPT = -0.03  # [rad] within the limits is enough
_STILL = 3e-3  # share of the cost that a step must save


class _Freedom:
    """Placement and grip about those of a branch, by unknowns in `_UNITS`."""

    def __init__(self, task: ArmTask, branch: Branch, fixed: bool):
        self.task, self.branch = task, branch
        self.which = np.flatnonzero(allowed(fixed, task.free_height))
        keeps_off = off_pedestal(task.robot, task.trajectory, branch.placement.z)
        self.allows = lambda unknowns: fixed or keeps_off(self.at(unknowns)[0])

    def at(self, unknowns: np.ndarray):
        change = np.zeros(6)
        change[self.which] = unknowns * _UNITS[self.which]
        return moved(self.branch.placement, self.branch.grip, change)

    def scene(self, unknowns: np.ndarray):
        """Grasp poses (K, 4, 4) in the base frame, and what is around."""
        place, grip = self.at(unknowns)
        task = self.task
        return task.targets(place, grip, task.travel), task.surroundings(place, task.travel)


def vary(task: ArmTask, branch: Branch, fixed: bool) -> Branch:
    """A branch near one that keeps the joints' limits better, and its miss 0 where it is followed.

    Args:
        fixed: the place must stay.
    """
    robot, freedom = task.robot, _Freedom(task, branch, fixed)
    unknowns = np.zeros(len(freedom.which))
    targets, around = freedom.scene(unknowns)
    q, error = refine(robot, branch.positions, targets)
    if np.abs(error).max() > 1e-3:
        return branch
    cost = PathCost(robot, task.model, len(q), longest=_LONGEST, singular_weight=_SINGULAR)
    damping, value = 1.0, cost.total(q, around)
    for _ in range(_ITERATIONS):
        elbow, gradient = free_motions(robot, q), cost.gradient(q, around)
        follow, slope = _columns(cost, freedom, q, unknowns, around, gradient)
        free = sparse.hstack([elbow, sparse.csc_matrix(follow)]).tocsc()
        reduced = np.concatenate([elbow.T @ gradient, slope])
        hessian = (free.T @ cost.curvature(q) @ free).tocsc()
        saved = 0.0
        for _ in range(8):
            lifted = hessian + damping * sparse.eye(hessian.shape[0], format="csc")
            step = -splu(lifted.tocsc()).solve(reduced)
            move = (free @ step).reshape(q.shape)
            share = _FARTHEST / max(_FARTHEST, np.abs(move).max())
            other = unknowns + share * step[elbow.shape[1] :]
            targets, near = freedom.scene(other)
            trial, error = refine(robot, q + share * move, targets, iterations=5)
            led = np.abs(error).max() < 1e-6 and freedom.allows(other)
            if led and (candidate := cost.total(trial, near)) < value:
                saved = value - candidate
                q, unknowns, around, value = trial, other, near, candidate
                damping = max(damping / 4.0, 1e-3)
                break
            damping *= 4.0
        if saved < _STILL * value:
            excess = float(np.maximum(q - robot.upper, robot.lower - q).max())
            if excess < _KEPT or cost.limit_weight >= _HARDEST:
                break
            cost.limit_weight *= _HARDER
            value, damping = cost.total(q, around), min(damping, 1.0)
    place, grip = freedom.at(unknowns)
    excess = np.maximum(q - robot.upper, robot.lower - q).max(-1)
    return Branch(place, grip, q, np.zeros(len(q)), excess)


def _columns(cost: PathCost, freedom: _Freedom, q, unknowns, around, gradient):
    """How the joints follow each unknown (K n, m), and how the cost does (m,): what stands around
    moves as well."""
    columns, slope = [], []
    here = cost.penalty(q, around)[0]
    for k in range(len(unknowns)):
        shifted = unknowns + _DIFFERENCE * np.eye(len(unknowns))[k]
        targets, near = freedom.scene(shifted)
        followed, _ = refine(cost.robot, q, targets, iterations=2)
        columns.append((followed - q).reshape(-1) / _DIFFERENCE)
        direct = (cost.penalty(q, near)[0] - here) / _DIFFERENCE
        slope.append(float(gradient @ columns[-1]) + direct)
    return np.array(columns).T, np.array(slope)
