"""One arm at its place: what it may not touch, and how it follows a hand at work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.robot.collision import CollisionModel, between
from wrod.robot.grip import TURN_LENGTH
from wrod.robot.holds import Grasp, Hand, Hold
from wrod.robot.kinematics import grasp_poses, refine
from wrod.robot.model import Robot
from wrod.robot.placement import Placement
from wrod.robot.redundancy import Surroundings, improve
from wrod.robot.search import Branch, follow_targets

LIMIT_MARGIN = 0.02  # [rad]
LINK_ROOM = 0.005  # [m] between links of one arm, and above the table
ARM_ROOM = 0.02  # [m] between the arms
TIP_ROOM = -0.0015  # [m] fingers press on the table by no more than a rod gives way
_REACHED = 1e-4  # [m], a turn of one radian counting as `TURN_LENGTH`
_COARSE = 0.025  # [m] of travel between the samples that are searched
_TRIED = 4  # branches that are improved
_SEEDS = 16


class Arm:
    """An arm with its capsules, standing before the table z = 0.

    Attributes:
        robot, model, hand: its description.
        placement: of the table's frame in its base.
    """

    def __init__(self, robot: Robot, model: CollisionModel, hand: Hand, placement: Placement):
        self.robot, self.model, self.hand, self.placement = robot, model, hand, placement
        self._lifted = np.setdiff1d(model.low, hand.fingers)

    @property
    def base(self) -> np.ndarray:
        """(4, 4) pose of the base in the table's frame [m]."""
        return self.placement.world_from_base

    def capsules(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Starts, ends (K, C, 3) and radii (C,) in the table's frame [m] at (K, n) [rad]."""
        base = self.base
        start, end = (p.numpy() for p in self._points(positions))
        return (
            start @ base[:3, :3].T + base[:3, 3],
            end @ base[:3, :3].T + base[:3, 3],
            self.model.radius,
        )

    def _points(self, positions: np.ndarray):
        import torch

        with torch.no_grad():
            q = torch.from_numpy(np.ascontiguousarray(positions))
            return self.model.points(self.robot.chain.forward_kinematics_tensor(q))

    def grasps(self, positions: np.ndarray) -> np.ndarray:
        """(K, 4, 4) poses of the grasp in the table's frame [m]."""
        return self.base @ grasp_poses(self.robot, positions)

    def rooms(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Gaps (K,) [m] between "links", to the "table", and of the fingers' "tips" to it."""
        start, end = self._points(positions)
        links = self.model.self_distances(start, end).amin(-1).numpy()
        low = self._lifted
        heights = np.minimum(start[:, low, 2].numpy(), end[:, low, 2].numpy())
        table = (heights - self.model.radius[low]).min(1) - self.placement.z
        poses = self.grasps(positions)
        tips = (poses[:, 2, :3] @ self.hand.tips.T).min(1) + poses[:, 2, 3]
        return {"links": links, "table": table, "tips": tips}

    def problem(self, positions: np.ndarray, other=None) -> tuple[float, str | None]:
        """By how much a path (K, n) fails, 0 if it does not, and how; `other` are capsules."""
        worst, what = 0.0, None
        rooms = self.rooms(positions)
        wanted = {"links": LINK_ROOM, "table": LINK_ROOM, "tips": TIP_ROOM}
        names = {
            "links": "two of its links come", "table": "it comes", "tips": "its fingers come"
        }  # fmt: skip
        if other is not None:
            rooms["arm"] = gap_between(self.capsules(positions), other)
            wanted["arm"], names["arm"] = ARM_ROOM, "it comes"
        for kind, room in rooms.items():
            short = wanted[kind] - float(room.min())
            if short > worst:
                to = {"links": "", "arm": " to the other arm"}.get(kind, " to the table")
                worst = short
                what = f"{names[kind]} within {1e3 * room.min():.1f} mm{to}"
        return worst, what

    def in_base(self, capsules):
        """Another arm's capsules, given in the table's frame, in this arm's base."""
        to_base = self.placement.base_from_world
        start, end, radius = capsules
        rotated = [p @ to_base[:3, :3].T + to_base[:3, 3] for p in (start, end)]
        return *rotated, radius


def gap_between(one, other) -> np.ndarray:
    """(K,) least gap [m] between two arms' capsules in one frame; see `Arm.capsules`."""
    import torch

    start, end = (torch.from_numpy(p) for p in one[:2])
    return between(start, end, one[2], *other).flatten(1).amin(-1).numpy()


def coarse_frames(hold: Hold, least: int = 8) -> np.ndarray:
    """Frames of a hold that are about `_COARSE` of travel apart; both ends are among them."""
    travel = hold_travel(hold)
    if travel[-1] < 1e-4:
        return np.array([0, len(travel) - 1]) if len(travel) > 1 else np.array([0])
    count = max(least, int(np.ceil(travel[-1] / _COARSE)))
    frames = np.searchsorted(travel, np.linspace(0.0, travel[-1], count) - 1e-12)
    frames = np.unique(np.append(frames, len(travel) - 1))
    # Frames at rest share one travel: keep the first.
    return frames[np.r_[True, np.diff(travel[frames]) > 1e-9]]


def hold_travel(hold: Hold) -> np.ndarray:
    """(frame,) way of the hand since the first frame, a radian counting `TURN_LENGTH` [m]."""
    turns = Rotation.from_matrix(hold.poses[:, :3, :3])
    turn = (turns[:-1].inv() * turns[1:]).magnitude()
    step = np.hypot(
        np.linalg.norm(np.diff(hold.poses[:, :3, 3], axis=0), axis=1), TURN_LENGTH * turn
    )
    return np.concatenate([[0.0], np.cumsum(np.where(step < 1e-6, 0.0, step))])


@dataclass(frozen=True)
class HoldPath:
    """Joint positions (frame, n) [rad] of an arm over the frames of a hold."""

    hold: Hold
    grasp: Grasp
    positions: np.ndarray


def solve_hold(
    arm: Arm, hold: Hold, grasps: list[Grasp], interval: np.ndarray, other=None
) -> HoldPath:
    """Follow a hand over a hold.

    Args:
        arm: which follows.
        hold, grasps: what, and the ways to hold the rod, the best first.
        interval: (frame - 1,) seconds between the frames.
        other: the other arm's joint positions at these frames are known: its capsules.

    Raises:
        RobotError: it cannot; names what fails on the best try.
    """
    frames = coarse_frames(hold)
    to_base = arm.placement.base_from_world
    targets = np.stack([to_base @ grasp.targets(hold, frames) for grasp in grasps])
    branches = []
    for choice, positions, miss, excess in follow_targets(arm.robot, targets, _SEEDS):
        branch = Branch(arm.placement, grasps[choice].grip, positions, miss, excess)
        short, _ = arm.problem(positions, _at(other, frames))
        cost = branch.cost + 10.0 * short + 0.5 * abs(grasps[choice].slant)
        branches.append((cost, choice, branch))
    branches.sort(key=lambda item: item[0])
    best: tuple[float, str | None] = (np.inf, None)
    for _, choice, branch in _distinct(branches):
        path = HoldPath(
            hold, grasps[choice], _filled(arm, hold, grasps[choice], frames, branch, other)
        )
        short, what = _check(arm, path, interval, other)
        if what is None:
            return path
        if short < best[0]:
            best = short, what
    raise RobotError(
        f"an arm at {arm.placement} cannot follow hand {hold.hand} over frames {hold.first} to "
        f"{hold.last}: {best[1]}; move the pattern or give the arms other places"
    )


def _at(other, frames):
    return None if other is None else (other[0][frames], other[1][frames], other[2])


def _distinct(branches):
    kept = []
    for item in branches:
        if all(
            item[1] != k[1] or np.abs(item[2].positions - k[2].positions).max() > 0.1 for k in kept
        ):
            kept.append(item)
        if len(kept) == _TRIED:
            break
    return kept


def _filled(arm: Arm, hold: Hold, grasp: Grasp, frames, branch: Branch, other) -> np.ndarray:
    """The branch at every frame, its elbow improved."""
    positions = branch.positions
    goals = arm.placement.base_from_world @ grasp.targets(hold)
    if branch.miss.max() < 0.02 and len(frames) > 2:
        near = None if other is None else arm.in_base(_at(other, frames))
        around = Surroundings(
            arm.placement.z, np.zeros((1, 3)), np.zeros(len(frames), dtype=int), 0.0, near
        )
        positions = improve(arm.robot, arm.model, positions, goals[frames], around, 12)
    travel = hold_travel(hold)
    if len(frames) > 2:
        start = CubicSpline(travel[frames], positions)(travel)
    else:
        start = np.repeat(positions[:1], len(travel), axis=0)
    return refine(arm.robot, start, goals)[0]


def _check(arm: Arm, path: HoldPath, interval: np.ndarray, other) -> tuple[float, str | None]:
    """By how much a path fails, and how; a miss counts most."""
    q, robot = path.positions, arm.robot
    reached = arm.grasps(q)
    wanted = path.grasp.targets(path.hold)
    off = np.linalg.norm(reached[:, :3, 3] - wanted[:, :3, 3], axis=1)
    turn = Rotation.from_matrix(reached[:, :3, :3].mT @ wanted[:, :3, :3]).magnitude()
    miss = np.hypot(off, TURN_LENGTH * turn)
    if miss.max() > _REACHED:
        k = int(miss.argmax())
        return 100.0 + miss[k], (
            f"the grasp is out of reach at frame {path.hold.first + k}: the nearest pose found is "
            f"{1e3 * off[k]:.1f} mm and {np.degrees(turn[k]):.1f} degrees away"
        )
    room = np.minimum(q - robot.lower, robot.upper - q)
    if room.min() < LIMIT_MARGIN:
        k, joint = np.unravel_index(room.argmin(), room.shape)
        return 10.0 - room.min(), (
            f"joint {robot.joint_names[joint]} comes within {room.min():.3f} rad of its limit at "
            f"frame {path.hold.first + k}"
        )
    if len(q) > 1:
        load = np.abs(np.diff(q, axis=0)) / (robot.velocity * interval[:, None])
        if load.max() > 1.0:
            k, joint = np.unravel_index(load.argmax(), load.shape)
            return 5.0 + load.max(), (
                f"joint {robot.joint_names[joint]} would have to turn {load.max():.1f} times as "
                f"fast as it can after frame {path.hold.first + k}"
            )
    short, what = arm.problem(*with_middles(q, other))
    if what is not None:
        what += f" between frames {path.hold.first} and {path.hold.last}"
    return short, what


def with_middles(positions: np.ndarray, other=None):
    """A path (2 K - 1, n) with the points half way between its frames, and the same of `other`."""

    def dense(values):
        out = np.repeat(values, 2, axis=0)[:-1]
        out[1::2] = (values[1:] + values[:-1]) / 2
        return out

    if other is None:
        return dense(positions), None
    return dense(positions), (dense(other[0]), dense(other[1]), other[2])
