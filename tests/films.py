"""Films of hands as plans command them, without any physics: what the arms must be able to do."""

from types import SimpleNamespace

import numpy as np

import wrod
from wrod.bench.applications_trials import cable_scene, knot_plan
from wrod.deployment.setup import prepare_deployment
from wrod.deployment.simulate import with_remainder_of
from wrod.knots.moves import hand_path, path_length
from wrod.patterns.curve import smoothstep
from wrod.planning.tail import tail

STEP = 0.4  # [s] between frames
UPRIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


class Film:
    """Frames as they are put together; a hand that is not at work is nowhere in particular."""

    def __init__(self):
        self.hands, self.closed = [], []

    def add(self, poses: dict[int, np.ndarray], count: int) -> None:
        for k in range(count):
            both = np.tile(np.eye(4), (2, 1, 1))
            for hand, mine in poses.items():
                both[hand] = mine[k]
            self.hands.append(both)
            self.closed.append([hand in poses for hand in range(2)])

    def rest(self, seconds: float) -> None:
        self.add({}, round(seconds / STEP))


def lay(film: Film, pattern, rod, speed: float):
    """Film a hand that lays a rod; returns the pattern with its remainder."""
    trajectory = wrod.plan(pattern, rod, "neural")
    pattern = with_remainder_of(pattern, trajectory)
    arc = np.linspace(0.0, rod.length, 100)
    schedule = prepare_deployment(
        pattern, rod, trajectory, arc, tail(pattern, rod, trajectory),
        hold=0.05, release=0.10, speed=speed,
    ).schedule  # fmt: skip
    poses = schedule.poses(np.arange(0.0, schedule.let_go_time, STEP))
    film.add({0: poses}, len(poses))
    film.rest(1.2)
    return pattern


def line(pattern, rod, count: int = 100) -> np.ndarray:
    """(count, 3) of a rod that lies as designed, straight on after its pattern."""
    s = np.linspace(0.0, rod.length, count) - pattern.remainder_length
    clipped = np.minimum(s, pattern.length)
    points, along, _ = pattern.sample(clipped)
    out = points + (s - clipped)[:, None] * along
    out[:, 2] = rod.radius
    return out


def lying(film: Film, rest: np.ndarray, start: int) -> np.ndarray:
    """Frames of a rod that lies, but for its end, which hangs from the hand that lays it."""
    frames = np.tile(rest, (len(film.hands), 1, 1))
    frames[:start] = np.nan
    for k in range(start, len(frames)):
        if not film.closed[k][0]:
            break
        pose = film.hands[k][0]
        frames[k, -2:] = pose[:3, 3] - [[0.005], [0.0]] * pose[:3, 0]
    return frames


def carry(path, speed: float) -> np.ndarray:
    """Upright poses along a way."""
    count = max(4, round(1.9 * path_length(path) / speed / STEP))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = UPRIGHT
    poses[:, :3, 3] = [path(smoothstep(u)) for u in np.linspace(0.0, 1.0, count)]
    return poses


def knot_film(case: str, steps: int | None = None) -> SimpleNamespace:
    """What `wrod.scene.tying.export_scene` takes, for a shipped knot or its last few steps."""
    plan, film = knot_plan(case), Film()
    patterns, starts = [], []
    for pattern, rod in plan.rods:
        starts.append(len(film.hands))
        patterns.append(lay(film, pattern, rod, 0.03))
    lines = [line(p, rod) for p, (_, rod) in zip(patterns, plan.rods, strict=True)]
    for step in plan.steps[-steps if steps else None :]:
        film.rest(1.2)
        poses = {}
        for move in step:
            radius = plan.rods[move.rod][1].radius
            place = (
                move.where
                or lines[move.rod][
                    np.searchsorted(np.linspace(0.0, plan.rods[move.rod][1].length, 100), move.at)
                ][:2]
            )
            last = np.array([*move.to, radius * move.lay_height])
            poses[move.hand] = carry(hand_path(np.array([*place, radius]), last, move.lift), 0.06)
        count = min(map(len, poses.values()))
        spread = {
            hand: p[np.linspace(0, len(p) - 1, count).astype(int)] for hand, p in poses.items()
        }
        film.add(spread, count)
        film.rest(0.8)
    film.rest(1.2)
    poses, count = {}, 15
    for hand, pull in enumerate(plan.pull):
        way = np.linspace(0.0, pull.distance, count)[:, None]
        poses[hand] = np.tile(np.eye(4), (count, 1, 1))
        poses[hand][:, :3, :3] = UPRIGHT
        direction = np.array(pull.direction) / np.linalg.norm(pull.direction)
        poses[hand][:, :2, 3] = pull.where + way * direction
        poses[hand][:, 2, 3] = plan.rods[pull.rod][1].radius
    film.add(poses, count)
    rods = [lying(film, rest, start) for rest, start in zip(lines, starts, strict=True)]
    return _given(film, rods, list(plan.rod_names), [r.radius for _, r in plan.rods], patterns)


def cable_film(case: str) -> SimpleNamespace:
    """The same for a cable, which one hand lays."""
    pattern, fixtures = cable_scene(case)
    rod, film = wrod.rod("cable"), Film()
    pattern = lay(film, pattern, rod, 0.02)
    given = _given(film, [lying(film, line(pattern, rod), 0)], ["cable"], [rod.radius], [pattern])
    given.hands, given.closed = given.hands[:, :1], given.closed[:, :1]
    given.fixtures = fixtures
    return given


def _given(film: Film, rods, names, radii, patterns) -> SimpleNamespace:
    hands = np.stack(film.hands)
    return SimpleNamespace(
        time=STEP * np.arange(len(hands)),
        rods=rods,
        names=names,
        radii=radii,
        patterns=patterns,
        hands=hands,
        closed=np.array(film.closed),
    )
