"""Deployments with feedback: what lies is looked at, and the rest of the path is planned anew.

After every so many centimetres a camera sees the laid part, without what the arm hides. What it
sees, against what the believed rod would have laid, updates the beliefs (friction, L_gb, natural
curvature, where the robot stands) through the derivatives of the deployment; then the path that is
left is corrected for the rod that is believed in now. What is laid already stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from wrod.deployment.corrections import Corrections
from wrod.deployment.expectation import COARSE, misplacement
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.setup import Disturbance
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Directions, Laid, lay
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.contact import Friction, FrictionField

# Standard deviations of what may be wrong and nobody declared: of the logarithms of friction and
# stiffness [-], natural curvature [1/m], and the robot's place [m].
_DOUBT = np.array([0.5, 0.5, 3.0, 2e-3, 2e-3])
# How much less sure these are at every look, and the largest change of a belief, in these.
_DRIFT = np.array([0.4, 0.05, 0.05, 0.1, 0.1])
_MOST_CHANGE = 1.5
# What a point differs by though the beliefs are right: mesh, shaking, whatever else [m]; and how
# far behind the contact a look tells of beliefs [m]: what lies there has told of them before.
_MODEL_ERROR, _MODEL_ERROR_HANGING = 1e-3, 3e-3
_MEMORY = 0.12
# Length before the contact over which what lies is compared with what is believed to [m].
_NEAR = 0.1
# Poses of the grip that a deployment has at least.
_LEAST_POSES = 3
# Costs of the corrections, a tenth of those in `optimise`: one rod is laid, not a sample of them;
# and the largest change of a correction in an iteration [L_gb].
_SIZE, _ROUGHNESS, _STEP = 2e-4, 2e-4, 0.35
_ITERATIONS = 1
# Of a spline that begins at the contact, so many first coefficients are its value and slope there.
_FIXED = 2


@dataclass(frozen=True)
class World:
    """What is really laid, on what.

    Attributes:
        rod: the rod.
        friction: of the table.
        disturbance: what else differs from the plan.
        friction_field: how friction varies over the table; None: it does not.
    """

    rod: RodMaterial
    friction: Friction
    disturbance: Disturbance = field(default_factory=Disturbance)
    friction_field: FrictionField | None = None


@dataclass(frozen=True)
class Sight:
    """How a camera sees what lies.

    Attributes:
        noise: standard deviation of each coordinate of a point [m].
        spacing: between points along the rod [m].
        hidden: length of rod before and after the contact, and before the grip, that the arm hides
            [m].
        hanging: standard deviation of each of three coordinates of the rod that hangs, as a camera
            at the side measures it [m]; infinite: nothing looks there.
        seed: of the noise.
    """

    noise: float = 0.5e-3
    spacing: float = 0.01
    hidden: float = 0.03
    hanging: float = 1e-3
    seed: int = 0


@dataclass(frozen=True)
class Look:
    """What was believed after a look.

    Attributes:
        laid: length that was laid then [m].
        friction: coefficient [-].
        lgb_error: relative, of L_gb.
        natural_curvature: [1/m].
        offset: (2,) of the robot [m].
        misfit: root mean square of what was seen against what had been believed [m].
    """

    laid: float
    friction: float
    lgb_error: float
    natural_curvature: float
    offset: tuple[float, float]
    misfit: float


@dataclass(frozen=True)
class Followed:
    """A deployment with feedback: the path that was gone, what lies in the end, and the looks."""

    trajectory: Trajectory
    laid: Laid
    looks: list[Look]


def lay_with_feedback(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float,
    world: World,
    *,
    every: float = 0.03,
    sight: Sight | None = None,
    known: bool = False,
    hold: float = 0.05,
    device: str | None = "cpu",
    **options,
) -> Followed:
    """Lay a rod that differs from the one believed in, looking at it on the way.

    The first look comes before the free end is let go: what is held is put down again where it
    belongs, so that an offset of the robot that is seen then does no harm.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: that is believed in.
        trajectory: planned for it.
        friction: that is believed in.
        world: what is really there; only its rod is looked at.
        every: length that is laid between two looks [m].
        sight: how the camera sees; default: `Sight()`.
        known: believe the truth from the first look on: what is left then is the share of control,
            and of what cannot be laid any better.
        hold: length of the free end that is held at first [m].
        device: "cpu", "cuda:0" or "auto".
        options: of `wrod.deployment.tangents.lay`, for the world.

    Raises:
        RodError: `every` is not positive.
    """
    if not every > 0.0:
        raise RodError(f"every is {every!r} m; give the positive length between two looks")
    sight = sight or Sight()
    rng = np.random.default_rng(sight.seed)
    one = _Replanner(pattern, rod, trajectory, friction, hold, device)

    def really(path: Trajectory, **more) -> Laid:
        how = world.disturbance
        how = replace(how, offset=tuple(np.asarray(how.offset) + one.placed))
        trial = Trial(pattern, world.rod, path, world.friction, how, _rest(path))
        given = {"friction_field": world.friction_field, **options, **more}
        return lay([trial], hold=hold, device=device, **given)[0]

    s, end = trajectory.arc_length, float(trajectory.arc_length[-1])
    first = float(s[min(int(np.searchsorted(s, hold)) + _LEAST_POSES, len(s) - 1)])
    looks = []
    for at in [first, *np.arange(first + every, end - 0.5 * every, every)]:
        held = {"release": at + hold} if at == first else {}
        seen = _Seen.of(really(_until(one.path, at), **held), at, sight, rng)
        misfit = one.believe(at, seen, held)
        if known:
            one.know(world)
        if at == first:
            one.placed -= one.offset
        one.replan(at, seen)
        looks.append(one.look(at, misfit))
    return Followed(one.path, really(one.path), looks)


@dataclass(frozen=True)
class _Seen:
    """Arc lengths (n,) and places (n, 3) of what is seen [m], and deviations (n, 3) of its noise
    [m], infinite for heights of what lies; the first `laid` points lie."""

    arc_length: np.ndarray
    place: np.ndarray
    deviation: np.ndarray
    laid: int

    @classmethod
    def of(cls, laid: Laid, s: float, sight: Sight, rng: np.random.Generator) -> _Seen:
        """The rod as the camera sees it when a length `s` [m] is laid."""
        on = np.arange(0.0, s - sight.hidden, sight.spacing)
        off = np.arange(s + sight.hidden, laid.arc_length[-1] - sight.hidden, sight.spacing)
        at = np.concatenate([on, off if np.isfinite(sight.hanging) else off[:0]])
        deviation = np.full((len(at), 3), sight.hanging)
        deviation[: len(on)] = [sight.noise, sight.noise, np.inf]
        noise = np.where(np.isfinite(deviation), deviation, 0.0)
        place = _at(laid.arc_length, laid.centerline, at)
        return cls(at, place + noise * rng.standard_normal(place.shape), deviation, len(on))


class _Replanner:
    """Beliefs and the path that goes with them."""

    def __init__(self, pattern, rod, trajectory, friction, hold, device):
        self.pattern, self.rod, self.hold, self.device = pattern, rod, hold, device
        self.friction, self.field = friction, None
        # In deviations: logarithms of friction and stiffness, natural curvature, offset.
        self.belief, self.covariance = np.zeros(5), np.eye(5)
        # How far the robot has moved all that it does, because of an offset that was seen [m].
        self.placed = np.zeros(2)
        self.path = trajectory

    @property
    def offset(self) -> np.ndarray:
        return (self.belief * _DOUBT)[3:]

    def know(self, world: World) -> None:
        """Believe the truth."""
        how = world.disturbance
        mu = np.log(world.friction.static / self.friction)
        stiffness = 3.0 * np.log1p(how.lgb_error)
        self.belief = np.array([mu, stiffness, how.natural_curvature, *how.offset]) / _DOUBT
        self.field = world.friction_field

    def _trial(self, path: Trajectory) -> Trial:
        mu, stiffness, natural, *_ = self.belief * _DOUBT
        x, y = self.offset + self.placed
        how = Disturbance(
            lgb_error=float(np.exp(stiffness / 3.0) - 1.0),
            natural_curvature=float(natural),
            offset=(float(x), float(y)),
        )
        law = Friction(float(self.friction * np.exp(mu)))
        return Trial(self.pattern, self.rod, path, law, how, _rest(path))

    def _lay(self, path: Trajectory, columns: Directions | None, **options) -> Laid:
        given = {"friction_field": self.field, **COARSE, **options}
        directions = None if columns is None else [columns]
        return lay([self._trial(path)], directions, hold=self.hold, device=self.device, **given)[0]

    def believe(self, s: float, seen: _Seen, held: dict) -> float:
        """Update the beliefs by what is seen; root mean square of what lies, before [m]."""
        path = _until(self.path, s)
        laid = self._lay(path, Directions.of_rod(len(path)), **held)
        residual = seen.place - _at(laid.arc_length, laid.centerline, seen.arc_length)
        rates = [_at(laid.arc_length, column, seen.arc_length) for column in laid.tangent]
        rates[0] *= self._trial(path).friction.static  # by its logarithm
        shifts = np.zeros((2, *residual.shape))
        shifts[0, :, 0] = shifts[1, :, 1] = 1.0
        matrix = np.concatenate([rates, shifts]).reshape(5, -1).T * _DOUBT
        model = np.where(np.arange(len(residual)) < seen.laid, _MODEL_ERROR, _MODEL_ERROR_HANGING)
        weight = 1.0 / (seen.deviation**2 + model[:, None] ** 2)
        weight[seen.arc_length < s - _MEMORY] = 0.0
        weight = weight.ravel()
        # What was believed before is a little less sure by now: tables differ from place to place.
        before = np.linalg.inv(self.covariance + np.diag(_DRIFT**2))
        self.covariance = np.linalg.inv((matrix.T * weight) @ matrix + before)
        step = self.covariance @ ((matrix.T * weight) @ residual.ravel())
        self.belief = self.belief + step * min(1.0, _MOST_CHANGE / np.abs(step).max())
        return float(np.sqrt(np.mean(residual[: seen.laid, :2] ** 2)))

    def replan(self, s: float, seen: _Seen) -> None:
        """Correct what is left of the path beyond `s`, at first without a step or a kink."""
        c = Corrections(self.pattern, self.path, self.rod.gravito_bending_length, s)
        free = np.arange(3 * c.count) >= 3 * _FIXED
        columns = Directions.of_path(c.columns()[free])
        cost = c.cost(_SIZE, _ROUGHNESS)[np.ix_(free, free)]
        scale = 1.0 / (METRIC_POINTS * c.lgb**2)
        points = np.linspace(0.0, self.pattern.length, METRIC_POINTS)
        ahead = points + self.pattern.remainder_length > s
        values, best, beside = np.zeros(3 * c.count), None, None
        for i in range(_ITERATIONS + 1):
            laid = self._lay(c.apply(values), columns if i < _ITERATIONS else None)
            error = misplacement(self.pattern, laid)[0].reshape(2, -1)
            if beside is None:
                beside = _beside(laid, s, seen)
            error = (error + beside[:, None] * ahead).ravel()
            value = np.inf if laid.diverged else float(error @ error)
            if best is not None and value >= best[0]:
                break
            best = value, values
            if i == _ITERATIONS:
                break
            rates = misplacement(self.pattern, laid)[1]
            matrix = cost + scale * rates.T @ rates
            slope = cost @ values[free] + scale * rates.T @ error
            step = -np.linalg.solve(matrix, slope)
            values = values.copy()
            values[free] += step * min(1.0, _STEP / np.abs(step).max())
        self.path = c.apply(best[1])

    def look(self, s: float, misfit: float) -> Look:
        trial = self._trial(self.path)
        how = trial.disturbance
        x, y = self.offset
        return Look(
            float(s),
            trial.friction.static,
            how.lgb_error,
            how.natural_curvature,
            (float(x), float(y)),
            misfit,
        )


def _beside(laid: Laid, s: float, seen: _Seen) -> np.ndarray:
    """(2,) how far what lies near the contact is beside what is believed to lie there [m]: what the
    beliefs cannot say is taken to go on."""
    near = np.arange(len(seen.arc_length)) < seen.laid
    near &= seen.arc_length > s - _NEAR
    if not near.any():
        return np.zeros(2)
    at = seen.arc_length[near]
    apart = (seen.place[near] - _at(laid.arc_length, laid.centerline, at))[:, :2]
    noise = seen.deviation[0, 0] ** 2
    return apart.sum(axis=0) / (len(at) + noise / _MODEL_ERROR**2)


def _at(arc_length: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n, 3) values (node, 3) at arc lengths (n,)."""
    return np.stack([np.interp(at, arc_length, column) for column in values.T], axis=1)


def _rest(path: Trajectory) -> Tail:
    """The grip stays where the path ends: what lies is looked at there, and no tail is laid."""
    return Tail.none(path)


def _until(trajectory: Trajectory, s: float) -> Trajectory:
    """Its beginning, up to that laid length [m]."""
    n = int(np.searchsorted(trajectory.arc_length, s, side="right"))
    names = ("arc_length", "contact", "position", "rotation", "force", "shape", "twist")
    cut = {
        name: getattr(trajectory, name)[:n]
        for name in names
        if getattr(trajectory, name) is not None
    }
    return replace(trajectory, **cut)
