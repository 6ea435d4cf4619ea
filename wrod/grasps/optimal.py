"""Optimal grasps of the suspended rod (Eq. optimize), batched.

Everything here is dimensionless: lengths in L_gb, forces in k_b / L_gb^2, weight 1/2 per length;
the contact frame has x along the pattern, z up, and a positive curvature turns left, towards +y.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np

from wrod.errors import GraspError
from wrod.grasps.curved import CurvedGraspSolver
from wrod.grasps.mesh import MIRROR, MIRROR_ROTATION
from wrod.grasps.solver import GraspSolution, GraspSolver
from wrod.kernels.grasping import straight as grasping
from wrod.rods.batch import resolve_device

CLOSURES = {
    "zero_tension": int(grasping.ZERO_TENSION),
    "min_force": int(grasping.MIN_FORCE),
    "min_friction": int(grasping.MIN_FRICTION),
}
EDGE_COUNT = 128

# Inputs that are solved; beyond them grasps do not exist, or have never been checked.
LIMITS = {
    "suspended_length": (0.2, 100.0),
    "curvature": (-5.0, 5.0),
    "stretch_ratio": (50.0, 1e5),
    "natural_curvature": (-1.0, 1.0),
}
# Grasps solved at once: few on a CPU, whose cache they should not leave; many on a GPU.
_CPU_CHUNK, _CUDA_CHUNK = 128, 32768


@dataclass(frozen=True)
class Grasps:
    """Optimal grasps, one per input (float64 NumPy, dimensionless).

    Attributes:
        position: (n, 3) grip position in the contact frame [L_gb].
        rotation: (n, 3) rotation vector of the rod's material frame at the grip: R x is the tangent
            there. A naturally straight rod has no twist between contact and grip [rad].
        force: (n, 3) force on the suspended rod at the contact [k_b/L_gb^2].
        converged: (n,) an admissible and stable equilibrium to the tolerance: z >= 0 everywhere,
            F_z >= 0. Only these are results.
        stable: (n,) the held grasp is stable (no negative eigenvalue of the constrained Hessian).
        eigenvalue: (n,) how far the held grasp is from instability: the smallest eigenvalue of that
            Hessian, the stiffness per length of its softest motion [k_b/L_gb^4]; or None.
        iterations: (n,) Newton iterations, all meshes together.
        residual: (n,) largest unbalanced force on the finest mesh [k_b/L_gb^2].
        force_jacobian: (n, 3, 3) derivative of `force` by the grip position, contact held.
        shape: (n, node, 3) the rod from contact to grip on the finest mesh [L_gb], or None.
        arc_length: (n, node) unstretched arc length of its nodes [L_gb], or None.
        twist: (n,) angle by which the rod is twisted between contact and grip, which may be more
            than a turn [rad]; None for naturally straight rods, which are not twisted.
        position_sensitivity, rotation_sensitivity, force_sensitivity: (n, 3, 3) derivatives of
            component i by input j of (suspended_length, curvature, stretch_ratio), or None.
    """

    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    converged: np.ndarray
    stable: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray
    force_jacobian: np.ndarray
    shape: np.ndarray | None = None
    arc_length: np.ndarray | None = None
    twist: np.ndarray | None = None
    eigenvalue: np.ndarray | None = None
    position_sensitivity: np.ndarray | None = None
    rotation_sensitivity: np.ndarray | None = None
    force_sensitivity: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.position)


def solve_grasps(
    suspended_length,
    curvature,
    stretch_ratio,
    *,
    closure: str = "zero_tension",
    natural_curvature=None,
    poisson: float = 0.5,
    device: str | None = None,
    sensitivities: bool = False,
    eigenvalues: bool = False,
    shapes: bool = True,
    edge_count: int = EDGE_COUNT,
    extrapolate: bool = True,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> Grasps:
    """Optimal grasps for arrays of (l_s, kappa, k_s), each from a cold start.

    Every grasp is continued from that of a straight pattern on a mesh of half the edges, which
    keeps it on the gentle branch, then refined; the two meshes are second order, and extrapolating
    them (Richardson) leaves errors below 1e-3 over the whole range.

    Args:
        suspended_length, curvature, stretch_ratio: arrays that broadcast to (n,):
            l_s [L_gb], signed kappa [1/L_gb], k_s [-].
        closure: "zero_tension", "min_force" or "min_friction": how the one freedom that mechanics
            leaves is used.
        natural_curvature: curvature of the rod at rest [1/L_gb], (2,) or (n, 2): towards +y (left)
            and +z (up) of the contact frame when the rod lies there straight; None and zeros are a
            straight rod. The laid rod keeps this roll, untwisted, and the grip's roll sees to it:
            `rotation` includes the twist between contact and grip.
        poisson: Poisson's ratio, for the twisting stiffness of a naturally curved rod.
        device: "cpu", "cuda:0", "auto" or None (the first CUDA device if there is one).
        sensitivities: return the derivatives by the inputs as well ("zero_tension" only).
        eigenvalues: return the smallest eigenvalue of each grasp as well.
        shapes: return the rods' shapes as well.
        edge_count: edges of the finest mesh, even.
        extrapolate: combine both meshes; without it the results are those of the finest mesh.
        threads: CPU threads; default: one per core.
        progress: called with the number of grasps done after every chunk.

    Raises:
        GraspError: an input is not finite or outside `LIMITS`, or an unknown closure.
    """
    if closure not in CLOSURES:
        raise GraspError(f"unknown closure {closure!r}; use one of {', '.join(CLOSURES)}")
    if sensitivities and closure != "zero_tension":
        raise GraspError(f"sensitivities need closure 'zero_tension', not {closure!r}")
    if edge_count < 16 or edge_count % 2:
        raise GraspError(f"edge_count is {edge_count}; use an even number from 16")
    ls, kappa, ks = check_inputs(suspended_length, curvature, stretch_ratio)
    natural = _natural_curvature(natural_curvature, len(ls))
    if natural is not None:
        if sensitivities:
            raise GraspError("sensitivities are known for naturally straight rods only")
        if not -1.0 < poisson <= 0.5:
            raise GraspError(f"poisson is {poisson!r}; an elastic rod needs a value in (-1, 0.5]")
        # Right turns are solved as left turns of the mirrored rod.
        natural[kappa < 0, 0] *= -1.0
    device = resolve_device(device)
    size = _CPU_CHUNK if device == "cpu" else _CUDA_CHUNK
    workers = 1 if device != "cpu" else (threads or os.cpu_count() or 1)
    size = max(1, min(size, -(-len(ls) // workers)))
    chunks = [slice(i, i + size) for i in range(0, len(ls), size)]

    def solve(chunk: slice) -> GraspSolution:
        result = _solve_chunk(
            ls[chunk],
            np.abs(kappa[chunk]),
            ks[chunk],
            CLOSURES[closure],
            device,
            edge_count,
            extrapolate,
            sensitivities,
            eigenvalues,
            shapes,
            None if natural is None else natural[chunk],
            poisson,
        )
        if progress is not None:
            progress(len(result.position))
        return result

    if workers > 1 and len(chunks) > 1:
        with ThreadPoolExecutor(workers) as pool:
            parts = list(pool.map(solve, chunks))
    else:
        parts = [solve(chunk) for chunk in chunks]
    return _grasps(parts, kappa, sensitivities)


def check_inputs(*inputs) -> tuple[np.ndarray, ...]:
    """(l_s, kappa, k_s) and anything after them as arrays of one shape (n,), or GraspError."""
    arrays = [np.asarray(value, dtype=np.float64) for value in inputs]
    try:
        arrays = [np.atleast_1d(a) for a in np.broadcast_arrays(*arrays)]
    except ValueError:
        shapes = ", ".join(str(a.shape) for a in arrays)
        raise GraspError(f"grasp inputs have shapes {shapes}, which do not broadcast") from None
    if arrays[0].ndim != 1:
        raise GraspError(f"grasp inputs have shape {arrays[0].shape}; give one-dimensional arrays")
    names = ("suspended_length", "curvature", "stretch_ratio")
    for name, value in zip(names, arrays, strict=False):
        low, high = LIMITS[name]
        bad = np.flatnonzero(~((value >= low) & (value <= high)))
        if bad.size:
            raise GraspError(
                f"{name}[{bad[0]}] is {value[bad[0]]:g}, outside the {low:g} to {high:g} that can "
                "be solved (dimensionless: lengths over L_gb, curvature times L_gb)"
            )
    return tuple(np.array(a) for a in arrays)


def _natural_curvature(value, count: int) -> np.ndarray | None:
    """(count, 2) natural curvatures, or None for straight rods."""
    value = np.asarray(0.0 if value is None else value, dtype=np.float64)
    if not np.any(value):  # a NaN counts as curved, and is refused below
        return None
    low, high = LIMITS["natural_curvature"]
    try:
        value = np.array(np.broadcast_to(value, (count, 2)))
    except ValueError:
        value = np.full((count, 3), np.nan)
    if value.shape != (count, 2):
        raise GraspError("natural_curvature must be (2,) or (n, 2): towards +y and +z [1/L_gb]")
    bad = np.flatnonzero(~((value >= low) & (value <= high)).all(axis=1))
    if bad.size:
        raise GraspError(
            f"natural_curvature[{bad[0]}] is {value[bad[0]].tolist()}, outside the {low:g} to "
            f"{high:g} that can be solved (dimensionless: times L_gb)"
        )
    return value


def _solve_chunk(
    ls,
    kappa,
    ks,
    closure,
    device,
    edge_count,
    extrapolate,
    sensitivities,
    eigenvalues,
    shapes,
    natural,
    poisson,
) -> GraspSolution:
    """Coarse from a cold start, fine from coarse, then both combined."""

    def level(chosen, edges, guess=None, thrust=None) -> tuple[GraspSolver, GraspSolution]:
        kind, rod = GraspSolver, {}
        if natural is not None:
            kind, rod = CurvedGraspSolver, {"natural_curvature": natural[chosen]}
            rod["poisson"] = poisson
        solver = kind(
            ls[chosen],
            kappa[chosen],
            ks[chosen],
            edge_count=edges,
            closure=closure,
            device=device,
            guess=guess,
            thrust=thrust,
            **rod,
        ).run()
        return solver, solver.solution(
            sensitivities=sensitivities,
            # Those of the coarse mesh are of no use: nothing is extrapolated from them.
            eigenvalues=eigenvalues and edges == edge_count,
            shapes=shapes,
        )

    everything = slice(None)
    solver, coarse = level(everything, edge_count // 2)
    _, fine = level(everything, edge_count, solver.refined(), coarse.thrust)
    fine.converged &= coarse.converged
    fine.iterations += coarse.iterations
    lost = np.flatnonzero(~fine.converged)
    if lost.size:
        # Too coarse a mesh to start from: start on the fine one and come back from there.
        solver, cold = level(lost, edge_count)
        _, back = level(lost, edge_count // 2, solver.coarsened(), cold.thrust)
        cold.converged &= back.converged
        cold.iterations += back.iterations + fine.iterations[lost]
        _put(coarse, lost, back)
        _put(fine, lost, cold)
    if extrapolate:
        coarse.rotation = _same_way_round(coarse.rotation, fine.rotation)
        for name in _EXTRAPOLATED:
            value = getattr(fine, name)
            if value is not None:
                setattr(fine, name, (4.0 * value - getattr(coarse, name)) / 3.0)
    admissible = (fine.lowest > -1e-6) & (fine.force[:, 2] > 0)
    fine.converged &= admissible & fine.stable & (fine.turning < _GENTLE)
    return fine


_EXTRAPOLATED = (
    "position",
    "rotation",
    "twist",
    "force",
    "force_jacobian",
    "position_sensitivity",
    "rotation_sensitivity",
    "force_sensitivity",
)
# Grasps on the gentle branch turn by less than this, those that have looped by more.
_GENTLE = 2.0 * np.pi


def _same_way_round(vectors: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) of the same rotations, with no full turn between them and `like`:
    those of two meshes may lie on either side of half a turn."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    axis = vectors / np.maximum(angle, 1e-300)
    turns = np.rint(((like - vectors) * axis).sum(axis=1, keepdims=True) / (2.0 * np.pi))
    return vectors + 2.0 * np.pi * turns * axis


def _put(target: GraspSolution, where: np.ndarray, source: GraspSolution) -> None:
    for field in fields(GraspSolution):
        value = getattr(target, field.name)
        if value is not None and getattr(source, field.name) is not None:
            value[where] = getattr(source, field.name)


def _grasps(parts: list[GraspSolution], kappa: np.ndarray, sensitivities: bool) -> Grasps:
    """Join the chunks and mirror the right turns: y -> -y, and inputs by -kappa."""

    def join(name):
        return np.concatenate([getattr(part, name) for part in parts])

    right = kappa < 0
    twist = None if parts[0].twist is None else np.where(right, -1.0, 1.0) * join("twist")
    position, rotation, force = join("position"), join("rotation"), join("force")
    jacobian = join("force_jacobian")
    shape = None if parts[0].shape is None else join("shape")
    position[right] *= MIRROR
    force[right] *= MIRROR
    rotation[right] *= MIRROR_ROTATION
    if shape is not None:
        shape[right] *= MIRROR
    jacobian[right] *= np.outer(MIRROR, MIRROR)
    extra = {}
    if parts[0].eigenvalue is not None:
        extra["eigenvalue"] = join("eigenvalue")
    if sensitivities:
        for name, mirror in (
            ("position_sensitivity", MIRROR),
            ("rotation_sensitivity", MIRROR_ROTATION),
            ("force_sensitivity", MIRROR),
        ):
            extra[name] = join(name)
            extra[name][right] *= np.outer(mirror, [1.0, -1.0, 1.0])
    return Grasps(
        position,
        rotation,
        force,
        join("converged"),
        join("stable"),
        join("iterations"),
        join("residual"),
        jacobian,
        shape,
        None if parts[0].arc_length is None else join("arc_length"),
        twist,
        **extra,
    )
