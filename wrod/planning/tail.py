"""What is left of the rod at the pattern's end, laid straight ahead before the grip lets go."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from wrod.patterns.curve import smoothstep
from wrod.patterns.pattern import Pattern
from wrod.planning.hold import as_held
from wrod.planning.shapes import course_of, led_along, placed
from wrod.planning.sources import MIN_SUSPENDED_LENGTH, SOURCES, GraspInputs
from wrod.planning.trajectory import Trajectory, followed_by
from wrod.rods.model import Rod

_SPACING = 0.01  # [m]
# Length over which a tail straightens after a pattern that ends in a bend, in L_gb.
_STRAIGHTEN = 3.0


@dataclass(frozen=True)
class Tail:
    """How the grip goes on after the pattern: straight ahead, until 1 L_gb is left or it would go
    under the table.

    laid (T,) laid length [m], contact (T, 3), position (T, 3), rotation (T, 3, 3); the first entry
    is the trajectory's last pose. shape (T, nodes, 3) as `Trajectory.shape`, where asked for.
    """

    laid: np.ndarray
    contact: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    shape: np.ndarray | None = None

    @classmethod
    def none(cls, path: Trajectory) -> Tail:
        """The grip stays where the trajectory ends."""
        return cls(path.arc_length[-1:], path.contact[-1:], path.position[-1:], path.rotation[-1:])


def tail(pattern: Pattern | None, rod: Rod, trajectory: Trajectory, shapes: bool = False) -> Tail:
    """The tail is laid by the same method along the pattern's end tangent, after a bend that
    straightens out.

    A grip goes on as it was planned: by grasps of the rod that the trajectory was planned for, of
    the length that `rod` has, whatever else `rod` is. Where the trajectory does not say its rod,
    by those of `rod`.

    Args:
        pattern: that was planned; None reads its end off the contacts.
        rod, trajectory: see above.
        shapes: compute the suspended rod's, by the solver.
    """
    rod = replace(trajectory.rod or rod, length=as_held(trajectory, rod).length)
    lgb = rod.gravito_bending_length
    start = float(trajectory.arc_length[-1])
    length = rod.length - MIN_SUSPENDED_LENGTH * lgb - start
    count = max(int(np.ceil(length / _SPACING)), 1) + 1
    s = np.linspace(0.0, max(length, 0.0), count)
    corner, tangent, bend = _end(pattern, trajectory)
    ease = smoothstep(s / (_STRAIGHTEN * lgb))
    curvature = bend * (1.0 - ease)
    turned = cumulative_trapezoid(curvature, s, initial=0.0)
    heading = np.arctan2(tangent[1], tangent[0]) + turned
    frame = Rotation.from_euler("z", heading[:, None]).as_matrix()
    ahead = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(count)])
    contact = corner + cumulative_trapezoid(ahead, s, axis=0, initial=0.0)
    method = trajectory.method or "numeric"
    if method == "neural":
        method = "auto"  # a tail is shorter in the end than what the controller was trained for
    if shapes:
        method = "numeric"
    inputs = GraspInputs.of(
        rod, rod.length - start - s, curvature, roll=trajectory.roll,
        closure=trajectory.closure or "zero_tension", device="cpu", eigenvalues=False,
    )  # fmt: skip
    poses = SOURCES[method](inputs)
    position = contact + lgb * np.einsum("tij,tj->ti", frame, poses.position)
    spun = Rotation.from_rotvec([trajectory.spin, 0.0, 0.0])  # and no further
    rotation = frame @ (Rotation.from_rotvec(poses.rotation) * spun).as_matrix()
    grip = position.copy()
    # A corrected trajectory ends beside its grasp: the correction fades out with the bend.
    position += (1.0 - ease)[:, None] * (trajectory.position[-1] - position[0])
    turn = Rotation.from_matrix(trajectory.rotation[-1] @ rotation[0].T).as_rotvec()
    rotation = Rotation.from_rotvec((1.0 - ease)[:, None] * turn).as_matrix() @ rotation
    shape = None
    if shapes:
        shape = led_along(placed(poses.shape, contact, frame, lgb), position - grip)
    good = np.isfinite(position).all(axis=1)
    if poses.converged is not None:
        good &= poses.converged
    # A rod that is bent down at rest may be held under the table, into which its grip would press.
    good[np.logical_or.accumulate(good & (position[:, 2] < 0.0))] = False
    good[0] = False
    return Tail(
        np.concatenate([[start], start + s[good]]),
        np.concatenate([trajectory.contact[-1:], contact[good]]),
        np.concatenate([trajectory.position[-1:], position[good]]),
        np.concatenate([trajectory.rotation[-1:], rotation[good]]),
        None if shape is None else np.concatenate([shape[:1], shape[good]]),
    )


def with_tail(
    trajectory: Trajectory, pattern: Pattern | None = None, lowest: float = 0.0
) -> Trajectory | None:
    """The trajectory with the nodes of its tail behind its own, as far as the grip stays higher
    than `lowest` [m]; None where its rod is not known, or where nothing is left to lay.

    Their forces are NaN; a twist stays as it was.
    """
    rod = trajectory.rod
    if rod is None or not np.isfinite(trajectory.position).all():
        return None
    # No closure and no shape: the straight rod of the intuitive method.
    shapes = trajectory.shape is not None
    found = tail(pattern, rod, trajectory, shapes)
    low = found.position[1:, 2] < lowest
    count = int(np.argmax(low)) if low.any() else len(low)
    if count < 3:
        return None
    new = slice(1, count + 1)
    rows = {
        "arc_length": found.laid[new], "contact": found.contact[new],
        "position": found.position[new], "rotation": found.rotation[new],
        "force": np.full((count, 3), np.nan),
    }  # fmt: skip
    if shapes:
        fit = CubicSpline(np.linspace(0.0, 1.0, found.shape.shape[1]), found.shape[new], axis=1)
        rows["shape"] = fit(np.linspace(0.0, 1.0, trajectory.shape.shape[1]))
    if trajectory.twist is not None:
        rows["twist"] = np.repeat(trajectory.twist[-1:], count)
    return followed_by(trajectory, **rows)


def _end(pattern: Pattern | None, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray, float]:
    """Last point (3,) [m], tangent (3,) and curvature [1/m] of what was laid."""
    if pattern is not None:
        (corner,), (tangent,), (bend,) = pattern.sample(pattern.length)
        return corner, tangent, bend
    tangent, curvature = course_of(trajectory)
    return trajectory.contact[-1], tangent[-1], float(curvature[-1])
