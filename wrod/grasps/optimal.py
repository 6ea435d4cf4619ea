"""Optimal grasps of the suspended rod (Eq. optimize), batched.

Everything here is dimensionless: lengths in L_gb, forces in k_b / L_gb^2, weight 1/2 per length;
the contact frame has x along the pattern, z up, and a positive curvature turns left, towards +y.
"""

from __future__ import annotations

import os
import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.general import curved_rods, solve_general
from wrod.grasps.inputs import LIMITS, GraspArrays
from wrod.grasps.levels import Ladder, compile_kernels
from wrod.grasps.results import SENSITIVITIES, empty_results
from wrod.grasps.solver import held_batch
from wrod.kernels.grasping import closures
from wrod.kernels.grasping.reading import Results
from wrod.solvers.stability import smallest_eigenvalue

CLOSURES = {
    "zero_tension": int(closures.ZERO_TENSION),
    "min_force": int(closures.MIN_FORCE),
    "min_friction": int(closures.MIN_FRICTION),
}
EDGE_COUNT = 128

# Grasps solved at once: few on a CPU, whose cache they should not leave; many on a GPU.
_CPU_CHUNK, _CUDA_CHUNK = 128, 65536
# Most of a GPU's memory that is kept from call to call.
_KEPT_SHARE = 0.1


@dataclass(frozen=True)
class Grasps:
    """Optimal grasps, one per input (float64 NumPy, or tensors or Warp arrays
    on the device as the inputs were; dimensionless).

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


@arguments.checked(
    GraspError,
    suspended_length=arguments.array(finite=False),
    curvature=arguments.array(finite=False),
    stretch_ratio=arguments.array(finite=False),
    natural_curvature=arguments.optional(arguments.array((2,), (None, 2), finite=False)),
    sensitivities=arguments.flag,
    eigenvalues=arguments.flag,
    shapes=arguments.flag,
    extrapolate=arguments.flag,
    closure=arguments.text,
    poisson=arguments.number(-1.0, 0.5),
    device=arguments.optional(arguments.text),
    edge_count=arguments.whole(4, 4096),
    threads=arguments.optional(arguments.whole(0, 4096)),
    progress=arguments.optional(arguments.callback),
)
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
    inputs = GraspArrays.of(suspended_length, curvature, stretch_ratio, device=device)
    natural = _natural_curvature(natural_curvature, len(inputs))
    if natural is not None:
        if sensitivities:
            raise GraspError("sensitivities are known for naturally straight rods only")
        if not -1.0 < poisson <= 0.5:
            raise GraspError(f"poisson is {poisson!r}; an elastic rod needs a value in (-1, 0.5]")
        return _solve_curved(
            inputs, natural, poisson, closure, edge_count, extrapolate, eigenvalues, shapes,
            threads, progress,
        )  # fmt: skip
    rods = len(inputs)
    out = empty_results(
        rods,
        edge_count,
        inputs.device,
        sensitivities=sensitivities,
        shapes=shapes or eigenvalues,
    )
    workers = 1 if inputs.device != "cpu" else (threads or os.cpu_count() or 1)
    size = _CPU_CHUNK if inputs.device == "cpu" else _CUDA_CHUNK
    size = max(1, min(size, -(-rods // workers)))

    def solve(first: int, ladder: Ladder) -> None:
        count = min(size, rods - first)
        ladder.solve(
            inputs.arrays,
            first,
            count,
            closure=CLOSURES[closure],
            extrapolate=extrapolate,
            out=out,
        )
        if progress is not None:
            progress(count)

    compile_kernels(inputs.device, sensitivities)
    spare: queue.SimpleQueue[Ladder] = queue.SimpleQueue()
    for _ in range(min(workers, -(-rods // size))):
        spare.put(_ladder(size, edge_count, inputs.device, sensitivities))

    def solve_with_spare(first: int) -> None:
        ladder = spare.get()
        solve(first, ladder)
        spare.put(ladder)

    firsts = range(0, rods, size)
    if workers > 1 and len(firsts) > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(solve_with_spare, firsts))
    else:
        for first in firsts:
            solve_with_spare(first)
    if inputs.device != "cpu":
        _keep(spare.get())
    eigenvalue = _eigenvalues(inputs, out, edge_count) if eigenvalues else None
    return _grasps(inputs, out, eigenvalue, shapes)


# Room on a GPU that the last call left, for the next of its kind: taking it from the driver costs
# as much as solving thousands of grasps.
_kept: list[Ladder] = []


def _ladder(rods: int, edges: int, device: str, sensitivities: bool) -> Ladder:
    kept = _kept.pop() if _kept and device != "cpu" else None
    if kept is not None and kept.fits(rods, edges, device, sensitivities):
        return kept
    return Ladder(rods, edges, device, sensitivities)


def _keep(ladder: Ladder) -> None:
    if ladder.byte_count < _KEPT_SHARE * wp.get_device(ladder.device).total_memory:
        _kept[:] = [ladder]


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


def _solve_curved(
    inputs, natural, poisson, closure, edge_count, extrapolate, eigenvalues, shapes, threads,
    progress,
) -> Grasps:  # fmt: skip
    length, curvature, stretch_ratio = inputs.numpy()
    fields = solve_general(
        length,
        curvature,
        stretch_ratio,
        lambda edges: curved_rods(length, stretch_ratio, natural, poisson, edges),
        roll=np.zeros(len(length)),
        closure=CLOSURES[closure],
        device=inputs.device,
        edge_count=edge_count,
        extrapolate=extrapolate,
        eigenvalues=eigenvalues,
        shapes=shapes,
        threads=threads,
        progress=progress,
    )
    if inputs.kind == "numpy":
        return Grasps(**fields)
    arrays = {k: wp.array(v, device=inputs.device) for k, v in fields.items()}
    return Grasps(**{k: inputs.result(v) for k, v in arrays.items()})


def _grasps(inputs: GraspArrays, out: Results, eigenvalue, shapes: bool) -> Grasps:
    names = ["position", "rotation", "force", "force_jacobian", "converged", "stable"]
    names += ["iterations", "residual"]
    if shapes:
        names += ["shape", "arc_length"]
    if out.position_sensitivity.shape[0]:
        names += SENSITIVITIES
    values = {name: inputs.result(getattr(out, name)) for name in names}
    return Grasps(**values, eigenvalue=eigenvalue)


def _eigenvalues(inputs: GraspArrays, out: Results, edge_count: int):
    """(n,) smallest eigenvalue of the Hessian of every rod, held at the contact and at the grip."""
    _, kappa, ks = inputs.numpy()
    shape, arc_length = out.shape.numpy(), out.arc_length.numpy()
    batch = held_batch(kappa, ks, np.diff(arc_length, axis=1), shape, inputs.device)
    value = smallest_eigenvalue(batch)
    return inputs.result(wp.array(value, dtype=wp.float64, device=inputs.device))
