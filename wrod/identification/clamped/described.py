"""Effects that are built from a print: what is missing, where, how much, in a few numbers.

None of them is a candidate of its own accord: each is built where the non-parametric profiles of
`wrod.identification.clamped.profiles` say that something is there, and fits start from that place.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from wrod.identification.clamped.layout import COMPLEX_STEP
from wrod.identification.effect import Effect, Estimate, Parameter, magnitude_and_angle

# Width of soft ends as a share of the length between them, within a factor of e.
SOFT_END = 0.025
# Cells that a load's moments are sums over.
_CELLS = 400


def _cells(fraction: np.ndarray) -> np.ndarray:
    """(n + 2,) ends of the nodes' cells along the rod, as shares of it."""
    return np.concatenate([fraction[:1], 0.5 * (fraction[1:] + fraction[:-1]), fraction[-1:]])


def _mean(law, bounds) -> np.ndarray:
    """(n,) means between (n + 1,) bounds of what `law` is the integral of, analytic."""
    return np.diff(law(bounds)) / np.diff(bounds)


def _window(bounds, start, stop, end) -> np.ndarray:
    """(n,) shares of the rod between (n + 1,) bounds that lie between two arc lengths, with ends
    that wide, analytic."""

    def covered(s):
        return end * (_softplus((s - start) / end) - _softplus((s - stop) / end))

    return _mean(covered, bounds)


def _softplus(x):
    over = np.real(x) > 0.0
    return np.where(over, x, 0.0) + np.log1p(np.exp(np.where(over, -x, x)))


def _soft_window(breadth, log_softness):
    """(length, width of the ends) of a window that spreads like a sharp one of that breadth: a
    variance of length^2 / 12 + pi^2 end^2 / 3, were the rod longer."""
    share = SOFT_END * np.exp(log_softness)
    length = breadth / np.sqrt(1.0 + (2.0 * np.pi * share) ** 2)
    return length, share * length


def _shortened(gain, ratio):
    """A relative gain over a stretch that is shorter by a ratio: in sum the same, of a loss what
    leaves something; once differentiable where it is nothing."""
    return gain * ratio if np.real(gain) > 0.0 else np.expm1(ratio * np.log1p(gain))


def _estimates(told: Callable, units: dict[str, str], values, covariance) -> dict[str, Estimate]:
    """What an analytic function tells of parameters, by key, with errors to first order."""
    values, steps = np.asarray(values), 1j * COMPLEX_STEP * np.eye(len(values))
    rates = np.array([told(values + h).imag for h in steps]).T / COMPLEX_STEP
    errors = np.sqrt(np.einsum("kp,pq,kq->k", rates, covariance, rates))
    return {
        key: Estimate(float(value), float(error), unit)
        for (key, unit), value, error in zip(units.items(), told(values), errors, strict=True)
    }


class Described(Effect):
    """An effect with starts of its own, from a print.

    Args:
        first: parameter vectors to start fits from, without how soft ends are.
    """

    def __init__(self, first: Sequence[ArrayLike]):
        self.first = [np.asarray(v, dtype=float) for v in first]

    def starts(self, measurements):
        soft = [0.0] * (self.parameters[-1].key == "log_softness")
        return [np.append(v, soft) for v in self.first]


class LocalBend(Described):
    name = "local_bend"
    title = "a bend at one place"
    reference = (
        "natural curvature of a Gaussian over arc length, its integral the angle of the bend"
    )
    parameters = (
        Parameter("angle_1", "rad", 1.0),
        Parameter("angle_2", "rad", 1.0),
        Parameter("arc_length", "m", 0.5, anywhere=True),
        Parameter("log_width", "", 0.7, lower=np.log(1e-3), anywhere=True),
    )

    def apply(self, setup, values):
        width = np.exp(values[3])
        bounds = _cells(setup.fraction) * setup.length
        bump = _mean(lambda s: ndtr((s - values[2]) / width), bounds)
        vector = np.array([values[1], -values[0]])
        setup.natural_curvature = setup.natural_curvature + bump[:, None] * vector

    def special_cases(self, values, measurements):
        """What is bent over the whole rod is curved by itself."""
        length, width = measurements.material.length, np.exp(values[3])
        within = np.diff(ndtr((np.array([0.0, length]) - values[2]) / width))[0]
        return {"natural_curvature": np.array([values[1], -values[0]]) * within / length}

    def describe(self, values, covariance, measurements):
        size, direction = magnitude_and_angle(*values[:2], covariance[:2, :2])
        width = float(np.exp(values[3]))
        own = super().describe(values, covariance, measurements)
        return {
            "bend": Estimate(*np.degrees(size).tolist(), "deg"),
            "direction": Estimate(*direction, "deg"),
            "arc_length": own["arc_length"],
            "width": Estimate(width, width * float(np.sqrt(covariance[3, 3])), "m"),
            "angle_1": own["angle_1"],
            "angle_2": own["angle_2"],
        }


class Stretch(Described):
    """Readings tell the sum, the centroid and the spread of what a stretch gives and weighs more,
    hardly how soft its ends are: its ends are those of the sharp stretch of the same, nearly so
    where it is stiffer or lighter, as there is no less than nothing of either."""

    name = "stretch"
    title = "a stretch of rod that is otherwise stiff and otherwise heavy"
    reference = (
        "compliance times a factor and mass per length times another between two places, the ends "
        "logistic"
    )
    parameters = (
        Parameter("log_stiffness_ratio", "", 2.0),
        Parameter("mass_gain", "", 2.0, lower=-0.95),
        Parameter("start", "m", 0.5, anywhere=True),
        Parameter("log_length", "", 1.0, lower=np.log(2e-3), anywhere=True),
        # A nick may be all sides: two standard deviations are a share of a half.
        Parameter("log_softness", "", 1.5),
    )

    def apply(self, setup, values):
        softer, heavier, *ends = self._ends(values)
        window = _window(_cells(setup.fraction) * setup.length, *ends)
        within = _window(setup.arc_length, *ends)
        # Sections give one after another: of a cell, and of an edge, compliances have a mean.
        setup.bending = setup.bending / (1.0 + softer * window)[:, None]
        setup.twisting = setup.twisting / (1.0 + softer * window)
        setup.stretching = setup.stretching / (1.0 + softer * within)
        setup.line_mass = setup.line_mass * (1.0 + heavier * window)

    def _ends(self, values):
        """(relative compliance more, mass per length more, start, stop, width of the ends)."""
        breadth = np.exp(values[3])
        length, end = _soft_window(breadth, values[4])
        start = values[2] + 0.5 * (breadth - length)
        gains = (_shortened(g, breadth / length) for g in (np.expm1(-values[0]), values[1]))
        return *gains, start, start + length, end

    def special_cases(self, values, measurements):
        """What is only heavier is as good as a mass at one place, if that is short."""
        rod, length = measurements.material, np.exp(values[3])
        mass = values[1] * rod.weight / rod.gravity * length
        return {"point_mass": np.array([mass, values[2] + 0.5 * length])}

    def doubt(self, values, covariance, measurements):
        own, length = self.describe(values, covariance, measurements), measurements.material.length
        first, last, end = own["start"], own["stop"], own["end_width"].value
        if last.value > length - max(2.0 * last.stderr, 4.0 * end):
            return "the stretch reaches the gripper, which may give way itself"
        if first.value < max(2.0 * first.stderr, 4.0 * end):
            return "the stretch reaches clamp A, which may give way itself"
        return ""

    def describe(self, values, covariance, measurements):
        rod = measurements.material

        def told(values):
            softer, heavier, start, stop, end = self._ends(values)
            sums = softer * (stop - start), heavier * (stop - start) * rod.weight / rod.gravity
            last = values[2] + np.exp(values[3])
            return np.array([values[2], last, end, 1.0 / (1.0 + softer), 1.0 + heavier, *sums])

        units = {"start": "m", "stop": "m", "end_width": "m", "stiffness_ratio": "",
                 "mass_ratio": "", "extra_compliance": "m", "extra_mass": "kg"}  # fmt: skip
        return _estimates(told, units, values, covariance)


class LocalLoad(Described):
    """Readings tell a load's moments. The same force from further out, or with softer ends, is
    nearly the same to them, so its parameters are the moments, and how soft the ends are."""

    name = "local_load"
    title = "a force along a stretch of the rod, fixed in the laboratory"
    reference = "dead force per length between two places, its ends logistic"
    parameters = (
        *(Parameter(f"load_{axis}", "N", 0.03) for axis in "xyz"),
        Parameter("middle", "m", 0.5, anywhere=True),
        Parameter("breadth", "m", 0.5, lower=2e-3, anywhere=True),
        Parameter("log_softness", "", 1.0),
    )

    def apply(self, setup, values):
        force, start, stop, end = self._ends(values)
        window = _window(_cells(setup.fraction) * setup.length, start, stop, end)
        setup.push(window[:, None] * force)

    def _ends(self, values):
        """(force per length, start, stop, width of the ends) of the load that has as much in sum as
        the parameters say, its centroid there, and spread like a sharp one of its breadth."""
        length, end = _soft_window(values[4], values[5])
        start = values[3] - 0.5 * length
        return np.asarray(values[:3]) / length, start, start + length, end

    def _told(self, values, rod) -> np.ndarray:
        """(11,) what `describe` tells, of a rod of that length."""
        force, *ends = self._ends(values)
        bounds = np.linspace(0.0, rod, _CELLS + 1)
        within, middle = _window(bounds, *ends), 0.5 * (bounds[1:] + bounds[:-1])
        whole = within.sum()
        centroid = (within @ middle) / whole
        spread = np.sqrt(within @ (middle - centroid) ** 2 / whole)
        return np.array([*(force * whole * bounds[1]), centroid, spread, *force, *ends])

    def describe(self, values, covariance, measurements):
        units = {f"total_{axis}": "N" for axis in "xyz"} | {"centroid": "m", "spread": "m"}
        units |= {f"force_{axis}": "N/m" for axis in "xyz"}
        units |= {"start": "m", "stop": "m", "end_width": "m"}
        rod = measurements.material.length
        return _estimates(lambda own: self._told(own, rod), units, values, covariance)


class Attraction(Described):
    """A pull towards one point.

    Args:
        shape: (T, n + 1, 3) where it pulls at the rods of all trials; default: at their measured
            shapes, which are theirs to within the noise.
    """

    name = "attraction"
    title = "a pull towards one point of the laboratory"
    reference = (
        "dead force per length strength * d^2 * r / (r^2 + reach^2)^(3/2) towards a point at the "
        "vector r from the rod, d = 0.1 m"
    )
    distance = 0.1
    parameters = (
        Parameter("strength", "N/m", 0.2),
        *(Parameter(axis, "m", 1.0, anywhere=True) for axis in "xyz"),
        Parameter("log_reach", "", 0.7, lower=np.log(5e-3), anywhere=True),
    )

    def __init__(self, first: Sequence[ArrayLike], shape: np.ndarray | None = None):
        super().__init__(first)
        self.shape = shape

    def _pulled_at(self, setup) -> np.ndarray:
        if self.shape is None:
            return setup.measured
        own, (_, nodes, _) = self.shape[setup.trials], setup.measured.shape
        if own.shape[1] == nodes:
            return own
        known = np.linspace(0.0, 1.0, own.shape[1])
        return CubicSpline(known, own, axis=1)(np.linspace(0.0, 1.0, nodes))

    def apply(self, setup, values):
        away = np.asarray(values[1:4]) - self._pulled_at(setup)
        square = np.sum(away * away, axis=2, keepdims=True) + np.exp(2.0 * values[4])
        setup.push(values[0] * self.distance**2 * away / (square * np.sqrt(square)))

    def describe(self, values, covariance, measurements):
        own = super().describe(values, covariance, measurements)
        reach = float(np.exp(values[4]))
        found = {k: v for k, v in own.items() if k != "log_reach"}
        error = reach * float(np.sqrt(covariance[4, 4]))
        return found | {"reach": Estimate(reach, error, "m")}
