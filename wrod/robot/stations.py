"""Where two arms stand so that each reaches everything that its hand does."""

import numpy as np

from wrod.errors import RobotError
from wrod.robot.grip import Grip
from wrod.robot.model import Robot
from wrod.robot.placement import Placement, Places, candidates
from wrod.robot.search import Branch, follow_targets
from wrod.robot.transfer_path import coarse_frames
from wrod.robot.transfers import Grasp, Transfer

_EACH = 3  # placements of each table height and turn that are looked at
_FRAMES, _SEEDS, _GRASPS = 80, 4, 3
_APART = 0.9  # [m] between two bases
_FACING = np.cos(np.radians(110.0))  # seen from the middle of the table
_POOR = 1.0  # a branch of this cost misses by a centimetre
_PAIRS = 8


def pairs_of_stations(
    robot: Robot,
    transfers: list[list[Transfer]],
    grasps: dict[int, list[Grasp]],
    ground: np.ndarray,
) -> list[tuple[Placement, Placement]]:
    """Pairs of placements, on one floor and facing each other, the easiest for the arms first.

    Args:
        robot: both arms.
        transfers: of each hand.
        grasps: of each transfer, by its `id`.
        ground: (n, 3) points of the table that must lie before the arms [m].

    Raises:
        RobotError: no pair reaches everything.
    """
    middle = (ground[:, :2].min(0) + ground[:, :2].max(0)) / 2
    ranked = [_stations(robot, mine, grasps, ground) for mine in transfers]
    pairs = []
    for cost, first in ranked[0]:
        for price, second in ranked[1]:
            a, b = (p.world_from_base[:2, 3] for p in (first, second))
            apart = np.linalg.norm(a - b)
            facing = (a - middle) @ (b - middle)
            facing /= np.linalg.norm(a - middle) * np.linalg.norm(b - middle)
            if first.z == second.z and apart > _APART and facing < _FACING:
                pairs.append(
                    (max(cost, price) + 0.2 * min(cost, price) + 0.1 * facing, first, second)
                )
    if not pairs:
        raise RobotError(
            "no two places for the arms, on one floor and facing each other, let both hands reach "
            "all that they do; use a smaller pattern or shorter moves"
        )
    pairs.sort(key=lambda item: item[0])
    # The best of each pair of bearings before the second best of any: places side by side fail
    # alike.
    seen: dict[tuple[float, float], int] = {}
    order = []
    for rank, (_, first, second) in enumerate(pairs):
        key = first.yaw, second.yaw
        seen[key] = seen.get(key, 0) + 1
        order.append((seen[key], rank))
    return [pairs[rank][1:] for _, rank in sorted(order)[:_PAIRS]]


def _stations(robot, transfers, grasps, ground) -> list[tuple[float, Placement]]:
    """Placements of one arm with the cost of its worst transfer."""
    ways = [transfer.poses[:, :3, 3] for transfer in transfers] or [ground + [0.0, 0.0, 0.2]]
    everything = Places(ground * [1, 1, 0], np.concatenate(ways))
    kept: dict[tuple[float, float], list[Placement]] = {}
    for placement in candidates(everything, robot, 1000):
        group = kept.setdefault((placement.z, placement.yaw), [])
        if len(group) < _EACH:
            group.append(placement)
    places = [placement for group in kept.values() for placement in group]
    if not places:
        return []
    cost = np.zeros(len(places))
    for transfer in transfers:
        frames = coarse_frames(transfer)
        frames = frames[np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))]
        choices = grasps[id(transfer)][:_GRASPS]
        targets = np.stack(
            [p.base_from_world @ g.targets(transfer, frames) for p in places for g in choices]
        )
        best = np.full(len(places), np.inf)
        for way, positions, miss, excess in follow_targets(robot, targets, _SEEDS):
            place = way // len(choices)
            found = Branch(places[place], Grip(), positions, miss, excess).cost
            best[place] = min(best[place], found)
        cost = np.maximum(cost, best)
    order = np.argsort(cost, kind="stable")
    return [(float(cost[k]), places[k]) for k in order if cost[k] < _POOR]
