"""Which of several plans a rod is expected to lie best by.

A rod that is bent at rest by more than it can hang with (`wrod.grasps.relaxed`) is held as a rod
closer to straight; whether that lays it better than the straight rod's grasps depends on where it
springs once it lies. That is for the simulation to say, before a plan is chosen.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from wrod import arguments
from wrod.deployment.expectation import UNMEASURED, expecting
from wrod.deployment.together import follow
from wrod.errors import GraspError, WrodWarning
from wrod.patterns.pattern import Pattern
from wrod.planning.plan import plan_grasps
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod, RodModel
from wrod.rods.model_file import rod_as_json
from wrod.rods.profile import Profile

# Disturbed rods that every rival lays.
_TRIALS = 4


def expected_errors(
    rod: Rod,
    rivals: Sequence[tuple[Pattern, Trajectory]],
    friction: float | tuple[float, float] | None,
    *,
    hold: float = 0.05,
    device: arguments.DeviceLike = "cpu",
) -> np.ndarray:
    """(plan,) mean distance from the pattern [m] to be expected of plans, each with the pattern and
    remainder that it is of: the same four disturbed rods on coarse meshes, on a table of such a
    friction or, where it is None, of 0.2 to 0.6. A plan of which one diverges is laid again on the
    finer meshes by which plans are judged; infinite where one diverges there, too."""
    table = UNMEASURED if friction is None else friction
    errors = np.full(len(rivals), np.inf)
    for coarse in (True, False):
        lost = np.flatnonzero(np.isinf(errors)).tolist()
        courses = [
            expecting(rivals[k][0], rod, [rivals[k][1]], table, _TRIALS, coarse=coarse)
            for k in lost
        ]
        said = follow(courses, hold=hold, device=device or "auto")
        for k, (one,) in zip(lost, said, strict=True):
            errors[k] = np.inf if one["diverged"] else one["mean"]
    return errors


def own_or_straight(
    pattern: Pattern, rod: Rod, method: str, friction, how: dict[str, Any]
) -> Trajectory:
    """The plan of the rod or, where it cannot hang in all of its grasps and that of the same rod
    straightened is expected to lay it better, the latter, which says so.

    Args:
        pattern: with its remainder.
        friction: of the table; None: unknown.
        how: further arguments of `plan_grasps`.
    """
    own = plan_grasps(pattern, rod, method, remainder=False, **how)
    if own.natural_share == 1.0:
        return own
    straightened = replace(RodModel.of(rod), natural_curvature=(Profile((0.0,)), Profile((0.0,))))
    rival = plan_grasps(pattern, straightened, method, remainder=False, **how | {"roll": own.roll})
    errors = expected_errors(
        rod, [(pattern, own), (pattern, rival)], friction, device=how["device"]
    )
    if errors[0] <= errors[1]:
        return own
    said = (
        f"the grasps of the rod as if it were straight are taken, which are expected to lay it "
        f"{100 * errors[1]:.1f} cm off, its own {100 * errors[0]:.1f} cm"
    )
    warnings.warn(said, WrodWarning, stacklevel=4)
    return replace(
        rival,
        metadata=rival.metadata
        | {"rod": rod_as_json(rod), "natural_share": 0.0}
        | {"warnings": [*own.metadata["warnings"], f"WrodWarning: {said}"]},
    )


def as_is_or_twisted(
    pattern: Pattern, rod: Rod, own: Trajectory, friction, how: dict[str, Any]
) -> Trajectory:
    """The plan or, where its hand spins and that is expected to lie better, one whose grasps know
    the twist: a table that does not hold it lets the rod roll, and what hangs untwists.

    Args:
        pattern: with its remainder.
        how: further arguments of `plan_grasps`, of which `own` is made.
    """
    if own.spin == 0.0:
        return own
    asked = how | {"closure": own.closure, "controller": None, "twisted": True}
    try:
        rival = plan_grasps(pattern, rod, "numeric", remainder=False, **asked)
    except GraspError:  # no such grasp exists, or nobody knows it
        return own
    rivals = [(pattern, own), (pattern, rival)]
    errors = expected_errors(rod, rivals, friction, device=how["device"])
    if errors[0] <= errors[1]:
        return own
    return replace(rival, metadata=rival.metadata | {"method": own.method})
