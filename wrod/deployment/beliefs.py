"""What is believed of a rod and its table while it is laid, and how looks change it."""

from dataclasses import replace

import numpy as np

from wrod.deployment.expectation import FINE
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen, interpolated
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Directions, Laid
from wrod.deployment.together import Asked, Course
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.contact import Friction, FrictionField

# Standard deviations of what may be wrong and nobody declared: of the logarithms of friction and
# stiffness [-], natural curvature [1/m], and the robot's place [m].
_DOUBT = np.array([0.5, 0.5, 3.0, 2e-3, 2e-3])
# How much less sure these are at a look, in these, and how likely: where all is as before, where it
# changes as things do, and where a table is another from here on, which is rare. The largest change
# of a belief, in these.
_DRIFT = np.array([0.1, 0.05, 0.05, 0.1, 0.1])
_OTHER_TABLE = np.array([1.0, 0.05, 0.05, 0.1, 0.1])
_DRIFTS = ((0.1 * _DRIFT, 0.475), (_DRIFT, 0.475), (_OTHER_TABLE, 0.05))
_MOST_CHANGE = 1.5
# Change of a belief up to which what is believed to lie answers linearly, in these.
_LINEAR = 0.2
# What a point differs by though the beliefs are right: mesh, shaking, whatever else [m]; and how
# far behind the contact a look tells of beliefs [m]: what lies there has told of them before.
_MODEL_ERROR, _MODEL_ERROR_HANGING = 1e-3, 3e-3
_MEMORY = 0.12
# Length before the contact over which what lies is compared with what is believed to, and over
# which it forgets how far beside that it is [m].
_NEAR, _STEP = 0.1, 1e-3
# Standard deviations that how far that is may have though the beliefs are right [m], and how likely
# they are before a look tells: most often the beliefs say it all.
_BESIDE = np.array([0.0, 2e-4, 4e-4, 8e-4, 1.6e-3])
_LIKELY = np.array([0.8, 0.05, 0.05, 0.05, 0.05])


class Beliefs:
    """Friction, stiffness, natural curvature and place of the robot, with their covariance.

    Args:
        pattern: that is laid.
        rod: that is believed in at first.
        friction: likewise.
        hold: length of the free end that is held at first [m].
    """

    def __init__(self, pattern: Pattern, rod: RodMaterial, friction: float, hold: float):
        self.pattern, self.rod, self.hold = pattern, rod, hold
        self.friction = friction
        self.field: FrictionField | None = None
        # In deviations: logarithms of friction and stiffness, natural curvature, offset.
        self.mean, self.covariance = np.zeros(5), np.eye(5)
        # How far the robot has moved all that it does since [m], and turned it [rad].
        self.placed = np.zeros(3)

    @property
    def offset(self) -> np.ndarray:
        """(2,) of the robot, before it moved all that it does [m]."""
        return (self.mean * _DOUBT)[3:]

    def know(self, friction: float, how: Disturbance, field: FrictionField | None) -> None:
        """Believe the truth."""
        stiffness = 3.0 * np.log1p(how.lgb_error)
        mu = np.log(friction / self.friction)
        self.mean = np.array([mu, stiffness, how.natural_curvature, *how.offset]) / _DOUBT
        self.field = field

    def trial(self, path: Trajectory, placed: np.ndarray | None = None) -> Trial:
        """The deployment that is believed in, all of it `placed` (3,) [m, rad] elsewhere; the grip
        stays where the path ends."""
        mu, stiffness, natural, *_ = self.mean * _DOUBT
        x, y, turned = self.placed if placed is None else placed
        x, y = self.offset + (x, y)
        how = Disturbance(
            lgb_error=float(np.exp(stiffness / 3.0) - 1.0),
            natural_curvature=float(natural),
            offset=(float(x), float(y)),
            yaw=float(turned),
        )
        law = Friction(float(self.friction * np.exp(mu)))
        return Trial(self.pattern, self.rod, path, law, how, Tail.none(path))

    def lay(
        self,
        path: Trajectory,
        columns: Directions | None = None,
        placed: np.ndarray | None = None,
        **options,
    ) -> Course[Laid]:
        """What is believed to lie at the end of a path."""
        given = {"friction_field": self.field, **FINE, **options}
        directions = None if columns is None else [columns]
        (laid,) = yield Asked([self.trial(path, placed)], directions, given)
        return laid

    def update(
        self, s: float, path: Trajectory, seen: Seen, still: bool = False, **options
    ) -> Course[tuple[float, Laid]]:
        """By what is seen when `s` [m] is laid, at the end of a path: root mean square of what lies
        against what was believed before [m], and what is believed to lie since. Nothing has changed
        since the last picture if the grip stood `still`."""
        laid = yield from self.lay(path, Directions.of_rod(len(path)), **options)
        residual = seen.place - interpolated(laid.arc_length, laid.centerline, seen.arc_length)
        rates = [interpolated(laid.arc_length, c, seen.arc_length) for c in laid.tangent]
        mu = self.trial(path).friction.static
        rates[0] *= mu  # by its logarithm
        shifts = np.zeros((2, *residual.shape))
        shifts[0, :, 0] = shifts[1, :, 1] = 1.0
        matrix = np.concatenate([rates, shifts]).reshape(5, -1).T * _DOUBT
        model = np.where(np.arange(len(residual)) < seen.laid, _MODEL_ERROR, _MODEL_ERROR_HANGING)
        weight = 1.0 / (seen.deviation**2 + model[:, None] ** 2)
        weight[seen.arc_length < s - _MEMORY] = 0.0
        weight = weight.ravel()
        information = (matrix.T * weight) @ matrix
        pull = (matrix.T * weight) @ residual.ravel()
        step = self._renewed(information, pull, still)
        step *= min(1.0, _MOST_CHANGE / np.abs(step).max())
        self.mean = self.mean + step
        misfit = float(np.sqrt(np.mean(residual[: seen.laid, :2] ** 2)))
        if np.abs(step).max() > _LINEAR:
            return misfit, (yield from self.lay(path, **options))
        change = step * _DOUBT
        change[0] *= mu
        moved = laid.centerline + np.tensordot(change[:3], laid.tangent, 1)
        moved[:, :2] += change[3:]
        return misfit, replace(laid, centerline=moved)

    def _renewed(
        self, information: np.ndarray, pull: np.ndarray, still: bool = False
    ) -> np.ndarray:
        """(5,) what a look adds to the beliefs, whose covariance becomes what it is then; whichever
        drift is likeliest, or none where the grip stood `still`."""
        drifts = ((0.0 * _DRIFT, 1.0),) if still else _DRIFTS
        told = [self._told(information, pull, *one) for one in drifts]
        _, self.covariance = max(told, key=lambda one: one[0])
        return self.covariance @ pull

    def _told(
        self, information: np.ndarray, pull: np.ndarray, drift: np.ndarray, chance: float
    ) -> tuple[float, np.ndarray]:
        """Logarithm of how likely it is to see what is seen after such a drift, and the covariance
        (5, 5) of the beliefs then."""
        before = np.linalg.inv(self.covariance + np.diag(drift**2))
        after = np.linalg.inv(information + before)
        volumes = np.linalg.slogdet(before)[1] + np.linalg.slogdet(after)[1]
        return np.log(chance) + 0.5 * (volumes + pull @ after @ pull), after


def doubted(laid: Laid, pattern: Pattern, s: float, seen: Seen) -> float:
    """How much likelier it is to see what lies near the contact where it is believed to than on the
    pattern: twice the logarithm of that."""
    near = np.arange(len(seen.arc_length)) < seen.laid
    near &= seen.arc_length > max(s - _NEAR, pattern.remainder_length)
    at = seen.arc_length[near]
    believed = interpolated(laid.arc_length, laid.centerline, at)
    wanted = pattern.sample(at - pattern.remainder_length)[0]
    weight = 1.0 / seen.deviation[near, :2] ** 2
    apart = [(seen.place[near] - one)[:, :2] ** 2 * weight for one in (wanted, believed)]
    return float(np.sum(apart[0] - apart[1]))


class Beside:
    """How far what lies near the contact is beside what is believed to lie there, look after look.

    A stationary process along the way for each of some deviations, none among them, which are as
    likely as they make what is seen: what the camera's noise explains moves no grip.
    """

    def __init__(self) -> None:
        self.mean = np.zeros((len(_BESIDE), 2))
        self.covariance = _BESIDE[:, None, None] ** 2 * np.eye(2)
        self.evidence = np.log(_LIKELY)
        self.gone = 0.0

    def told(self, laid: Laid, s: float, seen: Seen, gone: float) -> np.ndarray:
        """(2,) by what is seen when `s` [m] is laid and `gone` [m] of the way are gone [m]: what
        the beliefs cannot say is taken to go on. Only across the rod: how far along it a point is,
        a picture does not tell well."""
        left = np.exp(-(gone - self.gone) / _NEAR)
        self.gone = gone
        self.mean = left * self.mean
        renewed = (1.0 - left**2) * _BESIDE[:, None, None] ** 2 * np.eye(2)
        self.covariance = left**2 * self.covariance + renewed
        across, apart = _across(laid, s, seen)
        weight = 1.0 / seen.deviation[0, 0] ** 2 if len(apart) else 0.0
        information = weight * across.T @ across
        pull = weight * across.T @ apart - self.mean @ information
        spread = np.eye(2) + information @ self.covariance
        self.covariance = self.covariance @ np.linalg.inv(spread)
        step = np.einsum("kij,kj->ki", self.covariance, pull)
        self.mean = self.mean + step
        explained = np.einsum("ki,ki->k", pull, step)
        self.evidence = self.evidence + 0.5 * (explained - np.linalg.slogdet(spread)[1])
        chance = np.exp(self.evidence - self.evidence.max())
        return chance @ self.mean / chance.sum()


def _across(laid: Laid, s: float, seen: Seen) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) directions across the rod where it is seen to lie near the contact, and (n,) how far
    beside what is believed it is there [m]."""
    near = np.arange(len(seen.arc_length)) < seen.laid
    near &= seen.arc_length > s - _NEAR
    at = seen.arc_length[near]
    place, ahead = (
        interpolated(laid.arc_length, laid.centerline, at + step) for step in (0.0, _STEP)
    )
    tangent = (ahead - place)[:, :2]
    across = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    across /= np.linalg.norm(across, axis=1)[:, None]
    return across, np.einsum("ni,ni->n", across, (seen.place[near] - place)[:, :2])
