"""When the arm is where: a slow, jerk-limited run (Ruckig), slower where the path turns back."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from wrod.errors import RobotError
from wrod.robot.model import Robot

GRIP_SPEED = 0.02  # [m/s] quasi-static for rods that hang a metre: a swing takes over a second
_RAMP = 1.0  # [s] to reach the speed, roughly
_FINE = 2e-4  # [m] of travel at which local limits are read
_AROUND = (0.003, 0.006, 0.012, 0.024)  # [m] of travel over which a run slows down, tried in turn
_BELOW = 1.25  # how far below its limits a run is slowed, for what slowing down itself adds


@dataclass(frozen=True)
class Timing:
    """A run along the travel of a path, from rest to rest.

    Attributes:
        duration: [s].
        speed: greatest speed along the travel [m/s].
        load: (3,) largest joint velocity, acceleration and jerk over their limits; at most 1.
        steady_speed: that could be kept all along the travel [m/s].
    """

    duration: float
    speed: float
    load: tuple[float, float, float]
    steady_speed: float
    _profile: PPoly
    _course: "_Course"

    def travel(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Travel (K,) [m] and its rate (K,) [m/s] at times (K,) [s]; at rest after the end."""
        time = np.clip(time, 0.0, self.duration)
        at = self._profile(time)
        return self._course.travel(at), self._course.travel(at, 1) * self._profile(time, 1)

    def time_of(self, travel: np.ndarray) -> np.ndarray:
        """Times (K,) [s] at which the run passes the points `travel` (K,) [m]."""
        low = np.zeros(len(travel))
        high = np.full(len(travel), self.duration)
        for _ in range(50):
            middle = (low + high) / 2
            before = self.travel(middle)[0] < travel
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high


def schedule(robot: Robot, spline, length: float, grip_speed: float = GRIP_SPEED) -> Timing:
    """Run along a joint path within every joint's velocity, acceleration and jerk limits.

    The travel follows one Ruckig profile from rest to rest. Where a joint would pass a limit, the
    whole run is slowed by the factor that brings it back: stretching time by f divides
    velocities by f, accelerations by f^2 and jerks by f^3. A few millimetres, where the grip turns
    back, may ask for a tenth of the speed; then the run is slowed there alone, if that is shorter.

    Args:
        spline: joint positions (n,) [rad] over travel [m], a SciPy spline.
        length: of the travel [m].
        grip_speed: wanted along the travel [m/s].

    Raises:
        RobotError: the speed is not a positive number.
    """
    if not (np.isfinite(grip_speed) and grip_speed > 0):
        raise RobotError(f"grip speed is {grip_speed!r}; give a positive number of m/s")
    runs = [_run(robot, _Course(spline, length), grip_speed)]
    steady = runs[0].speed
    if steady < grip_speed / _BELOW:
        slow = _local_slowdown(robot, spline, length, grip_speed)
        runs += [_run(robot, _Course(spline, length, slow, h), grip_speed) for h in _AROUND]
    return replace(min(runs, key=lambda run: run.duration), steady_speed=steady)


class _Course:
    """Joint positions over a parameter [m] that runs ahead of the travel where that is slowed.

    Args:
        spline, length: joint positions over the travel [m].
        slow: (K,) by how much the travel is slowed at evenly spaced points; None: nowhere.
        around: how far before and after them it slows down [m].
    """

    def __init__(self, spline, length: float, slow: np.ndarray | None = None, around: float = 0.0):
        self.spline, self.length, self._travel = spline, length, None
        if slow is not None:
            step = length / (len(slow) - 1)
            width = 2 * max(1, round(around / step)) + 1
            # Even averages over what is at least as wide are never below what was asked for.
            smooth = maximum_filter1d(np.log(slow), 3 * width - 2, mode="nearest")
            for _ in range(3):
                smooth = uniform_filter1d(smooth, width, mode="nearest")
            rate = np.exp(smooth)
            ahead = np.concatenate([[0.0], np.cumsum(step * (rate[1:] + rate[:-1]) / 2)])
            self._travel = make_interp_spline(ahead, np.linspace(0.0, length, len(slow)), k=5)
            self.length = float(ahead[-1])

    def travel(self, at: np.ndarray, order: int = 0) -> np.ndarray:
        """(K,) of the parameter, or its derivative."""
        if self._travel is not None:
            return self._travel(at, order)
        return at if order == 0 else np.full(len(at), float(order == 1))

    def derivatives(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """First to third (K, n) of the joint positions by the parameter."""
        u, one, two, three = (self.travel(at, order) for order in range(4))
        first, second, third = (self.spline(u, order) for order in (1, 2, 3))
        one, two, three = (v[:, None] for v in (one, two, three))
        return (
            first * one,
            second * one**2 + first * two,
            third * one**3 + 3 * second * one * two + first * three,
        )


def _local_slowdown(robot: Robot, spline, length: float, speed: float) -> np.ndarray:
    """By how much a steady run has to be slower at evenly spaced points to keep every limit."""
    u = np.linspace(0.0, length, max(200, int(length / _FINE)))
    asked = [
        (np.abs(spline(u, order)) * speed**order / limit).max(1) ** (1 / order)
        for order, limit in enumerate((robot.velocity, robot.acceleration, robot.jerk), start=1)
    ]
    return np.maximum(_BELOW * np.max(asked, axis=0), 1.0)


def _run(robot: Robot, course: _Course, grip_speed: float) -> Timing:
    limits = np.array([grip_speed, grip_speed / _RAMP, 4 * grip_speed / _RAMP**2])
    profile = _profile(course.length, limits)
    factors = _slowdown(robot, course, profile, limits[2])
    while max(factors) > 1.0:
        # A little more than asked: the peaks are read at samples, which the new run shifts.
        slow = 1.001 * max(factors)
        limits = limits / np.array([slow, slow**2, slow**3])
        profile = _profile(course.length, limits)
        factors = _slowdown(robot, course, profile, limits[2])
    load = (float(factors[0]), float(factors[1] ** 2), float(factors[2] ** 3))
    speed = float(limits[0])
    return Timing(float(profile.x[-1]), speed, load, speed, profile, course)


def _profile(length: float, limits: np.ndarray) -> PPoly:
    """Travel [m] over time [s], from rest to rest: a cubic of each of Ruckig's phases."""
    import ruckig

    request = ruckig.InputParameter(1)
    request.current_position, request.target_position = [0.0], [float(length)]
    request.max_velocity, request.max_acceleration, request.max_jerk = ([v] for v in limits)
    profile = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(request, profile)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise RobotError(f"no run of {length:.3f} m along the path ({result})")
    ((phases,),) = profile.profiles
    lasts = np.array(phases.t) > 0.0
    terms = np.array([phases.j, phases.a[:-1], phases.v[:-1], phases.p[:-1]])[:, lasts]
    ends = np.cumsum(np.array(phases.t)[lasts])
    return PPoly(terms / np.array([[6.0], [2.0], [1.0], [1.0]]), np.concatenate([[0.0], ends]))


def _slowdown(
    robot: Robot, course: _Course, profile: PPoly, jerk: float
) -> tuple[float, float, float]:
    """Time stretch that each kind of limit asks for (1 where a joint is exactly at it).

    `jerk` bounds that of the profile everywhere, so the joints' jerk is bounded too.
    """
    duration = profile.x[-1]
    times = np.linspace(0.0, duration, max(2000, int(200 * duration)))
    u, du, ddu = (profile(times, order) for order in range(3))
    first, second, third = course.derivatives(u)
    velocity = np.abs(first * du[:, None])
    acceleration = np.abs(second * du[:, None] ** 2 + first * ddu[:, None])
    jolt = (
        np.abs(third * du[:, None] ** 3 + 3 * second * (du * ddu)[:, None]) + np.abs(first) * jerk
    )
    return (
        float((velocity / robot.velocity).max()),
        float((acceleration / robot.acceleration).max() ** 0.5),
        float((jolt / robot.jerk).max() ** (1 / 3)),
    )
