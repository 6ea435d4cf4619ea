"""Laying a rod as a vectorised environment of Gymnasium: a policy corrects the grip of a plan.

Every environment is a rod of one batch on a table of its own friction, laid by a robot that stands
and shakes differently. A policy adds to the planned pose of the grip; no action at all is the plan
itself, so `plan="auto"` makes the optimal grasps the baseline (OPT) and `plan="intuitive"` the grip
straight above the contact (INT).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.deployment.assembly import assemble
from wrod.deployment.discretisation import USUAL
from wrod.deployment.grip_path import KEY_INTERVAL
from wrod.deployment.result import errors_along
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import prepare_trials, with_remainder_of
from wrod.deployment.trial import Trial
from wrod.errors import RodError, needed_extras
from wrod.patterns.curve import smoothstep
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.device import OnDevice, resolve_device
from wrod.rods.model import Rod
from wrod.rods.rotation import one_hemisphere
from wrod.solvers.friction import Friction

with needed_extras():
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv

_ROD_POINTS, _AHEAD = 24, 8  # points of the rod, and of the pattern ahead, that are observed
_LOOK = 0.1  # [m] of pattern ahead
_HOLD, _RELEASE, _SPEED = 0.05, 0.05, 0.02
_LOST = 10.0  # [cm] that a rod costs whose simulation ends early


@dataclass
class _Episode:
    """The rods of one episode, and the tables of their planned grips."""

    setups: list
    batch: Any
    dynamics: Any
    position: np.ndarray
    rotation: np.ndarray


class LayingVectorEnv(OnDevice, VectorEnv):
    """Rods that are laid along a pattern, all at once.

    An action is (6,) in -1 to 1: where the grip shall be at the end of the next interval beside
    the plan, `reach` [m] along x, y and z and `turn` [rad] about them being 1. An observation is
    (1 + 6 + 72 + 16,): share laid, offset of the grip as in actions, 24 points of the rod from its
    free end to the grip (x, y, z), and 8 points of the pattern over the next 10 cm (x, y), all in
    metres from where the plan lays the rod at that moment. The rewards of an episode sum to minus
    the mean error (Eq. metric) in centimetres. All environments end together, and begin anew with
    the step after.

    Args:
        num_envs: how many rods.
        pattern, rod: what is laid along what.
        plan: method of `wrod.plan`, or a `Trajectory` of the pattern and the rod.
        friction: range of the table's static friction, one value for each environment and episode.
        disturbed: whether robots shake and stand elsewhere, as in `wrod deploy --trials`.
        interval: between actions [s].
        reach, turn: [m], [rad] of an action of 1.
        device: Warp device. On a CPU no other thread may launch kernels of its own during the first
            `step` of an episode, which records them.
        step: of time, at most [s].

    Raises:
        RodError: Gymnasium is missing, or a number makes no sense.
    """

    @arguments.checked(
        RodError,
        num_envs=arguments.whole(1, 100_000),
        plan=arguments.either(
            arguments.text, arguments.like("a wrod.Trajectory", "arc_length", "rotation")
        ),
        friction=arguments.array((2,)),
        interval=arguments.number(2 * KEY_INTERVAL, 1e3),
        reach=arguments.number(0.0, 1.0),
        turn=arguments.number(0.0, np.pi),
        step=arguments.number(1e-5, 1.0),
    )
    def __init__(
        self,
        num_envs: int,
        pattern: Pattern,
        rod: Rod,
        plan: str | Trajectory = "auto",
        *,
        friction: tuple[float, float] = (0.2, 0.6),
        disturbed: bool = True,
        interval: float = 0.5,
        reach: float = 0.02,
        turn: float = 0.2,
        device: arguments.DeviceLike = "cpu",
        step: float = 0.01,
    ):
        low, high = friction
        if not 0 <= low <= high <= 100:
            raise RodError(f"friction is {low:g} to {high:g}; give a range from 0 to 100")
        self.num_envs, self.rod, self.step_size = num_envs, rod, step
        self.device = resolve_device(device)
        self.friction, self.disturbed, self.interval = (low, high), disturbed, interval
        self.scale = np.repeat([reach, turn], 3)
        if isinstance(plan, str):
            from wrod.deployment.plan import plan as plan_of

            plan = plan_of(pattern, rod, plan, device=self.device)
        self.trajectory = plan
        self.pattern = with_remainder_of(pattern, plan)
        self._tail = Tail.none(plan)
        size = 1 + 6 + 3 * _ROD_POINTS + 2 * _AHEAD
        box = gymnasium.spaces.Box
        self.single_observation_space = box(-np.inf, np.inf, (size,), np.float64)
        self.single_action_space = box(-1.0, 1.0, (6,), np.float64)
        batched = gymnasium.vector.utils.batch_space
        self.observation_space = batched(self.single_observation_space, num_envs)
        self.action_space = batched(self.single_action_space, num_envs)
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self.render_mode = None
        self._episode: _Episode | None = None
        self._over = False

    @arguments.checked(RodError, seed=arguments.whole())
    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin an episode; returns observations and {"friction": (num_envs,)}."""
        super().reset(seed=None if seed is None else int(seed), options=options)
        rng = self.np_random
        self.mu = rng.uniform(*self.friction, self.num_envs)
        seeds = rng.integers(0, 2**31, self.num_envs)
        trials = [
            Trial(
                self.pattern, self.rod, self.trajectory, Friction(float(mu), None, False),
                Disturbance.random(int(k)) if self.disturbed else Disturbance(), self._tail, None,
            )
            for mu, k in zip(self.mu, seeds, strict=True)
        ]  # fmt: skip
        setups = prepare_trials(trials, _HOLD, _RELEASE, _SPEED, USUAL)
        # Grips move by what is written into their arrays: rounds of one step serve all steps.
        batch, _, dynamics = assemble(trials, setups, device=self.device, keeps_recording=True)
        motion: Any = dynamics.motion
        self._episode = _Episode(
            setups, batch, dynamics, motion.position.numpy().copy(), motion.rotation.numpy().copy()
        )
        self.offset = np.zeros((self.num_envs, 6))
        self.time = 0.0
        self._over = False
        self._cost = np.zeros(self.num_envs)
        return self._observed(), {"friction": self.mu.copy()}

    def step(self, actions):
        """Advance all by one interval.

        Returns:
            Observations (num_envs, 95), rewards, terminations and truncations (num_envs,), and
            {"error_mean": (num_envs,)} [m] where an episode ends.
        """
        if self._episode is None:
            raise RodError("the environment has not begun; call reset first")
        none = np.zeros(self.num_envs, dtype=bool)
        if self._over:
            observed, info = self.reset()
            return observed, np.zeros(self.num_envs), none, none.copy(), info
        asked = arguments.floats(actions, "LayingVectorEnv.step: actions", RodError)
        if asked.shape != (self.num_envs, 6):
            raise RodError(f"actions have shape {asked.shape}; give ({self.num_envs}, 6)")
        if not np.isfinite(asked).all():
            raise RodError("actions hold a number that is not finite; give -1 to 1")
        wanted = np.clip(asked, -1.0, 1.0) * self.scale
        end = self._episode.setups[0].measure_time
        until = min(self.time + self.interval, end)
        self._move_grips(wanted, until)
        progress = self._episode.dynamics.advance(until, self.step_size)
        self.time, self.offset = until, wanted
        self._over = bool(until >= end - 1e-9 or progress.diverged.all())
        before, self._cost = self._cost, self._costs()
        rewards = before - self._cost
        lost = progress.diverged if self._over else none
        rewards = np.where(lost, rewards - _LOST, rewards)
        over = np.full(self.num_envs, self._over)
        info = {"error_mean": self._cost / 100.0} if self._over else {}
        return self._observed(), rewards, over, none, info

    def close_extras(self, **kwargs) -> None:
        """Let go of the rods."""
        self._episode = None

    def _move_grips(self, wanted: np.ndarray, until: float) -> None:
        """Turn the offset of the grip smoothly into another until a time, and keep it after."""
        episode = self._episode
        t = KEY_INTERVAL * np.arange(episode.position.shape[1])
        share = smoothstep((t - self.time) / (until - self.time))[None, :, None]
        offset = self.offset[:, None] + share * (wanted - self.offset)[:, None]
        motion = episode.dynamics.motion
        motion.position.assign(episode.position + offset[..., :3])
        turns = Rotation.from_rotvec(offset[..., 3:].reshape(-1, 3))
        turned = (turns * Rotation.from_quat(episode.rotation.reshape(-1, 4))).as_quat()
        turned = turned.reshape(episode.rotation.shape)
        motion.rotation.assign(np.stack([one_hemisphere(table) for table in turned]))

    def _laid(self, k: int) -> float:
        """Length that the plan has laid by now [m], a remainder included."""
        covered = self._episode.setups[k].covered
        return float(covered[min(round(self.time / KEY_INTERVAL), len(covered) - 1)])

    def _costs(self) -> np.ndarray:
        """(num_envs,) sum of errors at the metric's points that are laid, over all points [cm]."""
        episode = self._episode
        nodes = episode.batch.positions()[:, :-1]
        out = np.empty(self.num_envs)
        last = self.time >= episode.setups[0].measure_time - 1e-9
        for k, setup in enumerate(episode.setups):
            s, error = errors_along(self.pattern, setup.arc_length, nodes[k])
            there = s + self.pattern.remainder_length <= self._laid(k)
            out[k] = 100.0 * np.where(there | last, error, 0.0).mean()
        return out

    def _observed(self) -> np.ndarray:
        episode = self._episode
        nodes = episode.batch.positions()[:, :-1]
        rows = []
        for k, setup in enumerate(episode.setups):
            laid = self._laid(k)
            s = laid - self.pattern.remainder_length
            ahead = np.clip(
                s + np.linspace(0.0, _LOOK, _AHEAD),
                -self.pattern.remainder_length, self.pattern.length,
            )  # fmt: skip
            target = self.pattern.sample(ahead)[0]
            at = np.linspace(0.0, setup.arc_length[-1], _ROD_POINTS)
            rod = np.column_stack([np.interp(at, setup.arc_length, c) for c in nodes[k].T])
            share = laid / float(self.trajectory.arc_length[-1])
            seen = (rod - target[0]).ravel(), (target - target[0])[:, :2].ravel()
            rows.append(np.concatenate([[share], self.offset[k] / self.scale, *seen]))
        return np.stack(rows)
