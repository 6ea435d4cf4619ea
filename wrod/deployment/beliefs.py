"""What is believed of a rod and its table while it is laid, and how looks change it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from wrod.deployment.discretisation import Discretisation
from wrod.deployment.expectation import FINE, PACE
from wrod.deployment.friction_modes import FrictionModes
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.setup import Disturbance
from wrod.deployment.sight import Seen, interpolated
from wrod.deployment.simulate import Trial
from wrod.deployment.tangents import Directions, Laid
from wrod.deployment.together import Asked, Course
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.solvers.friction import Friction, FrictionField

# Standard deviations of what may be wrong and nobody declared: of the logarithms of friction and
# stiffness [-], natural curvature [1/m], and the robot's place [m] and yaw [rad].
_DOUBT = np.array([0.5, 0.5, 3.0, 2e-3, 2e-3, 5e-3])
# How much less sure these are at a look, in these: where all is as before, or where it changes as
# things do.
_DRIFT = np.array([0.1, 0.05, 0.05, 0.1, 0.1, 0.1])
_DRIFTS = 0.1 * _DRIFT, _DRIFT
# How likely it is, before anything is seen, that friction differs from place to place.
_VARIES = 0.05
# Change of a belief up to which what lies answers linearly, in these; how often it is made linear
# anew for one that is larger and more than that part of its error, for all accounts together up to
# such a change; then for each by itself, and the largest change between two times.
_LINEAR, _TOGETHER, _ENOUGH, _MOST_TOGETHER = 0.05, 2, 0.2, 0.3
_ITERATIONS, _MOST_CHANGE = 8, 1.0
# Share of the time of a look that may be gone when they are made linear anew.
_SHARE = 0.4
# Which of these moves all that lies, and nothing else.
_PLACE = slice(3, 6)
# Residual forces and steps that are enough for what is believed, see `lay`: by the first what lies
# changes by 1 um, by steps of 40 instead of 20 ms by some 0.03 mm.
_MESH = replace(FINE, step=0.04, tolerance=1e-4)
# Points along a rod where friction by place is said to it.
_ALONG = 400
# What a point differs by though the beliefs are right: mesh, shaking, whatever else [m], in all
# pictures of a look alike; and how far behind the contact a look tells of beliefs [m]: what lies
# there has told of them before.
_MODEL_ERROR, _MODEL_ERROR_HANGING = 1e-3, 3e-3
_MEMORY = 0.12


@dataclass(frozen=True)
class Account:
    """One account of what is seen: mean (n,) and covariance (n, n) of what may be wrong, in
    deviations, and the logarithm of its evidence."""

    mean: np.ndarray
    covariance: np.ndarray
    evidence: float

    def after(
        self, here: np.ndarray, information: np.ndarray, pull: np.ndarray, still: bool
    ) -> Account:
        """With a picture that has such an information (n, n) and pull (n,) about the beliefs `here`
        (n,); the drift before it is the likeliest, or none where the grip stood `still`."""
        apart = self.mean - here
        fit = (pull - 0.5 * information @ apart) @ apart
        left, told = pull - information @ apart, []
        for drift in (0.0 * _DRIFT,) if still else _DRIFTS:
            grown = np.diag(np.pad(drift**2, (0, len(here) - len(drift))))
            before = self.covariance + grown
            spread = np.eye(len(here)) + information @ before
            covariance = before @ np.linalg.inv(spread)
            step = covariance @ left
            likely = fit + 0.5 * (left @ step - np.linalg.slogdet(spread)[1])
            told.append(Account(self.mean + step, covariance, self.evidence + float(likely)))
        return max(told, key=lambda one: one.evidence)


class Beliefs:
    """Friction, stiffness, natural curvature and place of the robot, with their covariance; and how
    friction varies over the table, as far as it is likely to.

    Args:
        pattern: that is laid.
        rod: that is believed in at first.
        friction: likewise.
        hold: length of the free end that is held at first [m].
    """

    def __init__(self, pattern: Pattern, rod: RodMaterial, friction: float, hold: float):
        self.pattern, self.rod, self.hold = pattern, rod, hold
        self.friction = friction
        self.places = FrictionModes(pattern)
        self.told_field: FrictionField | None = None
        # In deviations: logarithms of friction and stiffness, natural curvature, offset; and what
        # friction differs by from place to place.
        same = np.r_[np.ones(len(_DOUBT)), np.zeros(self.places.count)]
        chances = (same, 1.0 - _VARIES), (np.ones(len(same)), _VARIES)
        self.accounts = [Account(0.0 * same, np.diag(v), float(np.log(p))) for v, p in chances]
        # How far the robot has moved all that it does since [m], and turned it [rad].
        self.placed = np.zeros(3)
        # For what deployments are laid, and what these have come to on the way.
        self.about, self.remembered = 0.0 * same, LastDeployments()
        # Processor time that a look may take, what deployments had when it began [s], and whether
        # it was ended by that.
        self._patience, self._begun, self.cut = np.inf, 0.0, False

    @property
    def account(self) -> Account:
        """All of them: what has slid nowhere yet may be another than it is where it slid."""
        return _all_of(self.accounts)

    @property
    def mean(self) -> np.ndarray:
        """(6,) without what friction differs by from place to place [deviations]."""
        return self.account.mean[: len(_DOUBT)]

    @property
    def field(self) -> FrictionField | None:
        """How friction varies over the table; None: it does not."""
        return self._field(self.account.mean)

    def _field(self, mean: np.ndarray) -> FrictionField | None:
        varied = mean[len(_DOUBT) :]
        return self.places.field(varied) if varied.any() else self.told_field

    @property
    def offset(self) -> np.ndarray:
        """(2,) of the robot, before it moved all that it does [m]."""
        return (self.mean * _DOUBT)[3:5]

    @property
    def yaw(self) -> float:
        """Of the robot about the pattern's beginning, likewise [rad]."""
        return float(self.mean[5] * _DOUBT[5])

    def drawn(self, count: int) -> np.ndarray:
        """(2 count, n) of what may be wrong, beside what is believed: in pairs that lie opposite
        each other, and as likely as its covariance has them [deviations]."""
        values, vectors = np.linalg.eigh(self.account.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        half = np.random.default_rng(0).standard_normal((count, len(root))) @ root.T
        return np.concatenate([half, -half])

    def looking(self, patience: float) -> None:
        """A look begins, which may take so much processor time [s]."""
        self._patience, self._begun, self.cut = patience, self.remembered.effort, False

    def hurried(self, share: float) -> bool:
        """Whether the look ends what it does as it has taken such a share of its time; on a GPU it
        never has."""
        late = self.remembered.effort - self._begun > share * self._patience
        self.cut |= late
        return late

    def know(self, friction: float, how: Disturbance, field: FrictionField | None) -> None:
        """Believe the truth."""
        stiffness = 3.0 * np.log1p(how.lgb_error)
        mu = np.log(friction / self.friction)
        mean = np.array([mu, stiffness, how.natural_curvature, *how.offset, how.yaw])
        mean /= _DOUBT
        mean = np.pad(mean, (0, self.places.count))
        self.accounts = [replace(one, mean=mean) for one in self.accounts]
        self.about, self.told_field = mean, field

    def trial(
        self, path: Trajectory, placed: np.ndarray | None = None, mean: np.ndarray | None = None
    ) -> Trial:
        """The deployment that is believed in, or of another `mean`, all of it `placed` (3,) [m,
        rad] elsewhere; the grip stays where the path ends."""
        mean = self.account.mean if mean is None else mean
        mu, stiffness, natural, *own = (mean[: len(_DOUBT)] * _DOUBT).tolist()
        x, y, turned = self.placed if placed is None else placed
        how = Disturbance(
            lgb_error=float(np.exp(stiffness / 3.0) - 1.0),
            natural_curvature=natural,
            offset=(own[0] + float(x), own[1] + float(y)),
            yaw=own[2] + float(turned),
        )
        law = Friction(float(self.friction * np.exp(mu)))
        return Trial(self.pattern, self.rod, path, law, how, Tail.none(path))

    def felt(
        self,
        path: Trajectory,
        more: Directions | None = None,
        placed: np.ndarray | None = None,
        mean: np.ndarray | None = None,
        **options,
    ) -> Course[Laid]:
        """What is believed to lie at the end of a path, and its derivatives by all that is believed
        [m/deviation], and after these along `more`; `placed` and of a `mean` as in `trial`.

        As long as what is believed is nearly what deployments were laid for, what lies answers
        linearly, and these go on from where they have come to.
        """
        account = self.account
        mean = account.mean if mean is None else mean
        if not _enough(replace(account, mean=mean), self.about):
            self.about = mean
        apart = mean - self.about
        directions = self._directions(path)
        directions = directions if more is None else directions + more
        mesh = meshed_to_the_end(options.pop("discretisation", _MESH), self.pattern)
        how = {"friction_field": self._field(self.about), "speed": PACE, **options}
        trial = self.trial(path, placed, self.about)
        asked = [trial], [directions], how | {"discretisation": mesh}
        (laid,) = yield Asked(*asked, [self.remembered])
        start = self.pattern.sample(-self.pattern.remainder_length)[0][0]
        around = laid.centerline - start - [*trial.disturbance.offset, 0.0]
        moved = np.zeros((3, *around.shape))
        moved[0, :, 0] = moved[1, :, 1] = 1.0
        moved[2] = np.cross([0.0, 0.0, 1.0], around)
        moved *= _DOUBT[3:, None, None]
        tangent = np.concatenate([laid.tangent[:3], moved, laid.tangent[3:]])
        lies = laid.centerline + np.tensordot(apart, tangent[: len(apart)], 1)
        return replace(laid, centerline=lies, tangent=tangent)

    def update(
        self, s: float, path: Trajectory, pictures: list[Seen], still: bool = False, **options
    ) -> Course[tuple[float, Laid]]:
        """By pictures of the grip standing where `s` [m] is laid, at the end of a path: root mean
        square of what lies against what was believed before [m], and what is believed to lie since.
        Nothing has changed since the last look if the grip stood `still` ever since."""
        prior, misfit = self.accounts, None
        for _ in range(_TOGETHER):
            laid = yield from self.felt(path, **options)
            if misfit is None:
                residual = told_by(laid, s, pictures[0])[2][: pictures[0].laid, :2]
                misfit = float(np.sqrt(np.mean(residual**2)))
            here = self.account.mean
            self.accounts = [_told(one, here, laid, s, pictures, still) for one in prior]
            step = self.account.mean - here
            if _enough(self.account, self.about):
                lies = laid.centerline + np.tensordot(step, laid.tangent, 1)
                return misfit, replace(laid, centerline=lies)
            if np.abs(step).max() > _MOST_TOGETHER:
                break
        # Each by derivatives of its own: a rod that slides little where friction is high says by
        # its derivatives that it has to be far lower than it is, and more numbers explain that.
        told = []
        for one in prior:
            here = one.mean
            for _ in range(_ITERATIONS):
                laid = yield from self.felt(path, mean=here, **options)
                found = _told(one, here, laid, s, pictures, still)
                if _enough(found, here) or self.hurried(_SHARE):
                    break
                step = found.mean - here
                here = here + min(1.0, _MOST_CHANGE / float(np.abs(step).max())) * step
            told.append(found)
        self.accounts = told
        return misfit, (yield from self.felt(path, **options))

    def under(self, arc_length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Friction (n,) believed where a rod lies on the pattern at arc lengths (n,) [m], and the
        standard error (n,) of its logarithm."""
        modes = self.places.modes(arc_length)
        matrix = np.zeros((len(modes), len(self.account.mean)))
        matrix[:, 0], matrix[:, len(_DOUBT) :] = _DOUBT[0], modes
        error = np.sqrt(np.einsum("ni,ij,nj->n", matrix, self.account.covariance, matrix))
        return self.friction * np.exp(matrix @ self.account.mean), error

    def _directions(self, path: Trajectory) -> Directions:
        """Columns of all that is believed but the offset, per deviation."""
        mu, stiffness, natural = self.trial(path, None, self.about).friction.static, *_DOUBT[1:3]
        at = np.linspace(0.0, self.rod.length, _ALONG)
        friction = np.column_stack([np.full(_ALONG, _DOUBT[0]), self.places.modes(at)]).T * mu
        rod = np.zeros((2, _ALONG))
        one = np.eye(3 + self.places.count)
        return Directions(
            np.zeros((len(one), len(path), 6)),
            np.concatenate([friction[:1], rod, friction[1:]]),
            stiffness * one[1],
            natural * one[2],
        )


def meshed_to_the_end(mesh: Discretisation, pattern: Pattern) -> Discretisation:
    """For deployments of parts of a pattern, which go on from each other."""
    return replace(mesh, laid=pattern.length + pattern.remainder_length)


def _all_of(accounts: list[Account]) -> Account:
    """The mean of all, as likely as they are, and the covariance about it."""
    evidence = logsumexp([one.evidence for one in accounts])
    chance = np.exp([one.evidence - evidence for one in accounts])
    means = np.array([one.mean for one in accounts])
    apart = means - chance @ means
    covariance = np.tensordot(chance, [one.covariance for one in accounts], 1)
    return Account(chance @ means, covariance + (apart.T * chance) @ apart, float(evidence))


def _enough(account: Account, here: np.ndarray) -> bool:
    """Whether derivatives of what lies for beliefs `here` (n,) are those for an account, as far as
    it is sure; by the robot's place what lies always changes alike."""
    enough = np.maximum(_LINEAR, _ENOUGH * np.sqrt(np.diag(account.covariance)))
    return bool(np.delete(np.abs(account.mean - here) <= enough, _PLACE).all())


def _told(
    account: Account, here: np.ndarray, laid: Laid, s: float, pictures: list[Seen], still: bool
) -> Account:
    """An account after the pictures of a look, by what lies for the beliefs `here` (n,)."""
    for k, seen in enumerate(pictures):
        information, pull, _, unlikely = told_by(laid, s, seen, len(pictures))
        account = account.after(here, information, pull, still or k > 0)
        account = replace(account, evidence=account.evidence - unlikely)
    return account


def told_by(
    laid: Laid, s: float, seen: Seen, pictures: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """What is seen when `s` [m] is laid, on one of so many pictures of it, tells of what is
    believed to lie, by its derivatives: the information (n, n) and pull (n,) about these, the
    residuals (point, 3) [m], and how unlikely these are: minus its logarithm, but for a constant.
    """
    residual = seen.place - interpolated(laid.arc_length, laid.centerline, seen.arc_length)
    rates = [interpolated(laid.arc_length, c, seen.arc_length) for c in laid.tangent]
    matrix = np.reshape(rates, (len(rates), -1)).T
    model = np.where(np.arange(len(residual)) < seen.laid, _MODEL_ERROR, _MODEL_ERROR_HANGING)
    # All that the pictures tell together is as sure as 1 / (deviation^2 / pictures + model^2).
    weight = 1.0 / (seen.deviation**2 + pictures * model[:, None] ** 2)
    weight[seen.arc_length < s - _MEMORY] = 0.0
    weight, apart = weight.ravel(), residual.ravel()
    pulled = matrix.T * weight
    return pulled @ matrix, pulled @ apart, residual, 0.5 * float(weight @ apart**2)
