"""How far what lies is seen beside where it is believed to lie."""

import numpy as np

from wrod.deployment.sight import Seen, interpolated
from wrod.deployment.tangents import Laid
from wrod.patterns.pattern import Pattern

# Length before the contact over which what lies is compared with what is believed to, and over
# which it forgets how far beside that it is [m].
_NEAR, _STEP = 0.1, 1e-3
# Standard deviations that how far that is may have though the beliefs are right [m], how likely
# they are before a look tells (most often the beliefs say it all), and how likely it is that
# between two looks something comes up that nobody told of.
_BESIDE = np.array([0.0, 2e-4, 4e-4, 8e-4, 1.6e-3])
_LIKELY = np.array([0.8, 0.05, 0.05, 0.05, 0.05])
_NEWS = 0.05


def doubted(laid: Laid, pattern: Pattern, s: float, seen: Seen, aside: np.ndarray) -> float:
    """How much likelier it is to see what lies near the contact `aside` (2,) [m] of where it is
    believed to than on the pattern: twice the logarithm of that."""
    near = np.arange(len(seen.arc_length)) < seen.laid
    near &= seen.arc_length > max(s - _NEAR, pattern.remainder_length)
    at = seen.arc_length[near]
    believed = interpolated(laid.arc_length, laid.centerline, at) + [*aside, 0.0]
    wanted = pattern.sample(at - pattern.remainder_length)[0]
    weight = 1.0 / seen.deviation[near, :2] ** 2
    apart = [(seen.place[near] - one)[:, :2] ** 2 * weight for one in (wanted, believed)]
    return float(np.sum(apart[0] - apart[1]))


class Beside:
    """How far what lies near the contact is beside what is believed to lie there, look after look.

    A stationary process along the way for each of some deviations, none among them, which are as
    likely as they make what is seen: what the camera's noise explains moves no grip. Which of them
    it is may change from look to look: that all went well so far does not speak against what is
    seen now.
    """

    def __init__(self) -> None:
        self.mean = np.zeros((len(_BESIDE), 2))
        self.covariance = _BESIDE[:, None, None] ** 2 * np.eye(2)
        self.chance = _LIKELY
        self.gone = 0.0

    def told(self, laid: Laid, s: float, seen: Seen, gone: float) -> np.ndarray:
        """(2,) by what is seen when `s` [m] is laid and `gone` [m] of the way are gone [m]: what
        the beliefs cannot say is taken to go on. Only across the rod: how far along it a point is,
        a picture does not tell well."""
        left = np.exp(-(gone - self.gone) / _NEAR)
        if gone > self.gone:
            self.chance = (1.0 - _NEWS) * self.chance + _NEWS * _LIKELY
        self.gone, self.mean = gone, left * self.mean
        renewed = (1.0 - left**2) * _BESIDE[:, None, None] ** 2 * np.eye(2)
        self.covariance = left**2 * self.covariance + renewed
        across, apart = _across(laid, s, seen)
        weight = 1.0 / seen.deviation[0, 0] ** 2 if len(apart) else 0.0
        information = weight * across.T @ across
        told = weight * across.T @ apart
        pull = told - self.mean @ information
        # Against its being where it is believed to lie: what was known before, and what this adds.
        explained = np.einsum("ki,ki->k", told + pull, self.mean)
        spread = np.eye(2) + information @ self.covariance
        self.covariance = self.covariance @ np.linalg.inv(spread)
        step = np.einsum("kij,kj->ki", self.covariance, pull)
        self.mean = self.mean + step
        explained += np.einsum("ki,ki->k", pull, step)
        likely = 0.5 * (explained - np.linalg.slogdet(spread)[1])
        self.chance = self.chance * np.exp(likely - likely.max())
        self.chance = self.chance / self.chance.sum()
        return self.chance @ self.mean


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
