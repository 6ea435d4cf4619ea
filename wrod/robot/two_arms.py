"""Two arms that do what two hands did in a film, clear of each other and of the table."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from wrod.errors import RobotError
from wrod.robot.arm import ARM_ROOM, Arm, gap_between, with_middles
from wrod.robot.arm_timeline import ArmTimeline
from wrod.robot.collision import CollisionModel
from wrod.robot.kinematics import one_torch_thread
from wrod.robot.model import Robot, load_robot
from wrod.robot.placement import Placement
from wrod.robot.stations import pairs_of_stations
from wrod.robot.transfer_path import HandFollower, TransferPath, follow, follow_both
from wrod.robot.transfers import Grasp, Hand, HandFilm, Transfer, find_grasps, find_transfers
from wrod.robot.transit import park

_HANDS_APART = 0.03  # [m] between two hands at work


@dataclass(frozen=True)
class ArmFilm:
    """Joint positions of both arms over the time of a scene.

    While simulated time stands still, for an arm that needs longer than its hand did, `frame`
    stays the same.

    Attributes:
        time: (F,) [s].
        frame: (F,) of the film of hands.
        positions: (arm, F, n) [rad].
        robot: of both arms.
        placements: of the table's frame in either base.
        gap, table, links: least distances [m] between the arms, of their links above the fingers
            from the table, and between links of one arm.
        load: largest joint speed over its limit.
        waits: seconds added where simulated time stands still.
    """

    time: np.ndarray
    frame: np.ndarray
    positions: np.ndarray
    robot: Robot
    placements: tuple[Placement, Placement]
    gap: float
    table: float
    links: float
    load: float
    waits: float

    @property
    def facts(self) -> dict:
        """Plain values for metadata [m], [s]."""
        return {
            "arm_gap": self.gap,
            "table_gap": self.table,
            "link_gap": self.links,
            "joint_speed_share": self.load,
            "added_seconds": self.waits,
        }


def solve_two_arms(
    film: HandFilm,
    ground: np.ndarray,
    *,
    robot="sawyer",
    placements: tuple[Placement, Placement] | None = None,
) -> ArmFilm:
    """Joint paths of two arms, one for each hand.

    Where a hand is at work its arm follows it, with a constant hold of the rod. Between that, arms
    move back from the rod, go straight to the next or wait beside the table, and keep clear of
    each other; if they need longer than the hands did, simulated time stands still.

    Args:
        film: of the hands; a second hand is idle if there is only one.
        ground: (n, 3) points of the table that must lie before the arms [m].
        robot: as for `wrod.load_robot`.
        placements: tried first, as found for a similar film.

    Raises:
        RobotError: an arm cannot follow its hand, or the arms cannot keep clear of each other.
    """
    if film.hands.shape[1] == 1:
        idle = np.repeat(film.hands[:1], len(film.time), axis=0)
        closed = np.column_stack([film.closed, np.zeros_like(film.closed)])
        film = replace(film, hands=np.concatenate([film.hands, idle], axis=1), closed=closed)
    with one_torch_thread():
        arm = load_robot(robot)
        model = CollisionModel(arm)
        hand = Hand.of(model)
        transfers = find_transfers(film)
        grasps = _apart(transfers, {id(t): find_grasps(t, hand) for t in transfers}, hand)
        problem: RobotError | None = None
        for pair in _pairs(arm, transfers, grasps, ground, placements):
            arms = [Arm(arm, model, hand, place) for place in pair]
            try:
                return _solve(film, arms, transfers, grasps, ground)
            except RobotError as error:
                problem = problem or error
        raise problem


def _pairs(robot, transfers, grasps, ground, first):
    if first is not None:
        yield first
    mine = [[t for t in transfers if t.hand == k] for k in range(2)]
    yield from pairs_of_stations(robot, mine, grasps, ground)


def _apart(
    transfers: list[Transfer], grasps: dict[int, list[Grasp]], hand: Hand
) -> dict[int, list[Grasp]]:
    """Of hands at work at the same time, the grasps of least slant that keep them apart.

    Raises:
        RobotError: none do.
    """
    out = dict(grasps)
    for k, one in enumerate(transfers):
        for other in transfers[k + 1 :]:
            common = range(max(one.first, other.first), min(one.last, other.last) + 1)
            if one.hand == other.hand or not common:
                continue
            best: tuple[float, Grasp, Grasp, float] | None = None
            mine, theirs = out[id(one)], out[id(other)]
            for a, b in product(mine, theirs):
                gap = _hand_gap(hand, one, a, other, b, np.array(common))
                cost = a.slant**2 + b.slant**2 + 100.0 * max(0.0, _HANDS_APART - gap)
                if best is None or cost < best[0] - 1e-9:
                    best = cost, a, b, gap
            if best[3] < ARM_ROOM:
                raise RobotError(
                    f"two hands at work come within {1e3 * best[3]:.1f} mm of each other between "
                    f"frames {common[0]} and {common[-1]} of the film, however they are turned; "
                    "grasp farther apart or one after the other"
                )
            out[id(one)] = _like(mine, best[1])
            out[id(other)] = _like(theirs, best[2])
    return out


def _like(grasps: list[Grasp], wanted: Grasp) -> list[Grasp]:
    """The wanted grasp, and its like turned about the fingers."""
    return [g for g in grasps if g is wanted or (g.slant == wanted.slant and g.slant != 0.0)] + [
        g for g in grasps if wanted.slant == 0.0 and g.slant == 0.0 and g is not wanted
    ]


def _hand_gap(
    hand: Hand, one: Transfer, a: Grasp, other: Transfer, b: Grasp, frames: np.ndarray
) -> float:
    sides = []
    for transfer, grasp in ((one, a), (other, b)):
        poses = grasp.targets(transfer, frames - transfer.first)
        rotation, origin = poses[:, None, :3, :3], poses[:, None, :3, 3]
        sides.append(
            [(rotation @ p[None, :, :, None])[..., 0] + origin for p in (hand.start, hand.end)]
            + [hand.radius]
        )
    return float(gap_between(*sides).min())


def _solve(film: HandFilm, arms: list[Arm], transfers, grasps, ground: np.ndarray) -> ArmFilm:
    middle = (ground.min(0) + ground.max(0)) / 2 * [1, 1, 0]
    waiting = [park(arm, middle) for arm in arms]
    resting = [arm.capsules(q[None]) for arm, q in zip(arms, waiting, strict=True)]
    steps = np.diff(film.time)
    paths: list[TransferPath] = []

    def follower(transfer: Transfer) -> HandFollower:
        done = [path for path in paths if path.transfer.hand == transfer.hand]
        side = HandFollower(
            arms[transfer.hand],
            transfer,
            grasps[id(transfer)],
            steps[transfer.first : transfer.last],
            done[-1].positions[-1] if done else waiting[transfer.hand],
        )
        side.other = beside(side)
        return side

    def beside(side: HandFollower, path: TransferPath | None = None):
        """The other arm's capsules beside a transfer: at work where that is known, else waiting."""
        transfer, known = side.transfer, paths if path is None else [*paths, path]
        start, end, radius = resting[1 - transfer.hand]
        count = transfer.last - transfer.first + 1
        start, end = np.repeat(start, count, axis=0), np.repeat(end, count, axis=0)
        for work in known:
            done = work.transfer
            first, last = max(done.first, transfer.first), min(done.last, transfer.last)
            if done.hand == transfer.hand or last < first:
                continue
            there = slice(first - done.first, last + 1 - done.first)
            here = slice(first - transfer.first, last + 1 - transfer.first)
            start[here], end[here], _ = arms[done.hand].capsules(work.positions[there])
        return start, end, radius

    left = list(transfers)
    while left:
        transfer = left.pop(0)
        partner = next(
            (t for t in left if t.hand != transfer.hand and t.first <= transfer.last), None
        )
        if partner is None:
            paths.append(follow(follower(transfer)))
        else:
            left = [h for h in left if h is not partner]
            paths += follow_both(follower(transfer), follower(partner), beside)
    return measured(film, arms, *ArmTimeline(film, arms, paths, waiting).run())


def measured(film: HandFilm, arms: list[Arm], time, frame, positions) -> ArmFilm:
    """An `ArmFilm` of joint positions (arm, F, n), with its distances, also between the frames.

    Raises:
        RobotError: arms, links or the table come too near, or a joint is too fast.
    """
    dense = [with_middles(q)[0] for q in positions]
    one, other = (arm.capsules(q) for arm, q in zip(arms, dense, strict=True))
    gaps = gap_between(one, other)
    rooms = [arm.rooms(q) for arm, q in zip(arms, dense, strict=True)]
    speed = np.abs(np.diff(positions, axis=1)) / np.diff(time)[:, None]
    load = float((speed / arms[0].robot.velocity).max())
    if gaps.min() < 0.9 * ARM_ROOM:
        k = int(gaps.argmin()) // 2
        raise RobotError(
            f"the arms come within {1e3 * gaps.min():.1f} mm of each other at frame {frame[k]} of "
            "the film; give them other places or the hands more room"
        )
    if load > 1.0 + 1e-9:
        raise RobotError(f"a joint would have to turn {load:.2f} times as fast as it can")
    return ArmFilm(
        time=time,
        frame=frame,
        positions=positions,
        robot=arms[0].robot,
        placements=(arms[0].placement, arms[1].placement),
        gap=float(gaps.min()),
        table=min(float(room["table"].min()) for room in rooms),
        links=min(float(room["links"].min()) for room in rooms),
        load=load,
        waits=float(time[-1] - (film.time[-1] - film.time[0])),
    )
