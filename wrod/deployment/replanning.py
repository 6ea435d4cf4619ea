"""The rest of a grip's path, planned anew at a moment of a deployment for what is believed then."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from wrod.deployment.beliefs import Beliefs
from wrod.deployment.expectation import misplacement
from wrod.deployment.result import METRIC_POINTS
from wrod.deployment.tangents import Directions
from wrod.deployment.together import Course
from wrod.deployment.way import GripWay
from wrod.patterns.pattern import Pattern

# Costs of the corrections, a tenth of those in `optimise`: one rod is laid, not a sample of them.
_SIZE, _ROUGHNESS = 2e-4, 2e-4
# Largest change of a correction in an iteration [L_gb], at first; what is left of it after a change
# for the worse and after one that saves less than this part of what its model promised, and what it
# grows by after one that was cut to it and saves more. One step is not enough on a slippery table,
# where a rod answers linearly to a millimetre and not to a centimetre.
_STEP, _SHORTER, _SHORT, _LONGER, _KEPT_PROMISE = 0.35, 0.3, 0.5, 2.0, 0.5
# So many steps are tried at most, and none that would save less by its model than that part, or
# than a root mean square of that [m]: that is taken on trust, up to such a size [L_gb].
_STEPS, _DONE, _FELT, _TRUSTED = 10, 0.1, 1e-4, 0.03
# Damping of a step, relative to errors of 1 L_gb, that is tried first where it would be too large.
_DAMPING = 1e-6
# How far beyond the contact the path is corrected after a look: others follow [L_gb].
HORIZON = 6.0
# Over so much of the way the grip goes to where it is to be after a look [m]: were it to leave its
# path without a kink, the rod would be laid wrong for the next 5 L_gb where it slides.
_RISE = 0.01
# What lies is laid anew where it errs by more than this on average over so much rod before the
# contact, from where it begins to err by a share of that on, and from that much before, so that the
# grip is where it belongs when the contact comes there [m]; if the mean error of all is less by so
# much then [m].
_WRONG, _LOOKED_AT, _BEGINS, _BEFORE = 3e-4, 0.1, 0.5, 0.05
_GAIN = 2e-5
# Where the grip has gone back to about the same place before [m], it goes again only if that left
# less than so much of the error.
_THERE, _LEFT = 0.02, 0.7
# Shares of the time of a look that may be gone when the path ahead is corrected once more, and when
# it is asked whether to go back.
_FORWARDS, _BACK = 0.7, 0.85


# Pairs of others that are as likely as what is believed, which judge a way that is corrected: they
# are laid as its derivatives tell.
_PAIRS = 64


@dataclass(frozen=True)
class _Candidate:
    """A way, where the robot places all of it (3,) [m, rad], the laid length up to which it is
    judged [m], the errors (2 x 50,) that are expected of it [m], and their derivatives (2 x 50, n)
    by what is believed [m/deviation]."""

    way: GripWay
    placed: np.ndarray
    reach: float
    error: np.ndarray
    doubts: np.ndarray


@dataclass(frozen=True)
class Moment:
    """A moment of a deployment: what is believed, the way, how much of it is gone [m], how far what
    lies near the contact is beside what is believed to (2,) [m], how far ahead the path is
    corrected [L_gb], and the laid lengths to which the grip has gone back, each with the error that
    it went for [m]."""

    beliefs: Beliefs
    way: GripWay
    gone: float
    aside: np.ndarray
    horizon: float
    returns: list[tuple[float, float]] = field(default_factory=list)

    def begun(self) -> Course[tuple[GripWay, np.ndarray, bool]]:
        """The way of a deployment that is begun anew; where the robot places all of it then (3,)
        [m, rad]; and whether the way was kept, see `replanned`."""
        beliefs = self.beliefs
        beliefs.placed -= [*beliefs.offset, beliefs.yaw]
        _, _, old, new = yield from self._corrected(self.way, beliefs.hold, anew=True)
        kept = new is not old and not self._better(new, old)
        chosen = old if kept else new
        return chosen.way, chosen.placed, kept

    def replanned(self, again: bool) -> Course[tuple[GripWay, float, float | None, bool]]:
        """The way from now on; how much of it is gone where it begins to lay [m]; the laid length
        to which it goes back, if it does [m]; and whether it was kept though another is better by
        the beliefs: for others that are as likely as these it is not."""
        beliefs, pattern = self.beliefs, self.beliefs.pattern
        at = self.way.laid_at(self.gone)
        told = self._corrected(self.way, self.gone, share=_FORWARDS)
        before, after, old, new = yield from told
        kept = new is not old and not self._better(new, old)
        now, after = (old, before) if kept else (new, after)
        s = np.linspace(0.0, pattern.length, METRIC_POINTS) + pattern.remainder_length
        lately = (s > at - _LOOKED_AT) & (s <= at)
        wrong = float(before[lately].mean()) if lately.any() else 0.0
        if not again or wrong < _WRONG or beliefs.hurried(_BACK):
            return now.way, self.gone, None, kept
        begins = float(s[lately & (before > _BEGINS * _WRONG)][0]) - _BEFORE
        begins = max(begins, beliefs.hold + _BEFORE)
        if any(abs(to - begins) < _THERE and wrong > _LEFT * e for to, e in self.returns):
            return now.way, self.gone, None, kept
        back, turn = self.way.back(self.gone, begins)
        bar = float(after[s <= at].sum()) - _GAIN * METRIC_POINTS
        _, better, _, anew = yield from self._corrected(back, turn, bar=bar)
        if not better[s <= at].sum() < bar or not self._better(anew, now, at):
            return now.way, self.gone, None, kept
        self.returns.append((begins, wrong))
        return anew.way, turn, anew.way.laid_at(turn), False

    def _better(self, new: _Candidate, old: _Candidate, reach: float = np.inf) -> bool:
        """Whether one lays rods and tables that are as likely as those believed in better than the
        other, on average, as far as both lay them, up to `reach` at most [m]."""
        drawn, pattern = self.beliefs.drawn(_PAIRS), self.beliefs.pattern
        s = np.linspace(0.0, pattern.length, METRIC_POINTS) + pattern.remainder_length
        there = s <= min(reach, new.reach, old.reach)
        errors = []
        for one in (new, old):
            off = one.error + drawn @ one.doubts.T
            errors.append(np.hypot(*off.reshape(len(drawn), 2, -1).swapaxes(0, 1))[:, there].mean())
        return bool(errors[0] < errors[1])

    def _corrected(
        self,
        way: GripWay,
        turn: float,
        anew: bool = False,
        share: float = 1.0,
        bar: float = np.inf,
    ) -> Course[tuple[np.ndarray, np.ndarray, _Candidate, _Candidate]]:
        """(50,) error that is expected along the pattern before and after [m]; and the way before
        and after it is corrected from now on, which lays rod from `turn` on; or all of it `anew`.
        What lies near or beyond there comes to lie `aside` of what is believed. It is given up
        where the derivatives do not promise that the errors of what lies now, summed, come below a
        `bar` [m]."""
        beliefs, pattern = self.beliefs, self.beliefs.pattern
        lgb = beliefs.rod.gravito_bending_length
        last, s = turn + self.horizon * lgb, way.laid_at(turn)
        first, rise = (turn, 0.0) if anew else (self.gone, _RISE)
        c = way.corrections(pattern, lgb, first, last, rise)
        near = way.until(last).laid
        columns = Directions.of_path(c.columns()[:, : len(near)])
        along = np.linspace(0.0, pattern.length, METRIC_POINTS) + pattern.remainder_length
        there = np.tile(along <= near[-1], 2)
        beyond = np.outer(self.aside, along > s - _LOOKED_AT).ravel()
        # What a value of 1 shifts and turns of what is begun anew.
        rigid = lgb * np.array([1.0, 1.0, 1.0 / last])[: 3 if anew else 0]
        cost = c.cost(_SIZE, _ROUGHNESS)
        cost = METRIC_POINTS * lgb**2 * block_diag(cost, _SIZE * np.eye(len(rigid)))

        def moved(values: np.ndarray) -> tuple[GripWay, np.ndarray]:
            placed = beliefs.placed.copy()
            placed[: len(rigid)] += rigid * values[len(columns) :]
            return GripWay(c.apply(values[: len(columns)]), way.laid), placed

        def at(values: np.ndarray) -> Course[_Point]:
            ahead, placed = moved(values)
            path = ahead.until(last).path
            laid = yield from beliefs.felt(path, columns, placed)
            error, rates = misplacement(pattern, laid)
            doubts, rates = np.split(rates, [-len(columns)], axis=1)
            rates = np.column_stack([rates, rigid * _rigid_rates(pattern, error)[:, : len(rigid)]])
            lost = laid.diverged or not np.isfinite(rates).all()
            error = (error + beyond) * there + (np.inf if lost else 0.0)
            return _Point(values, error, rates * there[:, None], doubts, cost)

        lies = along <= way.laid_at(self.gone)

        def lying(point: _Point) -> float:
            return float(np.hypot(*point.error.reshape(2, -1))[lies].sum())

        first = now = yield from at(np.zeros(len(cost)))
        radius, damping = _STEP, _DAMPING * METRIC_POINTS * lgb**2
        for _ in range(_STEPS if np.isfinite(now.value) else 0):
            best = now.after(now.step(np.inf, damping))
            if min(lying(now), lying(best)) > bar:
                break
            step = now.step(radius, damping)
            length, promised = np.abs(step).max(), now.value - now.after(step).value
            worth = promised > max(_DONE * now.value, METRIC_POINTS * _FELT**2)
            if not worth or beliefs.hurried(share):
                now = now.after(now.step(min(radius, _TRUSTED), damping))
                break
            tried = yield from at(now.values + step)
            saved = now.value - tried.value
            if not saved > 0.0:
                radius = _SHORTER * length
                continue
            now = tried
            if not saved > _KEPT_PROMISE * promised:
                radius = _SHORT * length
            elif length > 0.8 * radius:
                radius *= _LONGER
        lost, left = (np.hypot(*one.error.reshape(2, -1)) for one in (first, now))
        reach = float(near[-1])
        old = new = _Candidate(way, beliefs.placed, reach, first.error, first.doubts)
        if now is not first:
            new = _Candidate(*moved(now.values), reach, now.error, now.doubts)
        return lost, left, old, new


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
    (m, n) of these, and (m, k) by what is believed, and the matrix (n, n) of what the corrections
    cost, as squared errors."""

    values: np.ndarray
    error: np.ndarray
    rates: np.ndarray
    doubts: np.ndarray
    cost: np.ndarray

    @property
    def value(self) -> float:
        """Squared errors, and what the corrections cost [m^2]."""
        return float(self.error @ self.error + self.values @ self.cost @ self.values)

    def after(self, step: np.ndarray) -> _Point:
        """After a step, if errors were linear."""
        error = self.error + self.rates @ step
        return replace(self, values=self.values + step, error=error)

    def step(self, radius: float, damping: float) -> np.ndarray:
        """(n,) by which they get least, damped until none of it is larger than `radius`: cut, it
        would lose what is well determined with what is not."""
        matrix = self.rates.T @ self.rates + self.cost
        slope = self.rates.T @ self.error + self.cost @ self.values
        step = -np.linalg.solve(matrix, slope)
        while np.abs(step).max() > radius:
            step = -np.linalg.solve(matrix + damping * np.eye(len(slope)), slope)
            damping *= 1.2
        return step
