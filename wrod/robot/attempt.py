"""One attempt at a joint path: branches at given places, ranked, improved, checked."""

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from wrod.planning.beyond import Beyond
from wrod.planning.trajectory import Trajectory
from wrod.robot.beyond import met_at
from wrod.robot.collision import CollisionModel
from wrod.robot.grip import Grip, TravelledPath, grasp_targets
from wrod.robot.knots import COARSEST, joint_spline
from wrod.robot.model import Robot
from wrod.robot.placement import Placement, off_pedestal
from wrod.robot.redundancy import GAP_ROOM, Surroundings, gaps, improve
from wrod.robot.report import PathReport, inspect
from wrod.robot.search import Branch, find_branches, follow_from

_COARSE = 0.025  # [m] of travel between the samples that are searched and improved
_LAID = 0.004  # [m] between the points of the laid rod that gaps are measured to
_OVER_TABLE = 0.03  # [m] above the table, from where on the rod keeps clear of obstacles
_HANGING, _HELD = 25, 0.06  # points of the hanging rod; [m] of it that are in the gripper's reach
_RANKED = 24  # different branches whose obstacles are looked at
_TRIED = 4  # branches that are improved and compared
_HOPELESS = 0.7  # [rad] beyond a limit, from where on the elbow's freedom is not tried
_ROUNDS, _AROUND = 4, 24  # of the search near a branch, and choices in each
# Reach of that search at first, as `moved` has it.
_NEAR = np.array([0.08, 0.08, 0.5, 0.5, 0.3, 0.06])


@dataclass(frozen=True)
class Solution:
    branch: Branch
    spline: Any
    report: PathReport


@dataclass
class ArmTask:
    """What is asked for: an arm, a path, and what it must keep.

    Attributes:
        robot, model, trajectory, path: of the task.
        limit_margin, clearance, rod_radius: see `solve_joint_path`.
        obstacles: capsules in the base frame at one pose ((C, 3), (C, 3), (C,)) or None [m].
        free_height: whether the table's height may be changed.
        until: when to stop looking [s of the monotonic clock].
    """

    robot: Robot
    model: CollisionModel
    trajectory: Trajectory
    path: TravelledPath
    limit_margin: float
    clearance: float
    rod_radius: float
    obstacles: tuple | None = None
    free_height: bool = False
    until: float = math.inf

    def __post_init__(self):
        self._hanging = hanging_rod(self.trajectory)
        count = max(24, math.ceil(self.path.travel[-1] / _COARSE))
        self.travel = np.linspace(0.0, self.path.travel[-1], count)

    @cached_property
    def _beyond(self) -> Beyond | None:
        return Beyond.of(self.trajectory)

    def room_beyond(self, solution: Solution) -> float:
        """Length from the grip at which what hangs beyond it first meets a link; infinite where it
        meets none [m]."""
        if self._beyond is None:
            return math.inf
        positions, place = solution.spline(self.path.travel), solution.branch.placement
        met = met_at(self.model, positions, place, self._beyond, self.clearance)
        return math.inf if met is None else met.free

    def is_over(self) -> bool:
        return time.monotonic() > self.until

    def targets(self, placement: Placement, grip: Grip, travel: np.ndarray) -> np.ndarray:
        return grasp_targets(self.path.poses(travel), grip, placement.base_from_world)

    def branches(self, places: list[Placement], angle: float, seeds: int) -> list[Branch]:
        """Distinct branches at one grip angle, the most promising first."""
        # Along the rod the last joint takes any roll up; across it, it decides where the hand is.
        rolls = (0.0,) if angle == 0.0 else tuple(math.pi / 4 * k for k in range(8))
        if len(places) > 1 and len(rolls) > 1:
            places, rolls = places[:12], rolls[::2]
        choices = [(place, Grip(angle, roll)) for place in places for roll in rolls]
        found = find_branches(self.robot, self.path, self.travel, choices, seeds=seeds)
        return sorted(_distinct(found, _RANKED), key=self.cost)

    def cost(self, branch: Branch) -> float:
        """Of a branch and of what it comes near; the elbow may still gain a few centimetres."""
        import torch

        with torch.no_grad():
            near = gaps(
                self.model,
                torch.from_numpy(branch.positions.copy()),
                self.surroundings(branch.placement, self.travel),
            )
        # A robot without shapes comes near to nothing.
        least = min((float(gap.min()) for gap in near.values() if gap.numel()), default=math.inf)
        return branch.cost + 10.0 * max(0.0, GAP_ROOM - least)

    def best(self, branches: list[Branch]) -> Solution | None:
        """The best path over the first few branches, feasible or not."""
        best = None
        for branch in branches[:_TRIED]:
            if best is not None and branch.excess.max() > _HOPELESS:
                continue
            solution = self.finish(branch)
            key = (solution.report.shortfall, -solution.report.quality)
            if best is None or key < (best.report.shortfall, -best.report.quality):
                best = solution
        return best

    def nearby(self, branch: Branch, fixed: bool, seed: int = 0, rounds: int = _ROUNDS) -> Branch:
        """A better branch near one: place, yaw, roll and grip angle varied, ever less.

        Args:
            fixed: the place must stay.
        """
        rng = np.random.default_rng(seed)
        scale = _NEAR * allowed(fixed, self.free_height)
        best, value = branch, self.cost(branch)
        keeps_off = off_pedestal(self.robot, self.trajectory, branch.placement.z)
        for _ in range(rounds):
            changes = rng.normal(size=(_AROUND, 6)) * scale / 2
            choices = [moved(best.placement, best.grip, change) for change in changes]
            choices = [choice for choice in choices if fixed or keeps_off(choice[0])]
            if not choices:
                continue
            middle = best.positions[len(best.positions) // 2]
            targets = np.stack([self.targets(p, g, self.travel) for p, g in choices])
            rows = follow_from(self.robot, targets, middle)
            tried = [Branch(*choices[way], *row) for way, *row in rows]
            for other in sorted(tried, key=lambda item: item.cost)[:6]:
                cost = self.cost(other)
                if cost < value:
                    best, value = other, cost
            scale = scale * 0.6
        return best

    def surroundings(self, placement: Placement, travel: np.ndarray) -> Surroundings:
        """Obstacles at samples `travel` of the path."""
        # Points of the laid rod a few millimetres apart are enough for gaps of that size.
        arc = self.trajectory.arc_length
        stride = max(1, int(_LAID * (len(self.path) - 1) / max(arc[-1] - arc[0], 1e-9)))
        contact = placement.to_base(self.trajectory.contact)[::stride]
        laid = np.searchsorted(self.path.travel[::stride], travel + 1e-12, side="right")
        other = None
        if self.obstacles is not None:
            start, end, radius = self.obstacles
            start, end = (np.repeat(ends[None], len(travel), axis=0) for ends in (start, end))
            other = start, end, radius
        hanging = None
        if self._hanging is not None:
            node = np.interp(travel, self.path.travel, np.arange(len(self.path)))
            low = np.minimum(node.astype(int), len(self.path) - 2)
            share = (node - low)[:, None, None]
            points = (1 - share) * self._hanging[low] + share * self._hanging[low + 1]
            hanging = placement.to_base(points)
        return Surroundings(placement.z, contact, laid, self.rod_radius, other, "obstacle", hanging)

    def finish(self, branch: Branch, improved: bool = False) -> Solution:
        """Improve a branch, unless it is, fill it in between the samples, and check it."""

        def targets(at):
            return self.targets(branch.placement, branch.grip, at)

        coarse = branch.positions
        if branch.miss.max() < 0.01 and not improved:
            around = self.surroundings(branch.placement, self.travel)
            coarse = improve(self.robot, self.model, coarse, targets(self.travel), around)
        spline, knots = joint_spline(
            self.robot, targets, self.travel, coarse, self.path.samples(COARSEST)
        )
        # Between the spline's knots, where nothing was solved: the honest place to check.
        check = np.sort(np.concatenate([self.path.travel, (knots[:-1] + knots[1:]) / 2]))
        report = self.inspected(branch.placement, check, spline(check), targets(check))
        return Solution(branch, spline, report)

    def inspected(self, placement: Placement, travel, positions, targets) -> PathReport:
        """What joint positions (K, n) keep at samples of travel (K,), and the rod with them."""
        around = self.surroundings(placement, travel)
        report = inspect(
            self.robot, self.model, self.path, self.trajectory.arc_length, travel, positions,
            targets, around, self.limit_margin, self.clearance,
        )  # fmt: skip
        gap, sample = self.rod_gap(around)
        if gap >= self.clearance or report.problem is not None:
            return report
        node = self.path.node_of(travel[sample])
        problem = (
            f"the hanging rod comes within {1e3 * max(gap, 0.0):.0f} mm of an obstacle at node "
            f"{node} (arc length {self.trajectory.arc_length[node]:.3f} m)"
        )
        return replace(report, problem=problem, shortfall=50.0 + self.clearance - gap)

    def rod_gap(self, around: Surroundings) -> tuple[float, int]:
        """Least gap of the hanging rod to an obstacle [m], and at which sample."""
        if around.hanging is None or self.obstacles is None:
            return math.inf, 0
        least = np.full(around.hanging.shape[:2], math.inf)
        low, high = around.hanging.min((0, 1)), around.hanging.max((0, 1))
        for start, end, radius in zip(*self.obstacles, strict=True):
            reach = radius + self.rod_radius + self.clearance
            near = np.minimum(start, end) - reach < high
            if not (near & (np.maximum(start, end) + reach > low)).all():
                continue
            along = end - start
            share = (around.hanging - start) @ along / max(float(along @ along), 1e-12)
            nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
            away = np.linalg.norm(around.hanging - nearest, axis=2) - radius - self.rod_radius
            least = np.minimum(least, away)
        # What is near the table touches what the table is given as.
        least[around.hanging[..., 2] < around.table_height + _OVER_TABLE] = math.inf
        sample = int(least.min(1).argmin())
        return float(least.min()), sample


def moved(place: Placement, grip: Grip, change: np.ndarray) -> tuple[Placement, Grip]:
    """A place and a grip changed by x, y [m], yaw, roll, grip angle [rad], table height [m]."""
    x, y, yaw, roll, angle, z = change
    tilt = float(np.clip(grip.angle + angle, 0.0, math.pi / 2))
    there = replace(place, x=place.x + x, y=place.y + y, z=place.z + z, yaw=place.yaw + yaw)
    return there, Grip(tilt, grip.roll + roll)


def allowed(fixed: bool, free_height: bool) -> np.ndarray:
    """(6,) which changes of `moved` are: a place that is `fixed` stays, as does the table's height
    unless it is free."""
    return np.array([not fixed] * 3 + [True, True, free_height and not fixed])


def hanging_rod(trajectory: Trajectory) -> np.ndarray | None:
    """(T, points, 3) of the suspended rod in the trajectory's frame [m], None where no shapes are
    known; without the last centimetres, which are the gripper's."""
    if trajectory.shape is None or not np.isfinite(trajectory.shape).all():
        return None
    steps = np.linalg.norm(np.diff(trajectory.shape, axis=1), axis=2)
    arc = np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=1)], axis=1)
    share = np.linspace(0.0, 1.0, _HANGING)
    points = np.empty((len(steps), _HANGING, 3))
    for k, shape in enumerate(trajectory.shape):
        wanted = share * max(arc[k, -1] - _HELD, 0.2 * arc[k, -1])
        points[k] = np.column_stack([np.interp(wanted, arc[k], c) for c in shape.T])
    return points


def _distinct(branches: list[Branch], count: int) -> list[Branch]:
    """The first few that differ from each other by more than rounding."""
    kept: list[Branch] = []
    for branch in branches:
        if all(
            branch.placement != other.placement
            or np.abs(branch.positions - other.positions).max() > 0.1
            for other in kept
        ):
            kept.append(branch)
        if len(kept) == count:
            break
    return kept
