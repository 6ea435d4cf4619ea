"""What is wrong with the grasps of a plan: errors, and warnings."""

import warnings

import numpy as np

from wrod.errors import GraspError, PatternError, RodError, StabilityWarning, WrodWarning
from wrod.grasps.mesh import WEIGHT
from wrod.grasps.results import LIMITS, Grasps
from wrod.patterns.pattern import Pattern
from wrod.planning.sources import GraspInputs
from wrod.rods.model import Rod

# Stiffness of a rod's softest motion over weight per length by suspended length. A chain that hangs
# without bending stiffness has (j_0 / 2)^2; optimal grasps have more, and one with a third of it
# would swing out three times as far as a chain.
CHAIN_MARGIN = 1.446
SMALL_STABILITY_MARGIN = CHAIN_MARGIN / 3.0
# What contacts may miss of a bend between them [m], and from where it is worth a word.
_ANOTHER, _STRAYS = 1e-2, 1e-3


def refuse_tight_bends(pattern: Pattern, rod: Rod) -> None:
    at, curvature = pattern.sharpest()
    if abs(curvature) * rod.radius >= 1.0:
        raise _too_tight(pattern, curvature, at, f"the rod's own radius of {rod.radius:g} m")


def refuse_unsolved_rod(rod: Rod) -> None:
    """Refuse rods of which more hangs than grasps are solved for, and ones too thick or thin."""
    longest = LIMITS["suspended_length"][1]
    lgb = rod.gravito_bending_length
    hangs = longest * lgb
    if rod.length > hangs:
        raise PatternError(
            f"of a rod of {rod.length:.4g} m grasps are solved up to the {hangs:.3g} m "
            f"({longest:g} L_gb) that may hang from the hand; check its length, its L_gb of "
            f"{lgb:.3g} m and their units, or let the hand hold it nearer, with that as its "
            "length, or lay the pattern in pieces"
        )
    low, high = LIMITS["stretch_ratio"]
    if not low <= rod.stretch_ratio <= high:
        raise RodError(
            f"the rod is too {'thick' if rod.stretch_ratio < low else 'thin'} for its stiffness: "
            f"with a radius of {rod.radius:.3g} m and an L_gb of {lgb:.3g} m "
            f"its stretch ratio is {rod.stretch_ratio:.3g}, and grasps are solved from {low:g} to "
            f"{high:g}; check both numbers and their units"
        )


def refuse_unsolved_bends(pattern: Pattern, rod: Rod, s: np.ndarray, curvature: np.ndarray) -> None:
    """Refuse contacts s (T,) [m] where the curvature (T,) [1/m] is beyond what is solved."""
    most = LIMITS["curvature"][1]
    bound, worst = most / rod.gravito_bending_length, int(np.argmax(np.abs(curvature)))
    if abs(curvature[worst]) > bound:
        why = f"the {bound:.3g} 1/m ({most:g} / L_gb) up to which grasps of this rod are solved"
        raise _too_tight(pattern, curvature[worst], s[worst], why)


def _too_tight(pattern: Pattern, curvature: float, at: float, than: str) -> PatternError:
    return PatternError(
        f"{pattern.source}: has a curvature of {curvature:.3g} 1/m at s = {at:.3f} m, tighter than "
        f"{than}; make it larger, check the rod's numbers and their units, or round it as "
        "`wrod plan` does (wrod.patterns.rounding.round_corners)"
    )


def judge_spacing(pattern: Pattern, spacing: float) -> None:
    """Refuse contacts so far apart that what is between them is another pattern, and warn of a
    millimetre."""
    s, curvature = pattern.sharpest()
    strays = spacing * min(spacing * abs(curvature), np.pi) / 8.0  # of an arc from its chord
    if strays <= _STRAYS:
        return
    said = (
        f"{pattern.source}: contacts {spacing:g} m apart cut bends of a radius of "
        f"{1.0 / abs(curvature):.3g} m (s = {s:.3f} m) by up to {1e3 * strays:.2g} mm; give a "
        "shorter spacing"
    )
    if strays > _ANOTHER:
        raise PatternError(said)
    warnings.warn(said, WrodWarning, stacklevel=4)


def refuse_unconverged(poses: Grasps, inputs: GraspInputs, s: np.ndarray) -> None:
    finite = np.all(np.isfinite(poses.position) & np.isfinite(poses.rotation), axis=1)
    good = finite if poses.converged is None else finite & poses.converged
    if np.all(good):
        return
    node = int(np.argmin(good))
    raise GraspError(
        f"no optimal grasp found at node {node} of {len(s)} (s = {s[node]:.4f} m, suspended "
        f"length {inputs.suspended_length[node]:.3f} L_gb, curvature "
        f"{inputs.curvature[node]:.3f} / L_gb, stretch ratio {inputs.stretch_ratio:.0f}; "
        f"{np.sum(~good)} nodes in all); make the pattern gentler there or the rod longer"
    )


def warn_relaxed(poses: Grasps, s: np.ndarray) -> None:
    if poses.natural_share is None:
        return
    less = np.concatenate([[False], poses.natural_share < 1.0, [False]])
    ends = np.flatnonzero(np.diff(less.astype(int)))
    where = ", ".join(f"{s[a]:.3f} to {s[b - 1]:.3f}" for a, b in ends.reshape(-1, 2))
    warnings.warn(
        f"{np.sum(less)} of {len(s)} grasps (s from {where} m) are of a rod with less natural "
        f"curvature, down to {np.min(poses.natural_share):.0%} of it: bent at rest as this one is, "
        "it would dip under the table there, pull at it or snap; "
        "expect it to lie off the pattern",
        WrodWarning,
        stacklevel=3,
    )


def warn_unstable(poses: Grasps, inputs: GraspInputs, s: np.ndarray) -> None:
    if poses.stable is not None and not np.all(poses.stable):
        where = s[~np.asarray(poses.stable, dtype=bool)]
        warnings.warn(
            f"{len(where)} of {len(s)} grasps are elastically unstable (s from {where.min():.3f} "
            f"to {where.max():.3f} m); the rod may snap there",
            StabilityWarning,
            stacklevel=3,
        )
        return
    if poses.eigenvalue is None:
        return
    margin = poses.eigenvalue * inputs.suspended_length / WEIGHT
    close = margin < SMALL_STABILITY_MARGIN
    if np.any(close):
        where, worst = s[close], int(np.argmin(margin))
        warnings.warn(
            f"{len(where)} of {len(s)} grasps come close to elastic instability (s from "
            f"{where.min():.3f} to {where.max():.3f} m; at {s[worst]:.3f} m the softest motion has "
            f"{margin[worst] / CHAIN_MARGIN:.0%} of a hanging chain's stiffness); "
            "hold the grip steady there or make the pattern gentler",
            StabilityWarning,
            stacklevel=3,
        )
