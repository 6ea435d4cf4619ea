"""At which pace a trajectory is played: from poses over the laid length to poses over seconds."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, RotationSpline

from wrod import arguments
from wrod.errors import DataError
from wrod.planning.trajectory import Trajectory

# The grip's pace is looked at every millimetre, and changes over a centimetre of laid rod [m].
_PACE_SPACING, _PACE_WIDTH = 0.001, 0.01
# Paces that a deployment takes, and those that a plan is corrected for [m/s].
PACES = arguments.number(1e-5, 100.0)
SLOWEST, FASTEST = 5e-4, 10.0
# Pace of a plan that was corrected for none, and how many times as fast a tail is laid [m/s].
USUAL_PACE, TAIL_FASTER = 0.02, 2.0
# How long the contact takes to come to its pace, and to rest [s].
_EASE = 0.4


class GripPath:
    """Grip pose over the laid length (numbers that never decrease).

    Args:
        laid: (T,) laid length [m].
        position: (T, 3) grip position [m].
        rotation: (T, 3, 3) grip frame.

    Attributes:
        position, rotation: splines over the laid length.
    """

    def __init__(self, laid: np.ndarray, position: np.ndarray, rotation: np.ndarray):
        self.position = CubicSpline(laid, position)
        self.rotation = RotationSpline(laid, Rotation.from_matrix(rotation))
        self.first, self.last = float(laid[0]), float(laid[-1])

    def counted(
        self, first: float | None = None, last: float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Laid lengths (n,) [m] of the path, or between two of it, and the way (n,) [m] by then,
        which is gone at the contact's pace: the laid length, and more where the grip would have to
        move faster than on a straight line, where it goes down as fast as forward."""
        # Points do not depend on the path's end: what is gone by then takes the time that it took.
        first, last = self.first if first is None else first, self.last if last is None else last
        cell = min(_PACE_SPACING, (last - first) / 8)
        count = int(np.ceil((last - first) / cell - 1e-6))
        laid = np.append(first + cell * np.arange(count), last)
        pace = np.linalg.norm(self.position(laid, 1), axis=1) / np.sqrt(2.0)
        pace = gaussian_filter1d(np.maximum(pace, 1.0), _PACE_WIDTH / _PACE_SPACING)
        return laid, cumulative_trapezoid(pace, laid, initial=0.0)

    def timed(self, speed: float) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
        """Time law along the path: its duration [s], and the laid length [m] at t (n,); the way
        that `counted` says is gone at `speed` [m/s]."""
        laid, way = self.counted()
        covered, laid_at = from_rest_to_rest(float(way[-1]), speed), PchipInterpolator(way, laid)
        duration = float(covered.x[-1])
        return duration, lambda t: laid_at(
            np.clip(covered(np.clip(t, 0.0, duration)), 0.0, way[-1])
        )

    def __call__(self, laid: np.ndarray) -> tuple[np.ndarray, Rotation]:
        laid = np.clip(laid, self.first, self.last)
        return self.position(laid), self.rotation(laid)


def pace_of(trajectory: Trajectory) -> float | None:
    """Pace of the contact that a plan was corrected for [m/s]; None: it was not, or its file holds
    none that could be."""
    pace = _said(trajectory)
    usable = isinstance(pace, int | float) and SLOWEST <= pace <= FASTEST
    return float(pace) if usable else None


def _said(trajectory: Trajectory):
    """What a plan's file has for the pace that it was corrected for, by itself or by a network that
    learnt from such."""
    said = trajectory.optimised or trajectory.metadata.get("distilled")
    return said.get("pace") if isinstance(said, dict) else None


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
    own = _said(trajectory)
    pace = speed if speed is not None else USUAL_PACE if own is None else own
    if said := arguments.wrong(PACES, pace):
        raise DataError(f"pose_times: metadata: optimised: pace {said}")
    duration, laid_at = path.timed(pace)
    t = np.linspace(0.0, duration, max(4000, 40 * len(laid)))
    times = np.interp(laid, laid_at(t), t)
    times[0], times[-1] = 0.0, duration
    return times


def from_rest_to_rest(distance: float, speed: float) -> PPoly:
    """Distance [m] over time [s] at a speed [m/s], or less where it is short, which rises and falls
    over 0.4 s each with the quintic smoothstep."""
    speed = min(speed, distance / _EASE)
    # Integrals of the smoothstep and of what it lacks of 1, in powers of t from the sixth down.
    rise = speed * np.array([1.0 / _EASE**5, -3.0 / _EASE**4, 2.5 / _EASE**3, 0, 0, 0, 0])
    even = speed * np.array([0, 0, 0, 0, 0, 1.0, 0])
    last = distance / speed
    even[-1] = 0.5 * speed * _EASE
    fall = even - rise
    fall[-1] = distance - 0.5 * speed * _EASE
    terms, ends = [rise, even, fall], [0.0, _EASE, last, last + _EASE]
    if last <= _EASE * (1.0 + 1e-12):
        terms, ends = [rise, fall], [0.0, _EASE, 2.0 * _EASE]
    return PPoly(np.array(terms).T, np.array(ends))
