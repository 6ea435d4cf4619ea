"""Pulling a knot with both hands: does it tighten, and does it hold?"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wrod.knots.moves import approach
from wrod.knots.tying_run import TyingRun
from wrod.knots.workbench import TICK, Poses, Workbench

# Once the pull is reached the knot comes to rest [s]; then the pull is kept up for so long [s], and
# the knot may give so far in that time, in diameters of the thinnest rod.
SETTLE, HOLD = 1.0, 3.0
CREEP = 1.0
# While it is kept up, no hand's pull may fall below this part of it.
_KEPT = 0.9
# Hands slow down over this part of the pull, to come to a little more than it.
_BAND, _ABOVE = 0.2, 1.02
# They rise while they begin, so that neither they nor the rods rub on the table [m].
_LIFT, _RISE = 0.03, 0.06


@dataclass(frozen=True)
class Outcome:
    """How scenes took a pull.

    Attributes:
        load: (scene, hand) at the end [N].
        strongest: (scene,) largest pull that both hands came to [N].
        crept: (scene,) how far both hands together went while the pull was kept up [m].
        held: (scene,) the pull was reached and kept up, and the knot gave no more than allowed.
        poses: of the hands at the end.
    """

    load: np.ndarray
    strongest: np.ndarray
    crept: np.ndarray
    held: np.ndarray
    poses: list[Poses]


def keep_up(
    bench: Workbench,
    starts: np.ndarray,
    ways: np.ndarray,
    load: float,
    give: float,
    *,
    speed: float,
    hand_pose: Callable[[int, np.ndarray], Poses],
    after_tick: Callable[[Callable[[float], list[Poses]]], Callable[[], None]],
    when_tight: Callable[[np.ndarray], None],
) -> Outcome:
    """Pull with two hands that hold their rods; let the knot come to rest for `SETTLE` seconds, and
    keep the pull up for `HOLD` more.

    Hands feel their pull: they go on as long as one of them pulls with less than `load`, and yield
    if both pull with more. A hand that has come to the end of its way ends the trial.

    Args:
        bench: where the rods are.
        starts, ways: (hand, 3) where the hands are, and their ways from there [m].
        load: pull of both hands [N].
        give: way of both hands together that is allowed while the pull is kept up [m].
        speed: of the faster hand [m/s].
        hand_pose: pose of a hand whose place is (scene, 3).
        after_tick: what is to be called after every tick of hands with these poses over time.
        when_tight: called with the scenes whose pull has just been reached.
    """
    scenes = len(bench.rods)
    lengths = np.linalg.norm(ways, axis=1)
    share, directions = lengths / lengths.max(), ways / lengths[:, None]
    since, way, pace = bench.time, np.zeros(scenes), np.zeros(scenes)

    def poses(t: float) -> list[Poses]:
        """Hands go the same part of their ways at the same time."""
        gone = way + pace * (t - since)
        x = np.clip(gone / _RISE, 0.0, 1.0)
        up = np.outer(_LIFT * x**2 * (3.0 - 2.0 * x), [0.0, 0.0, 1.0])
        return [
            hand_pose(h, starts[h] + share[h] * gone[:, None] * directions[h] + up)
            for h in range(2)
        ]

    watch = after_tick(poses)
    edge = bench.held.edge
    force, strongest = np.zeros((scenes, 2)), np.zeros(scenes)
    tight_at, tight_way = np.full(scenes, np.inf), np.full(scenes, np.nan)
    lowest, kept = np.full(scenes, np.inf), np.zeros(scenes, dtype=bool)
    done = (edge < 0).any(axis=1)
    while not done.all():
        bench.run(bench.time + TICK, poses, watch)
        way, since = way + pace * (bench.time - since), bench.time
        now = np.where(edge >= 0, bench.load(), 0.0)
        both = now.min(axis=1)
        force[~done] = now[~done]
        strongest[~done] = np.maximum(strongest, both)[~done]
        reached = ~done & ~np.isfinite(tight_at) & (both >= load)
        tight_at[reached] = since
        when_tight(np.flatnonzero(reached))
        keeping = ~done & (since - tight_at >= SETTLE)
        tight_way = np.where(keeping & np.isnan(tight_way), way, tight_way)
        lowest[keeping] = np.minimum(lowest, both)[keeping]
        done |= (edge < 0).any(axis=1) | (way >= lengths.max()) | bench.diverged
        kept |= ~done & (since - tight_at >= SETTLE + HOLD)
        done |= kept
        short = (_ABOVE * load - both) / (_BAND * load)
        pace = np.where(done, 0.0, speed * np.clip(short, -1.0, 1.0))
    crept = np.nan_to_num(share.sum() * np.abs(way - tight_way))
    held = kept & (lowest >= _KEPT * load) & (crept <= give)
    return Outcome(force, strongest, crept, held, poses(bench.time))


def pull(run: TyingRun) -> None:
    """Where the knot is tied, both hands grasp where the rods' ends were put down, pull with the
    plan's load, and keep it up."""
    bench, knot = run.bench, run.knot
    tied = [scene for scene, result in enumerate(run.results) if result.is_tied]
    if not tied:
        return
    heights = [run.plans[one.rod][1].radius for one in knot.pull]
    starts = np.array([[*one.where, z] for one, z in zip(knot.pull, heights, strict=True)])
    approach(run, dict(enumerate(starts)))
    for hand, one in enumerate(knot.pull):
        place = run.hand_pose(hand, starts[hand], floor=heights[hand])
        run.grasp(hand, one.rod, "pull", place, tied)
        run.closed[tied, hand] = True
    ways = np.array([[*one.direction, 0.0] for one in knot.pull])
    ways *= ([one.distance for one in knot.pull] / np.linalg.norm(ways, axis=1))[:, None]
    outcome = keep_up(
        bench,
        starts,
        ways,
        knot.load,
        2.0 * CREEP * min(rod.radius for _, rod in knot.rods),
        speed=0.5 * run.hand_speed,
        hand_pose=lambda hand, place: run.hand_pose(hand, place, floor=heights[hand]),
        after_tick=lambda poses: run.watch(poses, "pull"),
        when_tight=lambda scenes: run.note("tight", scenes),
    )
    for scene, result in enumerate(run.results):
        result.load = outcome.load[scene]
        result.strongest = float(outcome.strongest[scene])
        result.crept = float(outcome.crept[scene])
        result.held = bool(outcome.held[scene])
    run.now = outcome.poses
