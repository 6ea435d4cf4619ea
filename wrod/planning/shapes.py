"""Shapes of the suspended rod along a trajectory."""

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod import arguments
from wrod.errors import GraspError, RodError, WrodWarning
from wrod.patterns.pattern import Pattern
from wrod.planning.reservations import refuse_unconverged
from wrod.planning.sources import SOURCES, GraspInputs
from wrod.planning.trajectory import Trajectory
from wrod.rods.rotation import transport

# Grips closer than this [L_gb] are of one grasp, with a curvature that is off by a spline's noise.
_SAME_GRASP = 0.06


def with_shapes(
    trajectory: Trajectory,
    pattern: Pattern | None = None,
    *,
    device: arguments.DeviceLike = None,
    progress: Callable[[int, int], object] | None = None,
) -> Trajectory:
    """The trajectory with the shapes of the suspended rod, where its method gave none.

    They are those of the optimal grasps of the same inputs, from the rod solver, ended at the
    trajectory's grips. It thereby checks the controller: `metadata["shapes"]` says how far its
    grips are from the solver's at most [m], but for a plan that was corrected for a table. A
    trajectory that is not of optimal grasps, or has shapes, comes back as it is.

    Args:
        trajectory: what `plan` returned, or read from its file.
        pattern: of the trajectory; without it, or where the contacts are not on it, the curvature
            is that of a spline through the contacts.
        device, progress: see `plan`.

    Warns:
        WrodWarning: the solver gives no shapes, or has its grips elsewhere; the trajectory comes
            back without.
    """
    closure, rod = trajectory.closure, trajectory.rod
    if trajectory.shape is not None or closure is None or rod is None:
        return trajectory
    corrected = {"optimised", "distilled"} & set(trajectory.metadata)
    s = trajectory.pattern_arc_length
    tangent, curvature = _course(trajectory, pattern)
    lgb = rod.gravito_bending_length
    inputs = GraspInputs.of(
        rod, rod.length - trajectory.arc_length, curvature,
        roll=trajectory.roll,
        closure=closure, device=device, progress=progress, eigenvalues=False,
    )  # fmt: skip
    try:
        poses = SOURCES["numeric"](inputs)
        refuse_unconverged(poses, inputs, s)
        frame = contact_frame(tangent)
        grip = placed(poses.position[:, None], trajectory.contact, frame, lgb)[:, 0]
        apart = float(np.linalg.norm(grip - trajectory.position, axis=1).max())
        if apart > _SAME_GRASP * lgb and not corrected:
            raise GraspError(f"the solver's grips are up to {apart:.2g} m from the planned ones")
    except GraspError as error:
        warnings.warn(f"the rod's shapes are left out: {error}", WrodWarning, stacklevel=2)
        return trajectory
    shape = placed(poses.shape, trajectory.contact, frame, lgb)
    # What is left is of the controller, the mesh and corrections.
    solved = (frame @ Rotation.from_rotvec(poses.rotation).as_matrix())[..., 0]
    ways = solved, trajectory.rotation[..., 0]
    turn = np.stack([transport(axis, *ways) for axis in np.eye(3)], axis=2)
    shape = led_along(shape, trajectory.position - shape[:, -1], turn)
    said = {"shapes": {"method": "numeric", "largest_grip_difference": apart}}
    metadata = {**trajectory.metadata, **({} if corrected else said)}
    return replace(trajectory, shape=shape, metadata=metadata)


def _course(trajectory: Trajectory, pattern: Pattern | None) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent (T, 3) and signed curvature (T,) [1/m] at the contacts."""
    own = course_of(trajectory)
    if pattern is None:
        return own
    s, pattern = trajectory.pattern_arc_length, with_remainder_of(pattern, trajectory)
    contact, tangent, bent = pattern.sample(np.clip(s, -pattern.remainder_length, pattern.length))
    laid = np.abs(contact - trajectory.contact).max() < 1e-6
    return (tangent, bent) if laid else own


def course_of(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent (T, 3) and signed curvature (T,) [1/m] of a spline through the contacts."""
    curve = CubicSpline(trajectory.arc_length, trajectory.contact)
    forward, bend = (curve(trajectory.arc_length, order) for order in (1, 2))
    speed = np.linalg.norm(forward, axis=1)
    curvature = (forward[:, 0] * bend[:, 1] - forward[:, 1] * bend[:, 0]) / speed**3
    return forward / speed[:, None], curvature


@arguments.checked(RodError)
def with_remainder_of(pattern: Pattern, trajectory: Trajectory) -> Pattern:
    """The pattern with the remainder that the trajectory lays before it."""
    if pattern.remainder_length == 0.0 and trajectory.remainder_length > 0.0:
        return pattern.with_remainder(trajectory.remainder_length)
    return pattern


def contact_frame(tangent: np.ndarray) -> np.ndarray:
    """(T, 3, 3) R_t of Alg. OPT."""
    up = np.broadcast_to([0.0, 0.0, 1.0], tangent.shape)
    return np.stack([tangent, np.cross(up, tangent), up], axis=-1)


def placed(points: np.ndarray, contact: np.ndarray, frame: np.ndarray, lgb: float) -> np.ndarray:
    """(T, n, 3) points on the table [m] from those in contact frames [L_gb]."""
    return contact[:, None] + lgb * np.einsum("tij,tnj->tni", frame, points)


def led_along(
    shape: np.ndarray, displacement: np.ndarray, turn: np.ndarray | None = None
) -> np.ndarray:
    """Shapes (T, n, 3) whose grips are displaced by (T, 3) [m] and turned by matrices (T, 3, 3),
    and the rest of them less and less towards the contact [m]."""
    share = np.linspace(0.0, 1.0, shape.shape[1]) ** 2
    moves = displacement[:, None]
    if turn is not None:
        moves = moves + np.einsum("tij,tnj->tni", turn - np.eye(3), shape - shape[:, -1:])
    return shape + share[None, :, None] * moves
