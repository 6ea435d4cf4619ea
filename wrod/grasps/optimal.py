"""Optimal grasps of the suspended rod (Eq. optimize), batched.

Everything here is dimensionless: lengths in L_gb, forces in k_b / L_gb^2, weight 1/2 per length;
the contact frame has x along the pattern, z up, and a positive curvature turns left, towards +y.
"""

import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.device_results import FIELDS, SHAPES, at_once, empty_results, result_bytes
from wrod.grasps.general import RodArrays, curved_rods, solve_general
from wrod.grasps.held_rods import held_batch
from wrod.grasps.inputs import GraspArrays, GraspOptions, closure_number
from wrod.grasps.levels import Ladder, compile_kernels
from wrod.grasps.results import LIMITS, SENSITIVITIES, Grasps
from wrod.kernels.grasping.reading import Results
from wrod.machine import worker_threads
from wrod.solvers.recording import launching
from wrod.solvers.stability import smallest_eigenvalue

EDGE_COUNT = 128

# Grasps solved at once: few on a CPU, whose cache they should not leave; many on a GPU.
_CPU_CHUNK, _CUDA_CHUNK = 128, 65536
# Most of a GPU's memory that is kept from call to call.
_KEPT_SHARE = 0.1


@launching()
@arguments.checked(
    GraspError,
    suspended_length=arguments.array(finite=False, anywhere=True),
    curvature=arguments.array(finite=False, anywhere=True),
    stretch_ratio=arguments.array(finite=False, anywhere=True),
    natural_curvature=arguments.optional(arguments.array((2,), (None, 2), finite=False)),
    poisson=arguments.number(-1.0, 0.5),
    edge_count=arguments.whole(4, 4096),
    threads=arguments.optional(arguments.whole(0, 4096)),
)
def solve_grasps(
    suspended_length,
    curvature,
    stretch_ratio,
    *,
    closure: str = "zero_tension",
    natural_curvature=None,
    poisson: float = 0.5,
    device: arguments.DeviceLike = None,
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
        threads: CPU threads; default: one per core, but no more than OMP_NUM_THREADS says.
        progress: called with the number of grasps done after every chunk.

    Raises:
        GraspError: an input is not finite or outside `LIMITS`, or an unknown closure.
    """
    number = closure_number(closure)
    if sensitivities and closure != "zero_tension":
        raise GraspError(f"sensitivities need closure 'zero_tension', not {closure!r}")
    if edge_count < 16 or edge_count % 2:
        raise GraspError(f"edge_count is {edge_count}; use an even number from 16")
    inputs = GraspArrays.of(suspended_length, curvature, stretch_ratio, device=device)
    natural = _natural_curvature(natural_curvature, len(inputs))
    options = GraspOptions(
        number, inputs.device, edge_count, extrapolate, eigenvalues, shapes, threads, progress
    )
    if natural is None:
        return _solve_straight(inputs, sensitivities, options)
    if sensitivities:
        raise GraspError("sensitivities are known for naturally straight rods only")
    if not -1.0 < poisson <= 0.5:
        raise GraspError(f"poisson is {poisson!r}; an elastic rod needs a value in (-1, 0.5]")
    return _solve_curved(inputs, natural, poisson, options)


def solve_twisted(
    suspended_length, curvature, stretch_ratio, twist, *, closure: str, poisson: float, device=None
) -> Grasps:
    """`solve_grasps` of straight rods that the laid part twists besides: by its moment there is so
    much `twist` (n,) [1/L_gb] between contact and grip, which poses and shapes leave out."""
    inputs = GraspArrays.of(suspended_length, curvature, stretch_ratio, device=device)
    length, kappa, ratio = inputs.numpy()
    number = closure_number(closure)

    def rods(edges: int) -> RodArrays:
        straight = curved_rods(length, ratio, np.zeros((len(length), 2)), poisson, edges)
        # Laid and hanging as if it were not twisted, a rod twisted at rest has that moment.
        return straight | {"natural_twist": np.repeat(-twist[:, None], edges + 1, axis=1)}

    options = GraspOptions(number, inputs.device, EDGE_COUNT, True, True, True, None, None)
    fields = solve_general(length, kappa, ratio, rods, np.zeros(len(length)), options)
    return Grasps(**{**fields, "twist": None})


def _solve_straight(inputs: GraspArrays, sensitivities: bool, options: GraspOptions) -> Grasps:
    rods, device, edges = len(inputs), inputs.device, options.edge_count
    room = options.shapes or options.eigenvalues
    workers = 1 if device != "cpu" else worker_threads(options.threads)
    size = _CPU_CHUNK if device == "cpu" else _CUDA_CHUNK
    size = max(1, min(size, -(-rods // workers)))
    ladder = _kept_ladder(size, edges, device, sensitivities)
    kept = result_bytes(edges, sensitivities=sensitivities, shapes=room)
    working = 0.0 if ladder else workers * Ladder.bytes_each(edges, device)
    size = at_once(rods, size, kept, working, device)
    out = empty_results(rods, edges, device, sensitivities=sensitivities, shapes=room)
    compile_kernels(device, sensitivities)
    spare: queue.SimpleQueue[Ladder] = queue.SimpleQueue()
    for _ in range(min(workers, -(-rods // size))):
        spare.put(ladder or Ladder(size, edges, device, sensitivities))

    def solve(first: int) -> None:
        count, ladder = min(size, rods - first), spare.get()
        try:
            ladder.solve(
                inputs.arrays,
                first,
                count,
                closure=options.closure,
                extrapolate=options.extrapolate,
                out=out,
            )
        finally:
            spare.put(ladder)  # a thread whose rods failed goes on to others, and waits for one
        if options.progress is not None:
            options.progress(count)

    firsts = range(0, rods, size)
    if workers > 1 and len(firsts) > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(solve, firsts))
    else:
        for first in firsts:
            solve(first)
    if device != "cpu" and rods:
        _keep(spare.get())
    eigenvalue = _eigenvalues(inputs, out) if options.eigenvalues else None
    return _grasps(inputs, out, eigenvalue, options.shapes)


# Room on a GPU that the last call left, for the next of its kind: taking it from the driver costs
# as much as solving thousands of grasps.
_kept: list[Ladder] = []


def _kept_ladder(rods: int, edges: int, device: str, sensitivities: bool) -> Ladder | None:
    """The room that was kept, if it is what a call wants; else it is given back."""
    kept = _kept.pop() if _kept and device != "cpu" else None
    return kept if kept and kept.fits(rods, edges, device, sensitivities) else None


def _keep(ladder: Ladder) -> None:
    size = ladder.rods * Ladder.bytes_each(ladder.levels[-1].edges, ladder.device)
    if size < _KEPT_SHARE * wp.get_device(ladder.device).total_memory:
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
        raise GraspError(
            "natural_curvature must be (2,) or (n, 2): towards +y and +z [1/L_gb]"
        ) from None
    bad = np.flatnonzero(~((value >= low) & (value <= high)).all(axis=1))
    if bad.size:
        raise GraspError(
            f"natural_curvature[{bad[0]}] is {value[bad[0]].tolist()}, outside the {low:g} to "
            f"{high:g} that can be solved (dimensionless: times L_gb)"
        )
    return value


def _solve_curved(inputs: GraspArrays, natural, poisson: float, options: GraspOptions) -> Grasps:
    length, curvature, stretch_ratio = inputs.numpy()
    fields = solve_general(
        length,
        curvature,
        stretch_ratio,
        lambda edges: curved_rods(length, stretch_ratio, natural, poisson, edges),
        np.zeros(len(length)),
        options,
    )
    if inputs.kind == "numpy":
        return Grasps(**fields)
    arrays = {k: wp.array(v, device=inputs.device) for k, v in fields.items()}
    return Grasps(**{k: inputs.result(v) for k, v in arrays.items()})


def _grasps(inputs: GraspArrays, out: Results, eigenvalue, shapes: bool) -> Grasps:
    names = FIELDS + SHAPES if shapes else FIELDS
    if out.position_sensitivity.shape[1]:
        names += SENSITIVITIES
    values = {name: inputs.result(getattr(out, name)) for name in names}
    return Grasps(**values, eigenvalue=eigenvalue)


def _eigenvalues(inputs: GraspArrays, out: Results):
    """(n,) smallest eigenvalue of the Hessian of every rod, held at the contact and at the grip."""
    _, _, ks = inputs.numpy()
    shape, arc_length = out.shape.numpy(), out.arc_length.numpy()
    value = np.zeros(0)
    if len(ks):
        batch = held_batch(ks, np.diff(arc_length, axis=1), shape, inputs.device)
        value = smallest_eigenvalue(batch)
    return inputs.result(wp.array(value, dtype=wp.float64, device=inputs.device))
