"""Pulling a knot with both hands: does it tighten, and does it hold?"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from wrod.kernels.stepping import hands
from wrod.knots.moves import approach
from wrod.knots.tying_run import TyingRun
from wrod.knots.workbench import TICK, Poses, Workbench
from wrod.rods.state import node_positions
from wrod.solvers.readback import read

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
# What is known of a scene when its pull begins.
_BEGIN = {
    "way": 0.0, "pace": 0.0, "strongest": 0.0, "lowest": np.inf, "tight_at": np.nan,
    "tight_way": np.nan,
}  # fmt: skip


@dataclass(frozen=True)
class TwoHands:
    """Two hands that pull.

    Attributes:
        starts, ways: (hand, 3) where they are, and their ways from there [m].
        speed: of the faster one [m/s].
        rotation: (scene,) of both.
        misses: (scene, hand, tick, 3) by how much they are off their places, over and over [m].
        floor: height below which they do not go [m], (hand,).
    """

    starts: np.ndarray
    ways: np.ndarray
    speed: float
    rotation: Rotation = field(default_factory=lambda: Rotation.identity(1))
    misses: np.ndarray = field(default_factory=lambda: np.zeros((1, 2, 1, 3)))
    floor: tuple[float, float] = (-np.inf, -np.inf)

    def poses(self, tick: int) -> list[Poses]:
        """Of both where they start."""
        places = self.starts + self.misses[:, :, tick % self.misses.shape[2]]
        places[:, :, 2] = np.maximum(places[:, :, 2], self.floor)
        return [Poses(places[:, h], self.rotation) for h in range(2)]


@dataclass(frozen=True)
class PullOutcome:
    """How scenes took a pull.

    Attributes:
        load: (scene, hand) at the end [N].
        strongest: (scene,) largest pull that both hands came to [N].
        crept: (scene,) how far both hands together went while the pull was kept up [m].
        held: (scene,) the pull was reached and kept up, and the knot gave no more than allowed.
        tight_at: (scene,) when both hands first pulled with the load [s]; NaN if they never did.
        tight: (scene, node, 3) of every rod at that time [m].
    """

    load: np.ndarray
    strongest: np.ndarray
    crept: np.ndarray
    held: np.ndarray
    tight_at: np.ndarray
    tight: list[np.ndarray]


def keep_up(
    bench: Workbench,
    pair: TwoHands,
    load: float,
    give: float,
    film: Callable[[list[Poses]], object] | None = None,
    film_ticks: int = 1,
) -> PullOutcome:
    """Pull with two hands that hold their rods; let the knot come to rest for `SETTLE` seconds, and
    keep the pull up for `HOLD` more.

    Hands feel their pull: they go on as long as one of them pulls with less than `load`, and yield
    if both pull with more. A hand that has come to the end of its way ends the trial.

    Args:
        bench: where the rods are.
        pair: the hands, which are where they start.
        load: pull of both [N].
        give: way of both together that is allowed while the pull is kept up [m].
        film: called with the hands' poses after every so many ticks.
    """
    held, batch, pace = bench.held, bench.batch, bench.dynamics.pace
    lengths = np.linalg.norm(pair.ways, axis=1)
    share = lengths / lengths.max()
    carried = np.stack([pair.rotation.apply(held.offset[:, h]) for h in range(2)], axis=1)
    pull = _pull(pair, carried, load, batch.device)
    # Until both feel the load they are no slower than where they do.
    slowest = pair.speed * (_ABOVE - 1.0) / _BAND
    count = int((lengths.max() / slowest + SETTLE + HOLD) / TICK) + 4
    times = bench.time + TICK * np.arange(count)
    tight = wp.clone(batch.state.dof)

    def feel() -> None:
        state = [held.course, pace, pull]
        batch.launch(hands.pull, batch.rod_count, [held.holds, held.felt, *state], [held.position])
        batch.launch(hands.keep_tight, tight.shape, [*state, batch.state.dof], [tight])

    bench.plan(times.tolist(), [pair.poses(tick) for tick in range(2)], feel)
    key, waits = 0, np.ones(len(bench.rods), dtype=bool)
    while key < count - 1 and waits.any():
        key = count - 1 if film is None else min(key + film_ticks, count - 1)
        bench.go_to(key)
        places, waits = held.at_key()
        if film is not None:
            film([Poses(places[:, h] - carried[:, h], pair.rotation) for h in range(2)])
    way, tight_way = read(pull.way), read(pull.tight_way)
    crept = np.nan_to_num(share.sum() * np.abs(way - tight_way))
    kept = (read(pull.kept) != 0) & (read(pull.lowest) >= _KEPT * load)
    nodes = node_positions(read(tight))
    return PullOutcome(
        bench.load(),
        read(pull.strongest),
        crept,
        kept & (crept <= give),
        read(pull.tight_at),
        [nodes[:, s] for s in bench.slices],
    )


def _pull(pair: TwoHands, carried: np.ndarray, load: float, device: str) -> hands.PullApart:
    """A pull that begins, for kernels."""
    lengths = np.linalg.norm(pair.ways, axis=1)

    def array(values, dtype=wp.float64) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

    pull, scenes = hands.PullApart(), len(carried)
    pull.start, pull.floor = array(pair.starts, wp.vec3d), array(pair.floor)
    pull.direction = array(pair.ways / lengths[:, None], wp.vec3d)
    pull.share, pull.length, pull.speed = array(lengths / lengths.max()), lengths.max(), pair.speed
    pull.misses, pull.carried = array(pair.misses, wp.vec3d), array(carried, wp.vec3d)
    pull.load, pull.settle, pull.hold = load, SETTLE, HOLD
    pull.above, pull.band, pull.lift, pull.rise = _ABOVE, _BAND, _LIFT, _RISE
    for name, value in _BEGIN.items():
        setattr(pull, name, array(np.full(scenes, value)))
    pull.kept = array(np.zeros(scenes), wp.int32)
    return pull


def pull(run: TyingRun) -> None:
    """Where the knot is tied, both hands grasp where the rods' ends were put down, pull with the
    plan's load, and keep it up."""
    bench, knot = run.bench, run.knot
    tied = [scene for scene, result in enumerate(run.results) if result.is_tied]
    heights = [run.plans[one.rod][1].radius for one in knot.pull]
    starts = np.array([[*one.where, z] for one, z in zip(knot.pull, heights, strict=True)])
    approach(run, dict(enumerate(starts)))
    ways = np.array([[*one.direction, 0.0] for one in knot.pull])
    ways *= ([one.distance for one in knot.pull] / np.linalg.norm(ways, axis=1))[:, None]
    pair = TwoHands(starts, ways, 0.5 * run.hand_speed, run.upright, run.misses(), tuple(heights))
    for hand, (one, poses) in enumerate(zip(knot.pull, pair.poses(0), strict=True)):
        run.grasp(hand, one.rod, "pull", poses, tied)
        run.closed[tied, hand] = True
    held = bench.held.edge
    outcome = keep_up(
        bench,
        pair,
        knot.load,
        2.0 * CREEP * min(rod.radius for _, rod in knot.rods),
        **run.filming(),
    )
    run.note_slips("pull", held)
    run.note("tight", np.flatnonzero(np.isfinite(outcome.tight_at)), outcome.tight)
    for scene, result in enumerate(run.results):
        result.load = outcome.load[scene]
        result.strongest = float(outcome.strongest[scene])
        result.crept = float(outcome.crept[scene])
        result.held = bool(outcome.held[scene])
