"""Deployments with feedback: what lies is looked at, and the rest of the path is planned anew.

After every so many centimetres a camera sees the laid part, without what the arm hides. What it
sees, against what the believed rod would have laid, updates the beliefs (friction, L_gb, natural
curvature, where the robot stands) through the derivatives of the deployment; then the path that is
left is corrected for the rod that is believed in now. Where that says that what lies already has
gone wrong, and that it can be laid better, the grip goes back, lifts it, and lays it anew.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from wrod import arguments
from wrod.deployment.beliefs import Beliefs, Beside, doubted
from wrod.deployment.expectation import misplacement
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen, Sight
from wrod.deployment.simulate import Trial, refuse_other_plans
from wrod.deployment.tangents import Directions, Laid
from wrod.deployment.together import Asked, Course, follow
from wrod.deployment.way import Way
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.records import checked_fields
from wrod.rods.material import RodMaterial
from wrod.solvers.contact import Friction, FrictionField

# Poses of the grip that a deployment has at least.
_LEAST_POSES = 3
# Costs of the corrections, a tenth of those in `optimise`: one rod is laid, not a sample of them.
_SIZE, _ROUGHNESS = 2e-4, 2e-4
# Largest change of a correction in an iteration [L_gb], at first; what is left of it after a change
# for the worse and after one that saves less than this part of what its model promised, and what it
# grows by after one that was cut to it and saves more. One step is not enough on a slippery table,
# where a rod answers linearly to a millimetre and not to a centimetre.
_STEP, _SHORTER, _SHORT, _LONGER, _KEPT_PROMISE = 0.35, 0.3, 0.5, 2.0, 0.5
# So many steps at most, and none that would save less by its model than that part, or than a root
# mean square of that [m].
_STEPS, _DONE, _FELT = 10, 0.03, 5e-5
# Damping of a step, relative to errors of 1 L_gb, that is tried first where it would be too large.
_DAMPING = 1e-6
# How far beyond the contact the path is corrected after a look: others follow [L_gb].
HORIZON = 10.0
# Of a spline that begins at the contact, so many first coefficients are its value and slope there.
_FIXED = 2
# What lies is laid anew where it errs by more than this on average over so much rod before the
# contact, from where it begins to err by a share of that on, and from that much before, so that the
# grip is where it belongs when the contact comes there [m]; if the mean error of all is less by so
# much then [m]; so many times at most.
_WRONG, _LOOKED_AT, _BEGINS, _BEFORE = 3e-4, 0.1, 0.5, 0.05
_GAIN, _MOST_TIMES = 2e-5, 8
# And if it is likelier to be seen so than on the pattern, by twice the logarithm: three deviations
# of the camera's noise.
_BEYOND_NOISE = 9.0


@checked_fields(
    RodError,
    rod=arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length"),
    friction=arguments.like("a wrod.Friction", "static", "kinetic"),
    disturbance=arguments.like("a wrod.Disturbance", "jitter", "offset"),
    friction_field=arguments.optional(arguments.like("a wrod.FrictionField", "factor", "x", "y")),
)
@dataclass(frozen=True)
class Plant:
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
class Look:
    """What was believed after a look.

    Attributes:
        laid: length that was laid then [m].
        friction: coefficient under the contact [-].
        friction_error: standard error of its logarithm [-].
        lgb_error: relative, of L_gb.
        natural_curvature: [1/m].
        offset: (2,) of the robot [m].
        misfit: root mean square of what was seen against what had been believed [m].
        varies: least and largest factor by which friction is believed to vary over the table.
        back: laid length to which the grip went back then [m]; None: it went on.
    """

    laid: float
    friction: float
    friction_error: float
    lgb_error: float
    natural_curvature: float
    offset: tuple[float, float]
    misfit: float
    varies: tuple[float, float]
    back: float | None = None


@dataclass(frozen=True)
class Followed:
    """A deployment with feedback: the way that was gone, what lies in the end, and the looks."""

    trajectory: Trajectory
    laid: Laid
    looks: list[Look]


@arguments.checked(
    RodError,
    rod=arguments.like("a wrod.RodMaterial", "radius", "length", "gravito_bending_length"),
    friction=arguments.number(0.0, 100.0),
    plant=arguments.like("a wrod.deployment.feedback.Plant", "rod", "friction", "disturbance"),
    every=arguments.number(5e-3, 100.0),
    sight=arguments.optional(
        arguments.like("a wrod.deployment.sight.Sight", "noise", "spacing", "hidden", "hanging")
    ),
    horizon=arguments.number(2.0, 1e3),
    hold=arguments.number(0.0, 10.0, above=0.0),
)
def lay_with_feedback(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float,
    plant: Plant,
    *,
    every: float = 0.03,
    sight: Sight | None = None,
    known: bool = False,
    again: bool = True,
    horizon: float = HORIZON,
    hold: float = 0.05,
    device: str | None = "cpu",
    **options,
) -> Followed:
    """Lay a rod that differs from the one believed in, looking at it on the way.

    The first look comes before the free end is let go: all is then begun anew, the held end put
    down and the path corrected from there on for the rod that is believed in now, so that an offset
    of the robot that is seen then does no harm.

    Args:
        pattern: with the remainder that the trajectory lays.
        rod: that is believed in.
        trajectory: planned for it.
        friction: that is believed in.
        plant: what is really there; only its rod is looked at.
        every: length that the grip goes between two looks [m].
        sight: how the camera sees; default: `Sight()`.
        known: believe the truth from the first look on: what is left then is the share of control,
            and of what cannot be laid any better.
        again: whether the grip may go back and lay anew what has gone wrong.
        horizon: how far beyond the contact the path is corrected after a look [L_gb].
        hold: length of the free end that is held at first [m].
        device: "cpu", "cuda:0" or "auto".
        options: of `wrod.deployment.tangents.lay`, for the plant.

    Raises:
        RodError: an argument is not usable.
    """
    course = following(
        pattern, rod, trajectory, friction, plant, every=every, sight=sight, known=known,
        again=again, horizon=horizon, hold=hold, **options,
    )  # fmt: skip
    refuse_other_plans(Trial(pattern, plant.rod, trajectory, plant.friction))
    return follow([course], hold=hold, device=device)[0]


def following(
    pattern: Pattern,
    rod: RodMaterial,
    trajectory: Trajectory,
    friction: float,
    plant: Plant,
    *,
    every: float = 0.03,
    sight: Sight | None = None,
    known: bool = False,
    again: bool = True,
    horizon: float = HORIZON,
    hold: float = 0.05,
    **options,
) -> Course[Followed]:
    """The deployments of `lay_with_feedback`, and what it returns."""
    sight = sight or Sight()
    rng = np.random.default_rng(sight.seed)
    beliefs, beside = Beliefs(pattern, rod, friction, hold), Beside()
    way = Way(trajectory)

    def really(path: Trajectory, **more) -> Course[Laid]:
        how = plant.disturbance
        offset = np.asarray(how.offset) + beliefs.placed[:2]
        how = replace(how, offset=tuple(offset), yaw=how.yaw + beliefs.placed[2])
        trial = Trial(pattern, plant.rod, path, plant.friction, how, Tail.none(path))
        given = {"friction_field": plant.friction_field, **options, **more}
        (laid,) = yield Asked([trial], None, given)
        return laid

    s = trajectory.arc_length
    gone = float(s[min(int(np.searchsorted(s, hold)) + _LEAST_POSES, len(s) - 1)])
    path, looks = way.until(gone).path, []
    held: dict[str, Any] = {"release": gone + hold}
    laid = yield from really(path, **held)
    for picture in range(sight.pictures):
        seen, still = Seen.of(laid, gone, sight, rng), picture > 0
        misfit, _ = yield from beliefs.update(gone, path, seen, still=still, **held)
    if known:
        beliefs.know(plant.friction.static, plant.disturbance, plant.friction_field)
    looks.append(_look(beliefs, path, gone, misfit, None))
    way, beliefs.placed = yield from _Now(beliefs, way, gone, np.zeros(2), horizon).begun()
    while gone + every < way.end - 0.5 * every:
        told = 0.0
        for to in np.linspace(gone, gone + every, sight.pictures + 1)[1:]:
            path, at = way.until(to).path, way.laid_at(to)
            seen = Seen.of((yield from really(path)), at, sight, rng)
            misfit, laid = yield from beliefs.update(at, path, seen)
            if known:
                beliefs.know(plant.friction.static, plant.disturbance, plant.friction_field)
                laid = yield from beliefs.lay(path)
            aside = beside.told(laid, at, seen, to)
            told += doubted(laid, pattern, at, seen)
        times = sum(look.back is not None for look in looks)
        now = _Now(beliefs, way, float(to), aside, horizon)
        way, gone, back = yield from now.replanned(
            again and told > _BEYOND_NOISE and times < _MOST_TIMES
        )
        looks.append(_look(beliefs, path, at, misfit, back))
    return Followed(way.path, (yield from really(way.path)), looks)


@dataclass(frozen=True)
class _Now:
    """A moment of a deployment: what is believed, the way, how much of it is gone [m], how far what
    lies near the contact is beside what is believed to (2,) [m], and how far ahead the path is
    corrected [L_gb]."""

    beliefs: Beliefs
    way: Way
    gone: float
    aside: np.ndarray
    horizon: float

    def begun(self) -> Course[tuple[Way, np.ndarray]]:
        """The way of a deployment that is begun anew, and where the robot places all of it then
        (3,) [m, rad]."""
        beliefs = self.beliefs
        beliefs.placed[:2] -= beliefs.offset
        _, _, way, placed = yield from self._corrected(self.way, beliefs.hold, anew=True)
        return way, placed

    def replanned(self, again: bool) -> Course[tuple[Way, float, float | None]]:
        """The way from now on; how much of it is gone where it begins to lay [m]; and the laid
        length to which it goes back, if it does [m]."""
        beliefs, pattern = self.beliefs, self.beliefs.pattern
        at = self.way.laid_at(self.gone)
        before, after, way, _ = yield from self._corrected(self.way, self.gone)
        s = np.linspace(0.0, pattern.length, METRIC_POINTS) + pattern.remainder_length
        lately = (s > at - _LOOKED_AT) & (s <= at)
        if not again or not lately.any() or before[lately].mean() < _WRONG:
            return way, self.gone, None
        begins = float(s[lately & (before > _BEGINS * _WRONG)][0]) - _BEFORE
        back, turn = self.way.back(self.gone, max(begins, beliefs.hold + _BEFORE))
        _, better, back, _ = yield from self._corrected(back, turn)
        if not (after - better)[s <= at].sum() > _GAIN * METRIC_POINTS:
            return way, self.gone, None
        return back, turn, back.laid_at(turn)

    def _corrected(
        self, way: Way, turn: float, anew: bool = False
    ) -> Course[tuple[np.ndarray, np.ndarray, Way, np.ndarray]]:
        """(50,) error that is expected along the pattern before and after [m], and the way
        corrected from now on, at first without a step or a kink, which lays rod from `turn` on;
        or all of it `anew`, and where the robot then places it (3,) [m, rad]. What lies near or
        beyond there comes to lie `aside` of what is believed."""
        beliefs, pattern = self.beliefs, self.beliefs.pattern
        lgb = beliefs.rod.gravito_bending_length
        last, s = turn + self.horizon * lgb, way.laid_at(turn)
        c = way.corrections(pattern, lgb, turn if anew else self.gone, last)
        fixed = 0 if anew else 3 * _FIXED
        near = way.until(last).laid
        columns = Directions.of_path(c.columns()[fixed:, : len(near)])
        along = np.linspace(0.0, pattern.length, METRIC_POINTS) + pattern.remainder_length
        there = np.tile(along <= near[-1], 2)
        beyond = np.outer(self.aside, along > s - _LOOKED_AT).ravel()
        # What a value of 1 shifts and turns of what is begun anew.
        rigid = lgb * np.array([1.0, 1.0, 1.0 / last])[: 3 if anew else 0]
        cost = c.cost(_SIZE, _ROUGHNESS)[fixed:, fixed:]
        cost = METRIC_POINTS * lgb**2 * block_diag(cost, _SIZE * np.eye(len(rigid)))

        def moved(values: np.ndarray) -> tuple[Way, np.ndarray]:
            placed = beliefs.placed.copy()
            placed[: len(rigid)] += rigid * values[len(columns) :]
            values = np.concatenate([np.zeros(fixed), values[: len(columns)]])
            return Way(c.apply(values), way.laid), placed

        def at(values: np.ndarray) -> Course[_Point]:
            ahead, placed = moved(values)
            laid = yield from beliefs.lay(ahead.until(last).path, columns, placed)
            error, rates = misplacement(pattern, laid)
            rates = np.column_stack([rates, rigid * _rigid_rates(pattern, error)[:, : len(rigid)]])
            lost = laid.diverged or not np.isfinite(rates).all()
            error = (error + beyond) * there + (np.inf if lost else 0.0)
            return _Point(values, error, rates * there[:, None], cost)

        first = now = yield from at(np.zeros(len(cost)))
        radius = _STEP
        for _ in range(_STEPS if np.isfinite(now.value) else 0):
            step = now.step(radius, _DAMPING * METRIC_POINTS * lgb**2)
            length, promised = np.abs(step).max(), now.value - now.ahead(step)
            if not promised > max(_DONE * now.value, METRIC_POINTS * _FELT**2):
                break
            tried = yield from at(now.values + step)
            saved = now.value - tried.value
            if not saved > 0.0:
                radius = _SHORTER * length
                continue
            now = tried
            if not saved > _KEPT_PROMISE * promised:
                radius = _SHORT * length
            elif length > 0.9 * radius:
                radius *= _LONGER
        lost, left = (np.hypot(*one.error.reshape(2, -1)) for one in (first, now))
        return lost, left, *moved(now.values)


def _rigid_rates(pattern: Pattern, error: np.ndarray) -> np.ndarray:
    """(2 x 50, 3) derivatives of what lies `error` (2 x 50,) [m] from the points of the metric by
    shifts of all of it and by its turn about the pattern's beginning."""
    s = np.linspace(0.0, pattern.length, METRIC_POINTS)
    origin = pattern.sample(-pattern.remainder_length)[0][0, :2]
    x, y = error.reshape(2, -1) + (pattern.sample(s)[0][:, :2] - origin).T
    one, none = np.ones(METRIC_POINTS), np.zeros(METRIC_POINTS)
    return np.column_stack([np.r_[one, none], np.r_[none, one], np.r_[-y, x]])


@dataclass(frozen=True)
class _Point:
    """Corrections `values` (n,) [L_gb], errors (m,) that are expected of them [m], the derivatives
    (m, n) of these, and the matrix (n, n) of what the corrections cost, as squared errors."""

    values: np.ndarray
    error: np.ndarray
    rates: np.ndarray
    cost: np.ndarray

    @property
    def value(self) -> float:
        """Squared errors, and what the corrections cost [m^2]."""
        return float(self.error @ self.error + self.values @ self.cost @ self.values)

    def ahead(self, step: np.ndarray) -> float:
        """What `value` would be after a step, if errors were linear [m^2]."""
        error, values = self.error + self.rates @ step, self.values + step
        return float(error @ error + values @ self.cost @ values)

    def step(self, radius: float, damping: float) -> np.ndarray:
        """(n,) by which they get least, damped until none of it is larger than `radius`: cut, it
        would lose what is well determined with what is not."""
        matrix = self.rates.T @ self.rates + self.cost
        slope = self.rates.T @ self.error + self.cost @ self.values
        step = -np.linalg.solve(matrix, slope)
        while np.abs(step).max() > radius:
            step = -np.linalg.solve(matrix + damping * np.eye(len(slope)), slope)
            damping *= 2.0
        return step


def _look(beliefs: Beliefs, path: Trajectory, s: float, misfit: float, back: float | None) -> Look:
    trial = beliefs.trial(path)
    x, y = beliefs.offset
    (mu,), (error,) = beliefs.under(np.array([s]))
    factor = np.ones(1) if beliefs.field is None else np.asarray(beliefs.field.factor)
    return Look(
        s,
        float(mu),
        float(error),
        trial.disturbance.lgb_error,
        trial.disturbance.natural_curvature,
        (float(x), float(y)),
        misfit,
        (float(factor.min()), float(factor.max())),
        back,
    )
