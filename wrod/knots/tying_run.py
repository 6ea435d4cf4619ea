"""The state of tying that laying, moves and pulling share, and what watches it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.deployment.grip_path import smooth_noise
from wrod.deployment.plan import plan
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import with_remainder_of
from wrod.files.schemas import Move
from wrod.knots.fingers import REACH, holding_force
from wrod.knots.plan import KnotPlan
from wrod.knots.topology import recognise_knot, recognise_pair
from wrod.knots.trials import Handling, TyingResult
from wrod.knots.workbench import TICK, Poses, Workbench
from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.friction import Friction

# A hand that reaches down: its x axis, the rod's tangent where it hangs from the hand, points up.
_UPRIGHT = Rotation.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


class TyingRun:
    """All trials of one call of `wrod.knots.tying.tie`, side by side."""

    def __init__(
        self, knot, trials, method, friction, rod_friction, speed, hand_speed, step, film, device
    ):  # fmt: skip
        self.knot, self.trials = knot, trials
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
                    * (1.0 + laying_of(trial, k).lgb_error),
                )
                for k, (_, rod, _) in enumerate(self.plans)
            ]
            for trial in trials
        ]
        self.results = [TyingResult(wanted=knot.knot) for _ in trials]
        self.arc: list[np.ndarray] = []
        self.bench: Workbench | None = None
        self.elapsed = 0.0
        self.begun = 0.0  # when the clock of `bench` was started
        # (scene, hand) whether a hand is at work, whatever it has found.
        self.closed = np.zeros((len(trials), 2), dtype=bool)
        self.upright = Rotation.from_quat(_repeat(_UPRIGHT.as_quat(), trials))
        self.home = [Poses(_repeat(place, trials), self.upright) for place in _home(knot)]
        self.now = list(self.home)
        self.grasps = 0
        self.film: list[tuple[float, list[np.ndarray], np.ndarray, np.ndarray]] = []
        rng = [np.random.default_rng([trial.seed, 11]) for trial in trials]
        # (scene, hand, tick, 3): a minute of shaking, over and over.
        self.shaking = np.stack(
            [
                [smooth_noise(g, 1500, trial.jitter, 1.5) for _ in range(2)]
                for g, trial in zip(rng, trials, strict=True)
            ]
        )

    def planned(self, move: Move) -> np.ndarray:
        """(3,) where the plan says that a grasped point lies."""
        pattern, rod, _ = self.plans[move.rod]
        if move.where is not None:
            return np.array([*move.where, rod.radius])
        s = move.at - pattern.remainder_length
        clipped = float(np.clip(s, -pattern.remainder_length, pattern.length))
        (point,), (along,), _ = pattern.sample(clipped)
        point = point + (s - clipped) * along
        return np.array([point[0], point[1], rod.radius])

    def hand_pose(
        self,
        hand: int,
        position: np.ndarray,
        t: float,
        yaw: np.ndarray | float = 0.0,
        floor: float = 0.0,
    ) -> Poses:
        """A hand's true pose at a time for a commanded one, (3,) or (scene, 3); at the height
        `floor` its fingertips touch the table."""
        count, tick = len(self.trials), self._tick(t)
        out = np.broadcast_to(position, (count, 3)) + self.shaking[:, hand, tick]
        out += [trial.offset[hand] for trial in self.trials]
        out[:, 2] = np.maximum(out[:, 2], floor)
        yaw = np.broadcast_to(yaw, (count,))
        return Poses(out, Rotation.from_euler("z", yaw[:, None]) * _UPRIGHT)

    def _tick(self, t: float) -> int:
        return round((self.elapsed + t) / TICK) % self.shaking.shape[2]

    def misses(self) -> np.ndarray:
        """(scene, hand, tick, 3) by how much hands are off their places from now on [m]."""
        offset = np.array([trial.offset for trial in self.trials])
        shaking = np.roll(self.shaking, -self._tick(self.bench.time), axis=2)
        return shaking + offset[:, :, None]

    def run(
        self, until: float, poses: Callable[[float], list[Poses]], name: str | None = None
    ) -> None:
        """Let time pass, the hands moving as `poses(time)` says; what slips out of them is noted
        under the name."""
        bench = self.bench
        held = bench.held.edge
        while bench.time < until - 1e-9:
            due = np.inf if self.film_interval is None else self._next_frame()
            bench.run(min(due, until), poses)
            if due < until + 1e-9:
                self.shoot(poses(bench.time))
        self.note_slips(name, held)

    def _next_frame(self) -> float:
        """When the next one is due, on the clock of `bench`: at a tick."""
        now, last = self.begun + self.bench.time, self.film[-1][0] if self.film else -np.inf
        ticks = (last + self.film_interval - 1e-9 - now) / TICK
        return self.bench.time + TICK * max(np.ceil(ticks), 1.0)

    def filming(self) -> dict:
        """What `wrod.knots.pull.keep_up` takes."""
        if self.film_interval is None:
            return {}
        ticks = max(int(np.ceil(self.film_interval / TICK - 1e-9)), 1)
        return {"film": self.shoot, "film_ticks": ticks}

    def shoot(self, poses: list[Poses]) -> None:
        """Add a frame to the film."""
        bench = self.bench
        hands = np.tile(np.eye(4), (len(self.trials), 2, 1, 1))
        for h, pose in enumerate(poses):
            hands[:, h, :3, 3] = pose.position
            hands[:, h, :3, :3] = pose.rotation.as_matrix()
        self.film.append((self.begun + bench.time, bench.positions(), hands, self.closed.copy()))

    def note_slips(self, name: str | None, held: np.ndarray) -> None:
        """Name what slipped out of hands that held these edges (scene, hand)."""
        for scene, _ in np.argwhere((held >= 0) & (self.bench.held.edge < 0)):
            self.results[scene].slipped.append(name)

    def grasp(
        self, hand: int, rod: int, name: str, poses: Poses, scenes: Iterable[int] | None = None
    ) -> None:
        """Close a hand, of some scenes, all by default, on what it finds, its fingertips a radius
        of the rod below it."""
        middle, _ = self.bench.held.edges()
        radius = self.knot.rods[rod][1].radius
        for scene in range(len(self.trials)) if scenes is None else scenes:
            trial, place = self.trials[scene], poses.position[scene]
            gap = np.linalg.norm(middle[scene] - place, axis=1)
            for s in self.bench.slices[:-1]:
                gap[s.stop - 1] = np.inf  # between two rods
            edge = int(np.argmin(gap))
            found = next(k for k, s in enumerate(self.bench.slices) if edge < s.stop)
            thick, height = self.true_rods[scene][found].radius, middle[scene, edge, 2]
            tip = place[2] - radius
            if gap[edge] > REACH or tip > height + thick:
                self.results[scene].missed.append(name)
                continue
            strength = np.inf
            if trial.pad_friction:
                pads = trial.pad_friction[(self.grasps + hand) % len(trial.pad_friction)]
                strength = float(holding_force(thick, height, tip, pads))
            self.bench.held.grasp(scene, hand, edge, poses, strength)

    def keep(
        self,
        stage: str,
        scenes: Iterable[int] | None = None,
        rods: Sequence[np.ndarray] | None = None,
    ) -> list[int]:
        """Keep the rods (scene, node, 3) of some scenes; by default as all of them lie."""
        rods = self.bench.positions() if rods is None else rods
        chosen = list(range(len(self.trials)) if scenes is None else scenes)
        for scene in chosen:
            self.results[scene].stages[stage] = [rod[scene] for rod in rods]
        return chosen

    def note(self, stage: str, *which) -> None:
        """Keep them, and recognise their knots."""
        for scene in self.keep(stage, *which):
            lines = self.results[scene].stages[stage]
            found = recognise_knot(lines[0]) if len(lines) == 1 else recognise_pair(*lines)
            setattr(self.results[scene], stage, found)

    def count_steps(self) -> None:
        for scene, result in enumerate(self.results):
            result.steps += int(self.bench.steps[scene])
            result.diverged |= bool(self.bench.diverged[scene])

    def finished(self) -> list[TyingResult]:
        self.count_steps()
        times = self.bench.dynamics.time.numpy()
        for scene, result in enumerate(self.results):
            result.duration = self.begun + float(times[scene])
            if not self.film:
                continue
            result.time = np.array([frame[0] for frame in self.film])
            for k, arc in enumerate(self.arc):
                frames = [
                    rods[k][scene] if k < len(rods) else np.full((len(arc), 3), np.nan)
                    for _, rods, _, _ in self.film
                ]
                result.frames.append(np.stack(frames))
            result.hands = np.stack([frame[2][scene] for frame in self.film])
            result.closed = np.stack([frame[3][scene] for frame in self.film])
        return self.results


def laying_of(trial: Handling, k: int) -> Disturbance:
    return trial.laying[k] if k < len(trial.laying) else Disturbance()


def _repeat(point, trials) -> np.ndarray:
    return np.tile(np.asarray(point, dtype=float), (len(trials), 1))


def _home(knot: KnotPlan) -> tuple[np.ndarray, np.ndarray]:
    """Where the hands wait: high over the table, to both sides of the patterns."""
    points = np.concatenate(
        [pattern.sample(np.linspace(0.0, pattern.length, 50))[0] for pattern, _ in knot.rods]
    )
    middle, half = (points.min(0) + points.max(0)) / 2, np.ptp(points, axis=0) / 2
    aside = np.array([0.0, half[1] + 0.1, 0.0])
    return middle - aside + [0.0, 0.0, 0.3], middle + aside + [0.0, 0.0, 0.3]
