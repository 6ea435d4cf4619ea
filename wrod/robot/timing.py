"""When the arm is where: a slow, jerk-limited run along a joint path (Ruckig)."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly

from wrod.errors import RobotError
from wrod.robot.model import Robot

GRIP_SPEED = 0.02  # [m/s] quasi-static for rods that hang a metre: a swing takes over a second
_RAMP = 1.0  # [s] to reach the speed, roughly


@dataclass(frozen=True)
class Timing:
    """A run along the travel of a path, from rest to rest.

    Attributes:
        duration: [s].
        speed: greatest speed along the travel [m/s].
        load: (3,) largest joint velocity, acceleration and jerk over their limits; at most 1.
    """

    duration: float
    speed: float
    load: tuple[float, float, float]
    _profile: PPoly

    def travel(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Travel (K,) [m] and its rate (K,) [m/s] at times (K,) [s]; at rest after the end."""
        time = np.clip(time, 0.0, self.duration)
        return self._profile(time), self._profile(time, 1)

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
    velocities by f, accelerations by f^2 and jerks by f^3.

    Args:
        spline: joint positions (n,) [rad] over travel [m], a SciPy spline.
        length: of the travel [m].
        grip_speed: wanted along the travel [m/s].

    Raises:
        RobotError: the speed is not a positive number.
    """
    if not (np.isfinite(grip_speed) and grip_speed > 0):
        raise RobotError(f"grip speed is {grip_speed!r}; give a positive number of m/s")
    limits = np.array([grip_speed, grip_speed / _RAMP, 4 * grip_speed / _RAMP**2])
    profile = _profile(length, limits)
    factors = _slowdown(robot, spline, profile, limits[2])
    while max(factors) > 1.0:
        # A little more than asked: the peaks are read at samples, which the new run shifts.
        slow = 1.001 * max(factors)
        limits = limits / np.array([slow, slow**2, slow**3])
        profile = _profile(length, limits)
        factors = _slowdown(robot, spline, profile, limits[2])
    load = (float(factors[0]), float(factors[1] ** 2), float(factors[2] ** 3))
    return Timing(float(profile.x[-1]), float(limits[0]), load, profile)


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


def _slowdown(robot: Robot, spline, profile: PPoly, jerk: float) -> tuple[float, float, float]:
    """Time stretch that each kind of limit asks for (1 where a joint is exactly at it).

    `jerk` bounds that of the profile everywhere, so the joints' jerk is bounded too.
    """
    duration = profile.x[-1]
    times = np.linspace(0.0, duration, max(2000, int(200 * duration)))
    u, du, ddu = (profile(times, order) for order in range(3))
    first, second, third = (spline(u, order) for order in (1, 2, 3))
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
