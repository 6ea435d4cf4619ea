"""The grip's motion in time: from a trajectory over the laid length to poses over seconds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, RotationSpline

from wrod import arguments
from wrod.errors import DataError
from wrod.kernels.stepping import grip as kernels
from wrod.planning.trajectory import Trajectory
from wrod.rods.batch import RodBatch
from wrod.rods.state import RodState

# Spacing of the keys between which the grip moves smoothly [s].
KEY_INTERVAL = 0.02
# The grip's pace is looked at every millimetre, and changes over a centimetre of laid rod [m].
_PACE_SPACING, _PACE_WIDTH = 0.001, 0.01
# Paces that a deployment takes [m/s].
PACES = arguments.number(1e-5, 100.0)


class GripPath:
    """Grip pose over the laid length (numbers that never decrease).

    Args:
        laid: (T,) laid length [m].
        position: (T, 3) grip position [m].
        rotation: (T, 3, 3) grip frame.
    """

    def __init__(self, laid: np.ndarray, position: np.ndarray, rotation: np.ndarray):
        self._position = CubicSpline(laid, position)
        self._rotation = RotationSpline(laid, Rotation.from_matrix(rotation))
        self.first, self.last = float(laid[0]), float(laid[-1])

    def timed(self, speed: float) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
        """Time law along the path: its duration [s], and the laid length [m] at t (n,).

        The contact moves at `speed` [m/s], and slower where the grip would have to move faster
        than on a straight line, where it goes down as fast as forward.
        """
        # Points do not depend on the path's end: what is gone by then takes the time that it took.
        cell = min(_PACE_SPACING, (self.last - self.first) / 8)
        count = int(np.ceil((self.last - self.first) / cell - 1e-6))
        laid = np.append(self.first + cell * np.arange(count), self.last)
        pace = np.linalg.norm(self._position(laid, 1), axis=1) / np.sqrt(2.0)
        pace = gaussian_filter1d(np.maximum(pace, 1.0), _PACE_WIDTH / _PACE_SPACING)
        way = cumulative_trapezoid(pace, laid, initial=0.0)
        duration, covered = travel(float(way[-1]), speed)
        laid_at = PchipInterpolator(way, laid)
        return duration, lambda t: laid_at(np.clip(covered(t), 0.0, way[-1]))

    def __call__(self, laid: np.ndarray) -> tuple[np.ndarray, Rotation]:
        laid = np.clip(laid, self.first, self.last)
        return self._position(laid), self._rotation(laid)


@arguments.checked(
    DataError,
    trajectory=arguments.like("a wrod.Trajectory", "arc_length", "position", "rotation"),
    speed=arguments.optional(PACES),
)
def pose_times(trajectory: Trajectory, speed: float | None = None) -> np.ndarray:
    """When the grip is to be at each pose of a trajectory, for a robot or another simulator.

    Played at a constant pace of the contact instead, a grip goes several times as fast at bends,
    and its inertia drags the rod off them.

    Args:
        trajectory: of a plan.
        speed: of the contact where the grip has not far to go [m/s], as
            `wrod.simulate_deployment` takes it; by default the pace that the plan was corrected
            for, 0.02 where it was for none.

    Returns:
        (T,) times [s] from 0 on, from rest to rest. The contact is slower where the grip goes over
        1.4 times as far, smoothly over 1 cm.

    Raises:
        DataError: an argument is no trajectory, or no pace; the trajectory has two poses for one
            laid length, or fewer than two.
    """
    if len(trajectory) < 2 or not np.all(np.diff(trajectory.arc_length) > 0.0):
        raise DataError("pose_times: a pose of the trajectory lays no more than the one before")
    laid = trajectory.arc_length
    path = GripPath(laid, trajectory.position, trajectory.rotation)
    pace = (trajectory.optimised or {}).get("pace", 0.02) if speed is None else speed
    if said := arguments.wrong(PACES, pace):
        raise DataError(f"pose_times: metadata: optimised: pace {said}")
    duration, laid_at = path.timed(pace)
    t = np.linspace(0.0, duration, max(4000, 40 * len(laid)))
    times = np.interp(laid, laid_at(t), t)
    times[0], times[-1] = 0.0, duration
    return times


def travel(distance: float, speed: float) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
    """Smooth time law over `distance`: its duration [s], and the distance covered at t (n,).

    Speed rises and falls over 0.4 s each with the quintic smoothstep.
    """
    ease = 0.4
    if distance <= 0.0:
        return 0.0, lambda t: np.zeros_like(t)
    if distance < speed * ease:
        speed = distance / ease
    duration = distance / speed + ease

    def ramp(x):  # integral of the smoothstep from 0 to x, in 0...1
        x = np.clip(x, 0.0, 1.0)
        return x**6 - 3.0 * x**5 + 2.5 * x**4

    def covered(t):
        t = np.clip(t, 0.0, duration)
        rising = ease * ramp(t / ease) + np.maximum(t - ease, 0.0)
        falling = np.maximum(t - (duration - ease), 0.0)
        # What full speed would have covered since braking began, less what was covered.
        lost = falling - ease * (0.5 - ramp(1.0 - falling / ease))
        return speed * (rising - np.where(falling > 0.0, lost, 0.0))

    return duration, covered


def smooth_noise(rng: np.random.Generator, count: int, size: float, width: float) -> np.ndarray:
    """(count, 3) noise of standard deviation `size`, smooth over `width` samples."""
    reach = int(np.ceil(4 * width))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= np.linalg.norm(kernel)
    white = rng.standard_normal((3, count + 2 * reach))
    return size * np.stack([np.convolve(w, kernel, mode="valid") for w in white], axis=1)


@dataclass(frozen=True)
class GripSchedule:
    """One rod's grip over time, sampled every `KEY_INTERVAL` seconds.

    Attributes:
        position: (key, 3) [m].
        rotation: (key, 4) quaternions xyzw, neighbours in one hemisphere.
        held_nodes: how many first nodes stand still until `release_time` [s].
        let_go_time: when the grip opens [s].
    """

    position: np.ndarray
    rotation: np.ndarray
    held_nodes: int
    release_time: float
    let_go_time: float

    def poses(self, time: np.ndarray) -> np.ndarray:
        """(n, 4, 4) poses at times (n,) [s], at rest after the last key [m]."""
        keys = np.minimum(np.rint(time / KEY_INTERVAL).astype(int), len(self.position) - 1)
        out = np.tile(np.eye(4), (len(keys), 1, 1))
        out[:, :3, 3] = self.position[keys]
        out[:, :3, :3] = Rotation.from_quat(self.rotation[keys]).as_matrix()
        return out


class GripMotion:
    """Carries the ends of a batch's rods by ghost edges beyond them (a
    `wrod.solvers.steps.Motion`).

    Args:
        batch: the rods.
        schedules: one for each.
        angle: for each rod, from the grip's y axis to the rod's first director in the batch [rad].
    """

    def __init__(self, batch: RodBatch, schedules: list[GripSchedule], angle=None):
        self.batch, device = batch, batch.device
        keys = max(len(s.position) for s in schedules)

        def padded(name):
            tables = [getattr(s, name) for s in schedules]
            out = np.empty((len(tables), keys, tables[0].shape[1]))
            for row, table in zip(out, tables, strict=True):
                row[: len(table)], row[len(table) :] = table, table[-1]
            return out

        def floats(name):
            values = [getattr(s, name) for s in schedules]
            return wp.array(values, dtype=wp.float64, device=device)

        self.position = wp.array(padded("position"), dtype=wp.vec3d, device=device)
        rotation = padded("rotation")
        if np.any(angle):
            turns = Rotation.from_euler("x", np.repeat(angle, keys)[:, None])
            whole = (Rotation.from_quat(rotation.reshape(-1, 4)) * turns).as_quat(canonical=False)
            rotation = whole.reshape(rotation.shape)
        self.rotation = wp.array(rotation, dtype=wp.quatd, device=device)
        held = [s.held_nodes for s in schedules]
        self.held_nodes = wp.array(held, dtype=wp.int32, device=device)
        self.release_time, self.let_go_time = floats("release_time"), floats("let_go_time")

    def prescribe(self, running: wp.array, time: wp.array, step: wp.array, start: RodState):
        batch = self.batch
        batch.launch(
            kernels.prescribe,
            batch.rod_count,
            [wp.float64(KEY_INTERVAL), self.position, self.rotation, batch.rest_length]
            + [self.held_nodes, self.release_time, self.let_go_time, running, time, step]
            + [start.dof, start.tangent, start.director],
            [batch.free, batch.state.dof],
        )
