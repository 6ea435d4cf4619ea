"""Pick-and-place moves of a knot, and the ways of hands from place to place."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.files.schemas import Move
from wrod.knots.tying_run import TyingRun
from wrod.knots.workbench import Poses
from wrod.patterns.curve import arc_length, smoothstep

_REST = 0.6  # [s]
# Fastest over mean speed of the smooth way of a hand.
_PEAK = 1.9
_EMPTY_SPEED = 0.25  # of hands that carry nothing [m/s]


def make(run: TyingRun, moves: Sequence[Move], name: str) -> None:
    """Moves of one step, the hands at the same time."""
    bench = run.bench
    approach(run, {move.hand: run.planned(move) for move in moves})
    starts, ends = {}, {}
    for move in moves:
        at = run.planned(move)
        path = hand_path(at, np.array([*move.to, at[2] * move.lay_height]), move.lift)
        starts[move.hand], ends[move.hand] = at, (path, np.radians(move.turn), move)
    begin = bench.time
    lengths = [path_length(path) for path, _, _ in ends.values()]
    duration = _PEAK * max(lengths) / run.hand_speed

    def poses(t: float) -> list[Poses]:
        u = smoothstep((t - begin) / duration)
        out = []
        for hand in range(2):
            if hand not in ends:
                out.append(run.now[hand])
                continue
            path, turn, _ = ends[hand]
            out.append(run.hand_pose(hand, path(u), t, turn * u, starts[hand][2]))
        return out

    for move in moves:
        run.grasp(move.hand, move.rod, name, poses(begin)[move.hand])
        run.closed[:, move.hand] = True
    run.run(begin + duration + 0.2, poses, name)
    for move in moves:
        for scene in range(len(run.trials)):
            bench.held.open(scene, move.hand)
        run.closed[:, move.hand] = False
    run.run(bench.time + _REST, poses)
    run.now = poses(bench.time)
    run.grasps += len(moves)


def approach(run: TyingRun, places: dict[int, np.ndarray]) -> None:
    """Bring empty hands to where they grasp next, high above the table."""
    bench, begin = run.bench, run.bench.time
    paths = {
        h: (run.now[h], hand_path(run.now[h].position[0], at, 0.10)) for h, at in places.items()
    }
    duration = _PEAK * max(path_length(path) for _, path in paths.values()) / _EMPTY_SPEED

    def poses(t: float) -> list[Poses]:
        x = (t - begin) / duration
        out = list(run.now)
        for hand, (start, path) in paths.items():
            here = run.hand_pose(hand, path(smoothstep(x)), t, floor=places[hand][2])
            # Out of the pose in which the rod was laid into the upright one.
            turn = (here.rotation * start.rotation.inv()).as_rotvec()
            left = Rotation.from_rotvec((smoothstep(3.0 * x) - 1.0) * turn)
            out[hand] = Poses(here.position, left * here.rotation)
        return out

    run.run(begin + duration, poses)
    run.now = poses(bench.time)


def hand_path(first: np.ndarray, last: np.ndarray, lift: float) -> Callable[[float], np.ndarray]:
    """A way over everything between two places on the table: up, across, down, rounded.

    Args:
        first, last: (3,) places [m].
        lift: height above them [m].

    Returns:
        The place (3,) at u, 0 to 1.
    """

    def at(u: float) -> np.ndarray:
        across = smoothstep((u - 0.15) / 0.7)
        rise = min(smoothstep(u / 0.4), smoothstep((1.0 - u) / 0.4))
        return first + across * (last - first) + np.array([0.0, 0.0, lift * rise])

    return at


def path_length(path: Callable[[float], np.ndarray]) -> float:
    """Length of a way [m]."""
    return float(arc_length(np.array([path(u) for u in np.linspace(0.0, 1.0, 60)]))[-1])
