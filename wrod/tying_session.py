"""The course of tying: lay the rods, make the moves, pull, and watch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from wrod.deployment import with_remainder_of
from wrod.deployment_setup import Disturbance, disturb, prepare_deployment, tail
from wrod.grip import KEY_INTERVAL, smooth_noise
from wrod.hand_paths import hand_path, path_length, smooth
from wrod.knot_plan import KnotPlan, Move
from wrod.material import RodMaterial
from wrod.patterns import Pattern
from wrod.planner import plan
from wrod.substrate import Friction
from wrod.topology import recognise_knot, recognise_pair
from wrod.trajectory import Trajectory
from wrod.tying import Handling, TyingResult
from wrod.workbench import TICK, Poses, Workbench

# Length of the edges over the rod's radius: rods in contact want edges no longer than thick.
_EDGE = 2.0
# A hand finds a rod whose centreline is this near [m].
_FINGERS = 0.012
_AWAY = np.array([0.0, 2.0, 0.0])  # [m]
# First stretch of a rod, which ends before the first crossing, and what is laid when it is let go
# [m].
_HOLD, _RELEASE = 0.05, 0.10
_SETTLE, _REST = 0.4, 0.6
# Fastest over mean speed of the smooth way of a hand.
_PEAK = 1.9
# A hand that reaches down: its x axis, the rod's tangent where it hangs from the hand, points up.
_UPRIGHT = Rotation.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
_EMPTY_SPEED = 0.25  # of hands that carry nothing [m/s]


class Session:
    """One call of `wrod.tying.tie`."""

    def __init__(
        self, knot, trials, method, friction, rod_friction, speed, hand_speed, step, film, device,
        progress,
    ):  # fmt: skip
        self.knot, self.trials, self.progress = knot, trials, progress
        self.friction = (Friction(friction), Friction(rod_friction))
        self.speed, self.hand_speed, self.step = speed, hand_speed, step
        self.film_interval, self.device = film, device
        self.plans: list[tuple[Pattern, RodMaterial, Trajectory]] = []
        for pattern, rod in knot.rods:
            trajectory = plan(pattern, rod, method)
            self.plans.append((with_remainder_of(pattern, trajectory), rod, trajectory))
        self.true_rods = [
            [
                replace(
                    rod,
                    gravito_bending_length=rod.gravito_bending_length
                    * (1.0 + _laying(trial, k).lgb_error),
                )
                for k, (_, rod, _) in enumerate(self.plans)
            ]
            for trial in trials
        ]
        self.results = [TyingResult(wanted=knot.knot) for _ in trials]
        self.arc: list[np.ndarray] = []
        self.bench: Workbench | None = None
        self.elapsed = 0.0
        self.home = [Poses(_repeat(place, trials), _upright(trials)) for place in _home(knot)]
        self.now = list(self.home)
        self.grasps = 0
        self.film: list[tuple[float, list[np.ndarray], np.ndarray]] = []
        rng = [np.random.default_rng([trial.seed, 11]) for trial in trials]
        # (scene, hand, tick, 3): a minute of shaking, over and over.
        self.shaking = np.stack(
            [
                [smooth_noise(g, 1500, trial.jitter, 1.5) for _ in range(2)]
                for g, trial in zip(rng, trials, strict=True)
            ]
        )

    def run(self) -> list[TyingResult]:
        for k in range(len(self.plans)):
            self.progress(f"lay rod {k + 1}")
            self._lay(k)
        self._note("laid")
        self.bench.handle_roughly()
        for number, step in enumerate(self.knot.steps):
            self.progress(f"move {number + 1}")
            self._make(step, f"move {number + 1}")
        self._note("tied")
        if self.knot.pull:
            self.progress("pull")
            self._pull()
            self._note("pulled")
        return self._finished()

    # Laying

    def _lay(self, k: int) -> None:
        """Put the scene's rods on a new table, the next one hanging from the first hand."""
        pattern, rod, trajectory = self.plans[k]
        edges = int(np.ceil(rod.length / (_EDGE * rod.radius)))
        arc = np.linspace(0.0, rod.length, edges + 1)
        rest = tail(pattern, rod, trajectory)
        undisturbed = prepare_deployment(
            pattern, rod, trajectory, arc, rest, hold=_HOLD, release=_RELEASE, speed=self.speed
        )
        setups = [disturb(undisturbed, _laying(trial, k)) for trial in self.trials]
        position = np.stack([setup.position for setup in setups])
        director = np.stack([setup.director for setup in setups])
        director = np.stack([_carried(p, d) for p, d in zip(position, director, strict=True)])
        if self.bench is not None:
            before = self.bench.batch
            lying = before.positions()
            for scene, result in enumerate(self.results):
                if self._blocked(lying[scene], position[scene], k):
                    result.missed.append(f"no room for rod {k + 1}")
                    result.blocked = True
                    lying[scene] += _AWAY  # so that the other scenes may go on beside this one
            position = np.concatenate([lying, position], axis=1)
            link = position[:, before.node_count] - position[:, before.node_count - 1]
            across = np.cross(link, [0.31, 0.59, 0.74])[:, None]
            director = np.concatenate(
                [before.material_directors()[:, :, 0], across, director], axis=1
            )
            self._count_steps()
        self.arc.append(arc)
        self.bench = bench = Workbench(
            [scene[: k + 1] for scene in self.true_rods],
            self.arc,
            position,
            director,
            self.friction,
            step=self.step,
            device=self.device,
        )
        schedule = [setup.schedule for setup in setups]
        last = bench.batch.node_count - 2
        keys = max(len(s.position) for s in schedule)
        table = np.stack([_padded(s.position, keys) for s in schedule])
        turns = np.stack([_padded(s.rotation, keys) for s in schedule])

        def follow(t: float) -> list[Poses]:
            key = min(round(t / KEY_INTERVAL), keys - 1)
            return [Poses(table[:, key], Rotation.from_quat(turns[:, key])), self.home[1]]

        nodes = bench.slices[-1]
        bench.held.hold_still(slice(nodes.start, nodes.start + schedule[0].held_nodes))
        start = follow(0.0)
        for scene in range(len(self.trials)):
            bench.held.grasp(scene, 0, last, start[0])
        bench.run(min(s.release_time for s in schedule), follow, self._shoot(follow))
        bench.held.hold_still(None)
        bench.run(min(s.let_go_time for s in schedule), follow, self._shoot(follow))
        for scene in range(len(self.trials)):
            bench.held.open(scene, 0)
        bench.run(bench.time + 1.0, follow, self._shoot(follow))
        self.elapsed += bench.time
        self.now = follow(bench.time)
        for scene, result in enumerate(self.results):
            laid = bench.positions()[-1][scene]
            target = pattern.sample(
                np.clip(arc - pattern.remainder_length, -pattern.remainder_length, pattern.length)
            )[0]
            on = arc <= pattern.length + pattern.remainder_length
            gap = np.linalg.norm((laid - target)[on, :2], axis=1)
            result.error.append(float(gap.mean()))

    def _blocked(self, lying: np.ndarray, start: np.ndarray, k: int) -> bool:
        """Whether a rod would begin inside those that lie on the table."""
        fine = [_refined(lying[rod]) for rod in self.bench.slices]
        radii = [rod.radius for _, rod, _ in self.plans]
        return any(
            cKDTree(rod).query(_refined(start))[0].min() < 0.9 * (radius + radii[k])
            for rod, radius in zip(fine, radii[:k], strict=True)
        )

    # Moves

    def _planned(self, move: Move) -> np.ndarray:
        """(3,) where the plan says that a grasped point lies."""
        pattern, rod, _ = self.plans[move.rod]
        if move.where is not None:
            return np.array([*move.where, rod.radius])
        s = move.at - pattern.remainder_length
        clipped = float(np.clip(s, -pattern.remainder_length, pattern.length))
        (point,), (along,), _ = pattern.sample(clipped)
        point = point + (s - clipped) * along
        return np.array([point[0], point[1], rod.radius])

    def _hand(self, hand: int, position: np.ndarray, yaw: np.ndarray | float) -> Poses:
        """A hand's true pose for a commanded one, (3,) or (scene, 3)."""
        count = len(self.trials)
        tick = round((self.elapsed + self.bench.time) / TICK) % self.shaking.shape[2]
        out = np.broadcast_to(position, (count, 3)) + self.shaking[:, hand, tick]
        out[:, :2] += [trial.offset[hand] for trial in self.trials]
        yaw = np.broadcast_to(yaw, (count,))
        return Poses(out, Rotation.from_euler("z", yaw[:, None]) * _UPRIGHT)

    def _grasp(self, hand: int, move: Move, name: str, poses: Poses) -> None:
        """Close a hand on what it finds."""
        middle, _ = self.bench.held.edges()
        for scene in range(len(self.trials)):
            gap = np.linalg.norm(middle[scene] - poses.position[scene], axis=1)
            for s in self.bench.slices[:-1]:
                gap[s.stop - 1] = np.inf  # between two rods
            edge = int(np.argmin(gap))
            if gap[edge] > _FINGERS:
                self.results[scene].missed.append(name)
            else:
                self.bench.held.grasp(scene, hand, edge, poses)

    def _make(self, moves: list[Move], name: str) -> None:
        """Moves of one step, the hands at the same time."""
        bench = self.bench
        self._approach({move.hand: self._planned(move) for move in moves})
        starts, ends = {}, {}
        for move in moves:
            at = self._planned(move)
            path = hand_path(at, np.array([*move.to, at[2] * move.lay_height]), move.lift)
            starts[move.hand], ends[move.hand] = at, (path, np.radians(move.turn), move)
        begin = bench.time
        lengths = [path_length(path) for path, _, _ in ends.values()]
        duration = _PEAK * max(lengths) / self.hand_speed

        def poses(t: float) -> list[Poses]:
            u = smooth((t - begin) / duration)
            out = []
            for hand in range(2):
                if hand not in ends:
                    out.append(self.now[hand])
                    continue
                path, turn, _ = ends[hand]
                out.append(self._hand(hand, path(u), turn * u))
            return out

        for hand, move in ((m.hand, m) for m in moves):
            self._grasp(hand, move, name, poses(begin)[hand])
        after = self._shoot(poses, name)
        bench.run(begin + duration, poses, after)
        bench.run(bench.time + 0.2, poses, after)
        for move in moves:
            for scene in range(len(self.trials)):
                bench.held.open(scene, move.hand)
        bench.run(bench.time + _REST, poses, self._shoot(poses))
        self.now = poses(bench.time)
        self.grasps += len(moves)

    def _approach(self, places: dict[int, np.ndarray]) -> None:
        """Bring empty hands to where they grasp next, high above the table."""
        bench, begin = self.bench, self.bench.time
        paths = {
            h: (self.now[h], hand_path(self.now[h].position[0], at, 0.10))
            for h, at in places.items()
        }
        duration = _PEAK * max(path_length(path) for _, path in paths.values()) / _EMPTY_SPEED

        def poses(t: float) -> list[Poses]:
            x = (t - begin) / duration
            out = list(self.now)
            for hand, (start, path) in paths.items():
                here = self._hand(hand, path(smooth(x)), 0.0)
                # Out of the pose in which the rod was laid into the upright one.
                turn = (here.rotation * start.rotation.inv()).as_rotvec()
                left = Rotation.from_rotvec((smooth(3.0 * x) - 1.0) * turn)
                out[hand] = Poses(here.position, left * here.rotation)
            return out

        bench.run(begin + duration, poses, self._shoot(poses))
        self.now = poses(bench.time)

    def _pull(self) -> None:
        """Both hands grasp where the rods' ends are put down, and pull until the load is there."""
        bench, knot = self.bench, self.knot
        heights = [self.plans[pull.rod][1].radius for pull in knot.pull]
        self._approach({h: np.array([*pull.where, heights[h]]) for h, pull in enumerate(knot.pull)})
        begin = since = bench.time
        way = np.zeros((len(self.trials), 2))
        going = np.ones(len(self.trials), dtype=bool)
        starts = [np.array([*pull.where, 0.0]) for pull in knot.pull]
        for pull, start in zip(knot.pull, starts, strict=True):
            start[2] = self.plans[pull.rod][1].radius
        directions = [np.array([*pull.direction, 0.0]) for pull in knot.pull]
        directions = [d / np.linalg.norm(d) for d in directions]

        far = np.array([pull.distance for pull in knot.pull])
        speed = 0.5 * self.hand_speed * far / far.max()

        def at(t: float) -> np.ndarray:
            return way + going[:, None] * speed * (t - since)

        def poses(t: float) -> list[Poses]:
            here = at(t)
            return [
                self._hand(h, starts[h] + here[:, h, None] * directions[h], 0.0) for h in range(2)
            ]

        for hand, pull in enumerate(knot.pull):
            self._grasp(hand, pull, "pull", poses(begin)[hand])
        load = np.zeros((len(self.trials), 2))

        def after() -> None:
            nonlocal load, way, since
            load = bench.load()
            way, since = at(bench.time), bench.time
            going[(load.min(axis=1) >= knot.load) | (way[:, 0] >= far[0])] = False
            watch()

        watch = self._shoot(poses, "pull")
        longest = max(pull.distance for pull in knot.pull) / (0.5 * self.hand_speed)
        while bench.time < begin + longest and going.any():
            bench.run(bench.time + 0.4, poses, after)
        bench.run(bench.time + _SETTLE, poses, watch)
        load = bench.load()
        for result, pull in zip(self.results, load, strict=True):
            result.load = pull
        self.now = poses(bench.time)

    # Watching

    def _shoot(self, poses: Callable[[float], list[Poses]], name: str | None = None):
        """What happens after every tick: film, and rods slip out of overloaded hands."""

        def after() -> None:
            bench = self.bench
            if name is not None:
                self._slip(name)
            if self.film_interval is None:
                return
            now = self.elapsed + bench.time
            if self.film and now < self.film[-1][0] + self.film_interval - 1e-9:
                return
            hands = np.tile(np.eye(4), (len(self.trials), 2, 1, 1))
            for h, pose in enumerate(poses(bench.time)):
                hands[:, h, :3, 3] = pose.position
                hands[:, h, :3, :3] = pose.rotation.as_matrix()
            self.film.append((now, bench.positions(), hands))

        return after

    def _slip(self, name: str) -> None:
        load = self.bench.load()
        for scene, trial in enumerate(self.trials):
            for hand in range(2):
                if self.bench.held.edge[scene, hand] < 0 or not trial.strength:
                    continue
                strength = trial.strength[(self.grasps + hand) % len(trial.strength)]
                if load[scene, hand] > strength:
                    self.bench.held.open(scene, hand)
                    self.results[scene].slipped.append(name)

    def _note(self, stage: str) -> None:
        rods = self.bench.positions()
        for scene, result in enumerate(self.results):
            lines = [rod[scene] for rod in rods]
            result.stages[stage] = lines
            found = recognise_knot(lines[0]) if len(lines) == 1 else recognise_pair(*lines)
            setattr(result, stage, found)

    def _count_steps(self) -> None:
        for scene, result in enumerate(self.results):
            result.steps += int(self.bench.steps[scene])
            result.diverged |= bool(self.bench.diverged[scene])

    def _finished(self) -> list[TyingResult]:
        self._count_steps()
        for scene, result in enumerate(self.results):
            result.duration = self.elapsed + self.bench.time
            if not self.film:
                continue
            result.time = np.array([time for time, _, _ in self.film])
            for k, arc in enumerate(self.arc):
                frames = [
                    rods[k][scene] if k < len(rods) else np.full((len(arc), 3), np.nan)
                    for _, rods, _ in self.film
                ]
                result.frames.append(np.stack(frames))
            result.hands = np.stack([hands[scene] for _, _, hands in self.film])
        return self.results


def _laying(trial: Handling, k: int) -> Disturbance:
    return trial.laying[k] if k < len(trial.laying) else Disturbance()


def _carried(position: np.ndarray, director: np.ndarray) -> np.ndarray:
    """(node - 1, 3) the first edge's director carried along the rod without twist."""
    edges = np.diff(position, axis=0)
    tangents = edges / np.linalg.norm(edges, axis=1)[:, None]
    out = [director - (director @ tangents[0]) * tangents[0]]
    for before, after in pairwise(tangents):
        d, axis = out[-1], np.cross(before, after)
        out.append(
            (before @ after) * d + np.cross(axis, d) + axis * (axis @ d) / (1 + before @ after)
        )
    return np.array(out) / np.linalg.norm(out, axis=1)[:, None]


def _refined(line: np.ndarray) -> np.ndarray:
    """(4 n - 3, 3) points along a polyline (n, 3)."""
    at = np.arange(0, len(line) - 0.75, 0.25)
    return np.column_stack([np.interp(at, np.arange(len(line)), c) for c in line.T])


def _padded(values: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([values, np.repeat(values[-1:], count - len(values), axis=0)])


def _repeat(point, trials) -> np.ndarray:
    return np.tile(np.asarray(point, dtype=float), (len(trials), 1))


def _upright(trials) -> Rotation:
    return Rotation.from_quat(_repeat(_UPRIGHT.as_quat(), trials))


def _home(knot: KnotPlan) -> tuple[np.ndarray, np.ndarray]:
    """Where the hands wait: high over the table, to both sides of the patterns."""
    points = np.concatenate(
        [pattern.sample(np.linspace(0.0, pattern.length, 50))[0] for pattern, _ in knot.rods]
    )
    middle, half = (points.min(0) + points.max(0)) / 2, np.ptp(points, axis=0) / 2
    aside = np.array([0.0, half[1] + 0.1, 0.0])
    return middle - aside + [0.0, 0.0, 0.3], middle + aside + [0.0, 0.0, 0.3]
