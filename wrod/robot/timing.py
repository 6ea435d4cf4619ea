"""When the arm is where: a jerk-limited run, slower where the path turns back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from wrod.errors import RobotError
from wrod.planning.pace import from_rest_to_rest
from wrod.robot.grip import TravelledPath
from wrod.robot.model import Robot

_RAMP = 1.0  # [s] to reach the speed of a run that keeps no plan's pace, roughly
_FINE = 2e-4  # [m] of travel at which local limits are read
_AROUND = (0.003, 0.006, 0.012, 0.024)  # [m] of travel over which a run slows down, tried in turn
_BELOW = 1.25  # how far below its limits a run is slowed, for what slowing down itself adds
_SLOWER = 1.02  # [-] of a stretch that counts as laid more slowly than planned


@dataclass(frozen=True)
class Timing:
    """A run along a course, from rest to rest.

    Attributes:
        duration: [s].
        load: (3,) largest joint velocity, acceleration and jerk over their limits; at most 1.
        stretched: by how much it would have to be slowed all along to keep them [-], at least 1.
    """

    duration: float
    load: tuple[float, float, float]
    stretched: float
    _profile: PPoly
    _course: Course

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


class Course:
    """Joint positions over a parameter, at whose pace the travel goes [m].

    Args:
        spline: joint positions (n,) [rad] over travel [m], a SciPy spline.
        length: of the parameter [m].
        travel: spline of the travel over it; None: it is the travel.
    """

    def __init__(self, spline, length: float, travel=None):
        self.spline, self.length, self._travel = spline, length, travel

    @classmethod
    def of_plan(
        cls, spline, path: TravelledPath, first: float | None = None, last: float | None = None
    ) -> Course:
        """Joint positions over the way that is gone at the pace of a plan's contact
        (`GripPath.counted`), of all of it or between two laid lengths [m]."""
        laid, way = path.grip.counted(first, last)
        return cls(spline, float(way[-1]), make_interp_spline(way, path.travel_at(laid), k=5))

    def travel(self, at: np.ndarray, order: int = 0) -> np.ndarray:
        """(K,) at points of the parameter, or its derivative."""
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

    def slowed(self, slow: np.ndarray, around: float) -> Course:
        """The course with a longer parameter where it is slowed.

        Args:
            slow: (K,) by how much at evenly spaced points.
            around: how far before and after them it slows down [m].
        """
        step = self.length / (len(slow) - 1)
        width = 2 * max(1, round(around / step)) + 1
        # Even averages over what is at least as wide are never below what was asked for.
        smooth = maximum_filter1d(np.log(slow), 3 * width - 2, mode="nearest")
        for _ in range(3):
            smooth = uniform_filter1d(smooth, width, mode="nearest")
        rate = np.exp(smooth)
        ahead = np.concatenate([[0.0], np.cumsum(step * (rate[1:] + rate[:-1]) / 2)])
        travel = self.travel(np.linspace(0.0, self.length, len(slow)))
        return Course(self.spline, float(ahead[-1]), make_interp_spline(ahead, travel, k=5))


def gently(length: float, speed: float) -> PPoly:
    """A run of a parameter [m] over time [s] at a speed [m/s], which keeps no plan's pace: a cubic
    of each phase of Ruckig's profile."""
    import ruckig

    request = ruckig.InputParameter(1)
    request.current_position, request.target_position = [0.0], [float(length)]
    limits = speed, speed / _RAMP, 4 * speed / _RAMP**2
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


def schedule(
    robot: Robot,
    course: Course,
    speed: float,
    law: Callable[[float, float], PPoly] = from_rest_to_rest,
) -> Timing:
    """Run along a course within every joint's velocity, acceleration and jerk limits.

    Where a joint would pass a limit, the whole run is slowed by the factor that brings it back:
    stretching time by f divides velocities by f, accelerations by f^2 and jerks by f^3. A few
    millimetres, where the grip turns back, may ask for a tenth of the speed; then the run is slowed
    there alone, if that is shorter.

    Args:
        speed: of the parameter [m/s].
        law: parameter [m] over time [s] of a length and a speed.
    """
    runs = [_run(robot, course, law(course.length, speed))]
    stretched = runs[0].stretched
    if stretched > 1.0:
        slow = _local_slowdown(robot, course, speed)
        others = [course.slowed(slow, around) for around in _AROUND]
        runs += [_run(robot, one, law(one.length, speed)) for one in others]
    return replace(min(runs, key=lambda run: run.duration), stretched=stretched)


def laid_slowly(planned: np.ndarray, played: np.ndarray, laid: np.ndarray) -> tuple[float, list]:
    """By how much at most poses that are planned for times (T,) are played more slowly, at times
    (T,) [s], and the stretches [from, to] of the laid length (T,) [m] where they are."""
    slow = np.diff(played) / np.diff(planned)
    edges = np.diff(np.concatenate([[0], slow > _SLOWER, [0]]).astype(int))
    bounds = zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True)
    return max(float(slow.max()), 1.0), [[float(laid[a]), float(laid[b])] for a, b in bounds]


def _local_slowdown(robot: Robot, course: Course, speed: float) -> np.ndarray:
    """By how much a steady run has to be slower at evenly spaced points to keep every limit."""
    at = np.linspace(0.0, course.length, max(200, int(course.length / _FINE)))
    limits = robot.velocity, robot.acceleration, robot.jerk
    asked = [
        (np.abs(rate) * speed**order / limit).max(1) ** (1 / order)
        for order, rate, limit in zip((1, 2, 3), course.derivatives(at), limits, strict=True)
    ]
    return np.maximum(_BELOW * np.max(asked, axis=0), 1.0)


def _run(robot: Robot, course: Course, profile: PPoly) -> Timing:
    stretched, factors = 1.0, _slowdown(robot, course, profile)
    while max(factors) > 1.0:
        # A little more than asked: the peaks are read at samples, which the new run shifts.
        slow = 1.001 * max(factors)
        stretched *= slow
        powers = slow ** np.arange(len(profile.c))[::-1, None]
        profile = PPoly(profile.c / powers, profile.x * slow)
        factors = _slowdown(robot, course, profile)
    load = (float(factors[0]), float(factors[1] ** 2), float(factors[2] ** 3))
    return Timing(float(profile.x[-1]), load, stretched, profile, course)


def _slowdown(robot: Robot, course: Course, profile: PPoly) -> tuple[float, float, float]:
    """Time stretch that each kind of limit asks for (1 where a joint is exactly at it)."""
    duration = profile.x[-1]
    times = np.linspace(0.0, duration, max(2000, int(200 * duration)))
    u, du, ddu, jolt = (profile(times, order)[:, None] for order in range(4))
    first, second, third = course.derivatives(u[:, 0])
    velocity = np.abs(first * du)
    acceleration = np.abs(second * du**2 + first * ddu)
    jerk = np.abs(third * du**3 + 3 * second * du * ddu + first * jolt)
    return (
        float((velocity / robot.velocity).max()),
        float((acceleration / robot.acceleration).max() ** 0.5),
        float((jerk / robot.jerk).max() ** (1 / 3)),
    )
