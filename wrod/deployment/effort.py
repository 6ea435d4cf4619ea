"""What it takes to correct a plan for a table, and to look on, before anything is computed."""

from typing import Any

import numpy as np

from wrod.deployment.descent import paces
from wrod.deployment.expectation import PACE, coarse_mesh, judging_mesh
from wrod.deployment.spread import Spread, samples_of
from wrod.patterns.pattern import Pattern
from wrod.rods.model import Rod

# Processor time of a node for each second of a rod's way [s]: with the derivatives by a path, and
# where plans are judged; by how much a card is faster; and of looking on, by the squared length
# [s/m^2]. Of a core of an EPYC.
_DERIVED, _JUDGED, _CARD, _LOOKING = 6e-4, 2e-4, 5.0, 130.0
# The grip's way over the contact's, by curvature [1/L_gb] and its slope [1/L_gb^2], as plans of
# eighteen patterns with three rods have it within a sixth; what it takes before and after [s].
_BY_CURVATURE, _BY_SLOPE, _BEGIN_AND_END, _HOLD = 1.08, 3.4, 2.2, 0.05
# Largest curvature [1/L_gb] that a friction lays without a correction.
_LAID_BY, _LAYS = (0.1, 0.26, 0.55, 1.6), (0.25, 0.5, 1.0, 2.0)
# What turns beyond that is corrected in so many steps, and in these with each radian, up to that
# many radians; from more on, of two rods and of four, bend by bend, which takes as long as these:
# some before and after, and most between them are parts of the way.
_STEPS, _MORE, _MOST, _BEND_BY_BEND = 2.0, 1.2, 2.0, 12.0
_FAR = {2: 2.7, 4: 1.5}
# Paths that are judged, by so many rods, and nodes of what hangs.
_PATHS, _RODS, _HANGING = 3.0, 12, 30


def corrected(
    pattern: Pattern,
    rod: Rod,
    friction: float | tuple[float, float] | Spread,
    *,
    pace: float | tuple[float, float] | None = None,
    most: float = np.inf,
    device: str = "cpu",
) -> float:
    """Processor time of `wrod.deployment.optimise.optimise` [s].

    Most plans take as long within a factor of 1.5, counted in deployments: which ones are laid bend
    by bend is not always to be seen beforehand.

    Args:
        pattern: with its remainder.
        rod: what is laid.
        friction: of the table, see `optimise`.
        pace: of the contact [m/s], or a range; None: the usual one.
        most: that its steps may take [s].
        device: "cpu", or else a GPU.
    """
    if isinstance(pace, tuple):
        how: dict[str, Any] = {"most": most, "device": device}
        return sum(corrected(pattern, rod, friction, pace=v, **how) for v in paces(pace))
    spread, lgb = Spread.of(friction), rod.gravito_bending_length
    s = np.linspace(-pattern.remainder_length, pattern.length, 2000)
    curvature = np.abs(pattern.sample(s)[2]) * lgb
    beyond = np.maximum(curvature - np.interp(spread.friction[0], _LAID_BY, _LAYS), 0.0)
    turned = float(np.trapezoid(beyond, s / lgb))
    rods = samples_of(spread)
    steps = _STEPS + _MORE * min(turned, _MOST) if turned < _FAR[rods] else _BEND_BY_BEND
    laid = s[-1] - s[0]
    coarse, fine = (laid / mesh(lgb).spacing + _HANGING for mesh in (coarse_mesh, judging_mesh))
    way = way_time(pattern, rod, pace or PACE) / (1.0 if device == "cpu" else _CARD)
    return min(_DERIVED * steps * rods * coarse * way, most) + _JUDGED * _PATHS * _RODS * fine * way


def way_time(pattern: Pattern, rod: Rod, pace: float) -> float:
    """How long the grip is on its way [s], to within a sixth."""
    lgb = rod.gravito_bending_length
    s = np.linspace(_HOLD - pattern.remainder_length, pattern.length, 2000)
    curvature = np.abs(pattern.sample(s)[2]) * lgb
    slope = np.gradient(curvature, s / lgb)
    over = np.sqrt(1.0 + (_BY_CURVATURE * curvature) ** 2 + (_BY_SLOPE * slope) ** 2)
    return _BEGIN_AND_END + max(float(s[-1] - s[0]), 0.0) / pace * float(over.mean())


def looking_on(pattern: Pattern) -> float:
    """Processor time of a deployment that is looked at on the way, and planned anew [s]."""
    return _LOOKING * (pattern.length + pattern.remainder_length) ** 2
