"""Where along the rod the grip holds it."""

from dataclasses import replace

from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod

# What hangs when the pattern is laid, and rod beyond the grip with less of which it is held at its
# end [L_gb].
LEFT, _WORTH = 4.0, 1.0
# Lengths that are the same, relative.
_SAME = 1e-6


def held_near(pattern: Pattern, rod: Rod, left: float = LEFT):
    """The rod as a grip holds it that leaves no more of it hanging than it needs.

    What hangs, l long, is stretched by l^2 / (4 k_s L_gb), of which nobody knows much, and by as
    much a rod begins its bends early or late (docs/deployment.md).

    Args:
        pattern: with its remainder.
        rod: of which all could hang.
        left: what is to hang when the pattern is laid [L_gb].

    Returns:
        The rod, as long as what is between its free end and the grip; as it was where the grip
        would come nearer by less than 1 L_gb.
    """
    lgb = rod.gravito_bending_length
    needed = pattern.remainder_length + pattern.length + left * lgb
    return rod if needed > rod.length - _WORTH * lgb else replace(rod, length=needed)


def as_held(trajectory: Trajectory, rod: Rod):
    """The rod as far as the grip that moves along a trajectory, where it is as long as the whole
    one that this was planned for; any other, such as one that ends at the grip, as it is."""
    planned = trajectory.rod if trajectory.beyond_grip else None
    if planned is None:
        return rod
    whole = planned.length + trajectory.beyond_grip
    return rod if abs(whole - rod.length) > _SAME * whole else replace(rod, length=planned.length)
