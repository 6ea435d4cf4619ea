"""Plans: from a pattern and a rod to the trajectory of the grip (paper, Alg. OPT)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.errors import GraspError, PatternError, RodError, StabilityWarning, WrodWarning
from wrod.grasps.mesh import WEIGHT
from wrod.grasps.results import Grasps
from wrod.patterns.pattern import Pattern
from wrod.planning.friction import friction_bound
from wrod.planning.sources import MIN_SUSPENDED_LENGTH, SOURCES, GraspInputs
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.rods.model_file import rod_as_json

if TYPE_CHECKING:
    from wrod.controller.controller import Controller

# A pattern whose beginning would spring off by more than this [L_gb], once let go on a table of
# this friction, gets a remainder unless the caller decides: one that begins with a curvature of
# 0.15 / L_gb, or the paper's letter C, which bends soon after; its others stay below 0.04.
_SPRINGS_OFF, _SLIPPERY = 0.15, 0.3
# The beginning that is looked at [L_gb].
_BEGINNING, _BEGINNING_POINTS = 6.0, 400
# A default remainder is long enough to ask for this static friction at most...
_REMAINDER_FRICTION = 0.25
# ... but turns by no more than this [rad], which binds for stiff rods.
_REMAINDER_TURN = 0.8
_MAX_NODES = 20_000
# Dimensionless curvatures between which "min_friction" lays a pattern better, and points at which
# curvature is looked at; beyond the range not all grasps of that closure exist.
_GENTLE, _TIGHT = 0.4, 3.0
# The same for a naturally curved rod, and the natural curvature [1/L_gb] up to which they do.
_TIGHT_CURVED, _MILD = 1.4, 0.3
_COURSE_POINTS = 2000
# Stiffness of a rod's softest motion over weight per length by suspended length. A chain that hangs
# without bending stiffness has (j_0 / 2)^2; optimal grasps have more, and one with a third of it
# would swing out three times as far as a chain.
CHAIN_MARGIN = 1.446
SMALL_STABILITY_MARGIN = CHAIN_MARGIN / 3.0
# Grips closer than this [L_gb] are of one grasp, with a curvature that is off by a spline's noise.
_SAME_GRASP = 0.06


def plan_grasps(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
    method: str,
    *,
    closure: str | None,
    spacing: float,
    remainder: bool | float | None,
    roll: float | str,
    controller: Controller | None,
    device: str | None,
    progress: Callable[[int, int], object] | None,
) -> Trajectory:
    """Trajectory of the grip that lays `rod` along `pattern`, for no table in particular.

    Arguments, what it returns, errors and warnings are those of `wrod.plan` (`wrod.deployment`),
    which checks the arguments first, and corrects the trajectory for a table.
    """
    if method not in SOURCES:
        raise GraspError(f"unknown method {method!r}; use one of {', '.join(SOURCES)}")
    pattern = prepare(pattern, rod, remainder)
    if closure is None:
        closure = _usual_closure(pattern, rod, method, controller)
    s = _contacts(pattern, spacing)
    _, _, curvature = course = pattern.sample(s)
    _refuse_tight_bends(pattern, rod, s, curvature)
    roll = roll_angle(roll, pattern, rod)
    inputs = GraspInputs.of(
        rod, rod.length - (s - s[0]), curvature,
        roll=roll, closure=closure, device=device, progress=progress, controller=controller,
    )  # fmt: skip
    poses, said = _solved(method, inputs, s)
    return _trajectory(pattern, rod, s - s[0], course, poses, roll, said)


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
        _refuse_unconverged(poses, inputs, s)
        _warn_unstable(poses, inputs, s)
        _warn_relaxed(poses, s)
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
    return np.linspace(first, pattern.length, int(np.ceil(total / spacing - 1e-9)) + 1)


def _trajectory(
    pattern: Pattern,
    rod: RodModel | RodMaterial,
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
        said: method, closure and warnings.
    """
    contact, tangent, curvature = course
    lgb, frame = rod.gravito_bending_length, _contact_frame(tangent)
    force_unit = 2.0 * rod.weight * lgb
    shape = None if poses.shape is None else _placed(poses.shape, contact, frame, lgb)
    relaxed = {}
    if poses.natural_share is not None:
        relaxed["natural_share"] = float(np.min(poses.natural_share))
    return Trajectory(
        arc_length=laid,
        contact=contact,
        position=_placed(poses.position[:, None], contact, frame, lgb)[:, 0],
        rotation=frame @ Rotation.from_rotvec(poses.rotation).as_matrix(),
        force=force_unit * np.einsum("tij,tj->ti", frame, poses.force),
        metadata={
            "method": said["method"],
            "closure": said["closure"],
            "solver": said["solver"],
            "pattern": pattern.name,
            "pattern_length": pattern.length,
            "remainder_length": pattern.remainder_length,
            "rod": rod_as_json(rod),
            "roll": roll,
            "required_friction": float(np.max(friction_bound(pattern, rod).required)),
            "contact_friction": _contact_friction(poses.force),
            "largest_curvature": float(np.max(np.abs(curvature))),
            "warnings": said["warnings"],
            **relaxed,
        },
        shape=shape,
        twist=poses.twist,
        roll=roll,
    )


def favoured_closure(pattern: Pattern, rod: RodModel | RodMaterial) -> str:
    """The closure that lays such a pattern most accurately, whatever the table.

    "min_friction" where the pattern's largest curvature is over 0.4 / L_gb, "zero_tension"
    elsewhere. In bends the first asks the table for less: at 1 / L_gb for a tangential force of
    0.55 instead of 0.93 of the normal one, so that less slides on slippery tables. On a straight
    pattern both are the same grasps; in gentle bends both lay as well, and the second are the
    paper's. Evidence: `wrod bench closures`, docs/deployment.md, and for naturally curved
    rods docs/loop.md. Of a rod curved by more than 0.3 / L_gb not all grasps exist that ask for the
    least, and it gets "zero_tension".
    """
    s = np.linspace(-pattern.remainder_length, pattern.length, _COURSE_POINTS)
    lgb = rod.gravito_bending_length
    sharpest = np.max(np.abs(pattern.sample(s)[2])) * lgb
    natural = np.hypot(*rod.curvature_held(0.0)) * lgb
    tight = _TIGHT if rod.is_straight else _TIGHT_CURVED
    return "min_friction" if _GENTLE < sharpest <= tight and natural <= _MILD else "zero_tension"


def with_shapes(
    trajectory: Trajectory,
    pattern: Pattern | None = None,
    *,
    device: str | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Trajectory:
    """The trajectory with the shapes of the suspended rod, where its method gave none.

    They are those of the optimal grasps of the same inputs, from the rod solver, ended at the
    trajectory's grips. It thereby checks the controller: `metadata["shapes"]` says how far its
    grips are from the solver's at most [m]. A trajectory that is not of optimal grasps, or has
    shapes, comes back as it is.

    Args:
        trajectory: what `plan` returned, or read from its file.
        pattern: of the trajectory; without it, or where the contacts are not on it, the curvature
            is that of a spline through the contacts.
        device, progress: see `plan`.

    Warns:
        WrodWarning: the solver gives no shapes, or has its grips elsewhere; the trajectory comes
            back without.
    """
    closure, rod = trajectory.metadata.get("closure"), trajectory.rod
    corrected = {"optimised", "distilled"} & set(trajectory.metadata)
    if trajectory.shape is not None or closure is None or rod is None or corrected:
        return trajectory
    s = trajectory.pattern_arc_length
    tangent, curvature = _course(trajectory, pattern)
    lgb = rod.gravito_bending_length
    inputs = GraspInputs.of(
        rod, rod.length - trajectory.arc_length, curvature,
        roll=trajectory.roll,
        closure=closure, device=device, progress=progress,
    )  # fmt: skip
    try:
        poses = SOURCES["numeric"](inputs)
        _refuse_unconverged(poses, inputs, s)
        frame = _contact_frame(tangent)
        grip = _placed(poses.position[:, None], trajectory.contact, frame, lgb)[:, 0]
        apart = float(np.linalg.norm(grip - trajectory.position, axis=1).max())
        if apart > _SAME_GRASP * lgb:
            raise GraspError(f"the solver's grips are up to {apart:.2g} m from the planned ones")
    except GraspError as error:
        warnings.warn(f"the rod's shapes are left out: {error}", WrodWarning, stacklevel=2)
        return trajectory
    shape = _placed(poses.shape, trajectory.contact, frame, lgb)
    # What is left, of the controller and of the mesh, fades out towards the contact.
    share = np.linspace(0.0, 1.0, shape.shape[1]) ** 2
    shape += share[None, :, None] * (trajectory.position - shape[:, -1])[:, None]
    said = {"method": "numeric", "largest_grip_difference": apart}
    return replace(trajectory, shape=shape, metadata={**trajectory.metadata, "shapes": said})


def _contact_friction(force: np.ndarray) -> float | None:
    """Largest ratio of tangential to normal force on the table where the rod touches down; None
    where the method says no forces (T, 3)."""
    if not np.isfinite(force).all():
        return None
    return float(np.max(np.hypot(force[:, 0], force[:, 1]) / np.maximum(force[:, 2], 1e-9)))


def _course(trajectory: Trajectory, pattern: Pattern | None) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent (T, 3) and signed curvature (T,) [1/m] at the contacts."""
    curve = CubicSpline(trajectory.arc_length, trajectory.contact)
    forward, bend = (curve(trajectory.arc_length, order) for order in (1, 2))
    speed = np.linalg.norm(forward, axis=1)
    curvature = (forward[:, 0] * bend[:, 1] - forward[:, 1] * bend[:, 0]) / speed**3
    own = forward / speed[:, None], curvature
    if pattern is None:
        return own
    s = trajectory.pattern_arc_length
    if pattern.remainder_length == 0.0 and s[0] < 0.0:
        pattern = pattern.with_remainder(-float(s[0]))
    contact, tangent, bent = pattern.sample(np.clip(s, -pattern.remainder_length, pattern.length))
    laid = np.abs(contact - trajectory.contact).max() < 1e-6
    return (tangent, bent) if laid else own


def roll_angle(roll: float | str, pattern: Pattern, rod: RodModel | RodMaterial) -> float:
    """The roll [rad] that `plan`'s words "up" and "plane" mean. A rod that is straight at rest gets
    the softer of its principal directions upwards, or 0 where it has none.

    Raises:
        GraspError: the roll is neither these nor a finite number.
    """
    if roll not in ("up", "plane"):
        if isinstance(roll, str) or not np.isfinite(roll):
            raise GraspError(f"roll is {roll!r}; give a finite angle in radians, 'plane' or 'up'")
        return float(roll)
    if rod.is_straight:
        return _softer_upwards(rod)
    left = -float(np.arctan2(*rod.curvature_held(0.0)[::-1]))
    if roll == "up":
        return left + 0.5 * np.pi
    s = np.linspace(-pattern.remainder_length, pattern.length, 1000)
    turning = float(np.mean(pattern.sample(s)[2])) * (s[-1] - s[0])
    # A pattern that turns by nothing but rounding has no side.
    return left + np.pi if turning < -1e-3 else left


def read_roll(text: str | None, rod) -> float | str:
    """What `plan` takes as roll for what a command's --roll says of this rod.

    Raises:
        RodError: it is none, or there is no rod.
    """
    if text is None:
        return "plane"
    if rod is None:
        raise RodError("--roll belongs to one rod; name it with --rod")
    if text in ("plane", "up"):
        return text
    try:
        roll = float(np.radians(float(text)))
    except ValueError:
        roll = float("nan")
    if not np.isfinite(roll):
        raise RodError(f"--roll {text} is no roll; use plane, up or a finite number of degrees")
    return roll


def _softer_upwards(rod: RodModel | RodMaterial) -> float:
    """The roll that turns a straight rod's softer principal direction upwards, where it bends most;
    the other way round the suspended rod rolls towards it and takes the laid one along."""
    model = RodModel.of(rod)
    if model.is_isotropic:
        return 0.0
    first, second = (float(b.mean(0.0, model.length)) for b in model.bending_stiffness)
    softer = model.principal_angle + (0.5 * np.pi if second < first else 0.0)
    return float((0.5 * np.pi - softer + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


def _contact_frame(tangent: np.ndarray) -> np.ndarray:
    """(T, 3, 3) R_t of Alg. OPT."""
    up = np.broadcast_to([0.0, 0.0, 1.0], tangent.shape)
    return np.stack([tangent, np.cross(up, tangent), up], axis=-1)


def _placed(points: np.ndarray, contact: np.ndarray, frame: np.ndarray, lgb: float) -> np.ndarray:
    """(T, n, 3) points on the table [m] from those in contact frames [L_gb]."""
    return contact[:, None] + lgb * np.einsum("tij,tnj->tni", frame, points)


def prepare(
    pattern: Pattern, rod: RodModel | RodMaterial, remainder: bool | float | None
) -> Pattern:
    """The pattern with the remainder that `plan` lays before it, checked against the rod's length.

    Raises:
        PatternError: pattern and remainder leave less than 1 L_gb of the rod suspended.
    """
    spare = rod.length - MIN_SUSPENDED_LENGTH * rod.gravito_bending_length
    _refuse_long(pattern, rod, spare)
    if remainder is False or pattern.remainder_length > 0.0:
        return pattern
    off, start = free_end(pattern, rod)
    if remainder is None:
        if off < _SPRINGS_OFF * (1.0 - 1e-3):
            return pattern
        # A shorter remainder asks for more friction, which the metadata says; one much shorter
        # asks for more than it saves.
        wanted, room = _remainder_length(start, rod), spare - pattern.length
        return pattern.with_remainder(min(wanted, room)) if room > 0.5 * wanted else pattern
    if remainder is True:
        if start == 0.0:
            return pattern
        remainder = _remainder_length(start, rod)
    led = pattern.with_remainder(float(remainder))
    _refuse_long(led, rod, spare)
    return led


def free_end(pattern: Pattern, rod: RodModel | RodMaterial) -> tuple[float, float]:
    """How far the pattern's first point is expected to spring off once it is let go on a table of
    friction 0.3 [L_gb], and the largest curvature of the stretch that does [1/m].

    Friction over a length s from the free end supplies at most the moment mu w s^2 / 2, and the
    rod, k_b = 2 w L_gb^3, asks for k_b kappa(s): where it asks for more, it straightens.
    """
    lgb = rod.gravito_bending_length
    s = np.linspace(0.0, min(_BEGINNING * lgb, pattern.length), _BEGINNING_POINTS)
    bend = np.abs(pattern.sample(s)[2])
    held = bend * lgb <= 0.25 * _SLIPPERY * (s / lgb) ** 2
    held[0] = bend[0] == 0.0
    # What straightens begins at the free end, or where the rod, straight until then, bends.
    last = int(np.flatnonzero(~held)[-1]) if not held.all() else 0
    if last == 0:
        return 0.0, float(bend[0])
    turns = bend[: last + 1] * s[: last + 1]
    off = float(np.sum(0.5 * (turns[1:] + turns[:-1]) * np.diff(s[: last + 1])))
    return off / lgb, float(bend[: last + 1].max())


def _remainder_length(curvature: float, rod: RodModel | RodMaterial) -> float:
    """Length [m] over which the curvature grows from zero with little friction.

    The quintic smoothstep has |kappa''| <= 10 / sqrt(3) kappa / length^2, and mu_s = 2 L_gb^3
    |kappa''|.
    """
    steepest = 10.0 / np.sqrt(3.0) * curvature
    gentle = np.sqrt(2.0 * rod.gravito_bending_length**3 * steepest / _REMAINDER_FRICTION)
    return float(min(gentle, 2.0 * _REMAINDER_TURN / curvature))


def _refuse_long(pattern: Pattern, rod: RodModel | RodMaterial, spare: float) -> None:
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


def _refuse_tight_bends(
    pattern: Pattern, rod: RodModel | RodMaterial, s: np.ndarray, curvature: np.ndarray
) -> None:
    worst = int(np.argmax(np.abs(curvature)))
    if abs(curvature[worst]) * rod.radius >= 1.0:
        raise PatternError(
            f"{pattern.source}: has a curvature of {curvature[worst]:.0f} 1/m at s = "
            f"{s[worst]:.3f} m, tighter than the rod's own radius of {rod.radius:g} m; "
            "smooth the pattern or make it larger"
        )


def _refuse_unconverged(poses: Grasps, inputs: GraspInputs, s: np.ndarray) -> None:
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


def _warn_relaxed(poses: Grasps, s: np.ndarray) -> None:
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


def _warn_unstable(poses: Grasps, inputs: GraspInputs, s: np.ndarray) -> None:
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
