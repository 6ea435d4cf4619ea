"""Where along the rod the grip holds it."""

from dataclasses import replace

from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel

# What hangs when the pattern is laid, and rod beyond the grip with less of which it is held at its
# end [L_gb].
LEFT, _WORTH = 4.0, 1.0
# Lengths that are the same, relative.
_SAME = 1e-6


def held_near(pattern: Pattern, rod: RodModel | RodMaterial, left: float = LEFT):
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


def as_held(trajectory: Trajectory, rod: RodModel | RodMaterial):
    """The rod as a trajectory holds it, where that was planned for this rod held nearer than at its
    end."""
    beyond = trajectory.metadata.get("beyond_grip", 0.0)
    if not beyond or trajectory.rod is None:
        return rod
    held = trajectory.rod.length
    return replace(rod, length=held) if abs(held + beyond - rod.length) < _SAME * held else rod
