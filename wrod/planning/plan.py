"""Plans: from a pattern and a rod to the trajectory of the grip (paper, Alg. OPT)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.errors import GraspError, PatternError, WrodWarning
from wrod.grasps.results import Grasps
from wrod.patterns.pattern import Pattern
from wrod.planning.friction import friction_bound
from wrod.planning.remainder import prepare
from wrod.planning.reservations import (
    judge_spacing,
    refuse_tight_bends,
    refuse_unconverged,
    refuse_unsolved_bends,
    refuse_unsolved_rod,
    warn_relaxed,
    warn_unstable,
)
from wrod.planning.roll import held_twist, roll_angle, with_spin
from wrod.planning.shapes import contact_frame, placed
from wrod.planning.sources import SOURCES, GraspInputs
from wrod.planning.trajectory import Trajectory
from wrod.rods.model import Rod, RodModel
from wrod.rods.model_file import rod_as_json

if TYPE_CHECKING:
    from wrod.controller.controller import Controller

_MAX_NODES = 20_000
# Dimensionless curvatures between which "min_friction" lays a pattern better, and points at which
# curvature is looked at; beyond the range not all grasps of that closure exist.
_GENTLE, _TIGHT = 0.4, 3.0
# The same for a naturally curved rod, and the natural curvature [1/L_gb] up to which they do.
_TIGHT_CURVED, _MILD = 1.4, 0.3
_COURSE_POINTS = 2000


def plan_grasps(
    pattern: Pattern,
    rod: Rod,
    method: str,
    *,
    closure: str | None,
    spacing: float,
    remainder: bool | float | None,
    roll: float | str | None,
    controller: Controller | None,
    device: arguments.DeviceLike,
    progress: Callable[[int, int], object] | None,
    spin: float = 0.0,
    twisted: bool = False,
) -> Trajectory:
    """Trajectory of the grip that lays `rod` along `pattern`, for no table in particular.

    Arguments, what it returns, errors and warnings are those of `wrod.plan` (`wrod.deployment`),
    which checks the arguments first, and corrects the trajectory for a table. `twisted`: grasps by
    the rod solver of a uniform rod that the table holds as the spin twists it.
    """
    if device not in (None, "auto", "cpu"):  # a controller would not notice
        from wrod.rods.device import resolve_device

        resolve_device(device)
    RodModel.of(rod).refuse_lump()
    pattern = prepare(pattern, rod, remainder)
    refuse_tight_bends(pattern, rod)
    if closure is None:
        closure = _usual_closure(pattern, rod, method, controller)
    s = _contacts(pattern, spacing)
    _, _, curvature = course = pattern.sample(s)
    if method != "intuitive":
        refuse_unsolved_bends(pattern, rod, s, curvature)
    if method not in ("intuitive", "neural"):  # a controller goes on beyond, with a warning
        refuse_unsolved_rod(rod)
    roll = roll_angle(roll, pattern, rod, controller is not None)
    inputs = GraspInputs.of(
        rod, rod.length - (s - s[0]), curvature,
        roll=roll, closure=closure, device=device, progress=progress, controller=controller,
    )  # fmt: skip
    if twisted:
        if inputs.rod is not None:
            raise GraspError("grasps of a rod that spin twists are known of uniform ones only")
        twist = held_twist(rod.length, s - s[0], spin) * rod.gravito_bending_length
        inputs = replace(inputs, twist=twist)
    poses, said = _solved(method, inputs, s)
    return with_spin(_trajectory(pattern, rod, s - s[0], course, poses, roll, said), rod, spin)


def _usual_closure(pattern: Pattern, rod, method: str, controller: Controller | None) -> str:
    """The closure where none is asked for."""
    if controller is not None and method in ("auto", "neural"):
        return controller.closure
    return favoured_closure(pattern, rod) if method == "auto" else "zero_tension"


def _solved(method: str, inputs: GraspInputs, s: np.ndarray) -> tuple[Grasps, dict]:
    """Grasps at the contacts s [m], and what the trajectory says of them."""
    with warnings.catch_warnings(record=True) as reservations:
        warnings.simplefilter("always")
        if method == "neural" and inputs.controller is None and not inputs.is_straight:
            method = "numeric"
            own = "curved at rest" if inputs.rod is None else "not uniform, isotropic and linear"
            warnings.warn(
                "the controller that ships knows naturally straight rods only and this one is "
                f"{own}, so its grasps come from the rod solver",
                WrodWarning,
                stacklevel=2,
            )
        poses = SOURCES[method](inputs)
        refuse_unconverged(poses, inputs, s)
        warn_unstable(poses, inputs, s)
        warn_relaxed(poses, s)
    for reservation in reservations:
        warnings.warn(reservation.message, reservation.category, stacklevel=3)
    return poses, {
        "method": method,
        "closure": inputs.closure if method != "intuitive" else None,
        "solver": None if method == "intuitive" else _solver(poses),
        "warnings": [
            f"{warning.category.__name__}: {warning.message}"
            for warning in reservations
            if issubclass(warning.category, WrodWarning)
        ],
    }


def _solver(poses: Grasps) -> str:
    """Who found the grasps, in words."""
    count, solved = len(poses.position), 0
    if poses.eigenvalue is not None:  # of those that a controller predicts nobody knows it
        solved = int(np.sum(np.isfinite(poses.eigenvalue)))
    if solved in (0, count):
        return "rod solver" if solved else "trained controller"
    return f"trained controller, rod solver for {solved} of {count}"


def _contacts(pattern: Pattern, spacing: float) -> np.ndarray:
    """(T,) arc lengths of the contact nodes, from the remainder's first [m]."""
    first = -pattern.remainder_length
    total = pattern.length - first
    if not (np.isfinite(spacing) and spacing >= total / _MAX_NODES):
        raise PatternError(
            f"spacing is {spacing!r} m; give at least {total / _MAX_NODES:.2g} m, which "
            f"makes {_MAX_NODES} contact nodes"
        )
    judge_spacing(pattern, spacing)
    return np.linspace(first, pattern.length, int(np.ceil(total / spacing - 1e-9)) + 1)


def _trajectory(
    pattern: Pattern,
    rod: Rod,
    laid: np.ndarray,
    course: tuple[np.ndarray, np.ndarray, np.ndarray],
    poses: Grasps,
    roll: float,
    said: dict,
) -> Trajectory:
    """Dimensionless grasps in the contact's frame as a trajectory.

    Args:
        laid: (T,) laid lengths [m].
        course: contacts (T, 3) [m], tangents (T, 3) and curvatures (T,) [1/m] of the pattern there.
        poses: of the T grasps.
        roll: at which the rod is held [rad].
        said: method, closure, solver and warnings.
    """
    contact, tangent, curvature = course
    lgb, frame = rod.gravito_bending_length, contact_frame(tangent)
    force_unit = 2.0 * rod.weight * lgb
    shape = None if poses.shape is None else placed(poses.shape, contact, frame, lgb)
    aside: dict[str, float | str] = {}
    if poses.natural_share is not None:
        aside["natural_share"] = float(np.min(poses.natural_share))
    law = RodModel.of(rod).law
    if law.at_rest is None and said["method"] != "intuitive":
        aside["remembers"] = law.name
    return Trajectory(
        arc_length=laid,
        contact=contact,
        position=placed(poses.position[:, None], contact, frame, lgb)[:, 0],
        rotation=frame @ Rotation.from_rotvec(poses.rotation).as_matrix(),
        force=force_unit * np.einsum("tij,tj->ti", frame, poses.force),
        metadata={
            **said,
            "pattern": pattern.name,
            "pattern_length": pattern.length,
            "remainder_length": pattern.remainder_length,
            "rod": rod_as_json(rod),
            "required_friction": float(np.max(friction_bound(pattern, rod).required)),
            "contact_friction": _contact_friction(poses.force),
            "largest_curvature": float(np.max(np.abs(curvature))),
            **aside,
        },
        shape=shape,
        twist=poses.twist,
        roll=roll,
    )


def favoured_closure(pattern: Pattern, rod: Rod) -> str:
    """The closure that lays such a pattern most accurately, whatever the table.

    "min_friction" where the pattern's largest curvature is over 0.4 / L_gb, "zero_tension"
    elsewhere. In bends the first asks the table for less: at 1 / L_gb for a tangential force of
    0.55 instead of 0.93 of the normal one, so that less slides on slippery tables. On a straight
    pattern both are the same grasps; in gentle bends both lay as well, and the second are the
    paper's. Evidence: `wrod bench slippery`, docs/deployment.md, and for naturally curved
    rods docs/loop.md. Of a rod curved by more than 0.3 / L_gb not all grasps exist that ask for the
    least, and it gets "zero_tension"; so does one that stays bent.
    """
    if RodModel.of(rod).law.at_rest is None:
        return "zero_tension"
    s = np.linspace(-pattern.remainder_length, pattern.length, _COURSE_POINTS)
    lgb = rod.gravito_bending_length
    sharpest = np.max(np.abs(pattern.sample(s)[2])) * lgb
    natural = np.hypot(*rod.curvature_held(0.0)) * lgb
    tight = _TIGHT if rod.is_straight else _TIGHT_CURVED
    return "min_friction" if _GENTLE < sharpest <= tight and natural <= _MILD else "zero_tension"


def _contact_friction(force: np.ndarray) -> float | None:
    """Largest ratio of tangential to normal force on the table where the rod touches down; None
    where the method says no forces (T, 3)."""
    if not np.isfinite(force).all():
        return None
    return float(np.max(np.hypot(force[:, 0], force[:, 1]) / np.maximum(force[:, 2], 1e-9)))
