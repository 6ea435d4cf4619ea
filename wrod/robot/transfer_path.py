"""How an arm follows a hand over a transfer, alone or beside another arm."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.errors import RobotError
from wrod.robot.arm import Arm, gap_between, with_middles
from wrod.robot.grip import TURN_LENGTH
from wrod.robot.kinematics import refine
from wrod.robot.redundancy import Surroundings, improve
from wrod.robot.search import Branch, follow_targets
from wrod.robot.transfers import Grasp, Transfer

LIMIT_MARGIN = 0.02  # [rad]
_REACHED = 1e-4  # [m], a turn of one radian counting as `TURN_LENGTH`
_COARSE = 0.025  # [m] of travel between the samples that are searched
_TRIED = 4  # branches, or pairs of them, that are improved
_RANKED = 12  # branches of each of two arms that are paired
_SEEDS = 16
_PAIR_ROOM = 0.08  # [m] wanted between the branches of two arms before they are improved
_PAIR_FRAMES = 10
_FAR = 0.05  # cost of a radian between two transfers


def coarse_frames(transfer: Transfer) -> np.ndarray:
    """Frames of a transfer that are about `_COARSE` of travel apart; both ends are among them."""
    travel = transfer_travel(transfer)
    if travel[-1] < 1e-4:
        return np.array([0, len(travel) - 1]) if len(travel) > 1 else np.array([0])
    count = max(8, int(np.ceil(travel[-1] / _COARSE)))
    frames = np.searchsorted(travel, np.linspace(0.0, travel[-1], count) - 1e-12)
    frames = np.unique(np.append(frames, len(travel) - 1))
    # Frames at rest share one travel: keep the first.
    return frames[np.r_[True, np.diff(travel[frames]) > 1e-9]]


def transfer_travel(transfer: Transfer) -> np.ndarray:
    """(frame,) way of the hand since the first frame, a radian counting `TURN_LENGTH` [m]."""
    turns = Rotation.from_matrix(transfer.poses[:, :3, :3])
    turn = (turns[:-1].inv() * turns[1:]).magnitude()
    step = np.hypot(
        np.linalg.norm(np.diff(transfer.poses[:, :3, 3], axis=0), axis=1), TURN_LENGTH * turn
    )
    return np.concatenate([[0.0], np.cumsum(np.where(step < 1e-6, 0.0, step))])


@dataclass(frozen=True)
class TransferPath:
    """Joint positions (frame, n) [rad] of an arm over the frames of a transfer."""

    transfer: Transfer
    grasp: Grasp
    positions: np.ndarray


class HandFollower:
    """An arm about to follow a hand.

    Args:
        arm: which follows.
        transfer: what.
        grasps: the ways to hold the rod, the best first.
        interval: (frame - 1,) seconds between the frames.
        before: (n,) where the arm comes from: branches near that are preferred [rad].

    Attributes:
        other: the other arm's capsules at these frames as far as they are known, else None.
    """

    def __init__(self, arm: Arm, transfer: Transfer, grasps: list[Grasp], interval, before):
        self.arm, self.transfer, self.grasps = arm, transfer, grasps
        self.interval, self.before = interval, before
        self.other: Any = None
        self.frames = coarse_frames(transfer)
        self.travel = transfer_travel(transfer)

    def branches(self, count: int) -> list[tuple[float, Grasp, np.ndarray]]:
        """Cost, grasp and coarse joint positions of different branches, the best first."""
        to_base = self.arm.placement.base_from_world
        targets = np.stack([to_base @ g.targets(self.transfer, self.frames) for g in self.grasps])
        found, rows = [], follow_targets(self.arm.robot, targets, _SEEDS)
        paths = np.stack([positions for _, positions, _, _ in rows])
        shorts = self.arm.shortfalls(paths, _at(self.other, self.frames))
        for short, (choice, positions, miss, excess) in zip(shorts, rows, strict=True):
            grasp = self.grasps[choice]
            branch = Branch(self.arm.placement, grasp.grip, positions, miss, excess)
            far = np.abs(positions[0] - self.before).max()
            cost = branch.cost + 10.0 * short + 0.5 * abs(grasp.slant) + _FAR * far
            found.append((cost, grasp, positions))
        found.sort(key=lambda item: item[0])
        kept: list = []
        for item in found:
            if all(item[1] is not k[1] or np.abs(item[2] - k[2]).max() > 0.1 for k in kept):
                kept.append(item)
            if len(kept) == count:
                break
        return kept

    def path(self, grasp: Grasp, coarse: np.ndarray, improved: bool = True) -> TransferPath:
        """A branch at every frame, its elbow improved or as it is."""
        arm, frames = self.arm, self.frames
        goals = arm.placement.base_from_world @ grasp.targets(self.transfer)
        if improved and len(frames) > 2:
            near = None if self.other is None else arm.in_base(_at(self.other, frames))
            around = Surroundings(
                arm.placement.z, np.zeros((1, 3)), np.zeros(len(frames), dtype=int), 0.0, near
            )
            coarse = improve(arm.robot, arm.model, coarse, goals[frames], around, 12)
        start = np.repeat(coarse[:1], len(self.travel), axis=0)
        if len(frames) > 2:
            start = CubicSpline(self.travel[frames], coarse)(self.travel)
        return TransferPath(self.transfer, grasp, refine(arm.robot, start, goals)[0])

    def check(self, path: TransferPath) -> tuple[float, str | None]:
        """By how much a path fails, 0 if it does not, and how; a miss counts most."""
        q, arm, first = path.positions, self.arm, path.transfer.first
        robot, reached = arm.robot, arm.grasps(q)
        wanted = path.grasp.targets(path.transfer)
        off = np.linalg.norm(reached[:, :3, 3] - wanted[:, :3, 3], axis=1)
        turn = Rotation.from_matrix(reached[:, :3, :3].mT @ wanted[:, :3, :3]).magnitude()
        miss = np.hypot(off, TURN_LENGTH * turn)
        if miss.max() > _REACHED:
            k = int(miss.argmax())
            return 100.0 + miss[k], (
                f"the grasp is out of reach at frame {first + k}: the nearest pose found "
                f"is {1e3 * off[k]:.1f} mm and {np.degrees(turn[k]):.1f} degrees away"
            )
        room = np.minimum(q - robot.lower, robot.upper - q)
        if room.min() < LIMIT_MARGIN:
            k, joint = np.unravel_index(room.argmin(), room.shape)
            return 10.0 - room.min(), (
                f"joint {robot.joint_names[joint]} comes within {room.min():.3f} rad of its limit "
                f"at frame {first + k}"
            )
        if len(q) > 1:
            load = np.abs(np.diff(q, axis=0)) / (robot.velocity * self.interval[:, None])
            if load.max() > 1.0:
                k, joint = np.unravel_index(load.argmax(), load.shape)
                return 5.0 + load.max(), (
                    f"joint {robot.joint_names[joint]} would have to turn {load.max():.1f} times "
                    f"as fast as it can after frame {first + k}"
                )
        short, what = arm.problem(*with_middles(q, self.other))
        if what is not None:
            what += f" between frames {first} and {path.transfer.last}"
        return short, what

    def refusal(self, what: str) -> RobotError:
        over = self.transfer
        return RobotError(
            f"an arm at {self.arm.placement} cannot follow hand {over.hand} over frames "
            f"{over.first} to {over.last}: {what}; move the pattern or give the arms other places"
        )


def follow(one: HandFollower) -> TransferPath:
    """Follow a hand.

    Raises:
        RobotError: the arm cannot; names what fails on the best try.
    """
    best: tuple[float, str] = (np.inf, "no pose found")
    for _, grasp, coarse in one.branches(_TRIED):
        path = one.path(grasp, coarse)
        short, what = one.check(path)
        if what is None:
            return path
        best = min(best, (short, what))
    raise one.refusal(best[1])


def follow_both(
    one: HandFollower, two: HandFollower, beside: Callable[[HandFollower, TransferPath], object]
) -> tuple[TransferPath, TransferPath]:
    """Follow two hands that are at work at the same time.

    Args:
        one, two: the arms; `two` is improved last.
        beside: what a follower's `other` becomes beside a path of the other arm.

    Raises:
        RobotError: they cannot; names what fails on the best try.
    """
    first = max(one.transfer.first, two.transfer.first)
    last = min(one.transfer.last, two.transfer.last)
    common = np.unique(np.linspace(first, last, _PAIR_FRAMES).astype(int))
    sides = []
    for side in (one, two):
        ranked = []
        for cost, grasp, coarse in side.branches(_RANKED):
            rough = side.path(grasp, coarse, improved=False)
            capsules = side.arm.capsules(rough.positions[common - side.transfer.first])
            ranked.append((cost, grasp, coarse, rough, capsules))
        sides.append(ranked)
    pairs = []
    for a, b in product(*sides):
        gap = float(gap_between(a[4], b[4]).min())
        pairs.append((a[0] + b[0] + 20.0 * max(0.0, _PAIR_ROOM - gap), a, b))
    pairs.sort(key=lambda item: item[0])
    best: tuple[float, str, HandFollower] = (np.inf, "no pose found", one)
    for _, a, b in pairs[:_TRIED]:
        one.other = beside(one, b[3])
        mine = one.path(*a[1:3])
        two.other = beside(two, mine)
        theirs = two.path(*b[1:3])
        one.other = beside(one, theirs)
        failed = [(*side.check(path), side) for side, path in ((one, mine), (two, theirs))]
        failed = [item for item in failed if item[1] is not None]
        if not failed:
            return mine, theirs
        best = min([best, *failed], key=lambda item: item[0])
    raise best[2].refusal(best[1])


def _at(other, frames):
    return None if other is None else (other[0][frames], other[1][frames], other[2])
