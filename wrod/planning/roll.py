"""How a rod is rolled about its tangent where it is gripped."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import GraspError, RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod, RodModel

WORDS = ("plane", "tilted", "up")
# In the plane a rod that is strongly bent at rest is laid in waves that grow; raised by so much
# [rad] it is not (docs/loop.md). They may grow by so many e-folds, summed over so many contacts.
TILT = float(np.radians(30.0))
_FOLDS, _CONTACTS = 1.0, 8


def roll_angle(roll: float | str | None, pattern: Pattern, rod: Rod, known: bool = False) -> float:
    """The roll [rad] that `plan`'s words mean, None being "tilted" for rods whose departures grow
    when they are laid in the plane, and "plane" for others. A rod that is straight at rest gets the
    softer of its principal directions upwards, or 0 where it has none.

    Args:
        known: whether a controller is to be asked, which was made for rods in the plane.

    Raises:
        GraspError: the roll is neither these nor a finite number.
    """
    if roll is not None and roll not in WORDS:
        if isinstance(roll, str) or not np.isfinite(roll):
            said = "'plane', 'tilted' or 'up'"
            raise GraspError(f"roll is {roll!r}; give a finite angle in radians, {said}")
        return float(roll)
    if rod.is_straight:
        return _softer_upwards(rod)
    across, upwards = rod.curvature_held(0.0)
    left = -float(np.arctan2(upwards, across))
    if roll == "up":
        return left + 0.5 * np.pi
    raised = roll == "tilted" or (roll is None and not known and _waves(pattern, rod, left))
    tilt = TILT if raised else 0.0
    s = np.linspace(-pattern.remainder_length, pattern.length, 1000)
    turning = float(np.mean(pattern.sample(s)[2])) * (s[-1] - s[0])
    # A pattern that turns by nothing but rounding has no side.
    return left + np.pi - tilt if turning < -1e-3 else left + tilt


def _waves(pattern: Pattern, rod: Rod, roll: float) -> bool:
    """Whether small departures grow by more than `_FOLDS` e-folds on a straight stretch as long as
    the pattern, or nobody can say."""
    from wrod.grasps.rod_grasps import solve_rod_grasps  # Warp: plans by a network need none

    laid = np.linspace(0.0, pattern.remainder_length + pattern.length, _CONTACTS)
    try:
        grasps = solve_rod_grasps(rod, laid, 0.0, held_roll=roll, device="cpu", edge_count=40)
    except GraspError:
        return True
    grows = np.where(grasps.converged, np.maximum(grasps.growth, 0.0), np.inf)
    return not np.trapezoid(grows, laid) <= _FOLDS


def read_roll(text: str | None, rod) -> float | str | None:
    """What `plan` takes as roll for what a command's --roll says of this rod.

    Raises:
        RodError: it is none, or there is no rod.
    """
    if text is None:
        return None
    if rod is None:
        raise RodError("--roll belongs to one rod; name it with --rod")
    if text in WORDS:
        return text
    try:
        roll = float(np.radians(float(text)))
    except ValueError:
        roll = float("nan")
    if not np.isfinite(roll):
        raise RodError(
            f"--roll {text} is no roll; use plane, tilted, up or a finite number of degrees"
        )
    return roll


def with_spin(trajectory: Trajectory, rod: Rod, spin: float) -> Trajectory:
    """The trajectory with a hand that turns about the rod besides, by `spin` [rad] in all, evenly
    over the laid length.

    Raises:
        GraspError: the rod has sides, so that it matters how it is rolled.
    """
    if spin == 0.0:
        return trajectory
    if RodModel.of(rod).has_sides:
        raise GraspError(
            "spin turns the rod about itself, and this one is curved at rest, stays bent or bends "
            "more easily to one side, so that it would lie elsewhere; leave spin out"
        )
    share = trajectory.arc_length / trajectory.arc_length[-1]
    turns = Rotation.from_rotvec(spin * share[:, None] * [1.0, 0.0, 0.0])
    return replace(
        trajectory,
        rotation=trajectory.rotation @ turns.as_matrix(),
        metadata={**trajectory.metadata, "spin": float(spin)},
    )


def held_twist(length: float, laid: np.ndarray, spin: float) -> np.ndarray:
    """(T,) twist [rad/m] of what hangs of a rod of that length [m] when so much is `laid` (T,) [m],
    if the table holds the roll of what lies.

    What is laid down keeps the twist t that the hanging part has then: the grip's turn, even over
    the laid length s, is (L - s) t and the integral of t over what lies, so that dt/ds is the rate
    of the turn over L - s.
    """
    return spin / laid[-1] * np.log(length / (length - laid))


def _softer_upwards(rod: Rod) -> float:
    """The roll that turns a straight rod's softer principal direction upwards, where it bends most;
    the other way round the suspended rod rolls towards it and takes the laid one along."""
    model = RodModel.of(rod)
    if model.is_isotropic:
        return 0.0
    first, second = (float(b.mean(0.0, model.length)) for b in model.bending_stiffness)
    softer = model.principal_angle + (0.5 * np.pi if second < first else 0.0)
    return float((0.5 * np.pi - softer + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
