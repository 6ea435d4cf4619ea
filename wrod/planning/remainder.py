"""What is laid before a pattern, so that its beginning stays where it is put."""

import warnings

import numpy as np

from wrod.errors import PatternError, WrodWarning
from wrod.patterns.pattern import Pattern
from wrod.planning.sources import MIN_SUSPENDED_LENGTH
from wrod.rods.model import Rod

# A pattern whose beginning would spring off by more than this [L_gb], once let go on a table of
# this friction, gets a remainder unless the caller decides: one that begins with a curvature of
# 0.15 / L_gb, or the paper's letter C, which bends soon after; its others stay below 0.04.
_SPRINGS_OFF, _SLIPPERY = 0.15, 0.3
# The beginning that is looked at [L_gb].
_BEGINNING, _BEGINNING_POINTS = 6.0, 400
# A default remainder is long enough to ask for this static friction at most...
_REMAINDER_FRICTION = 0.25
# ... but turns by no more than this [rad], which binds for stiff rods, unless that is too short for
# the friction to hold it, and one that is not turns by no more than the second.
_REMAINDER_TURN, _HELD_TURN = 0.8, 1.7
# A gentle one shorter than this part of one by which the bends hold is another.
_ANOTHER = 0.9


def prepare(pattern: Pattern, rod: Rod, remainder: bool | float | None) -> Pattern:
    """The pattern with the remainder that `plan` lays before it, checked against the rod's length.

    Raises:
        PatternError: pattern and remainder leave less than 1 L_gb of the rod suspended.
    """
    spare = rod.length - MIN_SUSPENDED_LENGTH * rod.gravito_bending_length
    _refuse_long(pattern, rod, spare)
    if remainder is False or pattern.remainder_length > 0.0:
        return pattern
    if remainder is None:
        return lead_ins(pattern, rod)[0]
    if remainder is True:
        _, start = free_end(pattern, rod)
        if start == 0.0:
            return pattern
        remainder = _remainder_length(pattern, start, rod)
    led = pattern.with_remainder(float(remainder))
    _refuse_long(led, rod, spare)
    return led


def lead_ins(pattern: Pattern, rod: Rod) -> list[Pattern]:
    """The pattern with the remainder that it has by default, none where its beginning stays, and
    with a shorter one by which it may lie better for all that the first holds.

    Args:
        pattern: with room for itself, see `prepare`.
        rod: what is laid.

    Warns:
        WrodWarning: the rod leaves no room for one.
    """
    off, start = free_end(pattern, rod)
    if pattern.remainder_length > 0.0 or off < _SPRINGS_OFF * (1.0 - 1e-3):
        return [pattern]
    # A shorter remainder asks for more friction, which the metadata says; one much shorter than a
    # gentle one asks for more than it saves.
    gentle = _gentle_length(start, rod)
    room = rod.length - MIN_SUSPENDED_LENGTH * rod.gravito_bending_length - pattern.length
    if room <= 0.5 * gentle:
        warnings.warn(
            f"no room for a lead-in: let go, the free end is expected to spring off by "
            f"{100.0 * off * rod.gravito_bending_length:.1f} cm at friction {_SLIPPERY:g}; a "
            f"rod of {rod.length + gentle - room:.3f} m has room for one, as has a smaller pattern",
            WrodWarning,
            stacklevel=1,  # said once, whoever asks
        )
        return [pattern]
    lengths = [min(_remainder_length(pattern, start, rod), room)]
    if gentle < _ANOTHER * lengths[0]:
        lengths.append(gentle)
    return [pattern.with_remainder(length) for length in lengths]


def free_end(pattern: Pattern, rod: Rod) -> tuple[float, float]:
    """How far the pattern's first point is expected to spring off once it is let go on a table of
    friction 0.3 [L_gb], and the largest curvature of the stretch that does [1/m].

    Friction over a length s from the free end supplies at most the moment mu w s^2 / 2, and the
    rod, k_b = 2 w L_gb^3, asks for k_b kappa(s): where it asks for more, it straightens.
    """
    lgb = rod.gravito_bending_length
    s, bend = _beginning(pattern, rod)
    held = bend * lgb <= 0.25 * _SLIPPERY * (s / lgb) ** 2
    held[0] = bend[0] == 0.0
    # What straightens begins at the free end, or where the rod, straight until then, bends.
    last = int(np.flatnonzero(~held)[-1]) if not held.all() else 0
    if last == 0:
        return 0.0, float(bend[0])
    turns = bend[: last + 1] * s[: last + 1]
    off = float(np.sum(0.5 * (turns[1:] + turns[:-1]) * np.diff(s[: last + 1])))
    return off / lgb, float(bend[: last + 1].max())


def _beginning(pattern: Pattern, rod: Rod) -> tuple[np.ndarray, np.ndarray]:
    """Arc length [m] and size of the curvature [1/m] of a pattern's first 6 L_gb."""
    longest = _BEGINNING * rod.gravito_bending_length
    s = np.linspace(0.0, min(longest, pattern.length), _BEGINNING_POINTS)
    return s, np.abs(pattern.sample(s)[2])


def _remainder_length(pattern: Pattern, curvature: float, rod: Rod) -> float:
    """Length [m] over which the curvature grows from zero with little friction, or, if that is
    longer, from which on friction 0.3 holds the moment of every bend, see `free_end`."""
    lgb, gentle = rod.gravito_bending_length, _gentle_length(curvature, rod)
    s, bend = _beginning(pattern, rod)
    held = float(np.max(2.0 * lgb * np.sqrt(bend * lgb / _SLIPPERY) - s))
    return max(gentle, held) if 0.5 * curvature * held <= _HELD_TURN else gentle


def _gentle_length(curvature: float, rod: Rod) -> float:
    """Length [m] over which the curvature grows from zero with little friction.

    The quintic smoothstep has |kappa''| <= 10 / sqrt(3) kappa / length^2, and mu_s = 2 L_gb^3
    |kappa''|.
    """
    steepest = 10.0 / np.sqrt(3.0) * curvature
    gentle = np.sqrt(2.0 * rod.gravito_bending_length**3 * steepest / _REMAINDER_FRICTION)
    return float(min(gentle, 2.0 * _REMAINDER_TURN / curvature))


def _refuse_long(pattern: Pattern, rod: Rod, spare: float) -> None:
    total = pattern.length + pattern.remainder_length
    # The tolerance lets a remainder fill the spare length exactly.
    if total <= spare * (1.0 + 1e-9):
        return
    led = (
        f" with its remainder of {pattern.remainder_length:.3f} m"
        if pattern.remainder_length
        else ""
    )
    hint = ""
    if pattern.length > 20.0 * rod.length:
        hint = " (are the coordinates in another unit? say so with units)"
    raise PatternError(
        f"{pattern.source}: is {total:.4g} m long{led}, and a rod of {rod.length:.4g} m that keeps "
        f"{MIN_SUSPENDED_LENGTH:g} L_gb suspended can lay {max(spare, 0.0):.4g} m; shorten the "
        f"pattern by {total - spare:.3g} m or take a longer rod{hint}"
    )
