"""What `wrod plan` does to a pattern before it is planned: resize, round, hold."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from wrod.errors import PatternError, RodError
from wrod.options import option

if TYPE_CHECKING:  # `wrod --help` lists this command, and needs no rods
    from wrod.patterns.pattern import Pattern
    from wrod.planning.trajectory import Trajectory
    from wrod.rods.model import Rod

# Curvature [1/L_gb] that grasps of every closure exist for, and up to which rods lie well.
LARGEST_CURVATURE = 3.0
# Sizes tried for an arm, as shares of the largest, and rod left over at each [L_gb].
_SHARES, _LEFT_OVER = (0.86, 0.72, 1.0, 0.57, 0.79, 0.64, 0.93), 5.6


@dataclass(frozen=True)
class Shaping:
    """What is done to a pattern before it is planned."""

    resize: float | None = option("Draw the pattern this many times as large.")
    tolerance: float = option("How far rounded corners may leave the pattern [m].", default=0.01)
    hold: float | None = option(
        "Grip the rod at this length from its free end [m]; default: at its other end, with "
        "--friction where 4 L_gb are left to hang when the pattern is laid."
    )
    reverse: bool = option("Lay the pattern from its other end.", left_out=False)


@dataclass(frozen=True)
class Prepared:
    """A pattern ready for planning, the rod as it is held, and what was done to them."""

    pattern: "Pattern"
    rod: "Rod"
    notes: tuple[str, ...]
    figures: dict

    def held_by(self, trajectory: "Trajectory") -> "Prepared":
        """The same with the rod as a plan of it holds it."""
        from wrod.planning.hold import as_held

        rod, whole = as_held(trajectory, self.rod), self.rod.length
        if rod is self.rod:
            return self
        note = (
            f"held at {rod.length:.3f} m from the free end: the shorter the piece that hangs, the "
            f"less it stretches and errs (--hold {whole:g} holds the rod's other end); "
            f"{whole - rod.length:.3f} m hang beyond the grip"
        )
        return replace(self, rod=rod, notes=(*self.notes, note))


def fit(curve, rod, shaping: Shaping) -> Prepared:
    """Resize a pattern, hold the rod at a length, round what bends too much for the rod.

    Raises:
        PatternError: the curve departs from what was given by more than the tolerance, or is drawn
            shorter than the rod is thick.
        RodError: the hold is not on the rod.
    """
    from wrod.patterns.curve import runs_along_itself
    from wrod.patterns.rounding import round_corners

    resize, tolerance, hold = shaping.resize, shaping.tolerance, shaping.hold
    notes, figures = [], {}
    if shaping.reverse:
        curve = curve.reversed()
        notes.append("laid from its other end")
    if hold is not None:
        if not 0 < hold <= rod.length:
            raise RodError(
                f"--hold is {hold:g} m, and the rod is {rod.length:g} m long; hold it on the rod"
            )
        if hold < rod.length:
            notes.append(f"held at {hold:g} m; {rod.length - hold:.3f} m hang beyond the grip")
        figures["beyond_grip"] = rod.length - hold
        rod = replace(rod, length=hold)
    if resize is not None:
        curve = curve.scaled(resize)
        notes.append(f"drawn {resize:g} times as large")
        if curve.length < rod.radius:
            raise PatternError(
                f"--resize {resize:g} draws it {curve.length:.3g} m long, less than the radius of "
                f"the rod, {rod.radius:g} m; give a larger factor"
            )
    far, where = curve.departure()
    if far > tolerance:
        raise PatternError(
            f"{curve.source}: the curve through its points leaves the lines between them by "
            f"{1e3 * far:.1f} mm at s = {where:.3f} m, more than the tolerance of "
            f"{1e3 * tolerance:g} mm; give more points, or --tolerance {far + 1e-4:.4f}"
        )
    figures["departure_from_points"] = far
    if too_long(curve, rod) is not None:
        return Prepared(curve, rod, tuple(notes), figures)  # it is refused next
    bound = LARGEST_CURVATURE / rod.gravito_bending_length
    curve, rounding = round_corners(curve, bound, tolerance)
    if rounding is not None:
        notes.append(str(rounding))
        figures["rounding"] = {
            "largest": rounding.largest,
            "places": [list(place) for place in rounding.places],
            "sharpest": rounding.sharpest,
            "bound": rounding.bound,
        }
    twice = runs_along_itself(lambda s: curve.sample(s)[0][:, :2], curve.length, 2.0 * rod.radius)
    if twice:
        places = ", ".join(f"{a:.3f} to {b:.3f}" for a, b in twice[:5])
        more = " and further on" if len(twice) > 5 else ""
        notes.append(
            f"lies on what is laid already at s = {places} m{more}: "
            "simulations let a rod pass through itself, so no figure tells what it does there"
        )
    return Prepared(curve, rod, tuple(notes), figures)


def too_long(curve, rod, arm: bool = False) -> str | None:
    """The remedies for a pattern that the rod cannot lay, or None where it can.

    With an `arm` what they leave suspended keeps its fingers off the table.
    """
    from wrod.planning.sources import MIN_SUSPENDED_LENGTH

    kept = MIN_SUSPENDED_LENGTH * rod.gravito_bending_length
    if curve.length <= rod.length - kept or rod.length <= kept:
        return None
    if arm:
        from wrod.robot.remedy import least_suspended

        kept = max(kept, least_suspended(rod))
    spare, needed = rod.length - kept, curve.length + kept
    factor = int(1e3 * spare / curve.length - 5) / 1e3
    if factor <= 0:
        return None
    return (
        f"`--resize {factor:g}` draws it smaller; a longer rod of the same kind, "
        f"`--length {needed + 0.005:.3f}`, lays it as it is"
    )


def shorter(curve, rod, wanted: Shaping) -> list[Shaping]:
    """What to try where the rod is too short for the pattern and an arm, most likely first.

    An arm does best with tight bends laid last and a good piece left over; and with no more rod
    than that, which would hang from higher than it reaches.
    """
    import numpy as np

    s = np.linspace(0.0, curve.length, 400)
    bent = np.abs(curve.sample(s)[2])
    reverse = bool(bent @ s < 0.5 * bent.sum() * curve.length) != wanted.reverse
    left = _LEFT_OVER * rod.gravito_bending_length
    largest = min((rod.length - left) / curve.length, 1.0)
    tries = []
    for share in _SHARES:
        resize = int(100.0 * share * largest) / 100.0
        if resize > 0.2:
            hold = min(round(resize * curve.length + left, 3), rod.length)
            tries.append(replace(wanted, resize=resize, hold=hold, reverse=reverse))
    return tries
