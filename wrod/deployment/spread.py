"""What a plan is to be good for: tables and rods that cover what is known of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wrod.deployment.setup import DEVIATIONS, Disturbance
from wrod.deployment.table import friction_range
from wrod.rods.material import RodMaterial
from wrod.rods.model import Rod
from wrod.rods.profile import Profile
from wrod.solvers.friction import Friction

# Ranges of friction that call for more rods, by the largest over the least.
_WIDE = 1.5
# Deviations of uniform variables, in those of normal ones whose middle 90 % they cover.
_REACH = 1.65
# Of the errors of L_gb and natural curvature of two pairs of rods: a half, in opposite corners.
_CORNERS = ((0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (-0.5, -0.5))
# A rod is believed to stretch as a solid one of its stiffness in bending; braids hardly do. The
# sample is in between: where it hangs from its end it is shorter by this [L_gb], unless that leaves
# less than this part of its stretch. No path lays rods alike that differ by much more, and none has
# to: what is believed to hang longer by over twice that is soft for its thickness as rubber is and
# no braid, and the stretch of a solid section follows from its bending.
_LESS_STRETCH, _LEAST_STRETCH = 0.075, 0.1
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class Spread:
    """What a plan is to be good for; deviations are standard deviations.

    Attributes:
        friction: least and largest coefficient [-].
        lgb_error: relative, of L_gb.
        natural_curvature: [1/m].
        stretch: whether the rod may stretch less than is believed, down to not at all: the sample
            is then between the two.
    """

    friction: tuple[float, float]
    lgb_error: float = DEVIATIONS["lgb_error"]
    natural_curvature: float = DEVIATIONS["natural_curvature"]
    stretch: bool = True

    @classmethod
    def of(cls, friction: float | tuple[float, float] | Spread) -> Spread:
        """That of a coefficient or of a range; see `friction_range`."""
        if isinstance(friction, Spread):
            return friction
        return cls(friction_range(friction))

    def sample(self, count: int, rod: Rod) -> list[tuple]:
        """(rod, friction, disturbance) of rods that cover it evenly, from low friction to high, in
        pairs that lie opposite each other: what errors answer linearly to then moves no plan."""
        low, high = self.friction
        held = stretching(rod, self._stretches(rod, _LESS_STRETCH)) if self.stretch else rod
        out = []
        for i in range(count):
            aside, bent = _CORNERS[i % 4] if i - i % 2 + 1 < count else (0.0, 0.0)
            disturbance = Disturbance(
                lgb_error=_REACH * self.lgb_error * aside,
                natural_curvature=_REACH * self.natural_curvature * bent,
            )
            mu = low + (high - low) * (i + 0.5) / count
            out.append((held, Friction(mu), disturbance))
        return out

    def unseen(self, count: int, rod: Rod) -> tuple[np.ndarray, np.ndarray]:
        """Friction (count,) from low to high, and the part (count,) of what is believed that a rod
        stretches by, which covers what may be in an order of its own."""
        shares = (_GOLDEN * np.arange(1, count + 1)) % 1.0
        least = self._least_stretch(rod)
        return np.linspace(*self.friction, count), least + (1.0 - least) * shares

    def middle(self, rod: Rod) -> tuple[float, float]:
        """Of what the friction and the part of the stretch may be."""
        return 0.5 * sum(self.friction), 0.5 * (self._least_stretch(rod) + 1.0)

    def _least_stretch(self, rod: Rod) -> float:
        return self._stretches(rod, 2.0 * _LESS_STRETCH) if self.stretch else 1.0

    @staticmethod
    def _stretches(rod: Rod, less: float) -> float:
        """The part of its stretch with which a rod that hangs is shorter by so much [L_gb]."""
        hanging = (rod.length / rod.gravito_bending_length) ** 2 / (4.0 * rod.stretch_ratio)
        return max(1.0 - less / hanging, _LEAST_STRETCH)


def samples_of(spread: Spread) -> int:
    """Rods that are laid at a time to correct a plan."""
    return 4 if spread.friction[1] > _WIDE * spread.friction[0] else 2


def stretching(rod: Rod, part: float) -> Rod:
    """A rod that stretches by that part of what this one does, with the same L_gb."""
    if isinstance(rod, RodMaterial):
        return replace(rod, radius=float(np.sqrt(part)) * rod.radius)
    profile = rod.stretching_stiffness
    stiffer = Profile(np.array(profile.values) / part, profile.knots)
    return replace(rod, stretching_stiffness=stiffer)
