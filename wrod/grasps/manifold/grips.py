"""Grips of a straight (or curved) pattern: the suspended rod for a given grip position.

The rod is clamped along the table at the contact and the grip leaves the orientation free, so that
a grip position determines a discrete set of equilibria. What is returned is the gentle one: that
which continues from the optimal grasp. Dimensionless: lengths in L_gb, forces in k_b/L_gb^2.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.held_rods import HeldRods
from wrod.grasps.inputs import check_inputs
from wrod.grasps.optimal import solve_grasps
from wrod.machine import worker_threads
from wrod.rods.device import resolve_device

EDGE_COUNT = 64
# Rods led at once: few on a CPU, whose cache they should not leave; many on a GPU.
_CPU_CHUNK, _CUDA_CHUNK = 128, 16384
# Room for rounding when a rod is asked whether it keeps off the table and rests on it.
_CLEARANCE, _FORCE = -1e-6, -1e-6
# A grip this many suspended lengths away would have to stretch the rod beyond use.
_REACH = 1.5
_NEAREST = 1e-3


@dataclass(frozen=True)
class HeldGrips:
    """Equilibria of rods whose grip is held at a position, one per input (float64 NumPy).

    Where `converged` is false the other fields describe the last equilibrium on the way to the
    position; they are never NaN.

    Attributes:
        position: (n, 3) grip position in the contact frame [L_gb].
        converged: (n,) an equilibrium at the position that was asked for.
        admissible: (n,) converged, the whole rod above the table and F_z >= 0 (Eq. cons).
        stable: (n,) no negative eigenvalue of the constrained Hessian.
        force: (n, 3) force of the table on the rod at the contact [k_b/L_gb^2].
        moment: (n, 3) moment of the table on the rod at the contact [k_b/L_gb]: its y component is
            the upward curvature there, its z component minus that to the left.
        tangent: (n, 3) the rod's direction at the grip.
        stiffness: (n, 3, 3) derivative of the force on the grip by its position.
        clearance: (n,) least height of the rod [L_gb].
        shape: (n, node, 3) the rod from contact to grip [L_gb].
        iterations: (n,) Newton iterations.
    """

    position: np.ndarray
    converged: np.ndarray
    admissible: np.ndarray
    stable: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    tangent: np.ndarray
    stiffness: np.ndarray
    clearance: np.ndarray
    shape: np.ndarray
    iterations: np.ndarray

    def __len__(self) -> int:
        return len(self.position)


def equilibrium(
    position,
    suspended_length,
    stretch_ratio,
    *,
    curvature=0.0,
    device: arguments.DeviceLike = None,
    edge_count: int = EDGE_COUNT,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> HeldGrips:
    """The suspended rod for given grip positions, on the gentle branch.

    Every rod starts as the optimal grasp of its (l_s, kappa, k_s) and is led to its position
    along a path that turns about the contact. One that is lost on the way, or does not end
    admissible, is pulled taut first and let in along the ray from the contact.

    Args:
        position: (n, 3) or (3,) grip positions in the contact frame [L_gb].
        suspended_length, stretch_ratio, curvature: broadcast to (n,): l_s [L_gb], k_s [-], and the
            curvature kappa [1/L_gb] of the grasp to start from. The clamp prescribes the contact's
            tangent; its curvature is a result.
        device, threads, progress: as in `solve_grasps`.
        edge_count: edges of each rod; errors fall with its square.

    Raises:
        GraspError: inputs that are not finite, out of range or do not broadcast.
    """
    position = np.asarray(position, dtype=np.float64)
    if position.ndim == 1:
        position = position[None]
    if position.ndim != 2 or position.shape[1] != 3:
        raise GraspError(f"grip positions have shape {position.shape}; give (n, 3)")
    if not np.isfinite(position).all():
        bad = int(np.flatnonzero(~np.isfinite(position).all(axis=1))[0])
        raise GraspError(f"grip position[{bad}] is not finite: {position[bad]}")
    ls, kappa, ks, index = check_inputs(
        suspended_length, curvature, stretch_ratio, np.arange(len(position))
    )
    position = position[index.astype(int)]
    device = resolve_device(device)
    start = grasp_shapes(ls, kappa, ks, edge_count, device, threads)
    # Beyond reach and at the contact itself there is nothing to follow.
    distance = np.linalg.norm(position, axis=1)
    possible = (distance < _REACH * ls) & (distance > _NEAREST * ls)

    def solve(chunk: slice) -> HeldGrips:
        rods = HeldRods(ls[chunk], ks[chunk], start[chunk], device=device)
        goal, can = position[chunk], possible[chunk]
        rods.continue_to(rods.grip_position())
        result = held_grips(rods, rods.continue_to(goal, can))
        again = can & ~result.admissible
        if again.any():
            rods.reset(start[chunk])
            rods.continue_to(rods.grip_position(), again)
            rods.continue_to(taut_position(goal, ls[chunk]), again)
            other = held_grips(rods, rods.continue_to(goal, again))
            better = other.admissible | (other.converged & ~result.converged)
            for field in fields(HeldGrips):
                getattr(result, field.name)[better] = getattr(other, field.name)[better]
        if progress is not None:
            progress(len(goal))
        return result

    parts = in_chunks(solve, len(position), device, threads)
    names = [field.name for field in fields(HeldGrips)]
    return HeldGrips(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def held_grips(rods: HeldRods, converged: np.ndarray) -> HeldGrips:
    """Read the rods' equilibria out."""
    shape, force = rods.shape(), rods.force()
    lift = rods.lift()
    edge = np.diff(shape[:, -2:], axis=1)[:, 0]
    return HeldGrips(
        position=shape[:, -1].copy(),
        converged=converged.copy(),
        admissible=converged & (lift > _CLEARANCE) & (force[:, 2] > _FORCE),
        stable=rods.negative_pivots() == 0,
        force=force,
        moment=rods.moment(),
        tangent=edge / np.linalg.norm(edge, axis=1, keepdims=True),
        stiffness=rods.stiffness.numpy().copy(),
        clearance=shape[:, :, 2].min(axis=1),
        shape=shape,
        iterations=rods.iterations.numpy().copy(),
    )


def taut_position(position: np.ndarray, suspended_length: np.ndarray) -> np.ndarray:
    """(n, 3) points in the same directions at which a rod is taut.

    Towards -x the rod folds back at the contact, and the fold takes up some length, of short rods a
    share and of long ones a few L_gb.
    """
    distance = np.linalg.norm(position, axis=1, keepdims=True)
    direction = position / np.maximum(distance, 1e-12)
    angle = np.arccos(np.clip(direction[:, :1], -1.0, 1.0))
    length = suspended_length[:, None]
    return direction * (0.99 * length - 0.09 * angle / np.pi * np.minimum(length, 15.0))


def grasp_shapes(ls, kappa, ks, edge_count, device, threads) -> np.ndarray:
    """(n, edge_count + 1, 3) optimal grasps to start from; equal inputs are solved once.

    Raises:
        GraspError: a grasp that did not converge.
    """
    unique, index = np.unique(np.column_stack([ls, kappa, ks]), axis=0, return_inverse=True)
    grasps = solve_grasps(
        *unique.T, edge_count=edge_count, extrapolate=False, device=device, threads=threads
    )
    if not grasps.converged.all():
        bad = unique[np.argmin(grasps.converged)]
        raise GraspError(
            f"no optimal grasp to start from at suspended length {bad[0]:g} L_gb, curvature "
            f"{bad[1]:g} / L_gb, stretch ratio {bad[2]:g}"
        )
    return grasps.shape[index.ravel()]


def in_chunks(solve: Callable, count: int, device: str, threads: int | None) -> list:
    """`solve(slice)` over chunks of `count` rods, on the CPU by several threads."""
    workers = 1 if device != "cpu" else worker_threads(threads)
    size = _CPU_CHUNK if device == "cpu" else _CUDA_CHUNK
    size = max(1, min(size, -(-count // workers)))
    chunks = [slice(i, min(i + size, count)) for i in range(0, count, size)]
    if workers == 1 or len(chunks) == 1:
        return [solve(chunk) for chunk in chunks]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(solve, chunks))
