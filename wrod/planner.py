"""Plans: from a pattern and a rod to the trajectory of the grip (paper, Alg. OPT)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from wrod.errors import GraspError, PatternError, StabilityWarning
from wrod.friction import friction_bound
from wrod.material import RodMaterial
from wrod.patterns import Pattern
from wrod.trajectory import Trajectory

# The suspended part must stay this long, in L_gb, at the last contact: grasps of a shorter rod
# put the gripper's fingers on the table, and the studied range begins here.
MIN_SUSPENDED_LENGTH = 1.0
# A dimensionless start curvature above this gets a remainder unless the caller decides.
CONSIDERABLE_CURVATURE = 0.1
_MAX_NODES = 20_000
# Nodes handed to a solver at a time when someone watches the progress.
_CHUNK = 32


@dataclass(frozen=True)
class GraspInputs:
    """What a grasp source is given: (T,) dimensionless lengths and curvatures of all nodes."""

    suspended_length: np.ndarray
    curvature: np.ndarray
    stretch_ratio: float
    closure: str
    device: str | None
    progress: Callable[[int, int], None] | None


@dataclass(frozen=True)
class GraspPoses:
    """What a grasp source returns, in the contact frame and dimensionless.

    position, rotation (vector) and force are (T, 3); converged and stable are (T,) or None where
    the source does not say; shape is (T, nodes, 3) or None.
    """

    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    converged: np.ndarray | None = None
    stable: np.ndarray | None = None
    shape: np.ndarray | None = None


def _intuitive(inputs: GraspInputs) -> GraspPoses:
    """Grip straight above the contact, the rod hanging from it (Takizawa et al. 2015)."""
    length = inputs.suspended_length
    count = len(length)
    position = np.column_stack([np.zeros((count, 2)), length])
    rotation = np.tile([0.0, -np.pi / 2.0, 0.0], (count, 1))
    return GraspPoses(position, rotation, np.full((count, 3), np.nan))


def _numeric(inputs: GraspInputs) -> GraspPoses:
    """Optimal grasps from the rod solver; right turns are the mirror images of left ones."""
    from wrod.grasps import solve_grasps

    count = len(inputs.suspended_length)
    chunk = count if inputs.progress is None else _CHUNK
    parts = []
    for first in range(0, count, chunk):
        part = slice(first, min(first + chunk, count))
        grasps = solve_grasps(
            inputs.suspended_length[part],
            np.abs(inputs.curvature[part]),
            np.full(part.stop - part.start, inputs.stretch_ratio),
            closure=inputs.closure,
            device=inputs.device,
        )
        parts.append(grasps)
        if inputs.progress is not None:
            inputs.progress(part.stop - part.start, count)

    def joined(name: str) -> np.ndarray:
        return np.concatenate([np.asarray(getattr(grasps, name)) for grasps in parts])

    has_shape = all(getattr(grasps, "shape", None) is not None for grasps in parts)
    poses = GraspPoses(
        *(joined(name) for name in ("position", "rotation", "force", "converged", "stable")),
        shape=joined("shape") if has_shape else None,
    )
    return mirrored(poses, inputs.curvature < 0.0)


def mirrored(poses: GraspPoses, where: np.ndarray) -> GraspPoses:
    """Poses with those at `where` (T,) reflected in the contact frame's xz plane."""
    side = np.where(where, -1.0, 1.0)
    position, rotation, force = poses.position.copy(), poses.rotation.copy(), poses.force.copy()
    position[:, 1] *= side
    force[:, 1] *= side
    rotation[:, 0] *= side
    rotation[:, 2] *= side
    shape = poses.shape
    if shape is not None:
        shape = shape.copy()
        shape[:, :, 1] *= side[:, None]
    return GraspPoses(position, rotation, force, poses.converged, poses.stable, shape)


# A source takes the dimensionless inputs of every node and returns poses in the contact frame.
SOURCES: dict[str, Callable[[GraspInputs], GraspPoses]] = {
    "numeric": _numeric,
    "intuitive": _intuitive,
}


def plan(
    pattern: Pattern,
    rod: RodMaterial,
    method: str = "numeric",
    *,
    closure: str = "zero_tension",
    spacing: float = 0.005,
    remainder: bool | float | None = None,
    device: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Trajectory of the grip that lays `rod` along `pattern`.

    Args:
        pattern: where the rod is to lie.
        rod: its material and length.
        method: "numeric" (optimal grasps from the rod solver) or "intuitive" (straight above the
            contact).
        closure: "zero_tension", "min_force" or "min_friction" (numeric only).
        spacing: largest distance between the contact nodes [m].
        remainder: lay a remainder before the pattern (paper, Sec. Accuracy): None where the start
            curvature is considerable (over 0.1 / L_gb), True, False, or its length [m].
        device: where the solver runs: "cpu", "cuda:0" or None for the solver's choice.
        progress: called with the nodes done since the last call and the number of all nodes.

    Returns:
        One pose per contact node; `metadata` names method, rod, pattern, remainder and friction.

    Raises:
        PatternError: the pattern and its remainder leave less than 1 L_gb of the rod suspended,
            bend it tighter than its own radius, or spacing is not positive.
        GraspError: unknown method, or a grasp that did not converge; names node and inputs.

    Warns:
        StabilityWarning: some grasps are elastically unstable.
    """
    if method not in SOURCES:
        raise GraspError(f"unknown method {method!r}; use one of {', '.join(SOURCES)}")
    pattern = prepare(pattern, rod, remainder)
    first = -pattern.remainder_length
    total = pattern.length - first
    if not (np.isfinite(spacing) and spacing >= total / _MAX_NODES):
        raise PatternError(
            f"spacing is {spacing!r} m; give at least {total / _MAX_NODES:.2g} m, which "
            f"makes {_MAX_NODES} contact nodes"
        )
    s = np.linspace(first, pattern.length, int(np.ceil(total / spacing - 1e-9)) + 1)
    contact, tangent, curvature = pattern.sample(s)
    _refuse_tight_bends(pattern, rod, s, curvature)
    lgb = rod.gravito_bending_length
    laid = s - first
    inputs = GraspInputs(
        (rod.length - laid) / lgb, curvature * lgb, rod.stretch_ratio, closure, device, progress
    )
    poses = SOURCES[method](inputs)
    _refuse_unconverged(poses, inputs, s)
    _warn_unstable(poses, s)

    up = np.broadcast_to([0.0, 0.0, 1.0], tangent.shape)
    frame = np.stack([tangent, np.cross(up, tangent), up], axis=-1)  # R_t of Alg. OPT
    force_unit = rod.bending_stiffness / lgb**2
    shape = None
    if poses.shape is not None:
        shape = contact[:, None] + lgb * np.einsum("tij,tnj->tni", frame, poses.shape)
    return Trajectory(
        arc_length=laid,
        contact=contact,
        position=contact + lgb * np.einsum("tij,tj->ti", frame, poses.position),
        rotation=frame @ Rotation.from_rotvec(poses.rotation).as_matrix(),
        force=force_unit * np.einsum("tij,tj->ti", frame, poses.force),
        metadata={
            "method": method,
            "closure": closure if method != "intuitive" else None,
            "pattern": pattern.name,
            "pattern_length": pattern.length,
            "remainder_length": pattern.remainder_length,
            "rod": asdict(rod),
            "required_friction": float(np.max(friction_bound(pattern, rod).required)),
            "largest_curvature": float(np.max(np.abs(curvature))),
        },
        shape=shape,
    )


def prepare(pattern: Pattern, rod: RodMaterial, remainder: bool | float | None) -> Pattern:
    """The pattern with the remainder that `plan` lays before it, checked against the rod's length.

    Raises:
        PatternError: pattern and remainder leave less than 1 L_gb of the rod suspended.
    """
    spare = rod.length - MIN_SUSPENDED_LENGTH * rod.gravito_bending_length
    _refuse_long(pattern, rod, spare)
    if remainder is False or pattern.remainder_length > 0.0:
        return pattern
    if remainder is None:
        start = abs(pattern.sample(0.0)[2][0]) * rod.gravito_bending_length
        if start < CONSIDERABLE_CURVATURE:
            return pattern
        led = pattern.with_remainder()
        if led.remainder_length + led.length > spare and pattern.length < spare:
            # A shorter remainder asks for more friction, which the metadata says, but still helps.
            led = pattern.with_remainder(spare - pattern.length)
        return led
    led = pattern.with_remainder(None if remainder is True else float(remainder))
    _refuse_long(led, rod, spare)
    return led


def _refuse_long(pattern: Pattern, rod: RodMaterial, spare: float) -> None:
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
    pattern: Pattern, rod: RodMaterial, s: np.ndarray, curvature: np.ndarray
) -> None:
    worst = int(np.argmax(np.abs(curvature)))
    if abs(curvature[worst]) * rod.radius >= 1.0:
        raise PatternError(
            f"{pattern.source}: has a curvature of {curvature[worst]:.0f} 1/m at s = "
            f"{s[worst]:.3f} m, tighter than the rod's own radius of {rod.radius:g} m; "
            "smooth the pattern or make it larger"
        )


def _refuse_unconverged(poses: GraspPoses, inputs: GraspInputs, s: np.ndarray) -> None:
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


def _warn_unstable(poses: GraspPoses, s: np.ndarray) -> None:
    if poses.stable is None or np.all(poses.stable):
        return
    where = s[~np.asarray(poses.stable, dtype=bool)]
    warnings.warn(
        f"{len(where)} of {len(s)} grasps are elastically unstable (s from {where.min():.3f} to "
        f"{where.max():.3f} m); the rod may snap there",
        StabilityWarning,
        stacklevel=3,
    )
